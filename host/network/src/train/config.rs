//! The shape of the network.

use super::ops::fourier::FourierSizes;
use super::{Architecture, Feedback, TrainError};
use serde::{Deserialize, Serialize};

/// Shape of a network: a filter bank, and a residual channel-attention network (RCAN) that enhances its output.
///
/// A raw frame is corrected, padded to `filter_size` with the frame's centre at the filter's centre, Fourier
/// transformed, multiplied by each of the `channels` filters, transformed back, cropped to the object around the
/// centre, divided by its global maximum, and enhanced.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NetworkConfig {
    /// Rows and columns of a raw frame, pixels.
    pub frame: [usize; 2],
    /// Rows and columns of the object, pixels; even.
    pub object: [usize; 2],
    /// Side T of the square Fourier filters, pixels; devices need a power of two.
    pub filter_size: usize,
    /// Number C of Fourier filters; of views in a CM2Net.
    pub channels: usize,
    /// Number W of feature channels in the enhancement network.
    pub width: usize,
    /// Number of residual groups.
    pub groups: usize,
    /// Number of residual channel-attention blocks (RCABs) in a group; of residual blocks in each of the two parts of a
    /// CM2Net.
    pub blocks: usize,
    /// Channel reduction r of the attention: its bottleneck has W / r channels.
    pub reduction: usize,
    /// Architecture of the network.
    #[serde(default, rename = "family")]
    pub architecture: Architecture,
    /// Passes that compare what was found before them with the frame; None: one pass that does not.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub feedback: Option<Feedback>,
}

impl NetworkConfig {
    /// Checks that the sizes describe a network.
    ///
    /// # Errors
    /// [`TrainError::Config`] with the name of the field: a side is 0 or larger than the filter, a side of the object
    /// is odd, a count is not within 1 to 255, the reduction leaves no channel, or a CM2Net has another number of crops
    /// than channels.
    pub fn check(&self) -> Result<(), TrainError> {
        let wrong = |field, expected: String, found: usize| {
            Err(TrainError::Config { field, expected, found: found.to_string() })
        };
        let t = self.filter_size;
        for (field, sides) in [("frame", self.frame), ("object", self.object)] {
            if let Some(&side) = sides.iter().find(|&&side| side == 0 || side > t) {
                return wrong(field, format!("sides of 1 to filter_size = {t} pixels"), side);
            }
        }
        if let Some(&side) = self.object.iter().find(|&&side| side % 2 != 0) {
            return wrong("object", "even sides (PixelUnshuffle 2)".into(), side);
        }
        for (field, n) in
            [("channels", self.channels), ("width", self.width), ("groups", self.groups), ("blocks", self.blocks)]
        {
            if n == 0 || n > 255 {
                return wrong(field, "1 to 255".into(), n);
            }
        }
        if self.reduction == 0 || self.reduction > self.width {
            return wrong("reduction", format!("1 to width = {}", self.width), self.reduction);
        }
        if let Architecture::Cm2Net { crops } = &self.architecture
            && crops.len() != self.channels
        {
            return wrong("crops", format!("channels = {}", self.channels), crops.len());
        }
        if let Some(feedback) = &self.feedback {
            feedback.check()?;
            if matches!(self.architecture, Architecture::Cm2Net { .. }) {
                return wrong("passes", "1, for a CM2Net".into(), self.passes());
            }
        }
        Ok(())
    }

    /// Whether another network has the same learned parameters: the two differ at most in what is calibrated.
    pub fn learns_as(&self, other: &Self) -> bool {
        let learned = |network: &Self| Self { feedback: None, ..network.clone() };
        let inputs = |network: &Self| (network.passes(), network.iterations());
        inputs(self) == inputs(other) && learned(self) == learned(other)
    }

    /// Number of passes: one, and those of the feedback.
    pub fn passes(&self) -> usize {
        1 + self.feedback.as_ref().map_or(0, |feedback| feedback.passes)
    }

    /// Number of Richardson-Lucy iterations ahead of the first pass.
    pub fn iterations(&self) -> usize {
        self.feedback.as_ref().map_or(0, |feedback| feedback.iterations)
    }

    /// Number of channels that the enhancement network of pass `pass` (from 0) takes: the filter outputs, and the
    /// reconstruction before it where there is one.
    pub fn inputs(&self, pass: usize) -> usize {
        self.channels + usize::from(pass > 0 || self.iterations() > 0)
    }

    /// Number of channels W / r in the bottleneck of the attention.
    pub fn bottleneck(&self) -> usize {
        self.width / self.reduction
    }

    /// Sizes of the Fourier filter bank.
    pub fn fourier(&self) -> FourierSizes {
        FourierSizes { frame: self.frame, object: self.object, filter_size: self.filter_size, channels: self.channels }
    }
}
