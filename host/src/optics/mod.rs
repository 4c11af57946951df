//! Physical optics with units: chief rays, aberrations, and the point-spread function of a pupil.
//!
//! Scalar Fraunhofer diffraction: the field in the image of a point is the Fourier transform of the pupil function
//! (Goodman, Introduction to Fourier Optics, section 6.2); its squared modulus, integrated over pixels, is the PSF.

mod error;
mod geometry;
mod pupil;
mod zernike;

pub use error::OpticsError;
pub use geometry::{ArrayLayout, MicrolensArray};
pub use pupil::{Psf, PsfScratch, Pupil, PupilConfig};
pub use zernike::{NOLL_COUNT, Wavefront, noll, zernike};
