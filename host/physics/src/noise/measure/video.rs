//! Gain without flats: photon transfer on a video of a specimen that hardly changes from one frame to the next.
//!
//! Half the squared difference of two frames is the variance of one frame at its mean, whatever the specimen and the
//! fixed pattern: `var = c + g m`, with the light above black m and the gain g. Motion adds variance, mostly where the
//! specimen is bright. The brightest fifth of the pixels is therefore left out, and the dependence of the gain on that
//! share counts as an error. Each run of frames gives one gain; the result is their median, so that torn frames spoil
//! single runs only.

use super::transfer::{ROUNDING_DN2, Transfer};
use ndarray::Array2;
use ommatidia_session::{Role, Session, SessionError};

/// Number of runs into which a video is divided.
const RUNS: usize = 9;
/// Smallest number of frame pairs in a run.
const FEWEST_PAIRS: usize = 2;
/// Largest number of frame pairs in a run.
const MOST_PAIRS: usize = 12;
/// Largest number of pixels of a frame that are used.
const PIXELS: usize = 65_536;
/// Number of light levels; each has the same number of pixels.
const LEVELS: usize = 24;
/// Differences beyond this many robust standard deviations count as changes of the specimen.
const CHANGE: f64 = 5.0;
/// Shares of the pixels, darkest first, that are fitted: the middle one for the gain, the others for its error.
const SHARES: [f64; 3] = [0.6, 0.8, 0.95];
/// The gain must exceed zero by this many standard errors.
const SURE: f64 = 5.0;

/// Photon transfer on the longest video of a session; `None` if no video determines the gain.
///
/// # Errors
/// A frame cannot be read.
pub(super) fn transfer(session: &Session, black_dn: f64, saturation_dn: f64) -> Result<Option<Transfer>, SessionError> {
    let unknown = session.stacks_of(Role::Scene).filter(|s| s.entry().truth.is_none());
    let Some(stack) = unknown.max_by_key(|s| s.len()).filter(|s| s.len() >= 2 * RUNS * FEWEST_PAIRS) else {
        return Ok(None);
    };
    let mut frames = stack.frames()?;
    let per_run = stack.len() / 2 / RUNS;
    let mut fits = Vec::new();
    for run in 0..RUNS {
        let mut points = Vec::new();
        for pair in (0..per_run).step_by(per_run.div_ceil(MOST_PAIRS)) {
            let first = 2 * (run * per_run + pair);
            if stack.info()[first..first + 2].iter().any(|info| info.is_damaged()) {
                continue;
            }
            let (a, b) = (frames.read(first)?, frames.read(first + 1)?);
            points.extend(pairs(&a, &b, black_dn, saturation_dn));
        }
        fits.extend(fit(points));
    }
    Ok(summary(&fits))
}

/// Mean light and difference of each pixel of two frames, DN; the second frame is scaled to the total light of the
/// first.
fn pairs(a: &Array2<f32>, b: &Array2<f32>, black_dn: f64, saturation_dn: f64) -> Vec<[f64; 2]> {
    let light = |image: &Array2<f32>| image.iter().map(|v| f64::from(*v) - black_dn).sum::<f64>();
    let scale = light(a) / light(b);
    // The frame is torn, or shows another specimen.
    if !(0.8..1.25).contains(&scale) {
        return Vec::new();
    }
    let each = a.iter().zip(b).step_by(a.len().div_ceil(PIXELS).max(1));
    each.filter(|(a, b)| f64::from(a.max(**b)) < saturation_dn)
        .map(|(a, b)| {
            let (a, b) = (f64::from(*a) - black_dn, scale * (f64::from(*b) - black_dn));
            [(a + b) / 2.0, a - b]
        })
        .collect()
}

/// Fits one run: intercept and slope of the variance over the light, for the darkest pixels up to each of [`SHARES`].
fn fit(mut points: Vec<[f64; 2]>) -> Option<[[f64; 2]; 3]> {
    points.sort_by(|a, b| a[0].total_cmp(&b[0]));
    let lines = SHARES.map(|share| line(&points[..(share * points.len() as f64) as usize]));
    Some([lines[0]?, lines[1]?, lines[2]?])
}

