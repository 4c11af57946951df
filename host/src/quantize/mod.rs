//! Checkpoint -> network file of a device: filters to taps, weights to halves, memory plan, budget.

mod bank;
mod error;
mod pack;
mod report;
#[cfg(test)]
mod tests;

pub use error::QuantizeError;
pub use report::{Quality, QuantizeReport, Step};

use crate::train::{Checkpoint, Family, Support};
use bank::PlannedBank;
use ommatidia_shared::blob::{self, Header, MemoryPlan, Sensor, Size, Weights};
use ommatidia_shared::num::f16;
use ommatidia_shared::pipeline::Pipeline;
use serde::{Deserialize, Serialize};

/// How a network is made ready for a device.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct QuantizeConfig {
    /// Name that the network carries, at most 48 bytes; longer names are cut.
    pub name: String,
    /// Most bytes that the file may have.
    pub flash_bytes: Option<u64>,
    /// Most bytes of memory that it may need while it runs, fast and bulk together.
    pub ram_bytes: Option<u64>,
    /// Side of the transforms, pixels, a power of two: the filters are cut into taps. None: one transform of the whole padded frame.
    pub tile: Option<usize>,
    /// Part of the filters' energy that the taps must keep.
    pub energy: Option<f64>,
}

/// A network file, and what making it cost.
#[derive(Clone, Debug)]
pub struct Quantized {
    /// The file.
    pub bytes: Vec<u8>,
    /// What it cost.
    pub report: QuantizeReport,
}

/// Makes the network file of a checkpoint; `hash` is the SHA-256 of the checkpoint's file, hexadecimal.
///
/// # Errors
/// A weight is no number or too large for a half, a size is none that a device can have, or the budget is too small.
pub fn quantize(checkpoint: &Checkpoint, hash: &str, config: &QuantizeConfig) -> Result<Quantized, QuantizeError> {
    let network = &checkpoint.body.network;
    if network.family != Family::SvFourierNet {
        return Err(QuantizeError::Family(network.family.name().as_str()));
    }
    pack::check_finite(&checkpoint.weights)?;
    let bank = PlannedBank::new(checkpoint, config)?;
    let spectra = bank.spectra()?;
    let rcan = pack::rcan(network, &checkpoint.weights)?;
    let offset =
        checkpoint.maps.offset_dn.as_ref().map(|map| pack::halves("offset_dn", map.iter().copied())).transpose()?;
    let gain = checkpoint
        .maps
        .inverse_gain
        .as_ref()
        .map(|map| pack::halves("inverse_gain", map.iter().copied()))
        .transpose()?;
    let weights =
        Weights { spectra: &spectra, rcan: &rcan, offset_dn: offset.as_deref(), inverse_gain: gain.as_deref() };
    let header = header(checkpoint, hash, config, &bank)?;
    let mut bytes = vec![0; blob::encoded_len(&header)?];
    let len = blob::encode(&header, &weights, &mut bytes)?;
    bytes.truncate(len);
    budget("flash", config.flash_bytes, bytes.len() as u64)?;
    budget("RAM", config.ram_bytes, report::ram_bytes(&header))?;
    let report = QuantizeReport::new(
        checkpoint,
        &bank,
        &header,
        &bytes,
        [spectra.len(), rcan.len()].map(|n| n * size_of::<f16>()),
    )?;
    Ok(Quantized { bytes, report })
}

/// The taps of `tile` that keep the part `energy` of a checkpoint's filters, and the part that they keep: what fine-tuning holds filters to.
///
/// # Errors
/// The network is of another family, the tile is none that a device can have, or no set of taps keeps as much.
pub fn support(checkpoint: &Checkpoint, tile: usize, energy: f64) -> Result<(Support, f64), QuantizeError> {
    let family = checkpoint.body.network.family.name();
    if checkpoint.body.network.family != Family::SvFourierNet {
        return Err(QuantizeError::Family(family.as_str()));
    }
    let config = QuantizeConfig { tile: Some(tile), energy: Some(energy), ..QuantizeConfig::default() };
    let bank = PlannedBank::new(checkpoint, &config)?;
    Ok((bank.support(), bank.energy_kept))
}

fn header(
    checkpoint: &Checkpoint,
    hash: &str,
    config: &QuantizeConfig,
    bank: &PlannedBank,
) -> Result<Header, QuantizeError> {
    let (network, noise) = (&checkpoint.body.network, &checkpoint.body.noise);
    let size = |field, [rows, cols]: [usize; 2]| -> Result<Size, QuantizeError> {
        Ok(Size { rows: narrow(field, rows)?, cols: narrow(field, cols)? })
    };
    let mut header = Header {
        name: cut(&config.name, 48).parse().unwrap_or_default(),
        checkpoint: cut(hash, 16).parse().unwrap_or_default(),
        frame: size("frame", network.frame)?,
        object: size("object", network.object)?,
        sensor: Sensor {
            black_level_dn: noise.black_level_dn as f32,
            saturation_dn: narrow("saturation_dn", noise.saturation_dn as usize)?,
            has_offset_map: checkpoint.maps.offset_dn.is_some(),
            has_gain_map: checkpoint.maps.inverse_gain.is_some(),
        },
        bank: bank.describe()?,
        rcan: pack::describe(network)?,
        memory: MemoryPlan { fast_bytes: 0, bulk_bytes: 0 },
    };
    header.memory = Pipeline::plan(&header)?;
    Ok(header)
}

/// As much of a text as fits into `most` bytes.
fn cut(text: &str, most: usize) -> &str {
    let end = text.char_indices().map(|(at, c)| at + c.len_utf8()).take_while(|&end| end <= most).last().unwrap_or(0);
    &text[..end]
}

/// A size as the device keeps it.
fn narrow<T: TryFrom<usize>>(field: &'static str, value: usize) -> Result<T, QuantizeError> {
    let limit = 256usize.pow(size_of::<T>() as u32) - 1;
    value.try_into().map_err(|_| QuantizeError::Size { field, expected: format!("at most {limit}"), found: value })
}

fn budget(what: &'static str, expected: Option<u64>, found: u64) -> Result<(), QuantizeError> {
    match expected {
        Some(expected) if found > expected => {
            Err(QuantizeError::Budget { what, expected, found, missing: found - expected })
        }
        _ => Ok(()),
    }
}
