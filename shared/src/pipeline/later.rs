//! The plan of the passes after the first one.

use super::error::{PipelineError, check};
use crate::blob::{Header, Passes};
use crate::filter::FilterBank;
use crate::nn::rcan::Rcan;
use crate::predict::Predictor;

/// The plan of the passes after the first one.
#[derive(Clone, Copy, Debug)]
pub(super) struct Later<'a> {
    passes: &'a Passes,
    pub predictor: Predictor<'a>,
    pub rcan: Rcan,
    /// Columns of an object, of a frame.
    pub cols: [usize; 2],
}

impl<'a> Later<'a> {
    /// Plans the passes of a header.
    ///
    /// # Errors
    /// [`PipelineError::Field`] or [`PipelineError::Filter`] where a shape is impossible.
    pub fn new(header: &'a Header, passes: &'a Passes) -> Result<Self, PipelineError> {
        header.check().map_err(|_| PipelineError::Field {
            field: "passes",
            expected: "what `Header::check` accepts",
            found: passes.later.into(),
        })?;
        let channels = header.bank.channels;
        let few = |channels| (1..63).contains(&channels);
        check("bank.channels", "1 to 62 channels for more than one pass", channels.into(), few)?;
        let predictor = Predictor::new(passes, header.frame, header.object)?;
        let rcan = Rcan::new(header.rcan, None, channels + 1, header.object)?.to_logits();
        Ok(Self { passes, predictor, rcan, cols: [header.object.cols, header.frame.cols].map(usize::from) })
    }

    /// Number of passes after the first one.
    pub fn count(&self) -> usize {
        self.passes.later.into()
    }

    /// Length of fast scratch needed at least, numbers.
    pub fn scratch_len(&self) -> usize {
        self.predictor.scratch_len().max(self.rcan.scratch_len(1)).max(self.cols[0])
    }

    /// Length of fast scratch beyond which more does not help, numbers, for bands of `band` rows.
    pub fn scratch_len_best(&self, band: usize) -> usize {
        self.predictor.scratch_len_wide().max(self.rcan.scratch_len(band)).max(self.cols[0])
    }

    /// Length of the bulk arena, halves, where the first pass alone needs `first`. No term has more than 32 bits.
    pub fn bulk_len(&self, first: u64, filter: &FilterBank<'_>) -> u64 {
        let pixels = self.object_len() as u64;
        let input = self.rcan.input_len() as u64;
        let frame = self.predictor.frame_len() as u64;
        let (predictor, filters) = (self.predictor.arena_len() as u64, filter.arena_len() as u64);
        let pass = if filter.is_whole() {
            (frame + predictor.max(filter.prepared_len() as u64)).max(filters + input - pixels) + pixels
        } else {
            frame + (predictor + pixels).max(filters + input)
        };
        self.kept_len(filter) + first.max(self.rcan.arena_len() as u64).max(pass)
    }

    /// Length of what is kept from pass to pass, halves.
    pub fn kept_len(&self, filter: &FilterBank<'_>) -> u64 {
        let planes = if self.count() > 1 { 2 } else { 1 };
        filter.output_len() as u64 + planes * self.object_len() as u64
    }

    /// Length of an object, pixels.
    pub const fn object_len(&self) -> usize {
        let [_, rows, cols] = self.rcan.input_shape();
        rows * cols
    }
}
