//! What a training run needs besides its settings.

use super::NetworkConfig;
use super::pairs::PairSource;
use crate::noise::NoiseModel;
use crate::sensor::SensorMaps;

/// What training needs besides its settings.
#[derive(Clone, Debug)]
pub struct Task<'a> {
    /// The training pairs.
    pub source: &'a dyn PairSource,
    /// Shape of the network.
    pub network: NetworkConfig,
    /// Noise of the sensor.
    pub noise: NoiseModel,
    /// Sensor maps that frames are corrected with before the network; the checkpoint stores them for its users.
    pub maps: SensorMaps,
}
