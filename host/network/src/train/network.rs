//! The networks in single precision, on burn: a bank of filters followed by an RCAN, or CM2Net.

use super::feature_steps::{FeatureSteps, Features};
use super::normalise::DARK;
use super::ops::fourier::Fourier;
use super::ops::predicted::{Linear, filter_predicted};
use super::ops::{conv3x3, filter_bank, kernel_spectra};
use super::rounding::Rounding;
use super::weights::{self, FILTERS, KERNELS, LOG_K, PSFS, name};
use super::{Architecture, Backend, Mode, NetworkConfig, NetworkInput, Predictor, TrainError, network_input};
use burn_tensor::activation::{relu, sigmoid};
use burn_tensor::{Device, Gradients, Tensor, TensorData, Transaction};
use ommatidia_session::artifact::Tensors;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Divisor of the sum of two branches in CM2Net, which keeps its variance.
const HALF_POWER: f32 = std::f32::consts::SQRT_2;

/// Output of a network for a batch of frames.
pub struct NetworkOutput {
    /// Logits, [batch, 1, object rows, object cols]; the reconstruction is their sigmoid.
    pub logits: Tensor<4>,
    /// Logits of the passes before the last one, in their order, each as `logits`.
    pub before: Vec<Tensor<4>>,
    /// Logits of the image of each lens alone, [batch, lenses, object rows, object cols]; of a CM2Net only.
    pub views: Option<Tensor<4>>,
}

/// A network with its parameters on a device.
pub struct Network {
    config: NetworkConfig,
    plan: Arc<Fourier>,
    parameters: BTreeMap<String, Tensor<1>>,
    device: Device,
    /// The filters in frequency, computed once for inference.
    bank: Option<[Tensor<1>; 2]>,
    /// What predicts frames, where there is feedback.
    predict: Option<Arc<dyn Linear>>,
    /// Roundings of a network in integers; None: none.
    rounding: Option<Rounding>,
}

impl Network {
    /// A network with the parameters `tensors` (all of [`weights::shapes`]) on the CPU.
    ///
    /// # Errors
    /// The configuration is not valid, or a parameter is missing or has the wrong shape.
    pub fn new(config: &NetworkConfig, plan: &Arc<Fourier>, tensors: &Tensors, mode: Mode) -> Result<Self, TrainError> {
        Self::on(Backend::Cpu, config, plan, tensors, mode)
    }

    /// As [`Network::new`], on the given backend.
    ///
    /// # Errors
    /// As [`Network::new`]; or the program was built without the backend.
    pub fn on(
        backend: Backend,
        config: &NetworkConfig,
        plan: &Arc<Fourier>,
        tensors: &Tensors,
        mode: Mode,
    ) -> Result<Self, TrainError> {
        Self::planned(backend, config, plan, Predictor::of(config, tensors)?, tensors, mode)
    }

