//! Loops that convert between halves and singles while they load or store, without a widened copy.
//!
//! # Features are finite
//! Where a loop here stores a half, a number beyond the largest half, 65,504, becomes the largest one of its sign. So
//! all features are finite, and nothing that the enhancement network computes from them is infinite or NaN: a sum of
//! fewer than 2^14 products of two halves stays below 2^46, the numbers in a channel attention below 2^61. A NaN is
//! therefore never given to these loops; what they would make of one is not defined.
//!
//! A Cortex-M stores infinities first, and replaces them where the overflow flag of its floating-point unit is up, at
//! four instructions a call.

#[cfg(all(target_arch = "arm", feature = "fpv4"))]
use super::arm;
use super::convert::{bounded, narrow, widen};
use super::f16;
use super::function::mac;

/// Number of leading elements that the routine for Arm has done; 0 on other targets.
macro_rules! done_on_arm {
    ($function:ident($($argument:expr),*)) => {{
        #[cfg(all(target_arch = "arm", feature = "fpv4"))]
        let done = arm::$function($($argument),*);
        #[cfg(not(all(target_arch = "arm", feature = "fpv4")))]
        let done = 0;
        done
    }};
}

/// Replaces the infinities that were just stored. Elsewhere than on Arm there are none.
macro_rules! bound_on_arm {
    ($halves:expr) => {
        #[cfg(all(target_arch = "arm", feature = "fpv4"))]
        if arm::overflowed() {
            $halves.iter_mut().for_each(|half| *half = bounded(*half));
        }
    };
}

/// Rounds to half for storage. On Arm the caller replaces infinities afterwards.
#[inline(always)]
fn stored(value: f32) -> f16 {
    debug_assert!(!value.is_nan(), "no feature is NaN");
    let half = narrow(value);
    if cfg!(all(target_arch = "arm", feature = "fpv4")) { half } else { bounded(half) }
}

/// Computes leading elements of `((code - black) - offset) * gain` where the target has vectors of its own for that,
/// and returns how many. The caller computes the others.
#[inline(always)]
#[cfg_attr(
    not(all(target_arch = "arm", feature = "helium")),
    expect(unused_variables, reason = "only Helium computes any")
)]
pub fn correct_leading(codes: &[u16], black: f32, maps: [&[f16]; 2], to: &mut [f32]) -> usize {
    #[cfg(all(target_arch = "arm", feature = "helium"))]
    let done = arm::correct(codes, black, maps, to);
    #[cfg(not(all(target_arch = "arm", feature = "helium")))]
    let done = 0;
    done
}

/// Narrows each element.
#[inline(always)]
pub fn narrow_bounded(from: &[f32], to: &mut [f16]) {
    let done = done_on_arm!(narrow_whole(from, to));
    for (to, &x) in to[done..].iter_mut().zip(&from[done..]) {
        *to = stored(x);
    }
    bound_on_arm!(to);
}

/// Narrows `max(x, 0)` of each element. A negative zero becomes zero.
#[inline(always)]
pub fn narrow_relu(from: &[f32], to: &mut [f16]) {
    let done = done_on_arm!(narrow_relu(from, to));
    for (to, &x) in to[done..].iter_mut().zip(&from[done..]) {
        *to = stored(if x > 0.0 { x } else { 0.0 });
    }
    bound_on_arm!(to);
}

/// `to = to + from`, rounded to single, then to half.
#[inline(always)]
pub fn accumulate(from: &[f32], to: &mut [f16]) {
    let done = done_on_arm!(accumulate(from, to));
    for (to, &x) in to[done..].iter_mut().zip(&from[done..]) {
        *to = stored(widen(*to) + x);
    }
    bound_on_arm!(to);
}

/// `to = to + scale * from`, the product rounded to single, the sum rounded to single, then to half.
#[inline(always)]
pub fn add_scaled(scale: f32, from: &[f16], to: &mut [f16]) {
    let done = done_on_arm!(add_scaled(scale, from, to));
    for (to, &x) in to[done..].iter_mut().zip(&from[done..]) {
        *to = stored(mac(widen(x), scale, widen(*to)));
    }
    bound_on_arm!(to);
}

/// Divides each element by `divisor`, rounded to single, then to half.
#[inline(always)]
pub fn divide(values: &mut [f16], divisor: f32) {
    let done = done_on_arm!(divide(values, divisor));
    for x in &mut values[done..] {
        *x = stored(widen(*x) / divisor);
    }
    bound_on_arm!(values);
}

/// `to = 4 (from - scale * to)`, the product rounded to single, the difference rounded to single, then to half.
#[inline(always)]
pub fn difference(scale: f32, from: &[f16], to: &mut [f16]) {
    for (to, &x) in to.iter_mut().zip(from) {
        *to = stored(4.0 * mac(widen(*to), -scale, widen(x)));
    }
    bound_on_arm!(to);
}

/// Adds the products of the elements 8 k + j of two slices to partial sum j, in ascending order of k. The products are
/// exact.
#[inline(always)]
pub fn add_products_eights(a: &[f16], b: &[f16], sums: &mut [f32; 8]) {
    let ((a, a_rest), (b, b_rest)) = (a.as_chunks::<8>(), b.as_chunks::<8>());
    for (a, b) in a.iter().zip(b) {
        for (sum, (&a, &b)) in sums.iter_mut().zip(a.iter().zip(b)) {
            *sum += widen(a) * widen(b);
        }
    }
    for (sum, (&a, &b)) in sums.iter_mut().zip(a_rest.iter().zip(b_rest)) {
        *sum += widen(a) * widen(b);
    }
}

