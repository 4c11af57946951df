//! Sizes as narrow integers, and weights as halves in the order of the network file.

use super::QuantizeError;
use crate::train::NetworkConfig;
use crate::train::weights::name;
use ommatidia_session::artifact::Tensors;
use ommatidia_shared::blob::Rcan;
use ommatidia_shared::nn::rcan::{Entry, Layer, layout};
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
        section.extend(layer_halves(network, weights, &entry)?);
    }
    Ok(section)
}

/// Weights and biases of a layer as halves.
///
/// # Errors
/// As [`rcan`].
pub fn layer_halves(network: &NetworkConfig, weights: &Tensors, entry: &Entry) -> Result<Vec<f16>, QuantizeError> {
    let [w, b] = layer_values(network, weights, entry)?;
    let name = layer(network, entry.layer);
    let mut section = halves(&format!("{name}.weight"), w.into_iter())?;
    section.extend(halves(&format!("{name}.bias"), b.into_iter())?);
    Ok(section)
}

/// Weights and biases of a layer.
///
/// # Errors
/// A tensor is missing or has the wrong length.
pub fn layer_values(network: &NetworkConfig, weights: &Tensors, entry: &Entry) -> Result<[Vec<f32>; 2], QuantizeError> {
    let layer = layer(network, entry.layer);
    let values = |part: &str, expected: usize| {
        let name = format!("{layer}.{part}");
        let found = weights.get(&name).map_or(0, |t| t.len());
        match weights.get(&name).filter(|_| found == expected) {
            Some(tensor) => Ok(tensor.iter().copied().collect()),
            None => {
                let expected = format!("{expected} values in `{name}`");
                Err(QuantizeError::Size { field: "weights", expected, found })
            }
        }
    };
    Ok([values("weight", entry.weights_len())?, values("bias", entry.bias_len())?])
}

/// Name of a layer of the file in the checkpoint.
pub fn layer(network: &NetworkConfig, layer: Layer) -> String {
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
