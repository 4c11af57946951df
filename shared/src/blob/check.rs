//! The checks of a header and of the weights that belong to it.

use super::error::{BlobError, Section};
use super::header::{
    Header, HeaderField, Integers, MAX_LATER, MemoryPlan, Passes, SectionLens, Sensor, Size, Watching, Weights,
};
use super::layout::SECTIONS;
use crate::nn::integer::counts;
use crate::nn::rcan::{attention_count, weights_count};
use crate::num::widen;
use crate::watch::{self, MAX_BLOCK, MAX_PIXELS, Maps};
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
        // A later pass has one more input; that there is room for it is checked elsewhere.
        let later = |passes: &Passes| {
            let inputs = self.bank.channels.saturating_add(1);
            let predictor = passes.corners.len() as u64 * u64::from(passes.terms) * passes.term_len(self.object);
            (u64::from(passes.later) * weights_count(&self.rcan, inputs), predictor)
        };
        let (later, predictor) = self.passes.as_ref().map_or((0, 0), later);
        let (rcan, integers, channels) = match self.integers {
            None => (weights_count(&self.rcan, self.bank.channels) + later, 0, 0),
            Some(_) => {
                let (weights, channels) = counts(&self.rcan, self.bank.channels);
                (attention_count(&self.rcan, self.bank.channels), weights.div_ceil(2), 4 * channels)
            }
        };
        let watch = |watch: &Watching| {
            let [statistics, blocks] =
                [3 * usize::from(watch.lenses), watch::blocks(self.frame, watch.block).iter().product()];
            (blocks as u64 * Maps::weights_of_block(statistics) as u64, 8 * statistics as u64)
        };
        let (watch, statistics) = self.watch.as_ref().map_or((0, 0), watch);
        Ok(SectionLens {
            filters,
            index,
            rcan,
            integers,
            channels,
            predictor,
            watch,
            statistics,
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
        if !self.passes.as_ref().is_none_or(|passes| self.can_pass(passes)) {
            return wrong(HeaderField::Passes);
        }
        if !self.watch.as_ref().is_none_or(|watch| self.can_watch(watch)) {
            return wrong(HeaderField::Watch);
        }
        self.section_lens().map(|_| ())
    }

    /// Whether this watch is possible: no sum of it overflows, and its light and its height are numbers.
    fn can_watch(&self, watching: &Watching) -> bool {
        let pixels = u64::from(self.frame.rows) * u64::from(self.frame.cols);
        let shape =
            (3..=watch::MAX_LENSES).contains(&watching.lenses.into()) && (1..=MAX_BLOCK).contains(&watching.block);
        let numbers = watching.least_light_dn.is_finite() && watching.log_odds.is_normal();
        shape && numbers && pixels <= MAX_PIXELS && watching.least_light_dn >= 0.0 && watching.log_odds > 0.0
    }

    /// Whether these passes are possible: a model of one term or more that a transform holds, convolutions in halves.
    fn can_pass(&self, passes: &Passes) -> bool {
        let model = passes.terms > 0 && !passes.corners.is_empty() && passes.node_step.is_power_of_two();
        let held = passes.window % 2 == 1 && passes.tile(self.object).is_some();
        (1..=MAX_LATER).contains(&passes.later) && model && held && self.integers.is_none()
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

/// Checks that the light of each lens of an object within 0 and 1 stays within -1 and 1, so that no half overflows
/// where a frame is predicted: coefficients within -1 and 1, and the magnitudes of all lags of a lens, which are stored
/// times the side of the transforms, sum to that side at most.
fn check_lenses(passes: &Passes, object: Size, predictor: &[f16]) -> Result<(), BlobError> {
    let [rows, cols] = passes.nodes(object);
    let term = usize::try_from(passes.term_len(object)).unwrap_or(usize::MAX);
    let most = f32::from(passes.tile(object).unwrap_or(0));
    for (index, lens) in predictor.chunks(term.saturating_mul(passes.terms.into()).max(1)).enumerate() {
        let (mut sum, mut fits) = (0.0, true);
        for term in lens.chunks(term.max(1)) {
            let (nodes, lags) = term.split_at_checked(rows * cols).unwrap_or_default();
            fits &= nodes.iter().all(|node| widen(*node).abs() <= 1.0);
            lags.iter().for_each(|lag| sum += widen(*lag).abs());
        }
        if !fits || sum > most {
            return Err(BlobError::Lens { index: index as u32 });
        }
    }
    Ok(())
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

    /// Checks that every half is finite, and that no integer convolution and no predicted frame can overflow.
    ///
    /// # Errors
    /// [`BlobError::NonFinite`] names the first half that is not finite, [`BlobError::Channel`] the first channel that
    /// could overflow, [`BlobError::Lens`] the first lens.
    pub(super) fn check_numbers(&self, header: &Header) -> Result<(), BlobError> {
        self.halves().into_iter().try_for_each(|(section, halves)| check_finite(section, halves))?;
        if let Some(passes) = &header.passes {
            check_lenses(passes, header.object, self.predictor)?;
        }
        if let Some(index) = self.watch.statistics.iter().position(|statistic| !statistic.is_possible()) {
            return Err(BlobError::Statistic { index: index as u32 });
        }
        match self.convolutions {
            Some(convolutions) => convolutions.check(&header.rcan, header.bank.channels),
            None => Ok(()),
        }
    }

    /// The sections of halves.
    fn halves(&self) -> [(Section, &'a [f16]); 5] {
        let maps = [self.offset_dn.unwrap_or(&[]), self.inverse_gain.unwrap_or(&[])];
        [
            (Section::Filters, self.filters),
            (Section::Rcan, self.rcan),
            (Section::Offset, maps[0]),
            (Section::InverseGain, maps[1]),
            (Section::Predictor, self.predictor),
        ]
    }

    /// All sections in the order of the file, as bits.
    pub(super) fn words(&self) -> [(Section, &'a [u16]); SECTIONS] {
        let [filters, rcan, offset, gain, predictor] =
            self.halves().map(|(section, halves)| (section, bytemuck::cast_slice(halves)));
        let (integers, channels) = match self.convolutions {
            Some(convolutions) => (convolutions.weights, bytemuck::cast_slice(convolutions.channels)),
            None => (Default::default(), Default::default()),
        };
        let integers = [(Section::Integers, integers), (Section::Channels, channels)];
        let [watch, statistics] = [bytemuck::cast_slice(self.watch.maps), bytemuck::cast_slice(self.watch.statistics)];
        let [integers, channels] = integers;
        let index = (Section::Index, self.index);
        let watch = [(Section::Watch, watch), (Section::Statistics, statistics)];
        [filters, index, rcan, offset, gain, integers, channels, predictor, watch[0], watch[1]]
    }
}
