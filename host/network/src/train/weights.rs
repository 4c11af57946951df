//! The parameters of a network: names, shapes, and values before training.

use super::{Architecture, NetworkConfig};
use ndarray::{ArrayD, IxDyn};
use ommatidia_session::artifact::{self, ArtifactError, Tensors};
use ommatidia_session::rng;
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};
use std::path::Path;

/// Names of the real and imaginary parts of the filters.
pub const FILTERS: [&str; 2] = ["deconvolution.psfs_re", "deconvolution.psfs_im"];

/// Name of the PSFs of a MultiWienerNet.
pub const PSFS: &str = "deconvolution.psfs";
/// Name of the logarithms of the regularisations of a MultiWienerNet; logarithms keep them positive.
pub const LOG_K: &str = "deconvolution.log_k";
/// Name of the filters of a MultiFlatNet, which are learned in space.
pub const KERNELS: &str = "deconvolution.filters";

/// Name of the basis PSFs that feedback predicts frames with, [lens, term, window, window].
pub const BASIS: &str = "feedback.basis";
/// Name of their coefficients at the nodes of a grid over the object, [lens, term, node row, node col].
pub const COEFFICIENTS: &str = "feedback.coefficients";
/// Names of the rows and of the columns of the nodes, object pixels.
pub const NODES: [&str; 2] = ["feedback.node_rows", "feedback.node_cols"];

/// Whether the tensor with this name is calibrated and not learned.
pub fn is_calibrated(name: &str) -> bool {
    name == BASIS || name == COEFFICIENTS || NODES.contains(&name)
}

/// Whether the parameter with this name belongs to the filters of the first layer.
pub fn is_filter(name: &str) -> bool {
    FILTERS.contains(&name) || name == PSFS || name == KERNELS
}

/// Names of the layers after the filters, as in the reference implementation.
pub mod name {
    /// Convolution after the PixelUnshuffle.
    pub const HEAD: &str = "enhancement.downscale.1";
    /// Convolution after the residual groups.
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

    /// What comes before the names of the layers of pass `pass`, counted from 0.
    pub fn of_pass(pass: usize) -> String {
        if pass == 0 { String::new() } else { format!("pass{}.", pass + 1) }
    }

    /// Part of a CM2Net that separates the views.
    pub const DEMIX: &str = "demix";
    /// Part of a CM2Net that joins the views.
    pub const JOIN: &str = "recon";
    /// The last convolution of a CM2Net.
    pub const END: &str = "endconv";

    /// First (`which` = 1) or second (2) convolution of a part, before and after its blocks.
    pub fn part(part: &str, which: usize) -> String {
        format!("{part}.conv{which}")
    }

    /// First (`which` = 1) or second (2) convolution of a block of a part.
    pub fn part_block(part: &str, block: usize, which: usize) -> String {
        format!("{part}.resblocks.{block}.conv{which}")
    }

    /// Convolution at the end of a group.
    pub fn group(group: usize, blocks: usize) -> String {
        format!("enhancement.rgs.{group}.module.{blocks}")
    }
}

/// Layers after the filters in the order of their use: name, and [outputs, inputs, side of the kernel].
pub fn layers(config: &NetworkConfig) -> Vec<(String, [usize; 3])> {
    if let Architecture::Cm2Net { .. } = config.architecture {
        return cm2net(config);
    }
    let of = |pass| {
        let prefix = name::of_pass(pass);
        enhancement(config, pass).into_iter().map(move |(name, shape)| (format!("{prefix}{name}"), shape))
    };
    (0..config.passes()).flat_map(of).collect()
}

