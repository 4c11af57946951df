//! Pupils that explain calibrated PSFs: what a scan in one plane says of other depths and of other wavefronts.
//!
//! A bead scan in one plane has no PSFs of a specimen that is out of focus. But a PSF that a lens of known kind makes
//! determines the wavefront behind it, but for a sign. Each lens gets a round pupil,
//! ```text
//! h(x) = pixel * |F[P](x)|^2,   P(rho) = exp(-a rho^2 + i sum_k c_k(y, x) Z_k(rho)),   |rho| <= 1
//! ```
//! with Noll's polynomials Z_2 to Z_11, whose coefficients c_k are quadratic in the place (y, x) of the source, and
//! with a cut-off frequency and an apodisation a of its own (`fit`). Each lens is fitted by itself, and then with the
//! apodisation and from the design that most lenses share, which counts where it explains the PSFs as well. Pupils are
//! used only where they explain the PSFs ([`MOST_MISFIT`]), and then only for their *change* when the wavefront
//! changes: the PSFs themselves stay the calibrated ones.
//!
//! The wavefront `-W(-rho)` makes the same PSF as `W(rho)`: even terms (defocus, astigmatism, spherical aberration)
//! have a sign that one plane cannot show. The lenses are taken to be alike, so that they share one sign, and the sign
//! of all is chosen so that their mean defocus is positive. A scan at several depths shows the sign, and how far a
//! wavefront bends with depth (`depths`). Source: Fienup, Applied Optics 21, 2758 (1982), on the twin
//! image; Noll, J. Opt. Soc. Am. 66, 207 (1976).

mod change;
mod depths;
mod fit;
mod kernel;
mod shared;

pub use change::{PupilModel, PupilSummary, Scale, WAVELENGTH_UM, Wavefronts};
pub use shared::Pupils;
pub(crate) use shared::StoredPupils;

/// Relative error (root mean square over the windows of a lens) up to which a pupil counts as the explanation of PSFs.
pub const MOST_MISFIT: f64 = 0.1;
/// Number of Noll's polynomials that are fitted: Z_2 (tilt) to Z_11 (primary spherical aberration).
const TERMS: usize = 10;
/// Number of functions of the field.
const FUNCTIONS: usize = 6;
/// Those from this one on are its squares: y^2, y x and x^2.
const SQUARES: usize = 3;
/// Whether the polynomial Z_(k + 2) is even, so that its sign is unknown.
const EVEN: [bool; TERMS] = [false, false, true, true, true, false, false, false, false, true];

/// The six functions of a quadratic field at (y, x), each from -1 to 1 over the object.
fn field([y, x]: [f64; 2]) -> [f64; FUNCTIONS] {
    [1.0, y, x, y * y, y * x, x * x]
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests;