    /// As [`Network::on`], with a predictor that was planned before, which networks with feedback need.
    ///
    /// # Errors
    /// As [`Network::on`].
    pub fn planned(
        backend: Backend,
        config: &NetworkConfig,
        plan: &Arc<Fourier>,
        predictor: Option<Predictor>,
        tensors: &Tensors,
        mode: Mode,
    ) -> Result<Self, TrainError> {
        config.check()?;
        backend.check()?;
        if config.feedback.is_some() != predictor.is_some() {
            let (expected, found) = ("a predictor exactly where there is feedback".into(), "the other".into());
            return Err(TrainError::Config { field: "feedback", expected, found });
        }
        let predict = predictor.map(|predictor| Arc::new(predictor) as Arc<dyn Linear>);
        let device = backend.device(mode);
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
            if weights::is_calibrated(&name) {
                continue;
            }
            let values = tensor.as_slice().map_or_else(|| tensor.iter().copied().collect(), <[f32]>::to_vec);
            let n = values.len();
            let leaf = Tensor::<1>::from_data(TensorData::new(values, [n]), &device);
            parameters.insert(name, if mode == Mode::Train { leaf.require_grad() } else { leaf });
        }
        let (config, plan) = (config.clone(), Arc::clone(plan));
        let mut network = Self { config, plan, parameters, device, bank: None, predict, rounding: None };
        if mode == Mode::Infer && !matches!(network.config.architecture, Architecture::Cm2Net { .. }) {
            network.bank = Some(network.filters());
        }
        Ok(network)
    }

    /// The same network with its enhancement rounded as in integers with features of 8 bits.
    ///
    /// # Errors
    /// There is not one step for each channel, or the network has more than one pass.
    pub fn rounded(self, steps: &FeatureSteps) -> Result<Self, TrainError> {
        let wrong = |expected: &str, found: String| {
            Err(TrainError::Config { field: "feature_steps", expected: expected.into(), found })
        };
        let single = self.config.architecture == Architecture::SvFourierNet && self.config.feedback.is_none();
        if !single {
            return wrong("an svfouriernet of one pass", self.config.architecture.name().as_str().into());
        }
        if !steps.fits(&self.config) {
            return wrong("a positive step for each channel", format!("{steps:?}"));
        }
        let rounding = Some(Rounding::new(steps, &self.device));
        Ok(Self { rounding, ..self })
    }

    /// Computes the output of a batch of inputs, which must be of this network's configuration.
    pub fn forward(&self, frames: Vec<NetworkInput>) -> NetworkOutput {
        if let Architecture::Cm2Net { .. } = self.config.architecture {
            let x = self.crops(&frames);
            return self.join(x);
        }
        let (mut spectra, mut estimates) = (Vec::new(), Vec::new());
        for frame in frames {
            if let NetworkInput::Spectrum { spectrum, estimate } = frame {
                spectra.push(spectrum);
                estimates.extend(estimate);
            }
        }
        let batch = spectra.len();
        let [re, im] = self.bank.clone().unwrap_or_else(|| self.filters());
        let seen = normalise(filter_bank(&self.plan, Arc::new(spectra), re.clone(), im.clone()));
        let mut passes = match self.config.iterations() {
            0 => vec![self.enhance(0, seen.clone())],
            _ => Vec::new(),
        };
        let start = (!estimates.is_empty()).then(|| {
            let [rows, cols] = self.config.object;
            let logits = estimates.into_iter().map(logit).collect();
            Tensor::from_data(TensorData::new(logits, [batch, 1, rows, cols]), &self.device)
        });
        if let Some(predict) = &self.predict {
            for pass in passes.len()..self.config.passes() {
                let last: Tensor<4> = match passes.last().or(start.as_ref()) {
                    Some(last) => last.clone(),
                    None => unreachable!("a network without a first pass is given estimates"),
                };
                let x = sigmoid(last.clone());
                let predicted = filter_predicted(&self.plan, predict, x.clone(), [re.clone(), im.clone()]);
                let input = Tensor::cat(vec![difference(seen.clone(), predicted), x], 1);
                passes.push(last + self.enhance(pass, input));
            }
        }
        let logits = passes.pop().unwrap_or_else(|| unreachable!("there is a first pass"));
        NetworkOutput { logits, before: passes, views: None }
    }

    /// Real and imaginary parts of the filters in frequency, each [channels * T * (T/2+1)]; for architectures with a
    /// filter bank, which is all but CM2Net.
    pub fn filters(&self) -> [Tensor<1>; 2] {
        match self.config.architecture {
            Architecture::MultiWienerNet => {
                let [re, im] = kernel_spectra(&self.plan, self.parameter(PSFS));
                let (c, n) = (self.config.channels, re.dims()[0]);
                let k = self.parameter(LOG_K).exp().reshape([c, 1]).expand([c, n / c]).reshape([n]);
                let power = re.clone().square() + im.clone().square() + k;
                [re / power.clone(), im.neg() / power]
            }
            Architecture::MultiFlatNet => kernel_spectra(&self.plan, self.parameter(KERNELS)),
            _ => FILTERS.map(|f| self.parameter(f)),
        }
    }

    fn crops(&self, frames: &[NetworkInput]) -> Tensor<4> {
        let [rows, cols] = self.config.object;
        let values: Vec<f32> = frames
            .iter()
            .flat_map(|f| match f {
                NetworkInput::Crops(crops) => crops.as_slice(),
                NetworkInput::Spectrum { .. } => &[],
            })
            .copied()
            .collect();
        Tensor::from_data(TensorData::new(values, [frames.len(), self.config.channels, rows, cols]), &self.device)
    }

    /// CM2Net behind its crops [batch, lenses, rows, cols]: views are demixed, then joined.
    fn join(&self, x: Tensor<4>) -> NetworkOutput {
        let views = self.part(name::DEMIX, x);
        let logits = self.conv(name::END, self.part(name::JOIN, sigmoid(views.clone())));
        NetworkOutput { logits, before: Vec::new(), views: Some(views) }
    }

    /// One of the two parts of a CM2Net: a convolution, residual blocks, a convolution.
    fn part(&self, part: &str, x: Tensor<4>) -> Tensor<4> {
        let first = relu(self.conv(&name::part(part, 1), x));
        let mut y = first.clone();
        for b in 0..self.config.blocks {
            let inner = relu(self.conv(&name::part_block(part, b, 1), y.clone()));
            y = (self.conv(&name::part_block(part, b, 2), inner) + y) / HALF_POWER;
        }
        self.conv(&name::part(part, 2), (y + first) / HALF_POWER)
    }

    /// Gradient of one reconstructed pixel, [row, col], with respect to the normalised frame `x`, [frame rows * frame
    /// cols] in C order. The maximum that the frame was divided by is held fixed.
    ///
    /// The network must have been made with [`Mode::Train`].
    pub fn pixel_gradient(&self, x: &[f32], [row, col]: [usize; 2]) -> Vec<f32> {
        let frame = vec![NetworkInput::of(&self.config, &self.plan, x)];
        let [rows, cols] = self.config.object;
        let leaf = |values: Vec<f32>| {
            let shape = [1, self.config.channels, rows, cols];
            Tensor::<4>::from_data(TensorData::new(values, shape), &self.device).require_grad()
        };
        let pixel =
            |logits: Tensor<4>| sigmoid(logits).slice([0..1, 0..1, row..row + 1, col..col + 1]).sum().backward();
        let gradient = |x: Tensor<4>, g: Gradients| {
            let mut g = g;
            x.grad_remove(&mut g).map_or_else(|| vec![0.0; rows * cols * self.config.channels], values)
        };
        if let Architecture::Cm2Net { crops } = &self.config.architecture {
            let x = leaf(values(self.crops(&frame).inner()));
            let g = pixel(self.join(x.clone()).logits);
            return network_input::paste(&gradient(x, g), &self.config, crops);
        }
        let [re, im] = self.filters().map(|f| values(f.inner()));
        let filters = self.plan.filters(&re, &im);
        let y = leaf(self.plan.forward(&[frame[0].spectrum().to_vec()], &filters));
        let g = pixel(self.enhance(0, normalise(y.clone())));
        self.plan.backward_to_frame(&filters, &gradient(y, g))
    }

    /// The enhancement network (RCAN) of a pass: [batch, inputs, rows, cols] -> logits [batch, 1, rows, cols].
    fn enhance(&self, pass: usize, x: Tensor<4>) -> Tensor<4> {
        let prefix = name::of_pass(pass);
        let conv = |name: &str, of, x| self.conv_of(&format!("{prefix}{name}"), of, x);
        let sums = Some(Features::Sums);
        let head = self.stored(Features::Sums, conv(name::HEAD, None, unshuffle(x)));
        let mut y = head.clone();
        for g in 0..self.config.groups {
            let mut inner = y.clone();
            for b in 0..self.config.blocks {
                inner = self.block(&prefix, [g, b], inner);
            }
            y = self.stored(Features::Sums, y + conv(&name::group(g, self.config.blocks), sums, inner));
        }
        let y = self.stored(Features::Sums, head + conv(name::BODY, sums, y));
        let fine = self.stored(Features::Fine, shuffle(conv(name::UPSCALE, sums, y)));
        conv(name::TAIL, Some(Features::Fine), fine)
    }

    /// Residual block with channel attention.
    fn block(&self, prefix: &str, [group, block]: [usize; 2], x: Tensor<4>) -> Tensor<4> {
        let conv = |which, of, x| self.conv_of(&format!("{prefix}{}", name::conv(group, block, which)), Some(of), x);
        let linear = |which, x| self.linear(&format!("{prefix}{}", name::attention(group, block, which)), x);
        let between = Features::Inner(group * self.config.blocks + block);
        let inner = self.stored(between, relu(conv(0, Features::Sums, x.clone())));
        let r = self.stored(Features::Sums, conv(1, between, inner));
        let [batch, width, _, _] = r.dims();
        let means = r.clone().mean_dims(&[2, 3]).reshape([batch, width]);
        let squeezed = relu(linear(0, means));
        let gate = sigmoid(linear(1, squeezed));
        self.stored(Features::Sums, x + r * gate.reshape([batch, width, 1, 1]))
    }

    /// Features as they are stored.
    fn stored(&self, features: Features, x: Tensor<4>) -> Tensor<4> {
        match &self.rounding {
            Some(rounding) => rounding.features(features, x),
            None => x,
        }
    }

    fn conv(&self, layer: &str, x: Tensor<4>) -> Tensor<4> {
        self.conv_of(layer, None, x)
    }

    /// A convolution of some features; None: of an input.
    fn conv_of(&self, layer: &str, of: Option<Features>, x: Tensor<4>) -> Tensor<4> {
        let [weight, bias] = ["weight", "bias"].map(|part| self.parameter(&format!("{layer}.{part}")));
        let weight = match &self.rounding {
            Some(rounding) => rounding.weights(of, weight, bias.dims()[0]),
            None => weight,
        };
        conv3x3(x, weight, bias)
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
            None => unreachable!("`new` checked that every parameter is there; `{name}` is not a parameter"),
        }
    }

    /// Gradients of all parameters by name, each flat in C order.
    pub fn gradients(&self, mut gradients: Gradients) -> BTreeMap<String, Vec<f32>> {
        let found =
            self.parameters.iter().filter_map(|(name, tensor)| Some((name, tensor.grad_remove(&mut gradients)?)));
        // A graphics card is waited for once, not once for each parameter.
        let (mut names, mut reads) = (Vec::new(), Transaction::default());
        for (name, gradient) in found {
            names.push(name.clone());
            reads = reads.register(gradient);
        }
        names.into_iter().zip(reads.execute().into_iter().map(numbers)).collect()
    }
}

