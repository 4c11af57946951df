//! The float network of a checkpoint, of any architecture, as a method.

use super::Reconstruct;
use crate::train::network::{Network, values};
use crate::train::ops::fourier::Fourier;
use crate::train::{
    Architecture, ArchitectureName, Checkpoint, Estimator, Inference, Mode, NetworkConfig, NetworkInput, TrainError,
    normalise,
};
use burn_tensor::activation::sigmoid;
use ndarray::{Array2, ArrayView2};
use ommatidia_physics::sensor::FrameInput;
use std::path::Path;
use std::sync::Arc;

/// The network of a checkpoint in single precision, on this machine's cores.
pub struct FloatNetwork {
    engine: Engine,
    estimator: Option<Estimator>,
    input: FrameInput,
    config: NetworkConfig,
}

/// What computes the network.
enum Engine {
    /// Networks with a filter bank.
    Direct(Box<Inference>),
    /// Burn's graph, for CM2Net.
    Graph(Box<Network>, Arc<Fourier>),
}

impl FloatNetwork {
    /// The network with the best weights of a checkpoint.
    ///
    /// # Errors
    /// A weight is missing, or a weight or a sensor map has the wrong shape.
    pub fn new(checkpoint: &Checkpoint) -> Result<Self, TrainError> {
        let config = &checkpoint.body.network;
        let (engine, estimator) = match config.architecture {
            Architecture::Cm2Net { .. } => {
                let plan = Arc::new(Fourier::new(config.fourier()));
                let network = Network::new(config, &plan, &checkpoint.weights, Mode::Infer)?;
                (Engine::Graph(Box::new(network), plan), None)
            }
            _ => {
                let network = Inference::new(config, &checkpoint.weights)?;
                let estimator = network.estimator(config, &checkpoint.body.noise);
                (Engine::Direct(Box::new(network)), estimator)
            }
        };
        Ok(Self { engine, estimator, input: checkpoint.frame_input()?, config: config.clone() })
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
        let mut checkpoint = Checkpoint::read(path)?;
        // What only training needs takes three times the memory of the weights.
        checkpoint.current.clear();
        checkpoint.adam.first.clear();
        checkpoint.adam.second.clear();
        Self::new(&checkpoint)
    }
}

impl Reconstruct for FloatNetwork {
    fn name(&self) -> &str {
        self.architecture().as_str()
    }

    fn reconstruct(&self, frame_dn: ArrayView2<'_, f32>) -> anyhow::Result<Array2<f32>> {
        let light_dn = self.input.light_dn(frame_dn)?;
        let frame = normalise(&light_dn.iter().copied().collect::<Vec<f32>>());
        let out = match &self.engine {
            Engine::Direct(network) => {
                let estimate = self.estimator.as_ref().map(|e| e.estimate(light_dn.view())).unwrap_or_default();
                network.reconstruct(&frame, &estimate)
            }
            Engine::Graph(network, plan) => {
                let input = NetworkInput::of(&self.config, plan, &frame);
                values(sigmoid(network.forward(vec![input]).logits))
            }
        };
        let [rows, cols] = self.config.object;
        Ok(Array2::from_shape_vec((rows, cols), out)?)
    }
}
