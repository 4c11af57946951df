//! Statistics of the field that are held over the frames of a stream.

use super::error::PipelineError;
use super::field::{Field, Stats};
use super::reconstruct::{Memory, Pipeline};
use crate::blob::MemoryPlan;
use crate::image::Region;
use crate::num::f16;

/// A region of the object, and how old the statistics may be that it is reconstructed with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HeldRegion {
    /// Region of the object.
    pub region: Region,
    /// Largest age of the statistics, in runs. 0: they are measured in the same frame, so the region is exact.
    pub hold: u16,
}

/// Statistics of the field that were measured last. The scales lie in the last [`Pipeline::scales_len`] numbers of the
/// fast memory, which the caller must keep untouched from run to run.
#[derive(Clone, Copy, Debug, Default)]
pub struct Holder {
    /// What the run that measured them returned, and its age in runs.
    held: Option<(Stats, u16)>,
}

impl Holder {
    /// Discards what is held. To be called where the network, the memory or the scene changes.
    pub fn forget(&mut self) {
        self.held = None;
    }

    /// Reconstructs a region with statistics of the field that are at most `request.hold` runs old. Returns what the
    /// run measured, and the age of the statistics. The age is 0 where they were measured in this frame, so that the
    /// region is exact. That is the case where `hold` is 0, where nothing young enough is held, and where the held
    /// statistics no longer fit ([`PipelineError::Outgrown`]).
    ///
    /// # Errors
    /// As [`Pipeline::run_with`]; [`PipelineError::Memory`] where `hold` is not 0 and the fast memory has no room for
    /// the scales; [`PipelineError::Hold`] where `hold` is not 0 and the network has several passes.
    pub fn run(
        &mut self,
        pipeline: &Pipeline<'_>,
        frame: &[u16],
        HeldRegion { region, hold }: HeldRegion,
        Memory { fast, bulk }: Memory<'_>,
        output: &mut [f16],
    ) -> Result<(Stats, u16), PipelineError> {
        if pipeline.passes() > 1 {
            self.forget();
            return match hold {
                0 => Ok((pipeline.run_region(frame, region, Memory { fast, bulk }, output)?, 0)),
                _ => Err(PipelineError::Hold),
            };
        }
        let kept = pipeline.scales_len();
        let Some(least) = fast.len().checked_sub(kept).filter(|&rest| rest >= pipeline.fast_len()) else {
            self.forget();
            return match hold {
                0 => Ok((pipeline.run_region(frame, region, Memory { fast, bulk }, output)?, 0)),
                _ => Err(no_room(pipeline, fast.len(), bulk.len())),
            };
        };
        let (fast, scales) = fast.split_at_mut(least);
        if let Some((stats, age)) = self.held.filter(|&(_, age)| age < hold) {
            let memory = Memory { fast: &mut *fast, bulk: &mut *bulk };
            match pipeline.run_with(frame, region, Field::Held(stats, scales), memory, output) {
                Err(PipelineError::Outgrown) => {}
                Err(error) => return Err(error),
                Ok(now) => {
                    self.held = Some((stats, age + 1));
                    return Ok((now, age + 1));
                }
            }
        }
        self.forget();
        let stats = pipeline.run_with(frame, region, Field::Measured(Some(scales)), Memory { fast, bulk }, output)?;
        self.held = stats.can_be_held().then_some((stats, 0));
        Ok((stats, 0))
    }
}

fn no_room(pipeline: &Pipeline<'_>, fast: usize, bulk: usize) -> PipelineError {
    let bytes = |numbers: usize, each: usize| u32::try_from(numbers * each).unwrap_or(u32::MAX);
    let fast_bytes = bytes(pipeline.fast_len() + pipeline.scales_len(), size_of::<f32>());
    PipelineError::Memory {
        expected: MemoryPlan { fast_bytes, ..pipeline.header().memory },
        found: MemoryPlan { fast_bytes: bytes(fast, size_of::<f32>()), bulk_bytes: bytes(bulk, size_of::<f16>()) },
    }
}
