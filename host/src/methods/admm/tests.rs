#![allow(clippy::unwrap_used)]
use super::tv::{Edge, gradient, gradient_transposed, shrink, total_variation};
use super::*;
use crate::methods::Reconstruct;
use crate::metrics::compare;
use crate::rng;
use crate::testing::square_array as instrument;
use rand::RngExt;

fn random(rows: usize, cols: usize, index: u64) -> Array2<f32> {
    let mut draw = rng::stream(5, "admm test", index);
    Array2::from_shape_fn((rows, cols), |_| draw.random_range(-1.0..1.0f32))
}

/// Flat patches on a dark background: objects that suit total variation.
fn object() -> Array2<f32> {
    let inside = |r: usize, c: usize, [a, b]: [usize; 2], n: usize| r >= a && r < a + n && c >= b && c < b + n;
    Array2::from_shape_fn((20, 20), |(r, c)| {
        100.0 * f32::from(inside(r, c, [4, 5], 5)) + 60.0 * f32::from(inside(r, c, [11, 10], 6))
    })
}

/// Nine lenses whose foci are blurred in the same way all over the field, so that both models are exact.
fn blurred() -> Instrument {
    let mut instrument = instrument(3, [60, 60], [20, 20]);
    for lens in 0..9 {
        for (i, v) in [0.05f32, 0.1, 0.05, 0.1, 0.4, 0.1, 0.05, 0.1, 0.05].into_iter().enumerate() {
            instrument.psf.basis[[lens, 0, i / 3, i % 3]] = v;
        }
    }
    instrument
}

fn frame(instrument: &Instrument) -> Array2<f32> {
    Forward::new(instrument).unwrap().operator().apply(object().view()).unwrap() + 64.0
}

#[test]
fn the_transposed_gradient_is_the_transpose() {
    for edge in [Edge::Wrap, Edge::Mirror] {
        let (x, p) = (random(7, 9, 1), [random(7, 9, 2), random(7, 9, 3)]);
        let slope = gradient(x.view(), edge);
        let left = (&slope[0] * &p[0]).sum() + (&slope[1] * &p[1]).sum();
        let right = (&x * &gradient_transposed(&p, edge)).sum();
        assert!((left - right).abs() < 1e-4, "{edge:?}: {left} {right}");
    }
}

/// The proximal map minimises `by |q| + |q - p|^2 / 2`: no other q near it is better.
#[test]
fn shrinking_is_the_proximal_map() {
    let p = [random(4, 4, 4), random(4, 4, 5)];
    let by = 0.4f32;
    let mut q = p.clone();
    shrink(&mut q, by);
    let cost =
        |a: f32, b: f32, at: [usize; 2]| by * a.hypot(b) + 0.5 * ((a - p[0][at]).powi(2) + (b - p[1][at]).powi(2));
    for r in 0..4 {
        for c in 0..4 {
            let (a, b) = (q[0][[r, c]], q[1][[r, c]]);
            for (da, db) in [(1e-2, 0.0), (-1e-2, 0.0), (0.0, 1e-2), (0.0, -1e-2)] {
                assert!(cost(a, b, [r, c]) <= cost(a + da, b + db, [r, c]) + 1e-6);
            }
        }
    }
}

#[test]
fn the_scaled_operator_has_norm_one_and_its_transpose() {
    let method = AdmmConfig::low_rank().build_low_rank(&blurred()).unwrap();
    let (x, y) = (random(20, 20, 6), random(60, 60, 7));
    let (image, back) = (method.apply(&x).unwrap(), method.adjoint(&y).unwrap());
    let (left, right) = ((&image * &y).sum(), (&x * &back).sum());
    assert!((left - right).abs() < 1e-3 * left.abs().max(1.0), "{left} {right}");
    let norm = |a: &Array2<f32>| a.iter().map(|v| v * v).sum::<f32>().sqrt();
    assert!(norm(&image) <= 1.001 * norm(&x));
    let even = Array2::from_elem((20, 20), 1.0f32);
    assert!(norm(&method.apply(&even).unwrap()) > 0.8 * norm(&even));
}

