//! The network's parameters: names, shapes, and what they are before training.

use super::NetworkConfig;
use crate::artifact::{self, ArtifactError, Tensors};
use crate::rng;
use ndarray::{ArrayD, IxDyn};
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};
use std::path::Path;

/// Names of the filters' real and imaginary parts.
pub const FILTERS: [&str; 2] = ["deconvolution.psfs_re", "deconvolution.psfs_im"];

/// The layers behind the filters, by the names that the reference gives them.
pub mod name {
    /// Convolution behind the PixelUnshuffle.
    pub const HEAD: &str = "enhancement.downscale.1";
    /// Convolution behind the residual groups.
    pub const BODY: &str = "enhancement.conv1";
    /// Convolution before the PixelShuffle.
    pub const UPSCALE: &str = "enhancement.upscale.0";
    /// The last convolution.
    pub const TAIL: &str = "enhancement.conv2";

    /// First (`which` = 0) or second (1) convolution of a block.
    pub fn conv(group: usize, block: usize, which: usize) -> String {
        format!("enhancement.rgs.{group}.module.{block}.module.{}", 2 * which)
    }

    /// First (`which` = 0) or second (1) linear layer of a block's attention.
    pub fn attention(group: usize, block: usize, which: usize) -> String {
        format!("enhancement.rgs.{group}.module.{block}.module.3.module.{}", 1 + 2 * which)
    }

    /// Convolution at the end of a group.
    pub fn group(group: usize, blocks: usize) -> String {
        format!("enhancement.rgs.{group}.module.{blocks}")
    }
}

/// Layers behind the filters in the order of their use: name, outputs, inputs, side of the kernel.
pub fn layers(config: &NetworkConfig) -> Vec<(String, [usize; 3])> {
    let (w, bottleneck) = (config.width, config.bottleneck());
    let mut layers = vec![(name::HEAD.to_string(), [w, 4 * config.channels, 3])];
    for g in 0..config.groups {
        for b in 0..config.blocks {
            layers.push((name::conv(g, b, 0), [w, w, 3]));
            layers.push((name::conv(g, b, 1), [w, w, 3]));
            layers.push((name::attention(g, b, 0), [bottleneck, w, 1]));
            layers.push((name::attention(g, b, 1), [w, bottleneck, 1]));
        }
        layers.push((name::group(g, config.blocks), [w, w, 3]));
    }
    layers.push((name::BODY.into(), [w, w, 3]));
    layers.push((name::UPSCALE.into(), [4 * w, w, 3]));
    layers.push((name::TAIL.into(), [1, w, 3]));
    layers
}

/// Every parameter's name and shape; convolutions [outputs, inputs, side, side], filters [C, T, T/2+1].
pub fn shapes(config: &NetworkConfig) -> Vec<(String, Vec<usize>)> {
    let t = config.filter_size;
    let filters = FILTERS.map(|f| (f.to_string(), vec![config.channels, t, t / 2 + 1]));
    let layers = layers(config).into_iter().flat_map(|(name, [outputs, inputs, side])| {
        [(format!("{name}.weight"), vec![outputs, inputs, side, side]), (format!("{name}.bias"), vec![outputs])]
    });
    filters.into_iter().chain(layers).collect()
}

/// Parameters before training: filters 0.001 x U[0, 1] (paper, section 2D), convolutions normal with variance
/// 2 / fan-in (K. He et al., arXiv:1502.01852, Eq. 10), biases 0.
pub fn random(config: &NetworkConfig, seed: u64) -> Tensors {
    let mut tensors = Tensors::new();
    for (i, (name, shape)) in shapes(config).into_iter().enumerate() {
        let mut rng = rng::stream(seed, "weights", i as u64);
        let n = shape.iter().product();
        let values = if FILTERS.contains(&name.as_str()) {
            (0..n).map(|_| 1e-3 * rng.random::<f32>()).collect()
        } else if name.ends_with(".weight") {
            let deviation = (2.0 / shape[1..].iter().product::<usize>() as f32).sqrt();
            (0..n).map(|_| deviation * Distribution::<f32>::sample(&StandardNormal, &mut rng)).collect()
        } else {
            vec![0.0; n]
        };
        tensors.insert(name, array(&shape, values));
    }
    tensors
}

/// An array of this shape; `values` must have its length.
pub(super) fn array(shape: &[usize], values: Vec<f32>) -> ArrayD<f32> {
    ArrayD::from_shape_vec(IxDyn(shape), values).unwrap_or_else(|_| ArrayD::zeros(IxDyn(shape)))
}

/// Takes the parameters named `prefix` + name out of the tensors of the file `path`.
///
/// # Errors
/// One is missing or has another shape.
pub fn take(
    path: &Path,
    config: &NetworkConfig,
    tensors: &mut Tensors,
    prefix: &str,
) -> Result<Tensors, ArtifactError> {
    let mut taken = Tensors::new();
    for (name, shape) in shapes(config) {
        let shape: Vec<Option<usize>> = shape.into_iter().map(Some).collect();
        let tensor = artifact::take(path, tensors, &format!("{prefix}{name}"), &shape)?;
        taken.insert(name, tensor);
    }
    Ok(taken)
}
