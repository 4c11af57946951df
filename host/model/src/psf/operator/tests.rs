#![allow(clippy::unwrap_used)]

use super::*;
use crate::instrument::Instrument;
use crate::testing::instrument;

fn noise(shape: [usize; 2], seed: usize) -> Array2<f32> {
    Array2::from_shape_fn(shape, |(r, c)| (((r * 131 + c * 17 + seed) * 7919) % 1009) as f32 / 1009.0 - 0.2)
}

/// Eq. 3, term by term, in f64.
fn naive(i: &Instrument, object: &Array2<f32>) -> Array2<f64> {
    let sensor = [i.manifest.sensor.rows, i.manifest.sensor.cols];
    let (lenses, rank, window, _) = i.psf.basis.dim();
    let half = window as isize / 2;
    let mut frame = Array2::zeros(sensor);
    for l in (0..lenses).filter(|l| !i.geometry.dead[*l]) {
        let corner = [0, 1].map(|a| {
            let centre = ([object.nrows(), object.ncols()][a] as f64 - 1.0) / 2.0;
            (i.geometry.anchors_px[l][a] - centre).round() as isize
        });
        for ((r, c), o) in object.indexed_iter() {
            let (row, col) = (Taps::at(&i.psf.node_rows_px, r as f64), Taps::at(&i.psf.node_cols_px, c as f64));
            for k in 0..rank {
                let nodes = i.psf.coefficients.slice(s![l, k, 0, .., ..]);
                let down: Vec<f32> = nodes.outer_iter().map(|n| col.apply(&n.to_vec())).collect();
                let m = f64::from(row.apply(&down));
                for ((p, q), b) in i.psf.basis.slice(s![l, k, .., ..]).indexed_iter() {
                    let y = corner[0] + r as isize - half + p as isize;
                    let x = corner[1] + c as isize - half + q as isize;
                    if (0..sensor[0] as isize).contains(&y) && (0..sensor[1] as isize).contains(&x) {
                        frame[[y as usize, x as usize]] += m * f64::from(*o) * f64::from(*b);
                    }
                }
            }
        }
    }
    frame
}

fn plan(i: &Instrument, max_transform_px: usize) -> LowRankOperator {
    LowRankOperator::plan(i.optics(), &i.geometry, OperatorConfig { max_transform_px, ..OperatorConfig::default() })
        .unwrap()
}

#[test]
fn equals_the_sum_term_by_term_whatever_the_blocks() {
    for (object, sensor, window) in [([20, 23], [40, 37], 5), ([31, 8], [24, 30], 7)] {
        let i = instrument(object, sensor, window, 3);
        let o = noise(object, 1);
        let want = naive(&i, &o);
        let scale = want.iter().fold(0.0f64, |m, v| m.max(v.abs()));
        for max_transform_px in [1024, 2 * window, 18] {
            let got = plan(&i, max_transform_px).apply(o.view()).unwrap();
            for (a, b) in got.iter().zip(&want) {
                assert!((f64::from(*a) - b).abs() < 2e-6 * scale, "{a} {b} {scale}");
            }
        }
    }
}

#[test]
fn spectra_that_are_made_anew_give_the_bits_of_those_that_are_kept() {
    let i = instrument([31, 23], [40, 37], 5, 3);
    let (o, y) = (noise([31, 23], 4), noise([40, 37], 5));
    for max_transform_px in [1024, 18] {
        let kept = plan(&i, max_transform_px);
        let config = OperatorConfig { max_transform_px, most_spectra_bytes: 0, depth: 0 };
        let made = LowRankOperator::plan(i.optics(), &i.geometry, config).unwrap();
        assert_eq!(kept.apply(o.view()).unwrap(), made.apply(o.view()).unwrap());
        assert_eq!(kept.adjoint(y.view()).unwrap(), made.adjoint(y.view()).unwrap());
    }
}

#[test]
fn transforms_hold_the_object_in_few_blocks() {
    // The paper's size: two blocks of 1200 and the window make 1440.
    assert_eq!(best_transform(2400, 241, 1536), 1440);
    assert_eq!(best_transform(96, 21, 1536), 120);
    // A window that is larger than the bound has its way.
    assert!(best_transform(100, 61, 32) >= 100usize.div_ceil(3) + 60);
}

#[test]
fn a_dead_lens_adds_nothing() {
    let mut i = instrument([12, 12], [40, 40], 5, 2);
    let o = noise([12, 12], 2);
    let both = plan(&i, 64).apply(o.view()).unwrap();
    i.geometry.dead[0] = true;
    let second = plan(&i, 64).apply(o.view()).unwrap();
    i.geometry.dead = vec![false, true];
    let first = plan(&i, 64).apply(o.view()).unwrap();
    assert!(first.iter().any(|v| *v != 0.0) && second.iter().any(|v| *v != 0.0));
    assert_eq!(both, first + second);
}

