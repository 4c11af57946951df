//! Methods that reconstruct an object from one raw frame: the networks, and the classical methods they are compared
//! with.
//!
//! ```
//! use ndarray::Array2;
//! use ommatidia_network::methods::{Reconstruct, Wiener, WienerSetup};
//! use ommatidia_physics::sensor::{FrameInput, SensorMaps};
//!
//! // A PSF with two foci, 12 pixels apart: the image of a point at object pixel (4, 4).
//! let mut psf_dn = Array2::zeros((32, 32));
//! (psf_dn[[8, 8]], psf_dn[[20, 20]]) = (1.0, 0.5);
//! // An object with one bright pixel, and its frame on a black level of 64 DN.
//! let mut object = Array2::<f32>::zeros((8, 8));
//! object[[2, 5]] = 100.0;
//! let mut frame_dn = Array2::from_elem((32, 32), 64.0);
//! (frame_dn[[6, 9]], frame_dn[[18, 21]]) = (164.0, 114.0);
//!
//! let input = FrameInput::new(64.0, SensorMaps::default(), [32, 32])?;
//! let setup = WienerSetup { object: [8, 8], source: [4, 4], relative_k: 1e-4 };
//! let found = Wiener::new(input, psf_dn.view(), setup)?.reconstruct(frame_dn.view())?;
//! assert!((&found - &object).iter().all(|error| error.abs() < 0.5));
//! # Ok::<(), anyhow::Error>(())
//! ```

mod admm;
mod central;
mod error;
mod float_network;
mod frame;
mod network_file;
mod reconstruct;
mod registry;
mod richardson_lucy;
mod wiener;

pub use admm::{AdmmConfig, LowRankAdmm, ShiftInvariantAdmm};
pub use central::Central;
pub use error::MethodError;
pub use float_network::FloatNetwork;
pub use frame::frame_range;
pub use reconstruct::{Reconstruct, title};
pub use registry::MethodKind;
pub use richardson_lucy::{RichardsonLucy, RichardsonLucyConfig};
pub use wiener::{Wiener, WienerConfig, WienerSetup};
