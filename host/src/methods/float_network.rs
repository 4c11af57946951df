//! The float network of a checkpoint, of any architecture, as a method.

use super::Reconstruct;
use crate::sensor::FrameInput;
use crate::train::network::{Network, values};
use crate::train::ops::fourier::Fourier;
use crate::train::{ArchitectureName, Checkpoint, Mode, NetworkConfig, NetworkInput, TrainError, normalised};
use burn::tensor::activation::sigmoid;
use ndarray::{Array2, ArrayView2};
use std::path::Path;
use std::sync::Arc;

/// The network of a checkpoint in single precision, on this machine's cores.
pub struct FloatNetwork {
    network: Network,
    plan: Arc<Fourier>,
    input: FrameInput,
    config: NetworkConfig,
}

impl FloatNetwork {
    /// The network with the best weights of a checkpoint.
    ///
    /// # Errors
    /// A weight is missing, or a weight or a sensor map has the wrong shape.
    pub fn new(checkpoint: &Checkpoint) -> Result<Self, TrainError> {
        let config = &checkpoint.body.network;
        let plan = Arc::new(Fourier::new(config.fourier()));
        let network = Network::new(config, &plan, &checkpoint.weights, Mode::Infer)?;
        let input = checkpoint.frame_input()?;
        Ok(Self { network, plan, input, config: config.clone() })
    }

    /// Its architecture.
    pub fn architecture(&self) -> ArchitectureName {
        self.config.architecture.name()
    }

    /// The network with the best weights of the checkpoint at `path`.
    ///
    /// # Errors
    /// As [`Checkpoint::read`] and [`FloatNetwork::new`].
    pub fn open(path: &Path) -> Result<Self, TrainError> {
        Self::new(&Checkpoint::read(path)?)
    }
}

impl Reconstruct for FloatNetwork {
    fn name(&self) -> &str {
        self.architecture().as_str()
    }

    fn reconstruct(&self, frame_dn: ArrayView2<'_, f32>) -> anyhow::Result<Array2<f32>> {
        let frame = normalised(&self.input, frame_dn)?;
        let input = NetworkInput::of(&self.config, &self.plan, &frame);
        let out = values(sigmoid(self.network.forward(vec![input]).logits));
        let [rows, cols] = self.config.object;
        Ok(Array2::from_shape_vec((rows, cols), out)?)
    }
}
