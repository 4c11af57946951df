//! The shape of the network.

use serde::{Deserialize, Serialize};

/// Shape of an SV-FourierNet: the Fourier filter bank and the light RCAN behind it.
///
/// A raw frame is corrected, padded to `filter_size` with the frame's centre at the filter's centre, transformed, multiplied by each of the
/// `channels` filters, transformed back, cropped to the object round the centre, divided by its global maximum, enhanced.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NetworkConfig {
    /// Raw frame, rows and columns, pixels.
    pub frame: [usize; 2],
    /// Object, rows and columns, pixels; even.
    pub object: [usize; 2],
    /// Side of the square Fourier filters, pixels; a power of two where the network shall run on a device.
    pub filter_size: usize,
    /// Number of Fourier filters C.
    pub channels: usize,
    /// Feature channels W of the RCAN.
    pub width: usize,
    /// Residual groups.
    pub groups: usize,
    /// RCABs per group.
    pub blocks: usize,
    /// Channel reduction of the attention.
    pub reduction: usize,
}
