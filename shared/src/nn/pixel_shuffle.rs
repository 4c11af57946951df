//! Pixel shuffle and unshuffle by 2, done by addressing: no data are moved.
//!
//! Channel order of PyTorch: `unshuffle(x)[4 c + 2 i + j][y][x] = x[c][2 y + i][2 x + j]`, and `shuffle` is its
//! inverse.

use crate::image::Chw;
use crate::num::{f16, fused};

/// Widens row `row` of channel `channel` of the unshuffled `tensor` into `to` (`tensor.cols() / 2` long).
#[inline(always)]
pub fn widen_unshuffled_row(tensor: Chw<'_, f16>, channel: usize, row: usize, to: &mut [f32]) {
    let (i, j) = (channel / 2 % 2, channel % 2);
    let from = tensor.row(channel / 4, 2 * row + i);
    fused::widen_alternate(from, j, to);
}

/// Destination (channel, row, first column) of row `row` of channel `channel` where a tensor of 4 C channels is
/// shuffled to C. The columns then lie 2 apart.
#[inline(always)]
pub fn shuffled(channel: usize, row: usize) -> (usize, usize, usize) {
    (channel / 4, 2 * row + channel / 2 % 2, channel % 2)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `torch.nn.PixelUnshuffle(2)(torch.arange(16.).view(1, 4, 4))`, from its documentation's index formula.
    const UNSHUFFLED: [[f32; 4]; 4] =
        [[0.0, 2.0, 8.0, 10.0], [1.0, 3.0, 9.0, 11.0], [4.0, 6.0, 12.0, 14.0], [5.0, 7.0, 13.0, 15.0]];

    #[test]
    fn unshuffle_has_the_channel_order_of_pytorch() {
        let data: [f16; 16] = core::array::from_fn(|i| f16::from_f32(i as f32));
        let tensor = Chw::new(&data, 1, 4, 4).unwrap();
        for (channel, expected) in UNSHUFFLED.iter().enumerate() {
            for row in 0..2 {
                let mut to = [0.0; 2];
                widen_unshuffled_row(tensor, channel, row, &mut to);
                assert_eq!(to, expected[2 * row..][..2]);
            }
        }
    }

    #[test]
    fn shuffle_undoes_unshuffle() {
        let mut plane = [[-1.0_f32; 4]; 4];
        for (channel, values) in UNSHUFFLED.iter().enumerate() {
            for (i, &value) in values.iter().enumerate() {
                let (c, row, first) = shuffled(channel, i / 2);
                assert_eq!(c, 0);
                plane[row][first + 2 * (i % 2)] = value;
            }
        }
        assert!(plane.iter().flatten().enumerate().all(|(i, &v)| v == i as f32));
    }
}
