//! The checks of a header and of the weights that belong to it.

use super::error::{BlobError, Section};
use super::header::{Header, HeaderField, Integers, MemoryPlan, SectionLens, Sensor, Size, Weights};
use super::layout::SECTIONS;
use crate::nn::integer::counts;
use crate::nn::rcan::{attention_count, weights_count};
use half::f16;

impl Header {
    /// Number of 16-bit words that each weight section of this network has.
    ///
    /// # Errors
    /// [`BlobError::Header`] names the field whose value is impossible.
    pub fn section_lens(&self) -> Result<SectionLens, BlobError> {
        let tile = u64::from(self.bank.tile);
        let pixels = u64::from(self.frame.rows) * u64::from(self.frame.cols);
        if self.rcan.reduction == 0 {
            return Err(BlobError::Header { field: HeaderField::Rcan });
        }
        if self.bank.blocks.is_some_and(|b| !b.side.is_power_of_two() || b.side > self.bank.tile) {
            return Err(BlobError::Header { field: HeaderField::Blocks });
        }
        let (filters, index) = match self.bank.blocks {
            None => (self.bank.taps.len() as u64 * tile * (tile / 2 + 1) * 2, 0),
            Some(blocks) => {
                let rows = u64::from(self.bank.channels) * blocks.across(self.bank.tile) as u64;
                (u64::from(blocks.count) * u64::from(blocks.side).pow(2), rows + 1 + u64::from(blocks.count))
            }
        };
        let (rcan, integers, channels) = match self.integers {
            None => (weights_count(&self.rcan, self.bank.channels), 0, 0),
            Some(_) => {
                let (weights, channels) = counts(&self.rcan, self.bank.channels);
                (attention_count(&self.rcan, self.bank.channels), weights.div_ceil(2), 4 * channels)
            }
        };
        Ok(SectionLens {
            filters,
            index,
            rcan,
            integers,
            channels,
            offset_dn: if self.sensor.has_offset_map { pixels } else { 0 },
            inverse_gain: if self.sensor.has_gain_map { pixels } else { 0 },
        })
    }

    /// Checks that the numbers of the header are possible, each alone and together.
    ///
    /// # Errors
    /// [`BlobError::Header`] names the field whose value is impossible.
    pub fn check(&self) -> Result<(), BlobError> {
        let wrong = |field| Err(BlobError::Header { field });
        let bank = &self.bank;
        let empty = |size: Size| size.rows == 0 || size.cols == 0;
        if empty(self.frame) {
            return wrong(HeaderField::Frame);
        }
        if empty(self.object) || !self.object.rows.is_multiple_of(2) || !self.object.cols.is_multiple_of(2) {
            return wrong(HeaderField::Object);
        }
        let Sensor { black_level_dn, saturation_dn, .. } = self.sensor;
        if !has_black_level(black_level_dn) || f32::from(saturation_dn) <= black_level_dn {
            return wrong(HeaderField::Sensor);
        }
        let tile_ok = bank.tile.is_power_of_two() && bank.tile >= 2 && (1..=bank.tile).contains(&bank.step);
        if !tile_ok || bank.channels == 0 {
            return wrong(HeaderField::Bank);
        }
        let sorted = bank.taps.is_sorted_by(|a, b| a.order() < b.order());
        if !sorted || bank.taps.is_empty() || bank.taps.iter().any(|tap| tap.channel >= bank.channels) {
            return wrong(HeaderField::Taps);
        }
        // False for NaN.
        let possible = |scales: Integers| {
            let output = scales.output.is_normal() && scales.output > 0.0;
            (0..=24).contains(&scales.input_log2) && (-16..=24).contains(&scales.feature_log2) && output
        };
        if !self.integers.is_none_or(possible) {
            return wrong(HeaderField::Integers);
        }
        self.section_lens().map(|_| ())
    }
}

/// Whether a level, DN, is one that a code of 16 bits can lie above or below: with any other, corrected light could be
/// infinite.
pub(crate) fn has_black_level(level_dn: f32) -> bool {
    // False for NaN.
    level_dn.abs() <= f32::from(u16::MAX)
}

impl MemoryPlan {
    /// Checks that the plan fits into the memory of a device.
    ///
    /// # Errors
    /// [`BlobError::Memory`] gives what is needed and what there is.
    pub fn fits(self, available: Self) -> Result<(), BlobError> {
        if self.fast_bytes <= available.fast_bytes && self.bulk_bytes <= available.bulk_bytes {
            return Ok(());
        }
        Err(BlobError::Memory { needed: self, available })
    }
}

/// Checks that all weights of a section are finite.
fn check_finite(section: Section, halves: &[f16]) -> Result<(), BlobError> {
    match halves.iter().position(|half| !half.is_finite()) {
        Some(index) => Err(BlobError::NonFinite { section, index: index as u32 }),
        None => Ok(()),
    }
}

impl<'a> Weights<'a> {
    /// Checks that these are the weights of a network with this header: that the header is possible, each section has
    /// its length, and every half is finite.
    ///
    /// # Errors
    /// [`BlobError::Header`], [`BlobError::SectionLength`], [`BlobError::NonFinite`], [`BlobError::Channel`].
    pub(super) fn check(&self, header: &Header) -> Result<(), BlobError> {
        header.check()?;
        for ((section, words), expected) in self.words().into_iter().zip(header.section_lens()?.in_order()) {
            if words.len() as u64 != expected {
                return Err(BlobError::SectionLength { section, expected, found: words.len() as u64 });
            }
        }
        self.check_numbers(header)
    }

    /// Checks that every half is finite, and that no integer convolution can overflow.
    ///
    /// # Errors
    /// [`BlobError::NonFinite`] names the first half that is not finite, [`BlobError::Channel`] the first channel that
    /// could overflow.
    pub(super) fn check_numbers(&self, header: &Header) -> Result<(), BlobError> {
        self.halves().into_iter().try_for_each(|(section, halves)| check_finite(section, halves))?;
        match self.convolutions {
            Some(convolutions) => convolutions.check(&header.rcan, header.bank.channels),
            None => Ok(()),
        }
    }

    /// The sections of halves.
    fn halves(&self) -> [(Section, &'a [f16]); 4] {
        let maps = [self.offset_dn.unwrap_or(&[]), self.inverse_gain.unwrap_or(&[])];
        [
            (Section::Filters, self.filters),
            (Section::Rcan, self.rcan),
            (Section::Offset, maps[0]),
            (Section::InverseGain, maps[1]),
        ]
    }

    /// All sections in the order of the file, as bits.
    pub(super) fn words(&self) -> [(Section, &'a [u16]); SECTIONS] {
        let [filters, rcan, offset, gain] =
            self.halves().map(|(section, halves)| (section, bytemuck::cast_slice(halves)));
        let (integers, channels) = match self.convolutions {
            Some(convolutions) => (convolutions.weights, bytemuck::cast_slice(convolutions.channels)),
            None => (Default::default(), Default::default()),
        };
        let integers = [(Section::Integers, integers), (Section::Channels, channels)];
        [filters, (Section::Index, self.index), rcan, offset, gain, integers[0], integers[1]]
    }
}
