//! Measures the noise of a sensor: black level and read noise on darks, gain by photon transfer on flats.
//!
//! Photon transfer (Janesick, *Photon Transfer*, SPIE 2007): over frames of the same light, the variance of a pixel is
//! `var = gain * (mean - black) + (gain * read_noise)^2 + 1/12`. Variances are taken over time, pixel by pixel, so that
//! the fixed pattern does not contribute. The last term is the rounding to whole DN. Lamp flicker moves all pixels
//! together; its variance is measured on the frame means and subtracted.

mod bend;
mod calibration;
mod frames;
mod linearity;
mod notes;
mod reading;
mod response;
mod session;
#[cfg(test)]
mod tests;
mod transfer;
mod video;

pub use bend::Bend;
pub use calibration::{MapErrors, NoiseCalibration, NoiseConfig};
pub use notes::{NoiseError, NoiseNote};
pub use session::measure_noise;
pub use transfer::ROUNDING_DN2;
