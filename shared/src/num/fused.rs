//! Loops that convert between halves and singles while they load or store, without a widened copy.

#[cfg(all(target_arch = "arm", target_abi = "eabihf"))]
use super::arm;
use super::convert::{narrow, widen};
use super::f16;
use super::function::mac;

/// Number of leading elements that the routine for Arm has done; 0 on other targets.
macro_rules! done_on_arm {
    ($function:ident($($argument:expr),*)) => {{
        #[cfg(all(target_arch = "arm", target_abi = "eabihf"))]
        let done = arm::$function($($argument),*);
        #[cfg(not(all(target_arch = "arm", target_abi = "eabihf")))]
        let done = 0;
        done
    }};
}

/// Narrows `max(x, 0)` of each element. A negative zero becomes zero.
#[inline(always)]
pub fn narrow_relu(from: &[f32], to: &mut [f16]) {
    let done = done_on_arm!(narrow_relu(from, to));
    for (to, &x) in to[done..].iter_mut().zip(&from[done..]) {
        *to = narrow(if x > 0.0 { x } else { 0.0 });
    }
}

/// `to = to + from`, rounded to single, then to half.
#[inline(always)]
pub fn accumulate(from: &[f32], to: &mut [f16]) {
    let done = done_on_arm!(accumulate(from, to));
    for (to, &x) in to[done..].iter_mut().zip(&from[done..]) {
        *to = narrow(widen(*to) + x);
    }
}

/// `to = to + scale * from`, the product rounded to single, the sum rounded to single, then to half.
#[inline(always)]
pub fn add_scaled(scale: f32, from: &[f16], to: &mut [f16]) {
    let done = done_on_arm!(add_scaled(scale, from, to));
    for (to, &x) in to[done..].iter_mut().zip(&from[done..]) {
        *to = narrow(mac(widen(x), scale, widen(*to)));
    }
}

/// Divides each element by `divisor`, rounded to single, then to half.
#[inline(always)]
pub fn divide(values: &mut [f16], divisor: f32) {
    let done = done_on_arm!(divide(values, divisor));
    for x in &mut values[done..] {
        *x = narrow(widen(*x) / divisor);
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
        *pair = [widen(narrow(even)), widen(narrow(odd))];
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
