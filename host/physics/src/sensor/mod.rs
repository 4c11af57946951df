//! The pixels of a sensor as calibration knows them, and how a raw frame is checked and corrected.
//!
//! A raw frame y, DN, becomes light x, DN above black on pixels of mean response: `x = (y - black - offset) * inverse`.
//! Networks, classical methods and the bead scan all use
//! [`SensorMaps`] for it, and all that take raw frames check them with [`FrameInput`]. [`sensor_codes`] converts a
//! frame to the codes that a device receives.
//!
//! ```
//! use ndarray::{Array2, array};
//! use ommatidia_physics::sensor::{FrameError, FrameInput, SensorMaps};
//!
//! let maps = SensorMaps {
//!     offset_dn: Some(array![[2.0, 0.0], [0.0, 0.0]]),
//!     inverse_response: Some(array![[1.0, 0.5], [1.0, 1.0]]),
//!     ..SensorMaps::default()
//! };
//! let input = FrameInput::new(64.0, maps, [2, 2])?;
//! let light = input.light_dn(array![[76.0, 84.0], [64.0, 60.0]].view())?;
//! assert_eq!(light, array![[10.0, 10.0], [0.0, -4.0]]);
//! // A frame of another shape is refused.
//! let error = input.light_dn(Array2::zeros((3, 2)).view()).unwrap_err();
//! assert_eq!(error, FrameError::Shape { expected: [2, 2], found: [3, 2] });
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod codes;
mod error;
mod input;
mod maps;
mod watch;

pub use codes::sensor_codes;
pub use error::{FrameError, MapShapeError};
pub use input::FrameInput;
pub use maps::SensorMaps;
pub use watch::{FrameRange, FrameWatch, Oddity, Scaled, constant_dn, constant_words, odd_scenes};
