//! From a bead scan to PSF samples: find the chief rays, cut the windows, check what was measured.

mod error;
mod extent;
mod rays;
mod scan;
mod windows;

pub use error::{BeadError, Warning};
pub use extent::extent;
pub(crate) use rays::PASSES;
pub use rays::{RayFit, fit_chief_rays};
pub(crate) use scan::check_grid;
pub use scan::{Bead, BeadScan};
pub use windows::{BeadScale, LensWindows, cut_windows};
