//! Physical optics with units: chief rays, aberrations, and the point-spread function of a pupil.
//!
//! Scalar Fraunhofer diffraction: the field in the image of a point is the Fourier transform of the pupil function
//! (Goodman, Introduction to Fourier Optics, section 6.2). Its squared modulus, integrated over pixels, is the PSF.
//!
//! ```
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! use ommatidia_physics::optics::{MicrolensArray, Psf, PupilConfig, Wavefront};
//! let config = PupilConfig {
//!     wavelength_um: 0.5,
//!     aperture_um: 100.0,
//!     distance_um: 1000.0,
//!     soft_edge: 0.0,
//!     pixel_um: 1.5,
//!     oversampling: 3,
//!     field_px: 63,
//! };
//! let pupil = config.build()?;
//! let (mut scratch, mut psf) = (pupil.scratch(), Psf::default());
//! // A focus without aberrations, centred on the middle pixel (31, 31).
//! pupil.psf(&Wavefront::default(), [0.0, 0.0], &mut scratch, &mut psf);
//! let total: f32 = psf.share.iter().sum();
//! let sharp = psf.share[31 * psf.side + 31];
//! assert!((total - 1.0).abs() < 1e-5); // all of the light
//!
//! // A quarter wave rms of defocus (Noll's Z_4) keeps the light and lowers the peak.
//! let mut wavefront = Wavefront::default();
//! wavefront.coefficient[3] = 0.25;
//! assert_eq!(wavefront.rms_waves(), 0.25);
//! pupil.psf(&wavefront, [0.0, 0.0], &mut scratch, &mut psf);
//! assert!(psf.share[31 * psf.side + 31] < 0.5 * sharp);
//!
//! // A source 100 um off the axis is focused 0.66 * 100 / 1.85 = 35.7 pixels from the anchor.
//! let array = MicrolensArray { object_distance_um: 600.0, magnification: 0.66, pixel_pitch_um: 1.85 };
//! let focus = array.chief_ray_px([50.0, 50.0], [100.0, 0.0]);
//! assert!((focus[0] - 85.676).abs() < 1e-3 && focus[1] == 50.0);
//! # Ok(())
//! # }
//! ```

mod error;
mod geometry;
mod pupil;
mod zernike;

pub use error::OpticsError;
pub use geometry::MicrolensArray;
pub use pupil::{Psf, PsfScratch, Pupil, PupilConfig};
pub use zernike::{NOLL_COUNT, Wavefront, noll, zernike};
