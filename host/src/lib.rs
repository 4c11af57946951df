//! Ommatidia on the workstation: from a measured session to a network on a microcontroller.
//!
//! The way of the data: [`session`] -> [`bead`] -> [`psf`] -> [`instrument::Instrument`] -> [`forward`] ->
//! data set -> [`train`] -> checkpoint -> [`quantize`] -> blob -> firmware. Each arrow is one [`artifact`] on
//! disk and one verb of [`cli`].

pub mod artifact;
pub mod bead;
pub mod bench;
pub mod calibrate;
pub mod cli;
pub mod closing;
pub mod dataset;
pub mod device;
pub mod effects;
pub mod evaluate;
pub mod fft2;
pub mod forward;
pub mod instrument;
pub mod kind;
pub mod linalg;
pub mod methods;
pub mod metrics;
pub mod network_file;
pub mod noise;
pub mod optics;
pub mod psf;
pub mod quantize;
pub mod report;
pub mod rng;
pub mod scene;
pub mod sensor;
pub mod session;
pub mod study;
pub mod testing;
pub mod train;
