//! Columns of pairs of halves, such as complex numbers, that lie a stride apart.

use super::convert::{narrow, widen};
use super::f16;

/// Where pair `i` goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Order {
    /// To place `i`.
    Natural,
    /// To the place whose number has the bits of `i` reversed; the number of places is a power of two.
    Reversed,
}

/// Which number of a pair comes first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Parts {
    /// The first one.
    InOrder,
    /// The second one.
    Exchanged,
}

/// Widens the pairs at `from[i * stride..][..2]` into `to`.
#[inline(always)]
pub fn gather_pairs(from: &[f16], stride: usize, order: Order, to: &mut [[f32; 2]]) {
    let len = to.len();
    assert!(stride >= 2 && from.len() + stride >= len * stride + 2, "{} halves are too few", from.len());
    assert!(order == Order::Natural || len.is_power_of_two() && len > 1, "{len} places are no power of two");
    #[cfg(all(target_arch = "arm", target_abi = "eabihf"))]
    let done = super::arm::gather_pairs(from, stride, order, to);
    #[cfg(not(all(target_arch = "arm", target_abi = "eabihf")))]
    let done = 0;
    for i in done..len {
        let place = match order {
            Order::Natural => i,
            Order::Reversed => (i as u32).reverse_bits() as usize >> (u32::BITS - len.trailing_zeros()),
        };
        to[place] = [widen(from[i * stride]), widen(from[i * stride + 1])];
    }
}

/// Scales by `scale`, a power of two, and narrows the pairs of `from` into `to[i * stride..][..2]`.
#[inline(always)]
pub fn scatter_pairs(from: &[[f32; 2]], scale: f32, parts: Parts, to: &mut [f16], stride: usize) {
    assert!(stride >= 2 && to.len() + stride >= from.len() * stride + 2, "{} halves are too few", to.len());
    #[cfg(all(target_arch = "arm", target_abi = "eabihf"))]
    let done = super::arm::scatter_pairs(from, scale, parts, to, stride);
    #[cfg(not(all(target_arch = "arm", target_abi = "eabihf")))]
    let done = 0;
    for (i, &[a, b]) in from.iter().enumerate().skip(done) {
        let [a, b] = if parts == Parts::InOrder { [a, b] } else { [b, a] };
        to[i * stride] = narrow(a * scale);
        to[i * stride + 1] = narrow(b * scale);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pairs_go_where_the_order_says() {
        let halves: [f16; 70] = core::array::from_fn(|i| f16::from_f32(i as f32));
        for (stride, order, second) in [(2, Order::Natural, 1), (9, Order::Natural, 1), (8, Order::Reversed, 4)] {
            let mut pairs = [[-1.0; 2]; 8];
            gather_pairs(&halves, stride, order, &mut pairs);
            assert_eq!(pairs[second], [stride as f32, stride as f32 + 1.0]);
            assert_eq!(pairs[7], [7.0 * stride as f32, 7.0 * stride as f32 + 1.0]);
        }
    }

    #[test]
    fn pairs_come_from_where_they_go() {
        let pairs: [[f32; 2]; 7] = core::array::from_fn(|i| [2.0 * i as f32, 2.0 * i as f32 + 1.0]);
        for (stride, parts, flip) in [(2, Parts::InOrder, 0), (5, Parts::InOrder, 0), (4, Parts::Exchanged, 1)] {
            let mut halves = [f16::NEG_ONE; 40];
            scatter_pairs(&pairs, 0.5, parts, &mut halves, stride);
            for (i, half) in halves.iter().enumerate() {
                let (pair, part) = (i / stride, i % stride);
                let expected = if pair < 7 && part < 2 { (2 * pair + (part ^ flip)) as f32 / 2.0 } else { -1.0 };
                assert_eq!(half.to_f32(), expected, "stride {stride}: {i}");
            }
        }
    }
}
