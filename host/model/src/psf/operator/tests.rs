#![allow(clippy::unwrap_used)]

use super::*;
use crate::instrument::Instrument;
use crate::psf::chief_rays::ChiefRays;
use crate::psf::nodes::Taps;
use crate::testing::instrument;
use ndarray::{Array2, s};

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
fn spectra_that_are_recomputed_give_the_bits_of_those_that_are_kept() {
    let i = instrument([31, 23], [40, 37], 5, 3);
    let (o, y) = (noise([31, 23], 4), noise([40, 37], 5));
    for max_transform_px in [1024, 18] {
        let kept = plan(&i, max_transform_px);
        let made = LowRankOperator::plan(i.optics(), &i.geometry, local(max_transform_px, 0.0)).unwrap();
        assert_eq!(kept.apply(o.view()).unwrap(), made.apply(o.view()).unwrap());
        assert_eq!(kept.adjoint(y.view()).unwrap(), made.adjoint(y.view()).unwrap());
    }
}

/// An instrument whose coefficients are smooth over the field, and whose later terms are weak, as calibrated ones are.
fn smooth(object: [usize; 2], sensor: [usize; 2], window: usize, rank: usize) -> Instrument {
    let mut i = instrument(object, sensor, window, rank);
    let (rows, cols) = (i.psf.node_rows_px.clone(), i.psf.node_cols_px.clone());
    i.psf.coefficients = ndarray::Array5::from_shape_fn(i.psf.coefficients.dim(), |(l, k, _, r, c)| {
        let (y, x) = (rows[r] / object[0] as f64, cols[c] / object[1] as f64);
        ((1.0 + (1.0 + k as f64) * y + 0.3 * l as f64).cos() * (0.2 + (k as f64) * x).cos() * 3f64.powi(-(k as i32)))
            as f32
    });
    i
}

fn local(max_transform_px: usize, most_error: f64) -> OperatorConfig {
    OperatorConfig { max_transform_px, most_spectra_bytes: 0, most_error, depth: 0 }
}

fn rms(a: &Array2<f32>) -> f64 {
    a.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>().sqrt()
}

#[test]
fn shared_functions_are_fewer_and_keep_their_error() {
    let i = smooth([96, 80], [120, 110], 9, 24);
    let o = noise([96, 80], 6).mapv(f32::abs);
    let exact = LowRankOperator::plan(i.optics(), &i.geometry, local(48, 0.0)).unwrap();
    let want = exact.apply(o.view()).unwrap();
    assert!(exact.cost().1.iter().all(|transforms| *transforms == 2 * 24));
    let mut before = usize::MAX;
    for most in [1e-5, 1e-3, 3e-2] {
        let operator = LowRankOperator::plan(i.optics(), &i.geometry, local(48, most)).unwrap();
        let functions = operator.cost().1.iter().sum::<usize>() / operator.cost().1.len();
        let error = rms(&(&operator.apply(o.view()).unwrap() - &want)) / rms(&want);
        assert!(
            functions < 24 && functions <= before && error < most + 1e-6,
            "{most}: {functions} functions, error {error}"
        );
        before = functions;
    }
}

#[test]
fn blocks_that_no_lens_shows_stay_dark() {
    let mut i = smooth([96, 80], [120, 110], 9, 24);
    i.psf.coefficients.slice_mut(s![.., .., .., 1.., ..]).fill(0.0);
    let (o, y) = (noise([96, 80], 6).mapv(f32::abs), noise([120, 110], 9));
    let [exact, shared] =
        [0.0, 1e-3].map(|most| LowRankOperator::plan(i.optics(), &i.geometry, local(48, most)).unwrap());
    let counts = shared.cost().1;
    assert!(counts.contains(&0) && counts.iter().all(|functions| *functions < 24), "{counts:?}");
    let near = |a: Array2<f32>, b: Array2<f32>| rms(&(&a - &b)) < 2e-3 * rms(&a);
    assert!(near(exact.apply(o.view()).unwrap(), shared.apply(o.view()).unwrap()));
    assert!(near(exact.adjoint(y.view()).unwrap(), shared.adjoint(y.view()).unwrap()));
}

#[test]
fn shared_functions_do_not_depend_on_the_number_of_threads() {
    let i = smooth([60, 70], [90, 90], 9, 24);
    let (o, y) = (noise([60, 70], 7), noise([90, 90], 8));
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let a = LowRankOperator::plan(i.optics(), &i.geometry, local(40, 1e-3)).unwrap();
            assert!(a.cost().1.iter().all(|functions| *functions < 24));
            (a.apply(o.view()).unwrap(), a.adjoint(y.view()).unwrap())
        })
    };
    let one = run(1);
    assert!(run(2) == one && run(5) == one);
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
    /// <A x, y> = <x, A' y>, for any sizes, blocks and shifts of the chief rays, with all terms and with shared
    /// functions.
    #[test]
    fn the_adjoint_is_the_transpose(
        rows in 3usize..40, cols in 3usize..40, half in 0usize..5, rank in 1usize..4,
        max_transform_px in 8usize..96, seed in 0usize..1000, shift in -3.0f64..3.0, most_error in -0.1f64..0.1,
    ) {
        let i = smooth([rows, cols], [37, 44], 2 * half + 1, rank);
        let mut moved = i.geometry.clone();
        moved.anchors_px[1][0] += shift;
        let config = local(max_transform_px, most_error.max(0.0));
        let default = OperatorConfig { max_transform_px, ..OperatorConfig::default() };
        let config = if seed % 2 == 0 { config } else { default };
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