#[test]
fn whole_pixel_moves_of_the_chief_rays_move_the_image() {
    let i = instrument([12, 12], [40, 40], 5, 2);
    let o = noise([12, 12], 3);
    let mut moved = i.geometry.clone();
    moved.anchors_px.iter_mut().for_each(|a| *a = [a[0] + 2.0, a[1] - 1.0]);
    let here = plan(&i, 64).apply(o.view()).unwrap();
    let there = LowRankOperator::plan(i.optics(), &moved, OperatorConfig::default()).unwrap().apply(o.view()).unwrap();
    let scale = here.iter().fold(0.0f32, |m, v| m.max(v.abs()));
    for r in 0..38 {
        for c in 1..40 {
            assert!((there[[r + 2, c - 1]] - here[[r, c]]).abs() < 2e-6 * scale);
        }
    }
}

#[test]
fn moves_by_a_fraction_move_the_centre_of_light_by_it() {
    let mut i = instrument([9, 9], [60, 60], 11, 1);
    i.geometry.anchors_px = vec![[30.0, 30.0], [30.0, 30.0]];
    i.geometry.dead[1] = true;
    i.psf.coefficients.fill(1.0);
    i.psf.basis = ndarray::Array4::from_shape_fn((2, 1, 11, 11), |(_, _, r, c)| {
        (-((r as f32 - 5.0).powi(2) + (c as f32 - 5.0).powi(2)) / 3.0).exp()
    });
    let mut o = Array2::zeros((9, 9));
    o[[4, 4]] = 1.0;
    let centre = |g: &ChiefRays| {
        let f = LowRankOperator::plan(i.optics(), g, OperatorConfig::default()).unwrap().apply(o.view()).unwrap();
        let sum = f.sum();
        let moment = |a: usize| f.indexed_iter().map(|((r, c), v)| [r, c][a] as f32 * v).sum::<f32>() / sum;
        [moment(0), moment(1)]
    };
    let mut moved = i.geometry.clone();
    moved.anchors_px[0] = [30.4, 28.3];
    let (a, b) = (centre(&i.geometry), centre(&moved));
    assert!((b[0] - a[0] - 0.4).abs() < 5e-3 && (b[1] - a[1] + 1.7).abs() < 5e-3, "{a:?} {b:?}");
}

#[test]
fn wrong_shapes_and_tables_are_refused() {
    let i = instrument([12, 13], [40, 41], 5, 2);
    let operator = plan(&i, 64);
    let message = operator.apply(Array2::zeros((13, 12)).view()).unwrap_err().to_string();
    assert_eq!(message, "object: expected [12, 13], found [13, 12]");
    assert!(operator.adjoint(Array2::zeros((1, 1)).view()).is_err());
    let refused = |change: &dyn Fn(&mut Instrument, &mut OperatorConfig)| {
        let (mut i, mut config) = (i.clone(), OperatorConfig::default());
        let calibrated = i.geometry.clone();
        change(&mut i, &mut config);
        LowRankOperator::plan(i.optics(), &calibrated, config).unwrap_err()
    };
    assert!(matches!(refused(&|_, c| c.depth = 1), OperatorError::Depth { found: 1, depths: 1 }));
    assert!(matches!(refused(&|i, _| i.geometry.magnification = 2.0), OperatorError::Magnification { .. }));
    assert!(matches!(refused(&|i, _| i.psf.node_rows_px.truncate(2)), OperatorError::Field { .. }));
    assert!(matches!(refused(&|i, _| i.geometry.anchors_px.truncate(1)), OperatorError::Field { .. }));
}

proptest::proptest! {
    #![proptest_config(proptest::prelude::ProptestConfig::with_cases(24))]
    /// <A x, y> = <x, A' y>, for any sizes, blocks and shifts of the chief rays.
    #[test]
    fn the_adjoint_is_the_transpose(
        rows in 3usize..40, cols in 3usize..40, half in 0usize..5, rank in 1usize..4,
        max_transform_px in 8usize..96, seed in 0usize..1000, shift in -3.0f64..3.0,
    ) {
        let i = instrument([rows, cols], [37, 44], 2 * half + 1, rank);
        let mut moved = i.geometry.clone();
        moved.anchors_px[1][0] += shift;
        let config = OperatorConfig { max_transform_px, ..OperatorConfig::default() };
        let a = LowRankOperator::plan(i.optics(), &moved, config).unwrap();
        let (x, y) = (noise([rows, cols], seed), noise([37, 44], seed + 1));
        let dot = |a: &Array2<f32>, b: &Array2<f32>| -> f64 {
            a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum()
        };
        let norm = |a: &Array2<f32>| dot(a, a).sqrt();
        let ax = a.apply(x.view()).unwrap();
        let (left, right) = (dot(&ax, &y), dot(&x, &a.adjoint(y.view()).unwrap()));
        proptest::prop_assert!((left - right).abs() <= 2e-6 * norm(&ax) * norm(&y) + 1e-6, "{} {}", left, right);
    }
}
