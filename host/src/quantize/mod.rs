//! Checkpoint -> network file of a device: filters to taps, weights to halves, memory plan, budget.

mod bank;
mod choose;
mod error;
mod pack;
mod plane;
mod report;
#[cfg(test)]
mod tests;

pub use error::QuantizeError;
pub use report::{Quality, QuantizeReport, Step};

use crate::train::{Checkpoint, Family, Support};
use bank::PlannedBank;
pub use choose::BLOCK;
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
    /// Part of the dense filters' bytes that the strongest blocks of their kernels may take, with their index.
    pub prune: Option<f64>,
}

/// Bytes by which a pruned file may be longer than its filters: a longer header, gaps before sections.
const SLACK: u64 = 64;

/// A network file, and what making it cost.
#[derive(Clone, Debug)]
pub struct Quantized {
    /// The file.
    pub bytes: Vec<u8>,
    /// What it cost.
    pub report: QuantizeReport,
}

/// Makes the network file of a checkpoint; `hash` is the SHA-256 of the checkpoint's file, hexadecimal. Filters that were held to some lags while they
/// were trained keep these; others are pruned where the file would not fit into the flash.
///
/// # Errors
/// A weight is no number or too large for a half, a size is none that a device can have, or the budget is too small.
pub fn quantize(checkpoint: &Checkpoint, hash: &str, config: &QuantizeConfig) -> Result<Quantized, QuantizeError> {
    let whole = make(checkpoint, hash, config)?;
    let found = whole.bytes.len() as u64;
    let free = checkpoint.body.support.is_none() && config.tile.is_none() && config.prune.is_none();
    let made = match config.flash_bytes {
        Some(flash) if free && found > flash => {
            let dense = whole.report.dense_filter_bytes as u64;
            let part = (dense + flash).saturating_sub(found + SLACK) as f64 / dense as f64;
            // Where not even one block a channel fits, the whole file tells how much is missing.
            make(checkpoint, hash, &QuantizeConfig { prune: Some(part), ..config.clone() }).unwrap_or(whole)
        }
        _ => whole,
    };
    budget("flash", config.flash_bytes, made.bytes.len() as u64)?;
    budget("RAM", config.ram_bytes, made.report.ram_bytes)?;
    Ok(made)
}

fn make(checkpoint: &Checkpoint, hash: &str, config: &QuantizeConfig) -> Result<Quantized, QuantizeError> {
    let network = &checkpoint.body.network;
    if network.family != Family::SvFourierNet {
        return Err(QuantizeError::Family(network.family.name().as_str()));
    }
    pack::check_finite(&checkpoint.weights)?;
    let bank = PlannedBank::new(checkpoint, config)?;
    let (filters, index) = bank.filters()?;
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
        Weights { filters: &filters, index, rcan: &rcan, offset_dn: offset.as_deref(), inverse_gain: gain.as_deref() };
    let header = header(checkpoint, hash, config, &bank)?;
    let mut bytes = vec![0; blob::encoded_len(&header)?];
    let len = blob::encode(&header, &weights, &mut bytes)?;
    bytes.truncate(len);
    let lens = [filters.len() + index.len(), rcan.len()].map(|n| n * size_of::<f16>());
    let report = QuantizeReport::new(checkpoint, &bank, &header, &bytes, lens)?;
    Ok(Quantized { bytes, report })
}

/// What a checkpoint's filters would be cut or pruned to, and the part of their energy that this keeps: what fine-tuning holds filters to. None: they
/// stay whole.
///
/// # Errors
/// The network is of another family, or what is asked for cannot be kept.
pub fn support(checkpoint: &Checkpoint, config: &QuantizeConfig) -> Result<Option<(Support, f64)>, QuantizeError> {
    let family = checkpoint.body.network.family.name();
    if checkpoint.body.network.family != Family::SvFourierNet {
        return Err(QuantizeError::Family(family.as_str()));
    }
    let bank = PlannedBank::new(checkpoint, config)?;
    Ok(bank.support.map(|support| (support, bank.energy_kept)))
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
