//! The ranges of the numbers in the enhancement network, measured on frames in single precision.

use super::QuantizeError;
use super::pack::{describe, layer_values, narrow};
use crate::train::ops::conv::Conv3x3;
use crate::train::{Checkpoint, Inference, NetworkConfig, normalise};
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
        if checkpoint.cases.is_empty() {
            return Err(QuantizeError::NoFrames);
        }
        let network = &checkpoint.body.network;
        let inference = Inference::new(network, &checkpoint.weights)?;
        let frame_input = checkpoint.frame_input()?;
        let mut ranges = Self::default();
        for (index, case) in checkpoint.cases.iter().enumerate() {
            let light = frame_input
                .light_dn(case.frame_dn.view())
                .map_err(|error| QuantizeError::Case { index, detail: error.to_string() })?;
            let frame = normalise(&light.iter().copied().collect::<Vec<f32>>());
            ranges.follow(network, &checkpoint.weights, &inference.enhancement_input(&frame))?;
        }
        Ok(ranges)
    }

    /// Computes all features from the input of the network, [channels, object rows, object cols], and widens the ranges
    /// to them.
    fn follow(&mut self, network: &NetworkConfig, weights: &Tensors, input: &[f32]) -> Result<(), QuantizeError> {
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
        self.input = most(self.input, input);
        let head = conv(&unshuffled(input, [network.channels, rows, cols]), next()?);
        let mut largest = most(self.features, &head);
        let mut y = head.clone();
        for _ in 0..network.groups {
            let mut g = y.clone();
            for _ in 0..network.blocks {
                let mut inner = conv(&g, next()?);
                inner.iter_mut().for_each(|v| *v = v.max(0.0));
                let t = conv(&inner, next()?);
                let means: Vec<f32> = t.chunks(rows * cols).map(|c| c.iter().sum::<f32>() / c.len() as f32).collect();
                let hidden: Vec<f32> = dense(&means, &next()?.1).into_iter().map(|v| v.max(0.0)).collect();
                let scales = dense(&hidden, &next()?.1).into_iter().map(|v| 1.0 / (1.0 + (-v).exp()));
                for ((scale, t), g) in scales.zip(t.chunks(rows * cols)).zip(g.chunks_mut(rows * cols)) {
                    g.iter_mut().zip(t).for_each(|(g, t)| *g += scale * t);
                }
                largest = [&inner, &t, &g].into_iter().fold(largest, |largest, x| most(largest, x));
            }
            add(&mut y, &conv(&g, next()?));
            largest = most(largest, &y);
        }
        let body = conv(&y, next()?);
        y = head;
        add(&mut y, &body);
        self.features = most(most(largest, &y), &conv(&y, next()?));
        Ok(())
    }
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
