//! What a reconstruction takes from the whole field, and from which frame.
//!
//! Three things depend on every pixel of a frame: the maximum that it is divided by, the maximum of all filter outputs, and the scales of the
//! channel attentions, which are means over the features. A run *measures* them, so it computes the whole field up to the last attention
//! whatever region is wanted, and the region is exact. Or it takes those that are *held* from an earlier frame: then it computes the region
//! and what the convolutions and filters need around it, no more, and the result is approximate, but for a frame that is the same. Both
//! maxima are held together, so brightness stays on the scale of the frame that they are of.

use super::error::PipelineError;
use crate::nn::channel_attention::Scales;

/// How much brighter or darker than the frame that is held a frame may be. The network was trained on maxima of 1; far above, features would
/// leave the range of halves.
pub const GROWTH: f32 = 2.0;

/// What a run saw.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stats {
    /// Pixels of the raw frame at or above the saturation code.
    pub saturated_px: u32,
    /// Maximum of the corrected frame, DN. Where it is not positive the frame was taken as zero, unless another frame's is held.
    pub frame_max_dn: f32,
    /// Maximum of the filter outputs that were computed, for the frame divided by its maximum or by that which is held. Where it is not
    /// positive and none is held, or [`Self::filter_finite`] is false, the network saw zeros.
    pub filter_max: f32,
    /// No filter output that was computed left the range of halves.
    pub filter_finite: bool,
}

impl Stats {
    /// Whether later frames can be divided by these maxima: a frame without light leaves nothing to hold.
    pub fn can_be_held(&self) -> bool {
        self.frame_max_dn > 0.0 && self.filter_max > 0.0 && self.filter_finite
    }

    /// Whether a frame of this maximum can be divided by that which is held.
    pub(super) fn fits_frame(&self, max_dn: f32) -> Result<(), PipelineError> {
        let fits = max_dn <= GROWTH * self.frame_max_dn && GROWTH * max_dn >= self.frame_max_dn;
        if fits { Ok(()) } else { Err(PipelineError::Outgrown) }
    }

    /// The same for the filter outputs of a part of the object. How dark they are says nothing.
    pub(super) fn fits_filters(&self, max: f32, finite: bool) -> Result<(), PipelineError> {
        if finite && max <= GROWTH * self.filter_max { Ok(()) } else { Err(PipelineError::Outgrown) }
    }
}

/// Where that which depends on the whole field comes from.
#[derive(Debug)]
pub enum Field<'s> {
    /// From the frame at hand. Its scales are written down where there is a place for them, [`super::Pipeline::scales_len`] numbers.
    Measured(Option<&'s mut [f32]>),
    /// From another frame: what the run that measured it saw, and the scales that it wrote down.
    Held(Stats, &'s [f32]),
}

impl<'s> Field<'s> {
    /// Whose maxima are held, and the scales; checked.
    pub(super) fn split(self, scales_len: usize) -> Result<(Option<Stats>, Scales<'s>), PipelineError> {
        let (held, found, scales) = match self {
            Self::Measured(None) => return Ok((None, Scales::Measured(None))),
            Self::Measured(Some(place)) => (None, place.len(), Scales::Measured(Some(place))),
            Self::Held(stats, scales) => (Some(stats), scales.len(), Scales::Held(scales)),
        };
        if found != scales_len {
            return Err(PipelineError::Scales { expected: scales_len, found });
        }
        if held.is_some_and(|stats| !stats.can_be_held()) {
            return Err(PipelineError::NothingHeld);
        }
        Ok((held, scales))
    }
}
