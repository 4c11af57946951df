//! Weights of the enhancement network as halves, in the order of the network file.

use super::{QuantizeError, narrow};
use crate::artifact::Tensors;
use crate::train::NetworkConfig;
use crate::train::weights::name;
use ommatidia_shared::blob::Rcan;
use ommatidia_shared::nn::rcan::{Layer, layout};
use ommatidia_shared::num::f16;

/// Refuses weights that are no numbers.
///
/// # Errors
/// The first one.
pub fn check_finite(tensors: &Tensors) -> Result<(), QuantizeError> {
    for (name, tensor) in tensors {
        if let Some((index, &found)) = tensor.iter().enumerate().find(|(_, v)| !v.is_finite()) {
            return Err(QuantizeError::NotFinite { name: name.clone(), index, found });
        }
    }
    Ok(())
}

/// Rounded to halves.
///
/// # Errors
/// A value leaves their range.
pub fn halves(name: &str, values: impl Iterator<Item = f32>) -> Result<Vec<f16>, QuantizeError> {
    let one = |(index, found): (usize, f32)| {
        let half = f16::from_f32(found);
        if half.is_finite() { Ok(half) } else { Err(QuantizeError::Range { name: name.into(), index, found }) }
    };
    values.enumerate().map(one).collect()
}

/// Shape of the enhancement network as the file keeps it.
///
/// # Errors
/// A size is too large.
pub fn describe(network: &NetworkConfig) -> Result<Rcan, QuantizeError> {
    Ok(Rcan {
        width: narrow("width", network.width)?,
        groups: narrow("groups", network.groups)?,
        blocks: narrow("blocks", network.blocks)?,
        reduction: narrow("reduction", network.reduction)?,
    })
}

/// The weight section of the enhancement network.
///
/// # Errors
/// A weight leaves the range of halves.
pub fn rcan(network: &NetworkConfig, weights: &Tensors) -> Result<Vec<f16>, QuantizeError> {
    let mut section = Vec::new();
    for entry in layout(&describe(network)?, narrow("channels", network.channels)?) {
        let layer = layer(network, entry.layer);
        for (part, expected) in [("weight", entry.weights_len()), ("bias", entry.bias_len())] {
            let name = format!("{layer}.{part}");
            let found = weights.get(&name).map_or(0, |t| t.len());
            let Some(tensor) = weights.get(&name).filter(|_| found == expected) else {
                return Err(QuantizeError::Size {
                    field: "weights",
                    expected: format!("{expected} values in `{name}`"),
                    found,
                });
            };
            section.extend(halves(&name, tensor.iter().copied())?);
        }
    }
    Ok(section)
}

/// Name of a layer in the checkpoint.
fn layer(network: &NetworkConfig, layer: Layer) -> String {
    match layer {
        Layer::Head => name::HEAD.into(),
        Layer::BlockConv { group, block, conv } => name::conv(group.into(), block.into(), conv.into()),
        Layer::Squeeze { group, block } => name::attention(group.into(), block.into(), 0),
        Layer::Excite { group, block } => name::attention(group.into(), block.into(), 1),
        Layer::GroupConv { group } => name::group(group.into(), network.blocks),
        Layer::Conv1 => name::BODY.into(),
        Layer::Upscale => name::UPSCALE.into(),
        Layer::Conv2 => name::TAIL.into(),
    }
}
