//! From a checkpoint to a network file within a budget of memory.

use super::allowed::{check_architecture, check_integers};
use super::bank::PlannedBank;
use super::config::Numbers;
use super::integers::IntegerNetwork;
use super::pack::{self, narrow};
use super::passes::PlannedPasses;
use super::report::MadeFile;
use super::{QuantizeConfig, QuantizeError, QuantizeReport};
use crate::train::Checkpoint;
use ommatidia_shared::blob::{self, FeatureBits, Header, MemoryPlan, Sensor, Size, WatchWeights, Weights};
use ommatidia_shared::num::f16;
use ommatidia_shared::pipeline::Pipeline;

/// Bytes that pruning can add to a file besides the filters: a longer header, gaps before sections.
const SLACK: u64 = 64;

/// A network file, and its report.
#[derive(Clone, Debug)]
pub struct Quantized {
    /// Bytes of the file.
    pub bytes: Vec<u8>,
    /// Sizes, and quality before and after.
    pub report: QuantizeReport,
}

/// Makes the network file of a checkpoint; `hash` is the SHA-256 of the checkpoint's file, hexadecimal.
///
/// Filters that were trained with a mask keep it. Other filters are pruned if the file would not fit into the flash.
///
/// # Errors
/// A weight is not finite or too large for a half, a size is not supported by devices, or the budget is too small.
pub fn quantize(checkpoint: &Checkpoint, hash: &str, config: &QuantizeConfig) -> Result<Quantized, QuantizeError> {
    let whole = make(checkpoint, hash, config)?;
    let found = whole.bytes.len() as u64;
    let free = checkpoint.body.filter_mask.is_none() && config.tile.is_none() && config.prune.is_none();
    let made = match config.flash_bytes {
        Some(flash) if free && found > flash => {
            let dense = whole.report.dense_filter_bytes as u64;
            let part = (dense + flash).saturating_sub(found + SLACK) as f64 / dense as f64;
            // If not even one block a channel fits, the error reports how much memory the whole file lacks.
            make(checkpoint, hash, &QuantizeConfig { prune: Some(part), ..config.clone() }).unwrap_or(whole)
        }
        _ => whole,
    };
    budget("flash", config.flash_bytes, made.bytes.len() as u64)?;
    budget("RAM", config.ram_bytes, made.report.ram_bytes)?;
    Ok(made)
}

fn make(checkpoint: &Checkpoint, hash: &str, config: &QuantizeConfig) -> Result<Quantized, QuantizeError> {
    match config.numbers {
        Numbers::Halves => check_architecture(checkpoint)?,
        Numbers::Integers | Numbers::Bytes => check_integers(checkpoint)?,
    }
    let network = &checkpoint.body.network;
    pack::check_finite(&checkpoint.weights)?;
    let bank = PlannedBank::new(checkpoint, config)?;
    let (filters, index) = bank.filters()?;
    let integers = match config.numbers {
        Numbers::Halves => None,
        Numbers::Integers => Some(IntegerNetwork::of(checkpoint, FeatureBits::Sixteen)?),
        Numbers::Bytes => Some(IntegerNetwork::of(checkpoint, FeatureBits::Eight)?),
    };
    let mut rcan = match &integers {
        None => pack::rcan(network, &checkpoint.weights)?,
        Some(integers) => integers.attention.clone(),
    };
    let later = PlannedPasses::of(checkpoint)?;
    rcan.extend(later.iter().flat_map(|later| &later.rcan));
    let offset =
        checkpoint.maps.offset_dn.as_ref().map(|map| pack::halves("offset_dn", map.iter().copied())).transpose()?;
    let gain = checkpoint
        .maps
        .inverse_response
        .as_ref()
        .map(|map| pack::halves("inverse_gain", map.iter().copied()))
        .transpose()?;
    let weights = Weights {
        filters: &filters,
        index,
        rcan: &rcan,
        offset_dn: offset.as_deref(),
        inverse_gain: gain.as_deref(),
        convolutions: integers.as_ref().map(IntegerNetwork::convolutions),
        predictor: later.as_ref().map_or(&[], |later| &later.model),
        watch: config.watch.as_ref().map_or_else(WatchWeights::default, |watch| WatchWeights {
            maps: &watch.weights,
            statistics: &watch.statistics,
        }),
    };
    let parts = (integers.as_ref().map(|integers| integers.scales), later.as_ref().map(|later| later.passes.clone()));
    let header = header(checkpoint, hash, config, &bank, parts)?;
    let mut bytes = vec![0; blob::encoded_len(&header)?];
    let len = blob::encode(&header, &weights, &mut bytes)?;
    bytes.truncate(len);
    let file = MadeFile {
        header: &header,
        bytes: &bytes,
        filter_bytes: (filters.len() + index.len()) * size_of::<f16>(),
        rcan_bytes: rcan_bytes(&header)?,
        predictor_bytes: header.section_lens()?.predictor as usize * size_of::<f16>(),
        watch: config.watch.as_ref(),
    };
    let halves = match config.numbers {
        Numbers::Halves => None,
        Numbers::Integers | Numbers::Bytes => {
            Some(make(checkpoint, hash, &QuantizeConfig { numbers: Numbers::Halves, ..config.clone() })?)
        }
    };
    let report = QuantizeReport::new(checkpoint, &bank, &file, halves.map(|halves| halves.bytes))?;
    Ok(Quantized { bytes, report })
}

/// Length of the enhancement network in the file, bytes.
fn rcan_bytes(header: &Header) -> Result<usize, QuantizeError> {
    let lens = header.section_lens()?;
    Ok((lens.rcan + lens.integers + lens.channels) as usize * size_of::<u16>())
}

fn header(
    checkpoint: &Checkpoint,
    hash: &str,
    config: &QuantizeConfig,
    bank: &PlannedBank,
    (integers, passes): (Option<blob::Integers>, Option<blob::Passes>),
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
            has_gain_map: checkpoint.maps.inverse_response.is_some(),
        },
        bank: bank.describe()?,
        rcan: pack::describe(network)?,
        memory: MemoryPlan { fast_bytes: 0, bulk_bytes: 0 },
        integers,
        passes,
        watch: config.watch.as_ref().map(|watch| watch.header(network.frame)).transpose()?,
    };
    header.memory = Pipeline::plan(&header)?;
    Ok(header)
}

/// The start of a text that fits into `most` bytes, cut between characters.
fn cut(text: &str, most: usize) -> &str {
    let end = text.char_indices().map(|(at, c)| at + c.len_utf8()).take_while(|&end| end <= most).last().unwrap_or(0);
    &text[..end]
}

fn budget(what: &'static str, expected: Option<u64>, found: u64) -> Result<(), QuantizeError> {
    match expected {
        Some(expected) if found > expected => {
            Err(QuantizeError::Budget { what, expected, found, missing: found - expected })
        }
        _ => Ok(()),
    }
}
