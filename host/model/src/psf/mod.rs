//! The spatially varying PSF as a low-rank model (Eqs. 2 and 3 of the paper).
//!
//! From bead windows to the model, then to the operator: [`windows`] are what is fitted, [`decompose`] gives basis
//! PSFs, [`field`] makes their coefficients smooth over the field, [`fit`] does both for all lenses, [`low_rank`] holds
//! the result, and [`operator`] applies it to objects.
//!
//! One lens with one basis PSF, constant over the field:
//!
//! ```
//! use ndarray::{Array2, Array4, Array5};
//! use ommatidia_model::psf::{CalibratedOptics, ChiefRays, LowRankOperator, LowRankPsf, OperatorConfig};
//!
//! let row = vec![0.0, 0.0, 0.0, 0.25, 0.5, 0.25, 0.0, 0.0, 0.0];
//! let psf = LowRankPsf {
//!     basis: Array4::from_shape_vec((1, 1, 3, 3), row)?,
//!     coefficients: Array5::from_elem((1, 1, 1, 1, 1), 8.0), // DN of a unit source
//!     node_depths_um: vec![0.0],
//!     node_rows_px: vec![2.0],
//!     node_cols_px: vec![2.0],
//!     exposure_ms: 10.0,
//! };
//! let rays = ChiefRays { anchors_px: vec![[2.0, 3.0]], magnification: 0.66, dead: vec![false] };
//! let optics = CalibratedOptics { psf: &psf, rays: &rays, object: [5, 5], sensor: [5, 7] };
//! let a = LowRankOperator::plan(optics, &rays, OperatorConfig::default())?;
//!
//! let mut object = Array2::zeros((5, 5));
//! object[[2, 2]] = 1.0; // on the axis: its focus lies at the anchor
//! let light = a.apply(object.view())?;
//! assert!((light[[2, 3]] - 4.0).abs() < 1e-5);
//! assert!((light[[2, 4]] - 2.0).abs() < 1e-5);
//!
//! // The adjoint is the exact transpose: <A x, y> = <x, A' y>.
//! let back = a.adjoint(light.view())?;
//! assert!(((&light * &light).sum() - (&object * &back).sum()).abs() < 1e-4);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod chief_rays;
pub mod decompose;
pub mod field;
pub mod fit;
pub mod growth;
pub mod low_rank;
pub mod nodes;
pub mod operator;
pub mod pupils;
pub mod shift;
pub mod windows;

pub use chief_rays::ChiefRays;
pub use low_rank::LowRankPsf;
pub use operator::{CalibratedOptics, LensImage, LowRankOperator, OperatorConfig, OperatorError};
pub use windows::{BeadScale, LensWindows};
