//! The calibrated model of an instrument: from a bead scan to predicted frames and training pairs.
//!
//! | module | contents |
//! |---|---|
//! | [`bead`] | bead scan -> chief rays and PSF windows |
//! | [`psf`] | the low-rank PSF model: its types, its fit, the forward operator and its transpose |
//! | [`instrument`] | the calibrated instrument as data, and its file |
//! | [`forward`] | object -> frame: optics, then effects in physical order |
//! | [`calibrate`] | the act: session -> instrument |
//! | [`check`] | looks at a session before it is calibrated |
//! | [`dataset`] | instrument -> training pairs on disk |
//! | [`metrics`] | figures of merit: PSNR, SSIM, NRMSE, PCC, chi2 |
//! | [`richardson_lucy`] | frame -> object by the optics alone: the iterations |
//! | [`slopes`] | a plane over a frame: level and slopes of a background |
//! | [`testing`] | synthetic instruments and sessions for the tests of all packages |

pub mod bead;
pub mod calibrate;
pub mod check;
pub mod dataset;
pub mod forward;
pub mod instrument;
pub mod metrics;
pub mod psf;
pub mod richardson_lucy;
pub mod slopes;
pub mod testing;
