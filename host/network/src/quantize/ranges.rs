//! The ranges of the numbers in the enhancement network, measured on frames in single precision.

use super::QuantizeError;
use super::allowed::check_integers;
use super::pack::{describe, layer_values, narrow};
use crate::train::ops::conv::Conv3x3;
use crate::train::{Checkpoint, FeatureSteps, Features, Inference, NetworkConfig, Trainer, normalised};
use ommatidia_physics::sensor::FrameInput;
use ommatidia_session::artifact::Tensors;
use ommatidia_shared::nn::rcan::{Entry, layout};

/// Largest magnitudes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Ranges {
    /// Of the network's input.
    pub input: f32,
    /// Of all features that are stored.
    pub features: f32,
}

impl Ranges {
    /// The ranges on the held-out frames of a checkpoint.
    ///
    /// # Errors
    /// There are no frames, a frame is refused, or a weight is missing.
    pub fn of(checkpoint: &Checkpoint) -> Result<Self, QuantizeError> {
        let mut ranges = Self::default();
        for input in Frames::new(checkpoint)? {
            let input = input?;
            ranges.input = most(ranges.input, &input);
            let mut see = |_, x: &[f32]| ranges.features = most(ranges.features, x);
            follow(&checkpoint.body.network, &checkpoint.weights, &input, &mut see)?;
        }
        Ok(ranges)
    }
}

/// Steps that are tried for a channel: the smallest at which none of its features saturates, times 2 to the power of
/// -i/4. Below the last one, most features of a normal distribution would saturate.
const TRIED: usize = 16;

/// What is known of a channel.
#[derive(Clone, Copy, Default)]
struct Channel {
    largest: f32,
    /// Sum of squared errors for each step that is tried.
    errors: [f64; TRIED],
}

impl Channel {
    fn step(&self, tried: usize) -> f32 {
        // A channel that is always 0 needs a step, too.
        (self.largest / f32::from(i8::MAX) * (-0.25 * tried as f32).exp2()).max(f32::MIN_POSITIVE.sqrt())
    }

    /// The step with the smallest error.
    fn best(&self) -> f32 {
        let best = (0..TRIED).min_by(|&a, &b| self.errors[a].total_cmp(&self.errors[b]));
        self.step(best.unwrap_or(0))
    }

    fn add_errors(&mut self, features: &[f32]) {
        for tried in 0..TRIED {
            let step = self.step(tried);
            let error = |x: &f32| (x - step * (x / step + 0.5).floor().clamp(-128.0, 127.0)).powi(2);
            // In single precision over a row's length at a time.
            let parts = features.chunks(256).map(|part| f64::from(part.iter().map(error).sum::<f32>()));
            self.errors[tried] += parts.sum::<f64>();
        }
    }
}

/// The steps of features of 8 bits with the smallest squared error for each channel, on the held-out frames of a
/// checkpoint.
///
/// # Errors
/// As [`Ranges::of`].
pub fn feature_steps(checkpoint: &Checkpoint) -> Result<FeatureSteps, QuantizeError> {
    let network = &checkpoint.body.network;
    let inputs = Frames::new(checkpoint)?.collect::<Result<Vec<_>, _>>()?;
    let mut known = vec![vec![Channel::default(); network.width]; network.groups * network.blocks + 2];
    for errors in [false, true] {
        for input in &inputs {
            let mut see = |features: Features, x: &[f32]| {
                let channels = known[index(features)].iter_mut().zip(x.chunks_exact(x.len() / network.width));
                channels.for_each(|(channel, x)| match errors {
                    false => channel.largest = most(channel.largest, x),
                    true => channel.add_errors(x),
                });
            };
            follow(network, &checkpoint.weights, input, &mut see)?;
        }
    }
    let mut steps = FeatureSteps::even(network, 1.0);
    let all = (0..network.groups * network.blocks).map(Features::Inner).chain([Features::Sums, Features::Fine]);
    for features in all {
        let found = known[index(features)].iter().map(Channel::best);
        steps.of_mut(features).into_iter().flatten().zip(found).for_each(|(step, found)| *step = found);
    }
    Ok(steps)
}

/// The steps for training a network with features of 8 bits, from the weights that the run starts with.
///
/// # Errors
/// As [`quantize`](super::quantize).
pub fn training_steps(run: &Trainer<'_>) -> Result<FeatureSteps, QuantizeError> {
    let checkpoint = run.checkpoint();
    check_integers(checkpoint)?;
    feature_steps(checkpoint)
}

/// Features that share their steps have one number.
const fn index(features: Features) -> usize {
    match features {
        Features::Sums => 0,
        Features::Fine => 1,
        Features::Inner(block) => 2 + block,
    }
}

/// The inputs of the enhancement network for the held-out frames of a checkpoint.
struct Frames<'a> {
    checkpoint: &'a Checkpoint,
    inference: Inference,
    frame_input: FrameInput,
    next: usize,
}

