//! A network with a filter bank, for inference on the cores of this machine: in single precision, without burn's graph.

use super::network::{Network, values};
use super::ops::fourier::Fourier;
use super::ops::stream::StreamedBank;
use super::weights::FILTERS;
use super::{Architecture, Enhancement, Mode, NetworkConfig, TrainError};
use ommatidia_session::artifact::Tensors;
use rayon::prelude::*;
use std::sync::Arc;

/// Filter bank and enhancement network with their weights. Outputs agree with those of [`Network`] to some 1e-5.
pub struct Inference {
    bank: StreamedBank,
    enhancement: Enhancement,
}

impl Inference {
    /// From the tensors of a checkpoint (all of [`super::weights::shapes`]); of any architecture but CM2Net, which has
    /// no filter bank.
    ///
    /// # Errors
    /// The configuration is not valid, the network is a CM2Net, or a parameter is missing or has the wrong shape.
    pub fn new(config: &NetworkConfig, tensors: &Tensors) -> Result<Self, TrainError> {
        config.check()?;
        let plan = Arc::new(Fourier::new(config.fourier()));
        let enhancement = match config.architecture {
            Architecture::Cm2Net { .. } => {
                let (expected, found) =
                    ("a network with filters".into(), config.architecture.name().as_str().to_string());
                return Err(TrainError::Config { field: "network", expected, found });
            }
            _ => Enhancement::new(config, tensors)?,
        };
        let stored = FILTERS.map(|name| tensors.get(name).filter(|t| t.len() == filter_len(config)));
        let filters = match stored.map(|t| t.and_then(|t| t.as_slice())) {
            [Some(re), Some(im)] => plan.filters(re, im),
            _ => {
                let [re, im] = Network::new(config, &plan, tensors, Mode::Infer)?.filters().map(values);
                plan.filters(&re, &im)
            }
        };
        Ok(Self { bank: StreamedBank::new(plan, filters), enhancement })
    }

    /// The reconstruction, [object rows, object cols], of a normalised frame, [frame rows, frame cols].
    ///
    /// The result does not depend on the number of threads.
    pub fn reconstruct(&self, frame: &[f32]) -> Vec<f32> {
        let mut out = self.enhancement.logits(self.bank.apply(frame));
        out.par_iter_mut().for_each(|v| *v = 1.0 / (1.0 + (-*v).exp()));
        out
    }
}

/// Number of values of the real or the imaginary parts of all filters.
fn filter_len(config: &NetworkConfig) -> usize {
    config.channels * config.filter_size * (config.filter_size / 2 + 1)
}
