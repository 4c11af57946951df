//! The statistics of the field: the quantities of a reconstruction that depend on every pixel of a frame.
//!
//! There are three: the maximum that the frame is divided by, the maximum of all filter outputs, and the scales of the
//! channel attentions, which follow from means over the features. A run either *measures* them in its own frame. Then
//! it computes the whole field up to the last attention, whatever region is wanted, and the region is exact. Or it
//! takes those that are *held* from an earlier frame. Then it computes only the region and its surroundings that
//! filters and convolutions need, and the result is approximate unless both frames are equal. Both maxima are held
//! together, so the brightness stays on the scale of the frame in which they were measured.

use super::error::PipelineError;
use crate::nn::channel_attention::Scales;

/// Largest ratio, either way, of the maximum of a frame to the held maximum. The network was trained on maxima of 1;
/// far above that, features would leave the range of halves.
pub const GROWTH: f32 = 2.0;

/// What a run measured in its frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stats {
    /// Pixels of the raw frame at or above the saturation code.
    pub saturated_px: u32,
    /// Maximum of the corrected frame, DN. Where it is not positive and no other maximum is held, the frame was taken
    /// as zero.
    pub frame_max_dn: f32,
    /// Maximum of the filter outputs that were computed, for the frame divided by its maximum or by the held one. Where
    /// it is not positive and none is held, or where [`Self::filter_finite`] is false, the input of the enhancement
    /// network was zero.
    pub filter_max: f32,
    /// Whether all filter outputs that were computed were finite as halves.
    pub filter_finite: bool,
}

impl Stats {
    /// Whether later frames can be divided by these maxima. Those of a frame without light cannot be held.
    pub fn can_be_held(&self) -> bool {
        self.frame_max_dn > 0.0 && self.filter_max > 0.0 && self.filter_finite
    }

    /// Checks that a frame with this maximum, DN, can be divided by the held maximum.
    pub(super) fn fits_frame(&self, max_dn: f32) -> Result<(), PipelineError> {
        let fits = max_dn <= GROWTH * self.frame_max_dn && GROWTH * max_dn >= self.frame_max_dn;
        if fits { Ok(()) } else { Err(PipelineError::Outgrown) }
    }

    /// Checks the same of the filter outputs of a part of the object. A part may be dark, so there is no lower bound.
    pub(super) fn fits_filters(&self, max: f32, finite: bool) -> Result<(), PipelineError> {
        if finite && max <= GROWTH * self.filter_max { Ok(()) } else { Err(PipelineError::Outgrown) }
    }
}

/// Where a run takes the statistics of the field from.
#[derive(Debug)]
pub enum Field<'s> {
    /// From its own frame. Where a slice of [`super::Pipeline::scales_len`] numbers is given, the attention scales are
    /// written to it.
    Measured(Option<&'s mut [f32]>),
    /// From another frame: what the run on that frame returned, and the attention scales that it wrote.
    Held(Stats, &'s [f32]),
}

impl<'s> Field<'s> {
    /// The held maxima, if there are any, and the source of the scales. `scales_len` is the number of scales of the
    /// network.
    ///
    /// # Errors
    /// [`PipelineError::Scales`], [`PipelineError::NothingHeld`].
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