/// The layers of one enhancement network.
fn enhancement(config: &NetworkConfig, pass: usize) -> Vec<(String, [usize; 3])> {
    let (w, bottleneck) = (config.width, config.bottleneck());
    let mut layers = vec![(name::HEAD.to_string(), [w, 4 * config.inputs(pass), 3])];
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

fn cm2net(config: &NetworkConfig) -> Vec<(String, [usize; 3])> {
    let (w, c) = (config.width, config.channels);
    let part = |part: &'static str| {
        let blocks = (0..config.blocks).flat_map(move |b| [1, 2].map(|i| (name::part_block(part, b, i), [w, w, 3])));
        [(name::part(part, 1), [w, c, 3])].into_iter().chain(blocks).chain([(name::part(part, 2), [c, w, 3])])
    };
    part(name::DEMIX).chain(part(name::JOIN)).chain([(name::END.to_string(), [1, c, 3])]).collect()
}

/// Name and shape of every parameter: convolutions [outputs, inputs, side, side], filters [C, T, T/2+1] in frequency
/// and [C, T, T] in space.
pub fn shapes(config: &NetworkConfig) -> Vec<(String, Vec<usize>)> {
    let t = config.filter_size;
    let c = config.channels;
    let filters: Vec<(&str, Vec<usize>)> = match config.architecture {
        Architecture::SvFourierNet => FILTERS.map(|f| (f, vec![c, t, t / 2 + 1])).to_vec(),
        Architecture::MultiWienerNet => vec![(PSFS, vec![c, t, t]), (LOG_K, vec![c])],
        Architecture::MultiFlatNet => vec![(KERNELS, vec![c, t, t])],
        Architecture::Cm2Net { .. } => Vec::new(),
    };
    let filters = filters.into_iter().map(|(name, shape)| (name.to_string(), shape));
    let layers = layers(config).into_iter().flat_map(|(name, [outputs, inputs, side])| {
        [(format!("{name}.weight"), vec![outputs, inputs, side, side]), (format!("{name}.bias"), vec![outputs])]
    });
    let feedback = config.feedback.iter().flat_map(|feedback| {
        let ([lenses, terms], [rows, cols], window) =
            ([feedback.corners.len(), feedback.terms], feedback.nodes, feedback.window);
        let nodes = NODES.into_iter().zip([vec![rows], vec![cols]]);
        [(BASIS, vec![lenses, terms, window, window]), (COEFFICIENTS, vec![lenses, terms, rows, cols])]
            .into_iter()
            .chain(nodes)
            .map(|(name, shape)| (name.to_string(), shape))
    });
    filters.chain(layers).chain(feedback).collect()
}

/// Number of learned parameters.
pub fn count(config: &NetworkConfig) -> usize {
    let learned = shapes(config).into_iter().filter(|(name, _)| !is_calibrated(name));
    learned.map(|(_, shape)| shape.iter().product::<usize>()).sum()
}

/// Random parameters before training: filters 0.001 x U[0, 1] (Yang et al. 2024, section 2D), convolutions normal with
/// variance 2 / fan-in (K. He et al., arXiv:1502.01852, Eq. 10), biases 0, regularisations 0.001.
pub fn random(config: &NetworkConfig, seed: u64) -> Tensors {
    let mut tensors = Tensors::new();
    let begins = |name: &str| name.starts_with("pass") || config.iterations() > 0;
    for (i, (name, shape)) in shapes(config).into_iter().enumerate() {
        let mut rng = rng::stream(seed, "weights", i as u64);
        let n = shape.iter().product();
        let values = if is_filter(&name) {
            (0..n).map(|_| 1e-3 * rng.random::<f32>()).collect()
        } else if name == LOG_K {
            vec![1e-3f32.ln(); n]
        } else if begins(&name) && name.ends_with(&format!("{}.weight", name::TAIL)) {
            // A pass behind another or behind an estimate changes nothing before it has learned what to change.
            vec![0.0; n]
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

/// An array of this shape; `values` must have the length of the shape.
pub(super) fn array(shape: &[usize], values: Vec<f32>) -> ArrayD<f32> {
    ArrayD::from_shape_vec(IxDyn(shape), values).unwrap_or_else(|_| ArrayD::zeros(IxDyn(shape)))
}

/// Moves the parameters named `prefix` + name out of `tensors`, which were read from the file `path`.
///
/// # Errors
/// A parameter is missing or has another shape.
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
