//! Residual channel-attention block: `g = g + s * t` with `t = conv(relu(conv(g)))` and `s` the [channel
//! attention](super::channel_attention) of t.
//!
//! t is stored as halves; `s * t` is rounded to binary32, then added, then rounded to half.
//!
//! s depends on the whole frame. Where it is held from another frame, a block can work on only a window of the
//! features.

use super::activation::Activation;
use super::arithmetic::Arithmetic;
use super::channel_attention::{self, ChannelAttention, Scales};
use super::conv::{Conv3x3, Store, Tensors};
use super::error::{NnError, check_scratch};
use super::features::Features;
use crate::image::Region;

/// Weights of a block, with those of a convolution as `C`.
#[derive(Clone, Copy, Debug)]
pub struct Parameters<'a, C> {
    /// First and second convolution, W -> W.
    pub convs: [C; 2],
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
    /// Windows of the features that the two convolutions compute, the second one inside the first.
    pub windows: [Region; 2],
}

impl Rcab {
    const fn conv(&self, window: Region, activation: Activation) -> Conv3x3 {
        let (inputs, outputs) = (self.channels, self.channels);
        let (rows, cols) = (window.rows as usize, window.cols as usize);
        Conv3x3 { inputs, outputs, rows, cols, activation, store: Store::Replace }
    }

    const fn attention(&self) -> ChannelAttention {
        let Self { channels, hidden, windows: [_, Region { rows, cols, .. }] } = *self;
        ChannelAttention { channels, hidden, rows: rows as usize, cols: cols as usize }
    }

    /// Length of scratch for bands of `band` rows, numbers. With bands of 1 row it is what [`Self::process`] needs at
    /// least.
    pub(super) fn scratch_len<A: Arithmetic>(&self, band: usize) -> usize {
        let conv = A::conv_scratch_len(&self.conv(self.windows[0], Activation::Linear), band);
        let attention = self.channels + self.attention().scratch_len();
        conv.max(attention)
    }

    /// Adds the residual of the block to `g`, and cuts `g` to the second window. `t` is a buffer of the same length,
    /// which is overwritten.
    ///
    /// # Errors
    /// [`NnError`] where a tensor, the weights, the scales or the scratch do not fit the plan.
    pub(super) fn process<A: Arithmetic>(
        &self,
        arithmetic: A,
        parameters: Parameters<'_, A::Conv<'_>>,
        scales: Scales<'_>,
        g: &mut Features<'_, A::Number>,
        t: &mut [A::Number],
        scratch: &mut [f32],
    ) -> Result<(), NnError> {
        check_scratch(self.scratch_len::<A>(1), scratch.len())?;
        let [outer, inner] = self.windows;
        let mut t = Features::new(t, self.channels, outer);
        let (input, output) = (g.cut(outer)?, t.cut(outer)?);
        let first = Tensors::Apart { input: input.as_chw(), output };
        arithmetic.conv(&self.conv(outer, Activation::Relu), parameters.convs[0], first, scratch)?;
        let (mut g, mut t) = (g.cut(inner)?, t.cut(inner)?);
        let second = Tensors::InPlace(t.reborrow());
        arithmetic.conv(&self.conv(inner, Activation::Linear), parameters.convs[1], second, scratch)?;
        let (own, scratch) = scratch.split_at_mut(self.channels);
        let scales = match scales {
            Scales::Held(scales) => scales,
            Scales::Measured(place) => {
                self.attention().process_with(arithmetic, parameters.attention, t.as_chw(), own, scratch)?;
                place.into_iter().flat_map(|place| place.iter_mut().zip(&*own)).for_each(|(to, scale)| *to = *scale);
                own
            }
        };
        for (channel, &scale) in scales.iter().enumerate() {
            arithmetic.add_scaled(scale, t.as_chw().channel(channel), g.channel_mut(channel));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    extern crate std;

    use super::*;
    use crate::naive::{self, Cursor, Noise, Tensor, wide};
    use crate::nn::arithmetic::Halves;
    use crate::nn::conv;
    use crate::num::f16;
    use crate::num::simd::Simd;
    use std::vec;
    use std::vec::Vec;

    /// Roundings of the inner activation, of t and of the result, carried through a convolution.
    const TOLERANCE: f64 = 8.0e-4;

    fn run(plan: Rcab, simd: Simd, band: usize, weights: &[f16], input: &[f16]) -> Vec<f16> {
        let Rcab { channels, hidden, windows: [window, _] } = plan;
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
        let mut scratch = vec![f32::NAN; plan.scratch_len::<Halves>(band)];
        let mut features = Features::new(&mut g, channels, window);
        let parameters = Parameters { convs, attention };
        plan.process(Halves(simd), parameters, Scales::Measured(None), &mut features, &mut t, &mut scratch).unwrap();
        g
    }

    #[test]
    fn agrees_with_the_definition_whatever_the_band() {
        let plan = Rcab { channels: 8, hidden: 2, windows: [Region::whole(11, 13); 2] };
        let mut noise = Noise(6);
        let weights = noise.halves(2 * (9 * 64 + 8) + 2 * 16 + 10, 0.2);
        let input = noise.halves(8 * 11 * 13, 1.0);
        let wide_weights = wide(&weights);
        let expected =
            naive::rcab(&Tensor::new([8, 11, 13], wide(&input)), 2, &mut Cursor(&wide_weights), &mut |own| own);
        let found = run(plan, Simd::detect(), 1, &weights, &input);
        let error = naive::error(&found, &expected.data);
        assert!(error < TOLERANCE, "{error:e}");
        for band in [2, 5, 20] {
            assert_eq!(run(plan, Simd::PORTABLE, band, &weights, &input), found);
        }
    }
}