impl<'a> Frames<'a> {
    fn new(checkpoint: &'a Checkpoint) -> Result<Self, QuantizeError> {
        if checkpoint.cases.is_empty() {
            return Err(QuantizeError::NoFrames);
        }
        let inference = Inference::new(&checkpoint.body.network, &checkpoint.weights)?;
        Ok(Self { checkpoint, inference, frame_input: checkpoint.frame_input()?, next: 0 })
    }
}

impl Iterator for Frames<'_> {
    type Item = Result<Vec<f32>, QuantizeError>;

    fn next(&mut self) -> Option<Self::Item> {
        let index = self.next;
        let case = self.checkpoint.cases.get(index)?;
        self.next += 1;
        let frame = normalised(&self.frame_input, case.frame_dn.view())
            .map_err(|error| QuantizeError::Case { index, detail: error.to_string() });
        Some(frame.map(|frame| self.inference.enhancement_input(&frame)))
    }
}

/// Computes all features from the input of the network, [channels, object rows, object cols], and shows those that are
/// stored: as many parts of one length as the network has feature channels.
fn follow(
    network: &NetworkConfig,
    weights: &Tensors,
    input: &[f32],
    see: &mut dyn FnMut(Features, &[f32]),
) -> Result<(), QuantizeError> {
    let [rows, cols] = network.object.map(|side| side / 2);
    let mut entries = layout(&describe(network)?, narrow("channels", network.channels)?);
    let mut next = || {
        let none = || QuantizeError::Size { field: "layers", expected: "one layer more".into(), found: 0 };
        let entry = entries.next().ok_or_else(none)?;
        layer_values(network, weights, &entry).map(|values| (entry, values))
    };
    let conv = |x: &[f32], (entry, [weight, bias]): (Entry, [Vec<f32>; 2])| {
        let Entry { inputs, outputs, .. } = entry;
        Conv3x3 { batch: 1, inputs, outputs, rows, cols }.forward(x, &weight, &bias)
    };
    let head = conv(&unshuffled(input, [network.channels, rows, cols]), next()?);
    see(Features::Sums, &head);
    let mut y = head.clone();
    for group in 0..network.groups {
        let mut g = y.clone();
        for block in 0..network.blocks {
            let mut inner = conv(&g, next()?);
            inner.iter_mut().for_each(|v| *v = v.max(0.0));
            see(Features::Inner(group * network.blocks + block), &inner);
            let t = conv(&inner, next()?);
            see(Features::Sums, &t);
            let means: Vec<f32> = t.chunks(rows * cols).map(|c| c.iter().sum::<f32>() / c.len() as f32).collect();
            let hidden: Vec<f32> = dense(&means, &next()?.1).into_iter().map(|v| v.max(0.0)).collect();
            let scales = dense(&hidden, &next()?.1).into_iter().map(|v| 1.0 / (1.0 + (-v).exp()));
            for ((scale, t), g) in scales.zip(t.chunks(rows * cols)).zip(g.chunks_mut(rows * cols)) {
                g.iter_mut().zip(t).for_each(|(g, t)| *g += scale * t);
            }
            see(Features::Sums, &g);
        }
        add(&mut y, &conv(&g, next()?));
        see(Features::Sums, &y);
    }
    let body = conv(&y, next()?);
    y = head;
    add(&mut y, &body);
    see(Features::Sums, &y);
    // The four channels that a channel behind the pixel shuffle consists of are neighbours.
    see(Features::Fine, &conv(&y, next()?));
    Ok(())
}

/// The larger of a number and the largest magnitude of some values.
fn most(largest: f32, values: &[f32]) -> f32 {
    values.iter().fold(largest, |largest, v| largest.max(v.abs()))
}

fn add(to: &mut [f32], from: &[f32]) {
    to.iter_mut().zip(from).for_each(|(to, from)| *to += from);
}

/// `bias + weight x`.
fn dense(x: &[f32], [weight, bias]: &[Vec<f32>; 2]) -> Vec<f32> {
    let dot = |row: &[f32]| row.iter().zip(x).map(|(w, x)| w * x).sum::<f32>();
    weight.chunks(x.len()).zip(bias).map(|(row, bias)| bias + dot(row)).collect()
}

/// `[channels, 2 rows, 2 cols]` as `[4 channels, rows, cols]`, in PyTorch's order.
fn unshuffled(x: &[f32], [channels, rows, cols]: [usize; 3]) -> Vec<f32> {
    let at = |k: usize, r: usize, c: usize| x[(k / 4 * 2 * rows + 2 * r + k / 2 % 2) * 2 * cols + 2 * c + k % 2];
    let each = (0..4 * channels).flat_map(|k| (0..rows).flat_map(move |r| (0..cols).map(move |c| (k, r, c))));
    each.map(|(k, r, c)| at(k, r, c)).collect()
}
