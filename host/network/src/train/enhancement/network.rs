//! The layers one after the other, and the planes between them.

use super::super::ops::patch::{Patch, padded};
use super::super::{NetworkConfig, TrainError};
use super::layers::{Group, Layers};
use super::passes::{Gated, Unshuffled, block, layer, logits};
use ommatidia_session::artifact::Tensors;

/// The enhancement network with its weights, for inference.
pub struct Enhancement {
    layers: Layers,
    /// Rows and columns of filter outputs and of objects.
    object: [usize; 2],
    /// Number of planes that the network takes.
    inputs: usize,
}

/// Planes that are not in use, all of one size.
#[derive(Default)]
struct Pool(Vec<Patch>);

impl Pool {
    fn take(&mut self, [rows, cols, channels]: [usize; 3]) -> Patch {
        self.0.pop().unwrap_or_else(|| Patch { rows, cols, channels, data: vec![0.0; rows * cols * channels] })
    }
}

impl Enhancement {
    /// That of pass `pass` (from 0), from the tensors of a checkpoint whose network has a filter bank (all but CM2Net).
    ///
    /// # Errors
    /// A weight is missing or has another shape.
    pub fn new(config: &NetworkConfig, pass: usize, tensors: &Tensors) -> Result<Self, TrainError> {
        Ok(Self { layers: Layers::new(config, pass, tensors)?, object: config.object, inputs: config.inputs(pass) })
    }

    /// Planes times `scale`, [inputs, object rows, object cols] -> logits, [object rows, object cols].
    ///
    /// The result does not depend on the number of threads.
    pub fn logits(&self, x: Vec<f32>, scale: f32) -> Vec<f32> {
        let size = [self.object[0] / 2, self.object[1] / 2, self.layers.head.outputs()];
        let mut pool = Pool::default();
        let mut head = pool.take(size);
        let source = Unshuffled { x: &x, size: self.object, scale, channels: padded(4 * self.inputs) };
        layer(&source, &self.layers.head, None, &mut head);
        drop(x);
        let mut y: Option<Patch> = None;
        for group in &self.layers.groups {
            let next = self.group(group, y.as_ref().unwrap_or(&head), size, &mut pool);
            pool.0.extend(y.replace(next));
        }
        let mut features = pool.take(size);
        let source = Gated { base: y.as_ref().unwrap_or(&head), add: None };
        layer(&source, &self.layers.body, Some(&head), &mut features);
        drop((pool, y, head));
        logits(&features, &self.layers.tail)
    }

    /// A residual group: blocks, a convolution, and its input added.
    fn group(&self, group: &Group, input: &Patch, size: [usize; 3], pool: &mut Pool) -> Patch {
        let pixels = (size[0] * size[1]) as f64;
        // What the blocks have made so far is `sum + gate residual`; before the second block the sum is the input.
        let mut sum: Option<Patch> = None;
        let mut last: Option<(Patch, Vec<f32>)> = None;
        for one in &group.blocks {
            let mut residual = pool.take(size);
            let mut kept = last.is_some().then(|| pool.take(size));
            let base = sum.as_ref().unwrap_or(input);
            let source = Gated { base, add: last.as_ref().map(|(r, gate)| (r, &gate[..])) };
            let to = kept.as_mut().map_or(&mut [][..], |k| &mut k.data[..]);
            let sums = block(&source, &one.convolutions, &mut residual, to);
            let means: Vec<f32> = sums.iter().map(|s| (s / pixels) as f32).collect();
            let mut gate = one.gate(&means);
            gate.resize(size[2], 0.0);
            if let Some((old, _)) = last.replace((residual, gate)) {
                pool.0.push(old);
            }
            if let Some(kept) = kept {
                pool.0.extend(sum.replace(kept));
            }
        }
        let mut out = pool.take(size);
        let source = Gated { base: sum.as_ref().unwrap_or(input), add: last.as_ref().map(|(r, g)| (r, &g[..])) };
        layer(&source, &group.last, Some(input), &mut out);
        pool.0.extend(sum);
        pool.0.extend(last.map(|(r, _)| r));
        out
    }
}
