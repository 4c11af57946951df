//! Residual channel-attention block: `g = g + s * t` with `t = conv(relu(conv(g)))` and `s` the [channel attention](super::channel_attention) of t.
//!
//! t is stored as halves; `s * t` is rounded to binary32, then added, then rounded to half.

use super::activation::Activation;
use super::channel_attention::{self, ChannelAttention};
use super::conv::{self, Addressing, Conv3x3, Store, Tensors};
use super::error::{NnError, check_scratch};
use crate::image::ChwMut;
use crate::num::simd::{Kernel, Simd};
use crate::num::{f16, mac, narrow, widen};

/// Weights of a block.
#[derive(Clone, Copy, Debug)]
pub struct Parameters<'a> {
    /// First and second convolution, W -> W.
    pub convs: [conv::Parameters<'a>; 2],
    /// Channel attention.
    pub attention: channel_attention::Parameters<'a>,
}

/// Plan of a block.
#[derive(Clone, Copy, Debug)]
pub struct Rcab {
    /// Channels W.
    pub channels: usize,
    /// Width W/r of the attention's bottleneck.
    pub hidden: usize,
    /// Rows of the frame.
    pub rows: usize,
    /// Columns of the frame.
    pub cols: usize,
}

impl Rcab {
    const fn conv(&self, activation: Activation) -> Conv3x3 {
        let Self { channels, rows, cols, .. } = *self;
        Conv3x3 { inputs: channels, outputs: channels, rows, cols, activation, store: Store::Replace }
    }

    const fn attention(&self) -> ChannelAttention {
        let Self { channels, hidden, rows, cols } = *self;
        ChannelAttention { channels, hidden, rows, cols }
    }

    /// Numbers of scratch for bands of `band` rows; with 1 the least that [`Self::process`] works with.
    pub const fn scratch_len(&self, band: usize) -> usize {
        let conv = self.conv(Activation::Linear).scratch_len(band);
        let attention = self.channels + self.attention().scratch_len();
        if conv > attention { conv } else { attention }
    }

    /// Adds the block's residual to `g`; `t` is overwritten. Both are (channels, rows, cols).
    ///
    /// # Errors
    /// [`NnError`] where a tensor, the weights or the scratch do not fit the plan.
    pub fn process(
        &self,
        simd: Simd,
        parameters: Parameters<'_>,
        mut g: ChwMut<'_, f16>,
        mut t: ChwMut<'_, f16>,
        scratch: &mut [f32],
    ) -> Result<(), NnError> {
        check_scratch(self.scratch_len(1), scratch.len())?;
        let first = Tensors::Apart { input: g.as_chw(), addressing: Addressing::Direct, output: t.reborrow() };
        self.conv(Activation::Relu).process(simd, parameters.convs[0], first, scratch)?;
        let second = Tensors::InPlace(t.reborrow());
        self.conv(Activation::Linear).process(simd, parameters.convs[1], second, scratch)?;
        let (scale, scratch) = scratch.split_at_mut(self.channels);
        self.attention().process(simd, parameters.attention, t.as_chw(), scale, scratch)?;
        for (channel, &scale) in scale.iter().enumerate() {
            simd.run(AddScaled { scale, t: t.as_chw().channel(channel), g: g.channel_mut(channel) });
        }
        Ok(())
    }
}

struct AddScaled<'a> {
    scale: f32,
    t: &'a [f16],
    g: &'a mut [f16],
}

impl Kernel for AddScaled<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        for (g, &t) in self.g.iter_mut().zip(self.t) {
            *g = narrow(mac(widen(t), self.scale, widen(*g)));
        }
    }
}
