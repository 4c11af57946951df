//! The network in float, on burn.

use super::ops::fourier::{Fourier, Spectrum};
use super::ops::{conv3x3, filter_bank};
use super::weights::{self, FILTERS, name};
use super::{NetworkConfig, TrainError};
use crate::artifact::Tensors;
use burn::tensor::activation::{relu, sigmoid};
use burn::tensor::{Device, Gradients, Tensor, TensorData};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Maxima below this are taken for it: a frame without light has no scale.
const DARK: f32 = 1e-12;

/// Whether gradients are recorded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    /// They are.
    Train,
    /// They are not.
    Infer,
}

/// An SV-FourierNet with its parameters.
pub struct Network {
    config: NetworkConfig,
    plan: Arc<Fourier>,
    parameters: BTreeMap<String, Tensor<1>>,
}

impl Network {
    /// A network with these parameters (all of [`weights::shapes`]).
    ///
    /// # Errors
    /// The configuration makes no network, or a parameter is missing.
    pub fn new(config: &NetworkConfig, plan: &Arc<Fourier>, tensors: &Tensors, mode: Mode) -> Result<Self, TrainError> {
        config.check()?;
        let device = match mode {
            Mode::Train => Device::flex().autodiff(),
            Mode::Infer => Device::flex(),
        };
        let mut parameters = BTreeMap::new();
        for (name, shape) in weights::shapes(config) {
            let found = tensors.get(&name).filter(|t| t.shape() == shape);
            let Some(tensor) = found else {
                let found = tensors.get(&name).map_or("none".into(), |t| format!("{:?}", t.shape()));
                return Err(TrainError::Config {
                    field: "weights",
                    expected: format!("`{name}` of shape {shape:?}"),
                    found,
                });
            };
            let values: Vec<f32> = tensor.iter().copied().collect();
            let n = values.len();
            let leaf = Tensor::<1>::from_data(TensorData::new(values, [n]), &device);
            parameters.insert(name, if mode == Mode::Train { leaf.require_grad() } else { leaf });
        }
        Ok(Self { config: config.clone(), plan: Arc::clone(plan), parameters })
    }

    /// Logits, [batch, 1, object rows, object cols], of frames given by their spectra; the reconstruction is their sigmoid.
    pub fn logits(&self, spectra: Arc<Vec<Spectrum>>) -> Tensor<4> {
        let [re, im] = FILTERS.map(|f| self.parameter(f));
        let filtered = filter_bank(&self.plan, spectra, re, im);
        self.enhance(normalise(filtered))
    }

    /// The RCAN: [batch, C, rows, cols] -> logits [batch, 1, rows, cols].
    fn enhance(&self, x: Tensor<4>) -> Tensor<4> {
        let head = self.conv(name::HEAD, unshuffle(x));
        let mut y = head.clone();
        for g in 0..self.config.groups {
            let mut inner = y.clone();
            for b in 0..self.config.blocks {
                inner = self.block(g, b, inner);
            }
            y = y + self.conv(&name::group(g, self.config.blocks), inner);
        }
        let y = head + self.conv(name::BODY, y);
        self.conv(name::TAIL, shuffle(self.conv(name::UPSCALE, y)))
    }

    /// Residual block with channel attention.
    fn block(&self, group: usize, block: usize, x: Tensor<4>) -> Tensor<4> {
        let r = self.conv(&name::conv(group, block, 1), relu(self.conv(&name::conv(group, block, 0), x.clone())));
        let [batch, width, _, _] = r.dims();
        let means = r.clone().mean_dims(&[2, 3]).reshape([batch, width]);
        let squeezed = relu(self.linear(&name::attention(group, block, 0), means));
        let gate = sigmoid(self.linear(&name::attention(group, block, 1), squeezed));
        x + r * gate.reshape([batch, width, 1, 1])
    }

    fn conv(&self, layer: &str, x: Tensor<4>) -> Tensor<4> {
        conv3x3(x, self.parameter(&format!("{layer}.weight")), self.parameter(&format!("{layer}.bias")))
    }

    fn linear(&self, layer: &str, x: Tensor<2>) -> Tensor<2> {
        let bias = self.parameter(&format!("{layer}.bias"));
        let (outputs, inputs) = (bias.dims()[0], x.dims()[1]);
        let weight = self.parameter(&format!("{layer}.weight")).reshape([outputs, inputs]);
        x.matmul(weight.transpose()) + bias.reshape([1, outputs])
    }

    fn parameter(&self, name: &str) -> Tensor<1> {
        match self.parameters.get(name) {
            Some(tensor) => tensor.clone(),
            None => unreachable!("`new` put every parameter in; `{name}` is none"),
        }
    }

    /// Gradients by name, flat.
    pub fn gradients(&self, mut gradients: Gradients) -> BTreeMap<String, Vec<f32>> {
        let of = |(name, tensor): (&String, &Tensor<1>)| {
            let gradient = tensor.grad_remove(&mut gradients)?;
            Some((name.clone(), values(gradient)))
        };
        self.parameters.iter().filter_map(of).collect()
    }
}

/// The values of a tensor in C order.
pub fn values<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    match tensor.into_data().try_into_vec() {
        Ok(values) => values,
        Err(error) => unreachable!("every tensor here is f32: {error:?}"),
    }
}

/// Divides each image by the maximum over all its channels.
fn normalise(x: Tensor<4>) -> Tensor<4> {
    let [batch, c, h, w] = x.dims();
    let max = x.clone().reshape([batch, c * h * w]).max_dim(1).clamp_min(DARK);
    x / max.reshape([batch, 1, 1, 1])
}

/// PixelUnshuffle 2, channels in PyTorch's order: [batch, C, 2 h, 2 w] -> [batch, 4 C, h, w].
fn unshuffle(x: Tensor<4>) -> Tensor<4> {
    let [b, c, h, w] = x.dims();
    x.reshape([b, c, h / 2, 2, w / 2, 2]).permute([0, 1, 3, 5, 2, 4]).reshape([b, 4 * c, h / 2, w / 2])
}

/// PixelShuffle 2, its inverse: [batch, 4 C, h, w] -> [batch, C, 2 h, 2 w].
fn shuffle(x: Tensor<4>) -> Tensor<4> {
    let [b, c, h, w] = x.dims();
    x.reshape([b, c / 4, 2, 2, h, w]).permute([0, 1, 4, 2, 5, 3]).reshape([b, c / 4, 2 * h, 2 * w])
}
