//! What is transferred to a device.

use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// What is transferred to the device.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub enum Transfer {
    /// The network file.
    Blob,
    /// A raw frame: little-endian 16-bit codes, row by row.
    Frame,
}
