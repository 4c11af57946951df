//! Settings of making a network file.

use crate::watch::WatchMaps;
use serde::{Deserialize, Serialize};

/// How the enhancement network is computed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Numbers {
    /// Weights and features in half precision.
    #[default]
    Halves,
    /// 3x3 convolutions with weights of 8 bits and features of 16 bits.
    Integers,
    /// 3x3 convolutions with weights of 8 bits and features of 8 bits.
    Bytes,
}

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
    /// How the enhancement network is computed.
    #[serde(default)]
    pub numbers: Numbers,
    /// Maps with which the device watches its optics.
    #[serde(skip)]
    pub watch: Option<WatchMaps>,
}