/// Adds the elements 8 k + j to partial sum j, in ascending order of k.
#[inline(always)]
pub fn add_eights(from: &[f16], sums: &mut [f32; 8]) {
    let done = done_on_arm!(add_eights(from, sums));
    let (blocks, rest) = from[done..].as_chunks::<8>();
    for block in blocks {
        for (sum, &x) in sums.iter_mut().zip(block) {
            *sum += widen(x);
        }
    }
    for (sum, &x) in sums.iter_mut().zip(rest) {
        *sum += widen(x);
    }
}

/// Widens every second element, from element `first` (0 or 1) on: `to[i] = from[2 i + first]`.
#[inline(always)]
pub fn widen_alternate(from: &[f16], first: usize, to: &mut [f32]) {
    let done = done_on_arm!(widen_alternate(from, first, to));
    for (to, pair) in to[done..].iter_mut().zip(from[2 * done..].chunks_exact(2)) {
        *to = widen(pair[first]);
    }
}

/// Rounds to halves and widens again: `to[2 i]` from `even[i]`, `to[2 i + 1]` from `odd[i]`.
#[inline(always)]
pub fn round_interleaved(even: &[f32], odd: &[f32], to: &mut [f32]) {
    let done = done_on_arm!(round_interleaved(even, odd, to));
    let pairs = to[2 * done..].as_chunks_mut::<2>().0.iter_mut();
    for ((pair, &even), &odd) in pairs.zip(&even[done..]).zip(&odd[done..]) {
        *pair = [widen(stored(even)), widen(stored(odd))];
    }
    #[cfg(all(target_arch = "arm", feature = "fpv4"))]
    if arm::overflowed() {
        to.iter_mut().for_each(|x| *x = widen(bounded(narrow(*x))));
    }
}

#[cfg(test)]
mod tests {
    extern crate std;

    use super::*;
    use std::vec;
    use std::vec::Vec;

    fn singles(len: usize) -> Vec<f32> {
        (0..len).map(|i| (i as f32 - 11.0) * 0.3).collect()
    }

    fn halves(len: usize) -> Vec<f16> {
        singles(len).iter().map(|&x| narrow(7.0 - x)).collect()
    }

    #[test]
    fn stores_agree_with_their_steps() {
        for len in [0, 1, 7, 8, 23, 64] {
            let (x, y) = (singles(len), halves(len));
            let check = |found: &[f16], expected: &dyn Fn(usize) -> f32| {
                assert!(found.iter().enumerate().all(|(i, half)| half.to_bits() == narrow(expected(i)).to_bits()));
            };
            let mut to = y.clone();
            narrow_relu(&x, &mut to);
            check(&to, &|i| x[i].max(0.0));
            to.copy_from_slice(&y);
            accumulate(&x, &mut to);
            check(&to, &|i| y[i].to_f32() + x[i]);
            to.copy_from_slice(&y);
            let from: Vec<f16> = x.iter().map(|&x| narrow(x)).collect();
            add_scaled(0.3, &from, &mut to);
            check(&to, &|i| y[i].to_f32() + from[i].to_f32() * 0.3);
            to.copy_from_slice(&y);
            divide(&mut to, 3.0);
            check(&to, &|i| y[i].to_f32() / 3.0);
        }
    }

    #[test]
    fn what_does_not_fit_is_stored_as_the_largest_half() {
        let x: Vec<f32> = (0..23).map(|i| [-7.0e4, 1.0, 65_519.9, 65_520.0, 3.0e38][i % 5]).collect();
        let most = |x: f32| narrow(x.clamp(-65_504.0, 65_504.0));
        let mut to = vec![f16::NAN; 23];
        narrow_bounded(&x, &mut to);
        assert!(to.iter().zip(&x).all(|(to, x)| *to == most(*x)));
        narrow_relu(&x, &mut to);
        assert!(to.iter().zip(&x).all(|(to, x)| *to == most(x.max(0.0))));
        to.fill(f16::MIN);
        accumulate(&[-1.0e3; 23], &mut to);
        assert!(to.iter().all(|to| *to == f16::MIN));
        add_scaled(2.5, &[f16::MAX; 23], &mut to);
        assert!(to.iter().all(|to| *to == f16::MAX), "65504 * 2.5 - 65504");
        divide(&mut to, -0.5);
        assert!(to.iter().all(|to| *to == f16::MIN));
        let mut back = vec![0.0; 46];
        round_interleaved(&x, &x, &mut back);
        assert!(back.iter().enumerate().all(|(i, back)| *back == most(x[i / 2]).to_f32()));
    }

    #[test]
    fn partial_sums_take_every_eighth() {
        let mut sums = [0.5; 8];
        add_eights(&halves(19), &mut sums);
        let expected = |j: usize| (0..19).skip(j).step_by(8).fold(0.5, |sum, i| sum + halves(19)[i].to_f32());
        assert!(sums.iter().enumerate().all(|(j, &sum)| sum == expected(j)));
    }

    #[test]
    fn what_is_taken_apart_comes_together() {
        let from = halves(46);
        let mut parts = [vec![0.0; 23], vec![0.0; 23]];
        for (first, part) in parts.iter_mut().enumerate() {
            widen_alternate(&from, first, part);
        }
        let mut back = vec![0.0; 46];
        round_interleaved(&parts[0], &parts[1], &mut back);
        assert!(back.iter().zip(&from).all(|(back, from)| *back == from.to_f32()));
        round_interleaved(&[0.1], &[1.0e-9], &mut back[..2]);
        assert_eq!(back[..2], [narrow(0.1).to_f32(), 0.0]);
    }
}
