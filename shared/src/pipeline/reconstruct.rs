//! The pipeline at work.

use super::error::PipelineError;
use super::field::{Field, Stats};
use super::later::Later;
use super::validate::{self, Shapes};
use crate::blob::{Header, MemoryPlan, Network, Weights};
use crate::filter::{FilterBank, Filters, FrameRows};
use crate::image::{ChwMut, PlaneMut, Region};
use crate::nn::rcan::{self, Rcan};
use crate::num::simd::{Kernel, Simd, Vector};
use crate::num::{f16, fused, largest, max_finite, widen_slice};
use crate::sensor::FixedPattern;

/// Rows of a band beyond which the rows no longer stay in a workstation's caches.
const BEST_BAND: usize = 16;

/// The memory of a run. Its content before the run does not matter.
#[derive(Debug)]
pub struct Memory<'m> {
    /// Fast scratch, [`Pipeline::fast_len`] numbers at least.
    pub fast: &'m mut [f32],
    /// Bulk arena, [`Pipeline::bulk_len`] halves at least.
    pub bulk: &'m mut [f16],
}

/// A network that is ready to run on frames.
#[derive(Clone, Copy, Debug)]
pub struct Pipeline<'a> {
    header: &'a Header,
    pub(super) weights: Weights<'a>,
    pattern: FixedPattern<'a>,
    pub(super) filter: FilterBank<'a>,
    pub(super) rcan: Rcan,
    later: Option<Later<'a>>,
    pub(super) simd: Simd,
}

impl<'a> Pipeline<'a> {
    /// Plans every operator of a network, and checks that the memory plan in its header is that of [`Self::plan`]. The
    /// weights are not looked at again: a [`Network`] has been checked.
    ///
    /// # Errors
    /// [`PipelineError::Field`], [`PipelineError::BlackLevel`] or [`PipelineError::Filter`] where a shape is impossible
    /// or the index of the blocks is out of order; [`PipelineError::TooLarge`]; [`PipelineError::Plan`].
    pub fn new(network: &'a Network<'_>) -> Result<Self, PipelineError> {
        let (header, weights) = (network.header(), network.weights());
        let shapes = validate::shapes(header)?;
        let (expected, found) = (memory_plan(header, &shapes)?, header.memory);
        let Shapes { filter, rcan, later } = shapes;
        filter.check(Filters { halves: weights.filters, index: weights.index })?;
        if expected != found {
            return Err(PipelineError::Plan { expected, found });
        }
        let pattern = FixedPattern::new(header, &weights);
        Ok(Self { header, weights, pattern, filter, rcan, later, simd: Simd::detect() })
    }

    /// Memory that a network needs at least. It follows from the shapes in the header alone and is the same on every
    /// machine.
    ///
    /// # Errors
    /// [`PipelineError::Field`], [`PipelineError::BlackLevel`] or [`PipelineError::Filter`] where a shape is
    /// impossible, [`PipelineError::TooLarge`] where the network needs 4 GiB or more.
    pub fn plan(header: &Header) -> Result<MemoryPlan, PipelineError> {
        memory_plan(header, &validate::shapes(header)?)
    }

    /// Length of fast scratch beyond which more does not help, numbers.
    pub fn fast_len_best(&self) -> usize {
        let frame = usize::from(self.header.frame.cols);
        let later = self.later.as_ref().map_or(0, |later| later.scratch_len_best(BEST_BAND));
        self.filter.scratch_len_wide().max(self.rcan.scratch_len(BEST_BAND)).max(later) + frame
    }

    /// Length of fast scratch needed at least, numbers.
    pub fn fast_len(&self) -> usize {
        self.header.memory.fast_bytes as usize / size_of::<f32>()
    }

    /// Length of the bulk arena needed, halves.
    pub fn bulk_len(&self) -> usize {
        self.header.memory.bulk_bytes as usize / size_of::<f16>()
    }

    /// Length of a raw frame, pixels.
    pub fn frame_len(&self) -> usize {
        usize::from(self.header.frame.rows) * usize::from(self.header.frame.cols)
    }

    /// Length of the whole reconstruction, pixels.
    pub fn output_len(&self) -> usize {
        usize::from(self.header.object.rows) * usize::from(self.header.object.cols)
    }

    /// Number of passes.
    pub fn passes(&self) -> usize {
        self.later.as_ref().map_or(1, |later| 1 + later.count())
    }

    /// Number of scales of all channel attentions, for [`Field`]; 0 for a network with several passes, which cannot be
    /// held.
    pub const fn scales_len(&self) -> usize {
        if self.later.is_some() { 0 } else { self.rcan.scales_len() }
    }

