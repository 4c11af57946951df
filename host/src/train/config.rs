//! The shape of the network.

use super::ops::fourier::FourierSizes;
use super::{Family, TrainError};
use serde::{Deserialize, Serialize};

/// Shape of a network: a filter bank and the light RCAN behind it.
///
/// A raw frame is corrected, padded to `filter_size` with the frame's centre at the filter's centre, transformed, multiplied by each of the
/// `channels` filters, transformed back, cropped to the object round the centre, divided by its global maximum, enhanced.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NetworkConfig {
    /// Raw frame, rows and columns, pixels.
    pub frame: [usize; 2],
    /// Object, rows and columns, pixels; even.
    pub object: [usize; 2],
    /// Side of the square Fourier filters, pixels; a power of two where the network shall run on a device.
    pub filter_size: usize,
    /// Number of Fourier filters C.
    pub channels: usize,
    /// Feature channels W of the RCAN.
    pub width: usize,
    /// Residual groups.
    pub groups: usize,
    /// RCABs per group.
    pub blocks: usize,
    /// Channel reduction of the attention.
    pub reduction: usize,
    /// Which network; CM2Net has `channels` views and `blocks` residual blocks of `width` features in each of its two parts.
    #[serde(default)]
    pub family: Family,
}

impl NetworkConfig {
    /// Checks that the sizes make a network.
    ///
    /// # Errors
    /// A side is zero, the object is odd or larger than the filter, the frame is larger than the filter, or the reduction leaves no channel.
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
        if let Family::Cm2Net { crops } = &self.family
            && crops.len() != self.channels
        {
            return wrong("crops", format!("channels = {}", self.channels), crops.len());
        }
        Ok(())
    }

    /// Channels W/r in the bottleneck of the attention.
    pub fn bottleneck(&self) -> usize {
        self.width / self.reduction
    }

    /// Sizes of the filter bank.
    pub fn fourier(&self) -> FourierSizes {
        FourierSizes { frame: self.frame, object: self.object, filter_size: self.filter_size, channels: self.channels }
    }
}