fn line(points: &[[f64; 2]]) -> Option<[f64; 2]> {
    let size = points.len() / LEVELS;
    if size < 200 {
        return None;
    }
    let mut s = [0.0; 5];
    for level in points.chunks_exact(size).take(LEVELS) {
        let mean = level.iter().map(|p| p[0]).sum::<f64>() / size as f64;
        let mean_square = |limit: f64| {
            let squares = level.iter().map(|p| p[1] * p[1]).filter(|d| *d <= limit);
            let (sum, n) = squares.fold((0.0, 0.0), |(s, n), d| (s + d, n + 1.0));
            sum / f64::max(n, 1.0)
        };
        let mut variance = mean_square(f64::INFINITY);
        for _ in 0..4 {
            variance = mean_square(CHANGE * CHANGE * variance);
        }
        // The error of a variance is proportional to the variance.
        let w = variance.max(f64::MIN_POSITIVE).powi(-2);
        let y = variance / 2.0;
        for (sum, v) in s.iter_mut().zip([w, w * mean, w * mean * mean, w * y, w * mean * y]) {
            *sum += v;
        }
    }
    let determinant = s[0] * s[2] - s[1] * s[1];
    let slope = (s[0] * s[4] - s[1] * s[3]) / determinant;
    slope.is_finite().then_some([(s[3] - slope * s[1]) / s[0], slope])
}

/// The median of the runs, if it is significant. The dependence of the gain on the share of the pixels counts as an
/// error.
fn summary(fits: &[[[f64; 2]; 3]]) -> Option<Transfer> {
    if fits.len() < RUNS / 2 + 1 {
        return None;
    }
    let median = |mut v: Vec<f64>| {
        v.sort_by(f64::total_cmp);
        (v[(v.len() - 1) / 2] + v[v.len() / 2]) / 2.0
    };
    let of = |share: usize, k: usize| -> (f64, f64) {
        let values: Vec<f64> = fits.iter().map(|f| f[share][k]).collect();
        let middle = median(values.clone());
        let scatter = 1.4826 * median(values.iter().map(|v| (v - middle).abs()).collect());
        // The squared error of a median is pi / 2 times that of a mean.
        (middle, 1.2533 * scatter / (values.len() as f64).sqrt())
    };
    let [(intercept, off), (slope, scatter)] = [of(1, 0), of(1, 1)];
    let [low, high] = [of(0, 1).0, of(2, 1).0];
    let slope_sigma = scatter.hypot((high - low) / 2.0);
    let intercept = intercept - ROUNDING_DN2;
    (slope > SURE * slope_sigma).then_some(Transfer { slope, slope_sigma, intercept, intercept_sigma: off, bend: None })
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::noise::draw::draw_electrons;
    use ommatidia_session::rng::stream;

    /// Frames of a specimen of many brightnesses that fades and moves by some per cent, at a gain of 1.7.
    fn video(moves: f64) -> Vec<Array2<f32>> {
        let light = |r: usize, c: usize| 15.0 + 400.0 * (((r * 7 + c * 3) % 101) as f64 / 100.0).powi(3);
        (0..72)
            .map(|k| {
                let mut rng = stream(3, "video", k);
                let fade = 1.0 - 0.002 * k as f64;
                let wave = |r: usize, c: usize| 1.0 + moves * ((r * 31 + c * 17 + k as usize * 5) as f64).sin();
                let mut frame = Array2::from_shape_fn((100, 120), |(r, c)| (light(r, c) * fade * wave(r, c)) as f32);
                draw_electrons(frame.as_slice_mut().unwrap(), 2.0, &mut rng);
                frame.mapv(|e| (100.0 + 1.7 * e).round())
            })
            .collect()
    }

    fn gain(moves: f64) -> Option<Transfer> {
        let frames = video(moves);
        let run = |run: usize| {
            fit((0..4)
                .flat_map(|p| pairs(&frames[8 * run + 2 * p], &frames[8 * run + 2 * p + 1], 100.0, 4095.0))
                .collect())
        };
        summary(&(0..RUNS).filter_map(run).collect::<Vec<_>>())
    }

    #[test]
    fn the_gain_is_recovered_from_a_still_and_from_a_moving_specimen() {
        for moves in [0.0, 0.03] {
            let t = gain(moves).unwrap();
            assert!(
                (t.slope - 1.7).abs() < 4.0 * t.slope_sigma + 0.02 && t.slope_sigma < 0.15,
                "{moves} {} {}",
                t.slope,
                t.slope_sigma
            );
        }
    }

    #[test]
    fn frames_of_different_specimens_are_not_a_video() {
        let frames: Vec<Array2<f32>> = (0..4)
            .map(|k| {
                Array2::from_shape_fn(
                    (50, 50),
                    |(r, c)| if (r + 7 * k) % 50 < 10 * (k + 1) && c > 3 { 900.0 } else { 100.0 },
                )
            })
            .collect();
        assert!(pairs(&frames[0], &frames[1], 100.0, 4095.0).is_empty());
    }
}