    /// The header of the network.
    pub const fn header(&self) -> &'a Header {
        self.header
    }

    /// Reconstructs a frame. `frame` holds the raw codes (frame rows, frame cols), DN; `output` is (object rows, object
    /// cols), 0 to 1.
    ///
    /// # Errors
    /// [`PipelineError::Frame`] or [`PipelineError::Output`] where a slice has the wrong length,
    /// [`PipelineError::Memory`] where the memory is too small. Nothing is written then.
    pub fn run(&self, frame: &[u16], memory: Memory<'_>, output: &mut [f16]) -> Result<Stats, PipelineError> {
        self.run_region(frame, self.whole(), memory, output)
    }

    /// Reconstructs only `region` of the object. `output` is (region rows, region cols), 0 to 1, with the bits of
    /// [`Self::run`].
    ///
    /// # Errors
    /// As [`Self::run`]; [`PipelineError::Region`] where the region is empty or reaches beyond the object.
    pub fn run_region(
        &self,
        frame: &[u16],
        region: Region,
        memory: Memory<'_>,
        output: &mut [f16],
    ) -> Result<Stats, PipelineError> {
        self.run_with(frame, region, Field::Measured(None), memory, output)
    }

    /// Reconstructs `region` of the object with the statistics of the field from `field`. Measured in this frame, the
    /// region is exact. Held from another frame, only the region and its surroundings are computed.
    ///
    /// # Errors
    /// As [`Self::run_region`]; [`PipelineError::Hold`] where the network has several passes and `field` is more
    /// than [`Field::Measured`] of nothing; [`PipelineError::Scales`] where `field` belongs to another network;
    /// [`PipelineError::NothingHeld`] and [`PipelineError::Outgrown`] where the held statistics cannot be used. The
    /// output is not written then.
    pub fn run_with(
        &self,
        frame: &[u16],
        region: Region,
        field: Field<'_>,
        memory: Memory<'_>,
        output: &mut [f16],
    ) -> Result<Stats, PipelineError> {
        let Memory { fast, bulk } = memory;
        self.check_region(region)?;
        self.check_lengths(frame, fast, bulk, (region.pixels(), output.len()))?;
        let bulk = &mut bulk[..self.bulk_len()];
        if let Some(later) = &self.later {
            let Field::Measured(None) = field else { return Err(PipelineError::Hold) };
            return self.run_passes(later, frame, region, Memory { fast, bulk }, output);
        }
        let (held, scales) = field.split(self.scales_len())?;
        let (saturated_px, frame_max_dn) = self.survey(frame, fast);
        held.map_or(Ok(()), |held| held.fits_frame(frame_max_dn))?;
        let max = held.map_or(frame_max_dn, |held| held.frame_max_dn);
        let source = Source::Raw { pipeline: self, frame, max };
        let part = self.rcan.input(region, held.is_some());
        let filter = self.filter.of_part(part)?;
        let (arena, channels) = bulk.split_at_mut(bulk.len() - filter.output_len());
        let tensor = ChwMut::new(channels, usize::from(self.header.bank.channels), part.rows.into(), part.cols.into())?;
        let filters = Filters { halves: self.weights.filters, index: self.weights.index };
        filter.process(self.simd, Some(&source), filters, tensor, arena, fast)?;
        let by = held.map(|held| held.filter_max);
        let (filter_max, filter_finite) = self.simd.run(Normalise { values: channels, by });
        held.map_or(Ok(()), |held| held.fits_filters(filter_max, filter_finite))?;
        let arena = bulk.len() - self.rcan.arena_len();
        let output = PlaneMut::new(output, region.rows.into(), region.cols.into())?;
        let parameters =
            rcan::Parameters { weights: self.weights.rcan, convolutions: self.weights.convolutions, scales };
        self.rcan.process(self.simd, parameters, &mut bulk[arena..], region, output, fast)?;
        Ok(Stats { saturated_px, frame_max_dn, filter_max, filter_finite })
    }

    /// The region of the whole object.
    pub fn whole(&self) -> Region {
        Region::whole(self.header.object.rows, self.header.object.cols)
    }

    /// Checks that a region lies in the object.
    ///
    /// # Errors
    /// [`PipelineError::Region`] where it is empty or reaches beyond the object.
    pub fn check_region(&self, region: Region) -> Result<(), PipelineError> {
        let object = self.header.object;
        let inside = region.lies_in(object.rows, object.cols);
        if inside { Ok(()) } else { Err(PipelineError::Region { object, found: region }) }
    }

    fn check_lengths(
        &self,
        frame: &[u16],
        fast: &[f32],
        bulk: &[f16],
        output: (usize, usize),
    ) -> Result<(), PipelineError> {
        if frame.len() != self.frame_len() {
            return Err(PipelineError::Frame { expected: self.frame_len(), found: frame.len() });
        }
        if output.0 != output.1 {
            return Err(PipelineError::Output { expected: output.0, found: output.1 });
        }
        let expected = self.header.memory;
        let found = MemoryPlan { fast_bytes: bytes(size_of_val(fast)), bulk_bytes: bytes(size_of_val(bulk)) };
        if found.fast_bytes < expected.fast_bytes || found.bulk_bytes < expected.bulk_bytes {
            return Err(PipelineError::Memory { expected, found });
        }
        Ok(())
    }

    /// Number of saturated pixels, and the maximum of the corrected frame, DN.
    pub(super) fn survey(&self, frame: &[u16], fast: &mut [f32]) -> (u32, f32) {
        let cols = usize::from(self.header.frame.cols);
        let row = &mut fast[..cols];
        let (mut saturated, mut max) = (0, f32::NEG_INFINITY);
        for (r, codes) in frame.chunks_exact(cols).enumerate() {
            saturated += self.pattern.saturated(codes);
            let done = self.pattern.correct_with(r, 0, codes, row, |signal| {
                max = if signal > max { signal } else { max };
                signal
            });
            max = largest(&row[..done], max);
        }
        // A zero without a sign: targets compare in different orders.
        (saturated, max + 0.0)
    }
}

