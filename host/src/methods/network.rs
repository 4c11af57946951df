//! The float network of a checkpoint, of any family.

use super::Reconstruct;
use crate::train::network::{Mode, Network, values};
use crate::train::ops::fourier::Fourier;
use crate::train::{Checkpoint, FamilyName, NetworkConfig, Seen, Sight, TrainError};
use burn::tensor::activation::sigmoid;
use ndarray::{Array2, ArrayView2};
use std::path::Path;
use std::sync::Arc;

/// The float network of a checkpoint.
pub struct FloatNetwork {
    network: Network,
    plan: Arc<Fourier>,
    sight: Sight,
    config: NetworkConfig,
}

impl FloatNetwork {
    /// The best network of a checkpoint.
    ///
    /// # Errors
    /// A weight is missing or has the wrong shape.
    pub fn new(checkpoint: &Checkpoint) -> Result<Self, TrainError> {
        let config = &checkpoint.body.network;
        let plan = Arc::new(Fourier::new(config.fourier()));
        let network = Network::new(config, &plan, &checkpoint.weights, Mode::Infer)?;
        let sight = Sight::new(&checkpoint.body, &checkpoint.maps);
        Ok(Self { network, plan, sight, config: config.clone() })
    }

    /// Its family.
    pub fn family(&self) -> FamilyName {
        self.config.family.name()
    }

    /// Reads a checkpoint.
    ///
    /// # Errors
    /// As [`Checkpoint::read`].
    pub fn open(path: &Path) -> Result<Self, TrainError> {
        Self::new(&Checkpoint::read(path)?)
    }
}

impl Reconstruct for FloatNetwork {
    fn name(&self) -> &str {
        self.family().as_str()
    }

    fn reconstruct(&self, frame_dn: ArrayView2<'_, f32>) -> anyhow::Result<Array2<f32>> {
        self.sight.check(frame_dn)?;
        let seen = Seen::of(&self.config, &self.plan, &self.sight.normalised(frame_dn));
        let out = values(sigmoid(self.network.say(vec![seen]).logits));
        let [rows, cols] = self.config.object;
        Ok(Array2::from_shape_vec((rows, cols), out)?)
    }
}
