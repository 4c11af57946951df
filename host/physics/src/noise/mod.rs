//! The sensor's noise: mixed Poisson-Gaussian, in DN.
//!
//! A pixel that expects `n` electrons reads `y = black + gain * (Poisson(n) + Normal(0, read_noise))`, rounded to
//! whole DN and clipped to `0..=saturation`. Its variance is
//! `var(y) = gain * (E[y] - black) + (gain * read_noise)^2 + 1/12`.
//!
//! [`NoiseModel`] holds the values, [`measure_noise`] measures them on a session's darks and flats, and
//! [`draw_electrons`] draws noise.
//!
//! ```
//! use ommatidia_physics::noise::{NoiseModel, draw_electrons};
//! use ommatidia_session::rng;
//! let noise = NoiseModel::nominal();
//! // Black level 64 DN, gain 0.4 DN/e-, read noise 2 e-: at 1000 e- a pixel expects 464 DN.
//! let variance_dn2 = noise.variance_dn2(464.0);
//! assert!((variance_dn2 - (0.4 * 400.0 + 0.64 + 1.0 / 12.0)).abs() < 1e-9);
//! assert_eq!(noise.full_scale_e(), (4095.0 - 64.0) / 0.4);
//!
//! // Drawn electrons have that variance, up to the rounding and the statistics of 10,000 pixels.
//! let mut electrons = vec![1000.0; 10_000];
//! draw_electrons(&mut electrons, noise.read_noise_e as f32, &mut rng::stream(1, "example", 0));
//! let mean = electrons.iter().sum::<f32>() / 10_000.0;
//! let variance_e2 = electrons.iter().map(|e| (e - mean).powi(2)).sum::<f32>() / 9_999.0;
//! assert!((mean - 1000.0).abs() < 2.0);
//! assert!((variance_e2 / 1004.0 - 1.0).abs() < 0.1);
//! ```

mod draw;
mod measure;
mod model;
mod stats;

pub use draw::{draw_electrons, draw_poisson};
pub use measure::{Bend, MapErrors, NoiseCalibration, NoiseConfig, NoiseError, NoiseNote, ROUNDING_DN2, measure_noise};
pub use model::{NoiseModel, Source, Sources, inverse_response};