fn memory_plan(header: &Header, shapes: &Shapes<'_>) -> Result<MemoryPlan, PipelineError> {
    let Shapes { filter, rcan, later } = shapes;
    let fast = filter.scratch_len().max(rcan.scratch_len(1)).max(usize::from(header.frame.cols)) as u64;
    // Each length has been checked alone; their sum has not.
    let bulk = (rcan.arena_len() as u64).max(filter.arena_len() as u64 + rcan.input_len() as u64);
    let (fast, bulk) = match later {
        None => (fast, bulk),
        Some(later) => (fast.max(later.scratch_len() as u64), later.bulk_len(bulk, filter)),
    };
    let (fast, bulk) = (fast * size_of::<f32>() as u64, bulk * size_of::<f16>() as u64);
    match (u32::try_from(fast), u32::try_from(bulk)) {
        (Ok(fast_bytes), Ok(bulk_bytes)) => Ok(MemoryPlan { fast_bytes, bulk_bytes }),
        _ => Err(PipelineError::TooLarge { fast, bulk }),
    }
}

/// Length as 32 bits. It saturates: a length that does not fit is large enough or much too large.
fn bytes(len: usize) -> u32 {
    u32::try_from(len).unwrap_or(u32::MAX)
}

/// What the filters take. It is one type, so that there is one copy of their code.
pub(super) enum Source<'a> {
    /// The corrected frame, divided by its maximum.
    Raw { pipeline: &'a Pipeline<'a>, frame: &'a [u16], max: f32 },
    /// A predicted frame with so many columns.
    Predicted { frame: &'a [f16], cols: usize },
}

impl FrameRows for Source<'_> {
    fn load(&self, row: usize, first: usize, to: &mut [f32]) {
        match *self {
            Self::Raw { pipeline, frame, max } if max > 0.0 => {
                let start = row * usize::from(pipeline.header.frame.cols) + first;
                let codes = &frame[start..start + to.len()];
                let done = pipeline.pattern.correct_with(row, first, codes, to, |signal| signal / max);
                to[..done].iter_mut().for_each(|signal| *signal /= max);
            }
            Self::Raw { .. } => to.fill(0.0),
            Self::Predicted { frame, cols } => {
                let start = row * cols + first;
                widen_slice(frame.get(start..start + to.len()).unwrap_or_default(), to);
            }
        }
    }
}

/// Divides by the maximum, or by `by` where it is given. Returns the maximum and whether all values are finite.
pub(super) struct Normalise<'a> {
    pub values: &'a mut [f16],
    pub by: Option<f32>,
}

impl Kernel for Normalise<'_> {
    type Output = (f32, bool);

    #[inline(always)]
    fn run<V: Vector>(self) -> (f32, bool) {
        let (max, finite) = max_finite(self.values);
        let by = self.by.unwrap_or(max);
        if by > 0.0 && finite {
            fused::divide(self.values, by);
        } else {
            self.values.fill(f16::ZERO);
        }
        (max, finite)
    }
}
