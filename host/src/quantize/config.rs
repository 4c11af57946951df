//! Settings of making a network file.

use serde::{Deserialize, Serialize};

/// Settings of making a network file.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct QuantizeConfig {
    /// Name stored in the file; names longer than 48 bytes are cut.
    pub name: String,
    /// Maximum length of the file, bytes.
    pub flash_bytes: Option<u64>,
    /// Maximum memory that a device needs while it runs the network, bytes, its program included.
    pub ram_bytes: Option<u64>,
    /// Side of small transforms, pixels, a power of two: the filters are cut into taps. None: one transform of the
    /// whole padded frame.
    pub tile: Option<usize>,
    /// Fraction of the filters' energy that the taps must keep; None: 0.95.
    pub energy: Option<f64>,
    /// Fraction of the dense filters' bytes that the strongest blocks of their kernels may take, index included.
    pub prune: Option<f64>,
}
