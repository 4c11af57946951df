//! Residual channel-attention block: `g = g + s * t` with `t = conv(relu(conv(g)))` and `s` the [channel attention](super::channel_attention) of t.
//!
//! t is stored as halves; `s * t` is rounded to binary32, then added, then rounded to half.

use super::activation::Activation;
use super::channel_attention::{self, ChannelAttention};
use super::conv::{self, Addressing, Conv3x3, Store, Tensors};
use super::error::{NnError, check_scratch};
use crate::image::ChwMut;
use crate::num::simd::{Kernel, Simd, Vector};
use crate::num::{f16, fused};

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
    fn run<V: Vector>(self) {
        fused::add_scaled(self.scale, self.t, self.g);
    }
}

#[cfg(test)]
mod tests {
    extern crate std;

    use super::*;
    use crate::naive::{self, Cursor, Noise, Tensor, wide};
    use std::vec;
    use std::vec::Vec;

    /// Roundings of the inner activation, of t and of the result, carried through a convolution.
    const TOLERANCE: f64 = 8.0e-4;

    fn run(plan: Rcab, simd: Simd, band: usize, weights: &[f16], input: &[f16]) -> Vec<f16> {
        let Rcab { channels, hidden, rows, cols } = plan;
        let mut rest = weights;
        let mut take = |len: usize| {
            let (taken, tail) = rest.split_at(len);
            rest = tail;
            taken
        };
        let convs = [(); 2].map(|()| conv::Parameters { weights: take(9 * channels * channels), bias: take(channels) });
        let attention = channel_attention::Parameters {
            squeeze: take(channels * hidden),
            squeeze_bias: take(hidden),
            excite: take(channels * hidden),
            excite_bias: take(channels),
        };
        let (mut g, mut t) = (input.to_vec(), vec![f16::NAN; input.len()]);
        let mut scratch = vec![f32::NAN; plan.scratch_len(band)];
        let [g_tensor, t_tensor] =
            [&mut g, &mut t].map(|data| ChwMut::new(data.as_mut_slice(), channels, rows, cols).unwrap());
        plan.process(simd, Parameters { convs, attention }, g_tensor, t_tensor, &mut scratch).unwrap();
        g
    }

    #[test]
    fn agrees_with_the_definition_whatever_the_band() {
        let plan = Rcab { channels: 8, hidden: 2, rows: 11, cols: 13 };
        let mut noise = Noise(6);
        let weights = noise.halves(2 * (9 * 64 + 8) + 2 * 16 + 10, 0.2);
        let input = noise.halves(8 * 11 * 13, 1.0);
        let wide_weights = wide(&weights);
        let expected = naive::rcab(&Tensor::new([8, 11, 13], wide(&input)), 2, &mut Cursor(&wide_weights));
        let found = run(plan, Simd::detect(), 1, &weights, &input);
        let error = naive::error(&found, &expected.data);
        assert!(error < TOLERANCE, "{error:e}");
        for band in [2, 5, 20] {
            assert_eq!(run(plan, Simd::PORTABLE, band, &weights, &input), found);
        }
    }
}
