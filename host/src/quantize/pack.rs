//! Sizes as narrow integers, and weights as halves in the order of the network file.

use super::QuantizeError;
use crate::artifact::Tensors;
use crate::train::NetworkConfig;
use crate::train::weights::name;
use ommatidia_shared::blob::Rcan;
use ommatidia_shared::nn::rcan::{Layer, layout};
use ommatidia_shared::num::f16;

/// Checks that all weights are finite.
///
/// # Errors
/// [`QuantizeError::NotFinite`] with the first weight that is not.
pub fn check_finite(tensors: &Tensors) -> Result<(), QuantizeError> {
    for (name, tensor) in tensors {
        if let Some((index, &found)) = tensor.iter().enumerate().find(|(_, v)| !v.is_finite()) {
            return Err(QuantizeError::NotFinite { name: name.clone(), index, found });
        }
    }
    Ok(())
}

/// A size as the narrower integer type that the file stores.
///
/// # Errors
/// The size is too large for the type.
pub fn narrow<T: TryFrom<usize>>(field: &'static str, value: usize) -> Result<T, QuantizeError> {
    let limit = 256usize.pow(size_of::<T>() as u32) - 1;
    value.try_into().map_err(|_| QuantizeError::Size { field, expected: format!("at most {limit}"), found: value })
}

/// Values rounded to IEEE half precision; `name` names them in errors.
///
/// # Errors
/// A value is too large for a half.
pub fn halves(name: &str, values: impl Iterator<Item = f32>) -> Result<Vec<f16>, QuantizeError> {
    let one = |(index, found): (usize, f32)| {
        let half = f16::from_f32(found);
        if half.is_finite() { Ok(half) } else { Err(QuantizeError::Range { name: name.into(), index, found }) }
    };
    values.enumerate().map(one).collect()
}

/// Shape of the enhancement network as the file stores it.
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

/// The weights of the enhancement network in the order of the file.
///
/// # Errors
/// A tensor is missing or has the wrong length, or a weight is too large for a half.
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

/// Name of a layer of the file in the checkpoint.
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
