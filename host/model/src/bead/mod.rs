//! From a bead scan to PSF samples: fits the chief rays, removes the background, cuts the windows round the foci, and
//! checks the frames.

mod background;
mod centroids;
mod error;
mod extent;
mod rays;
mod scan;
mod windows;

pub use crate::slopes::{Slopes, slope_terms};
pub use background::{BeadBackground, remove_background};
pub use error::{BeadError, Warning};
pub use extent::{Extent, extent};
pub(crate) use rays::PASSES;
pub use rays::{RayFit, fit_chief_rays};
pub(crate) use scan::check_grid;
pub use scan::{Bead, BeadScan};
pub(crate) use windows::corner;
pub use windows::{BeadCut, cut_windows};
