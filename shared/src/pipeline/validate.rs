//! The checks at the door.

use super::error::PipelineError;
use crate::blob::{Header, Section, Weights};
use crate::filter::{FilterBank, Filters};
use crate::nn::rcan::{self, Rcan};
use crate::num::f16;

/// The largest side of a frame or an object, so that no product of shapes overflows 32 bits.
const MAX_SIDE: u32 = 4096;

/// Checks the shapes of a header and plans the operators.
pub(super) fn shapes(header: &Header) -> Result<(FilterBank<'_>, Rcan), PipelineError> {
    for (field, side) in [("frame.rows", header.frame.rows), ("frame.cols", header.frame.cols)] {
        check(field, "1 to 4096 pixels", u32::from(side), |side| (1..=MAX_SIDE).contains(&side))?;
    }
    for (field, side) in [("object.rows", header.object.rows), ("object.cols", header.object.cols)] {
        let even = |side| (2..=MAX_SIDE).contains(&side) && side % 2 == 0;
        check(field, "an even number of 2 to 4096 pixels", u32::from(side), even)?;
    }
    let network = header.rcan;
    check("rcan.width", "1 to 63 channels", network.width.into(), |width| (1..64).contains(&width))?;
    let divides = |reduction| reduction > 0 && u32::from(network.width) % reduction == 0;
    check("rcan.reduction", "a divisor of the width", network.reduction.into(), divides)?;
    check("bank.channels", "1 to 63 channels", header.bank.channels.into(), |channels| (1..64).contains(&channels))?;
    if !header.sensor.black_level_dn.is_finite() {
        return Err(PipelineError::BlackLevel { found: header.sensor.black_level_dn });
    }
    let filter = FilterBank::new(&header.bank, header.frame, header.object)?;
    Ok((filter, Rcan::new(network, header.bank.channels, header.object)))
}

fn check(
    field: &'static str,
    expected: &'static str,
    found: u32,
    good: impl Fn(u32) -> bool,
) -> Result<(), PipelineError> {
    if good(found) { Ok(()) } else { Err(PipelineError::Field { field, expected, found }) }
}

/// Checks the lengths of the weights and that all are finite.
pub(super) fn weights(header: &Header, filter: &FilterBank<'_>, weights: &Weights<'_>) -> Result<(), PipelineError> {
    let pixels = usize::from(header.frame.rows) * usize::from(header.frame.cols);
    let map = |present: bool| if present { pixels } else { 0 };
    let filters = Filters { halves: weights.filters, index: weights.index };
    filter.check(filters)?;
    section(Section::Filters, filters.halves.len(), filters.halves)?;
    section(Section::Rcan, rcan::weights_len(&header.rcan, header.bank.channels), weights.rcan)?;
    section(Section::Offset, map(header.sensor.has_offset_map), weights.offset_dn.unwrap_or(&[]))?;
    section(Section::InverseGain, map(header.sensor.has_gain_map), weights.inverse_gain.unwrap_or(&[]))
}

fn section(section: Section, expected: usize, weights: &[f16]) -> Result<(), PipelineError> {
    if weights.len() != expected {
        return Err(PipelineError::Length { section, expected, found: weights.len() });
    }
    match weights.iter().position(|weight| !weight.is_finite()) {
        Some(index) => Err(PipelineError::NotFinite { section, index }),
        None => Ok(()),
    }
}