/// The values of a tensor in C order.
pub fn values<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    numbers(tensor.into_data())
}

fn numbers(data: TensorData) -> Vec<f32> {
    match data.try_into_vec() {
        Ok(values) => values,
        Err(error) => unreachable!("every tensor here is f32: {error:?}"),
    }
}

/// The logit of an estimate between 0 and 1, at most 5.5 in magnitude: darker pixels are as good as dark.
pub(super) fn logit(x: f32) -> f32 {
    let x = x.clamp(1.0 / 256.0, 255.0 / 256.0);
    (x / (1.0 - x)).ln()
}

/// Divides each image by the maximum over all its channels.
fn normalise(x: Tensor<4>) -> Tensor<4> {
    let [batch, c, h, w] = x.dims();
    let max = x.clone().reshape([batch, c * h * w]).max_dim(1).clamp_min(DARK);
    x / max.reshape([batch, 1, 1, 1])
}

/// Weight of the difference between seen and predicted filter outputs beside a reconstruction of up to 1.
pub(super) const DIFFERENCE: f32 = 4.0;

/// What the filter outputs of a frame hold beyond those of the frame that was predicted, which is scaled to fit best
/// (least squares over all channels), times [`DIFFERENCE`].
fn difference(seen: Tensor<4>, predicted: Tensor<4>) -> Tensor<4> {
    let sum = |x: Tensor<4>| x.sum_dim(1).sum_dim(2).sum_dim(3);
    let scale = sum(seen.clone() * predicted.clone()) / sum(predicted.clone().square()).clamp_min(DARK);
    (seen - predicted * scale) * DIFFERENCE
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
