//! The weights of the enhancement network, by their names in a checkpoint.

use super::super::ops::winograd::Kernels;
use super::super::weights::name;
use super::super::{NetworkConfig, TrainError, weights};
use super::tail::Tail;
use ommatidia_session::artifact::Tensors;

/// All layers of the network.
pub struct Layers {
    pub head: Kernels,
    pub groups: Vec<Group>,
    pub body: Kernels,
    pub tail: Tail,
}

/// A residual group.
pub struct Group {
    pub blocks: Vec<Block>,
    pub last: Kernels,
}

/// A residual block with channel attention.
pub struct Block {
    pub convolutions: [Kernels; 2],
    pub attention: [Linear; 2],
}

/// A linear layer: weights [outputs, inputs], and a bias for each output.
pub struct Linear {
    weight: Vec<f32>,
    bias: Vec<f32>,
}

impl Linear {
    /// The outputs for `x`.
    fn apply(&self, x: &[f32]) -> Vec<f32> {
        let rows = self.weight.chunks_exact(x.len().max(1));
        rows.zip(&self.bias).map(|(w, b)| w.iter().zip(x).map(|(w, x)| w * x).sum::<f32>() + b).collect()
    }
}

impl Block {
    /// The gate of each channel, `sigmoid(W2 relu(W1 means + b1) + b2)`, from the field's means; those of
    /// channels without a meaning are left out.
    pub fn gate(&self, means: &[f32]) -> Vec<f32> {
        let [first, second] = &self.attention;
        let means = &means[..first.weight.len() / first.bias.len().max(1)];
        let squeezed: Vec<f32> = first.apply(means).into_iter().map(|v| v.max(0.0)).collect();
        second.apply(&squeezed).into_iter().map(sigmoid).collect()
    }
}

/// The logistic function.
pub fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + (-x).exp())
}

impl Layers {
    /// Takes the layers of pass `pass` of a network with a filter bank from the tensors of a checkpoint.
    ///
    /// # Errors
    /// A weight is missing or has another shape.
    pub fn new(config: &NetworkConfig, pass: usize, tensors: &Tensors) -> Result<Self, TrainError> {
        let prefix = name::of_pass(pass);
        let shapes: std::collections::BTreeMap<_, _> = weights::shapes(config).into_iter().collect();
        let flat = |name: String| {
            let shape = shapes.get(&name);
            let found = tensors.get(&name).filter(|t| shape.is_some_and(|s| t.shape() == s));
            found.map(|t| t.iter().copied().collect::<Vec<f32>>()).ok_or_else(|| TrainError::Config {
                field: "weights",
                expected: format!("`{name}` of shape {shape:?}"),
                found: tensors.get(&name).map_or("none".into(), |t| format!("{:?}", t.shape())),
            })
        };
        let both = |layer: &str| {
            let layer = format!("{prefix}{layer}");
            Ok::<_, TrainError>([flat(format!("{layer}.weight"))?, flat(format!("{layer}.bias"))?])
        };
        let kernels = |layer: &str| both(layer).map(|[weight, bias]| Kernels::new(&weight, &bias));
        let linear = |layer: &str| both(layer).map(|[weight, bias]| Linear { weight, bias });
        let block = |g: usize, b: usize| -> Result<Block, TrainError> {
            Ok(Block {
                convolutions: [kernels(&name::conv(g, b, 0))?, kernels(&name::conv(g, b, 1))?],
                attention: [linear(&name::attention(g, b, 0))?, linear(&name::attention(g, b, 1))?],
            })
        };
        let group = |g: usize| -> Result<Group, TrainError> {
            let blocks = (0..config.blocks).map(|b| block(g, b)).collect::<Result<_, _>>()?;
            Ok(Group { blocks, last: kernels(&name::group(g, config.blocks))? })
        };
        Ok(Self {
            head: kernels(name::HEAD)?,
            groups: (0..config.groups).map(group).collect::<Result<_, _>>()?,
            body: kernels(name::BODY)?,
            tail: Tail::new(&both(name::UPSCALE)?, &both(name::TAIL)?),
        })
    }
}
