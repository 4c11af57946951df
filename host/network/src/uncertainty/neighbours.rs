//! Scenes that look alike, without the truth: the calibration of a frame uses those most.

use super::observer::FRAME;

/// The scenes nearest to `at` by the features of frames, each divided by its unit, nearest first; `without` leaves out
/// one. At equal distance the earlier scene comes first.
pub(super) fn nearest(
    scenes: &[[f64; FRAME]],
    units: &[f64; FRAME],
    at: &[f64; FRAME],
    count: usize,
    without: Option<usize>,
) -> Vec<(usize, f64)> {
    let distance = |scene: &[f64; FRAME]| {
        scene.iter().zip(at).zip(units).map(|((a, b), unit)| ((a - b) / unit).powi(2)).sum::<f64>().sqrt()
    };
    let others = scenes.iter().enumerate().filter(|(i, _)| Some(*i) != without);
    let mut all: Vec<(usize, f64)> = others.map(|(i, scene)| (i, distance(scene))).collect();
    all.sort_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0)));
    all.truncate(count.max(1));
    all
}

/// Weights of the features: light, and the two figures of how fine the structure is, count twice (chosen on development
/// seeds).
const WEIGHTS: [f64; FRAME] = [2.0, 1.0, 1.0, 2.0, 2.0, 1.0, 1.0];

/// Unit of each feature: its standard deviation over all scenes (1 where it does not vary) over its weight.
pub(super) fn units(scenes: &[[f64; FRAME]]) -> [f64; FRAME] {
    let n = scenes.len().max(1) as f64;
    std::array::from_fn(|k| {
        let mean = scenes.iter().map(|s| s[k]).sum::<f64>() / n;
        let sigma = (scenes.iter().map(|s| (s[k] - mean).powi(2)).sum::<f64>() / n).sqrt();
        (if sigma > 1e-9 { sigma } else { 1.0 }) / WEIGHTS[k]
    })
}

/// The value that at most the share `miss` of exchangeable values exceeds, with the finite-sample correction of split
/// conformal prediction: the value of rank `ceil((n + 1) (1 - miss))` of n, or infinity where there is none.
pub(super) fn conformal_quantile(values: &[f64], miss: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_unstable_by(f64::total_cmp);
    let rank = ((sorted.len() as f64 + 1.0) * (1.0 - miss) - 1e-9).ceil() as usize;
    if rank == 0 { f64::NEG_INFINITY } else { sorted.get(rank - 1).copied().unwrap_or(f64::INFINITY) }
}

/// Median of values; 0 for none.
pub(super) fn median(mut values: Vec<f64>) -> f64 {
    values.sort_unstable_by(f64::total_cmp);
    let n = values.len();
    match n {
        0 => 0.0,
        n if n % 2 == 1 => values[n / 2],
        n => (values[n / 2 - 1] + values[n / 2]) / 2.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_finite_sample_correction_is_exact() {
        let values: Vec<f64> = (1..=9).map(f64::from).collect();
        // Rank ceil(10 * 0.9) = 9: a tenth value is above the largest of nine in one of ten orders.
        assert_eq!(conformal_quantile(&values, 0.1), 9.0);
        assert_eq!(conformal_quantile(&values[..8], 0.1), f64::INFINITY);
        assert_eq!(conformal_quantile(&values, 0.5), 5.0);
        // Over all places that a new value can have among nine, it is missed in exactly one of ten.
        let misses = (0..10).filter(|place| {
            let rest: Vec<f64> = (0..10).filter(|i| i != place).map(f64::from).collect();
            f64::from(*place) > conformal_quantile(&rest, 0.1)
        });
        assert_eq!(misses.count(), 1);
    }

    #[test]
    fn nearest_scenes_by_distance_then_by_number() {
        let scenes: Vec<[f64; FRAME]> = [3.0, 1.0, 2.0, 1.0].iter().map(|v| [*v; FRAME]).collect();
        let order = |without| -> Vec<usize> {
            nearest(&scenes, &[1.0; FRAME], &[0.0; FRAME], 3, without).iter().map(|(i, _)| *i).collect()
        };
        assert_eq!(order(None), [1, 3, 2]);
        assert_eq!(order(Some(1)), [3, 2, 0]);
        assert_eq!(units(&scenes[1..2]), WEIGHTS.map(f64::recip));
        assert_eq!((median(vec![3.0, 1.0, 2.0]), median(vec![4.0, 1.0]), median(Vec::new())), (2.0, 2.5, 0.0));
    }
}