/// `1/2 ||A x - y||^2 + tau TV(x)`.
fn cost(method: &LowRankAdmm, y: &Array2<f32>, tau: f32, x: &Array2<f32>) -> f64 {
    let off = method.apply(x).unwrap() - y;
    0.5 * off.iter().map(|&v| f64::from(v).powi(2)).sum::<f64>()
        + f64::from(tau) * total_variation(x.view(), Edge::Mirror)
}

#[test]
fn it_converges_to_the_minimum() {
    let config = AdmmConfig { iterations: 400, settled: 0.0, inner: 3, tv: 0.0, penalty: 0.03 };
    let method = config.build_low_rank(&blurred()).unwrap();
    let y = method.apply(&(object() / 100.0)).unwrap() + random(60, 60, 8) * 0.01;
    let tau = 2e-3;
    let mut costs = Vec::new();
    let x = method.solve(&y, tau, |x| costs.push(cost(&method, &y, tau, x))).unwrap();
    let (early, last) = (costs[30], costs[399]);
    assert!(costs[2] > 1.05 * last && early < 1.01 * last && costs[200] < last * (1.0 + 1e-4), "{early} {last}");
    // No step along a random direction, cut at zero, leads lower.
    for i in 0..20 {
        for size in [1e-2f32, 1e-3] {
            let near = (&x + &(random(20, 20, 100 + i) * size)).mapv(|v| v.max(0.0));
            assert!(cost(&method, &y, tau, &near) > last * (1.0 - 1e-5));
        }
    }
}

#[test]
fn it_ends_where_it_has_settled() {
    let config = AdmmConfig::low_rank();
    let method = config.build_low_rank(&blurred()).unwrap();
    let y = method.apply(&(object() / 100.0)).unwrap() + random(60, 60, 8) * 0.01;
    let mut seen = Vec::new();
    let x = method.solve(&y, 2e-3, |x| seen.push(x.clone())).unwrap();
    let n = seen.len();
    assert!(n > 5 && n < config.iterations && x == seen[n - 1], "{n}");
    let apart = |i: usize| (&seen[i] - &x).mapv(|v| v * v).sum().sqrt() / x.mapv(|v| v * v).sum().sqrt();
    assert!(apart(n - 2) < 2e-3 && apart(n / 2) < 0.05, "{} {}", apart(n - 2), apart(n / 2));
}

#[test]
fn both_models_agree_where_the_psf_does_not_vary() {
    let instrument = blurred();
    let frame = frame(&instrument);
    let one = AdmmConfig { iterations: 600, settled: 0.0, ..AdmmConfig::shift_invariant() }
        .build_shift_invariant(&instrument)
        .unwrap();
    let all =
        AdmmConfig { iterations: 300, settled: 0.0, ..AdmmConfig::low_rank() }.build_low_rank(&instrument).unwrap();
    let (a, b) = (one.reconstruct(frame.view()).unwrap(), all.reconstruct(frame.view()).unwrap());
    let apart = compare(a.view(), b.view()).unwrap();
    assert!(apart.nrmse < 0.02, "{apart:?}");
    assert!(compare(b.view(), object().view()).unwrap().nrmse < 0.05);
    assert!(compare(a.view(), object().view()).unwrap().nrmse < 0.05);
}

#[test]
fn total_variation_takes_noise_out() {
    let instrument = blurred();
    let noisy = frame(&instrument) + random(60, 60, 9) * 60.0;
    let judge = |tv| {
        let method = AdmmConfig { tv, ..AdmmConfig::low_rank() }.build_low_rank(&instrument).unwrap();
        compare(method.reconstruct(noisy.view()).unwrap().view(), object().view()).unwrap().nrmse
    };
    let (without, with) = (judge(0.0), judge(2.0));
    assert!(with < 0.8 * without, "{with} {without}");
}

#[test]
fn a_dark_frame_gives_a_dark_object() {
    let dark = Array2::from_elem((60, 60), 64.0f32);
    let instrument = blurred();
    let one = AdmmConfig::shift_invariant().build_shift_invariant(&instrument).unwrap();
    let all = AdmmConfig::low_rank().build_low_rank(&instrument).unwrap();
    for method in [&one as &dyn Reconstruct, &all] {
        assert!(method.reconstruct(dark.view()).unwrap().iter().all(|v| *v == 0.0));
    }
}
