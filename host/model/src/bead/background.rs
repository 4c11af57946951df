//! The background of bead frames: light, or a shift of the black level, that has nothing to do with the bead.
//!
//! Each frame is fitted with a constant and slopes along rows and columns, from the pixels far from all foci (farther
//! than the largest window reaches). The frames of one stack and dose share one background, about which single frames
//! scatter; a frame gets the mean plus the part of its own deviation that the noise does not explain (empirical Bayes,
//! Efron & Morris, J. Am. Stat. Assoc. 70, 311, 1975). Where frames do not differ, all get the mean, whose noise is
//! that of millions of pixels: its removal adds nothing that could be seen, so it is removed in any case.

use super::rays::displacement;
use super::{BeadError, BeadScan};
use crate::psf::ChiefRays;
use crate::slopes::{Slopes, slope_terms};
use ndarray::{Array2, ArrayView2};
use ommatidia_physics::linalg::least_squares;
use ommatidia_session::Manifest;
use serde::{Deserialize, Serialize};

/// Fewest pixels far from the foci that determine a background.
const FEWEST_PX: usize = 256;
/// Most pixels of a frame that are fitted; of more an even sample is used.
const MOST_PX: usize = 1 << 17;
/// Smallest standard deviation of the pixels' rows or columns, as a share of the frame, from which slopes are fitted.
const SPREAD: f64 = 0.1;
/// Pixels farther than this from the fit, in standard deviations of the noise, do not count: dust, hot pixels, cosmic
/// rays. So far out the skewness of photon noise has no influence.
const OUTLIER: f64 = 5.0;
/// Rounds of fit and rejection of outliers.
const ROUNDS: usize = 4;
/// Significance, in standard errors, at which light that falls off with the distance from the foci counts as their
/// tails.
const TAIL: f64 = 4.0;
/// Smallest number of pixels of the farthest half, where tails reach the others.
const FEWEST_FAR_PX: usize = 2 * FEWEST_PX;

/// The background of a bead scan, as it was found and removed. Electrons a pixel, at the exposure of the frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BeadBackground {
    /// Mean over the frames: level, change from the first to the last row, change from the first to the last column,
    /// e-.
    pub mean_e: Slopes,
    /// Standard errors of the means by the noise of the frames and of the darks, e-.
    pub sigma_e: Slopes,
    /// Standard deviation of single frames about the mean beyond the noise, e-.
    pub scatter_e: Slopes,
    /// Pixels of a frame that it was fitted to, mean over the frames.
    pub pixels: f64,
    /// How much brighter the pixels nearest to the windows are than the farthest ones, e-: tails of foci, which are no
    /// background. 0 where they are not significant.
    pub tail_e: f64,
}

impl BeadBackground {
    /// Significance of level and slopes together, in standard deviations: the root of chi-squared over its three
    /// degrees of freedom.
    pub fn significance(&self) -> f64 {
        let terms = self.mean_e.iter().zip(&self.sigma_e).filter(|(_, s)| **s > 0.0);
        let (chi2, n) = terms.fold((0.0, 0.0), |(sum, n), (m, s)| (sum + (m / s).powi(2), n + 1.0));
        if n > 0.0 { f64::sqrt(chi2 / n) } else { 0.0 }
    }

    /// Whether there is a background: level and slopes cannot be the noise's.
    pub fn is_seen(&self) -> bool {
        self.significance() > SEEN || self.scatter_e.iter().zip(&self.sigma_e).any(|(t, s)| *t > SEEN * s)
    }

    /// The same background in electrons that are `factor` times as many, as another gain makes them.
    pub(crate) fn scaled(self, factor: f64) -> Self {
        let each = |slopes: Slopes| slopes.map(|v| v * factor);
        Self {
            mean_e: each(self.mean_e),
            sigma_e: each(self.sigma_e),
            scatter_e: each(self.scatter_e),
            pixels: self.pixels,
            tail_e: self.tail_e * factor,
        }
    }
}

/// Significance from which a background is called one. It is removed in any case; see the head of this file.
const SEEN: f64 = 5.0;

/// The fit of one frame, DN.
#[derive(Clone, Copy, Debug)]
struct FrameFit {
    value: Slopes,
    sigma: Slopes,
    pixels: f64,
    /// Mean of the residuals of the nearer half of the pixels minus that of the farther half, and its variance.
    tail: [f64; 2],
}

/// Estimates the background of each frame of a scan and removes it from what the scan gives from now on. Reads each
/// frame once, or twice where the foci have long tails, and calls `step` after the first reading of each. `offset_dn`
/// is the standard error of a pixel's offset, DN. None where too few pixels lie far from all foci: nothing is removed.
///
/// # Errors
/// A frame cannot be read.
pub fn remove_background(
    scan: &mut BeadScan,
    manifest: &Manifest,
    rays: &ChiefRays,
    offset_dn: f64,
    step: &mut dyn FnMut(),
) -> Result<Option<(BeadBackground, Vec<Slopes>)>, BeadError> {
    let reach = super::extent::reach(manifest) as f64;
    let mut fits = read(scan, manifest, rays, [reach, 0.0], step)?;
    let known: Vec<&FrameFit> = fits.iter().flatten().collect();
    if known.is_empty() {
        return Ok(None);
    }
    let n = known.len() as f64;
    let tail = known.iter().map(|f| f.tail[0]).sum::<f64>() / n;
    let pixels = known.iter().map(|f| f.pixels).sum::<f64>() / n;
    let error = (known.iter().map(|f| f.tail[1]).sum::<f64>() / (n * n) + 4.0 * offset_dn * offset_dn / pixels).sqrt();
    let tails = tail > TAIL * error;
    if tails && pixels as usize > FEWEST_FAR_PX {
        fits = read(scan, manifest, rays, [reach, 0.5], &mut || ())?;
    }
    let gain = scan.noise().gain_dn_per_e;
    let (mut summary, planes) = shared(scan, &fits, offset_dn);
    summary.tail_e = if tails { tail / gain } else { 0.0 };
    for v in summary.mean_e.iter_mut().chain(&mut summary.sigma_e).chain(&mut summary.scatter_e) {
        *v /= gain;
    }
    let planes_e = planes.iter().map(|p| p.map(|v| v / gain)).collect();
    scan.set_background(planes);
    Ok(Some((summary, planes_e)))
}

/// Fits every frame; None for a frame with too few pixels far from all foci.
fn read(
    scan: &mut BeadScan,
    manifest: &Manifest,
    rays: &ChiefRays,
    [reach, nearest_share]: [f64; 2],
    step: &mut dyn FnMut(),
) -> Result<Vec<Option<FrameFit>>, BeadError> {
    let mut fits = Vec::with_capacity(scan.beads.len());
    for n in 0..scan.beads.len() {
        let (frame, cut) = scan.cut_light_dn(n)?;
        let moved = displacement(manifest, scan.beads[n].at_px);
        let slope = rays.magnification / manifest.optics.magnification;
        let foci: Vec<[f64; 2]> =
            rays.anchors_px.iter().map(|a| [a[0] + slope * moved[0], a[1] + slope * moved[1]]).collect();
        let usable = |at: [usize; 2]| scan.useful(at) && cut.as_ref().is_none_or(|c| c.holds(at[0], at[1]));
        let mut far = far_pixels(frame.view(), &foci, reach, usable);
        far.drain(..(far.len() as f64 * nearest_share) as usize);
        let noise = scan.noise();
        fits.push(fit(frame.view(), &far, |dn| noise.variance_dn2(noise.black_level_dn + dn)));
        step();
    }
    Ok(fits)
}

/// Pixels [row, col] farther than `reach` (Chebyshev distance) from all foci, the nearest first.
fn far_pixels(
    frame: ArrayView2<'_, f32>,
    foci: &[[f64; 2]],
    reach: f64,
    usable: impl Fn([usize; 2]) -> bool,
) -> Vec<[usize; 2]> {
    let every = frame.len().div_ceil(MOST_PX);
    let mut far: Vec<(f64, [usize; 2])> = Vec::new();
    for ((r, c), v) in frame.indexed_iter() {
        // A Weyl sequence is even and favours neither odd nor even rows and columns.
        let taken = every <= 1 || ((r * frame.ncols() + c) as f64 * 0.618_033_988_75).fract() * (every as f64) < 1.0;
        if !taken || !v.is_finite() || !usable([r, c]) {
            continue;
        }
        let distance = |f: &[f64; 2]| (r as f64 - f[0]).abs().max((c as f64 - f[1]).abs());
        let nearest = foci.iter().map(distance).fold(f64::INFINITY, f64::min);
        if nearest > reach {
            far.push((nearest, [r, c]));
        }
    }
    far.sort_by(|a, b| a.0.total_cmp(&b.0));
    far.into_iter().map(|(_, at)| at).collect()
}

/// Fits level and slopes to the pixels `far`, nearest first; slopes only where the pixels are spread over the frame.
fn fit(frame: ArrayView2<'_, f32>, far: &[[usize; 2]], variance: impl Fn(f64) -> f64) -> Option<FrameFit> {
    if far.len() < FEWEST_PX {
        return None;
    }
    let place = |at: &[usize; 2]| slope_terms(frame.dim(), *at);
    let n = far.len() as f64;
    let wide = |a: usize| {
        let mean = far.iter().map(|p| place(p)[a]).sum::<f64>() / n;
        far.iter().map(|p| (place(p)[a] - mean).powi(2)).sum::<f64>() / n > SPREAD * SPREAD
    };
    let used: Vec<usize> = if wide(1) && wide(2) { vec![0, 1, 2] } else { vec![0] };
    let mut sorted: Vec<f32> = far.iter().map(|p| frame[*p]).collect();
    let middle = sorted.len() / 2;
    let mut value = [f64::from(*sorted.select_nth_unstable_by(middle, f32::total_cmp).1), 0.0, 0.0];
    let at = |value: &Slopes, p: &[usize; 2]| place(p).iter().zip(value).map(|(x, v)| x * v).sum::<f64>();
    let mut sigma = [0.0; 3];
    for _ in 0..ROUNDS {
        let mut gram = Array2::<f64>::zeros((used.len(), used.len()));
        let mut right = Array2::<f64>::zeros((used.len(), 1));
        for p in far {
            let (model, y) = (at(&value, p), f64::from(frame[*p]));
            if (y - model).powi(2) > OUTLIER * OUTLIER * variance(model.max(0.0)) {
                continue;
            }
            let x = place(p);
            for (i, a) in used.iter().enumerate() {
                right[[i, 0]] += x[*a] * y;
                used.iter().enumerate().for_each(|(j, b)| gram[[i, j]] += x[*a] * x[*b]);
            }
        }
        if gram[[0, 0]] < FEWEST_PX as f64 {
            // The noise model and the frame disagree (for instance without darks): the median stays.
            break;
        }
        let Ok(found) = least_squares(&gram, &right) else { break };
        let inverse = least_squares(&gram, &Array2::eye(used.len())).ok()?;
        for (i, a) in used.iter().enumerate() {
            value[*a] = found[[i, 0]];
            sigma[*a] = (inverse[[i, i]] * variance(value[0].max(0.0))).sqrt();
        }
    }
    if sigma[0] == 0.0 {
        sigma[0] = (variance(value[0].max(0.0)) / n).sqrt();
    }
    let half = |part: &[[usize; 2]]| {
        let dn2 = variance(value[0].max(0.0));
        let off = part.iter().map(|p| f64::from(frame[*p]) - at(&value, p));
        let (sum, count) =
            off.filter(|d| d * d < OUTLIER * OUTLIER * dn2).fold((0.0, 0.0), |(s, n), d| (s + d, n + 1.0));
        (sum / f64::max(count, 1.0), dn2 / f64::max(count, 1.0))
    };
    let ((near, near_dn2), (beyond, beyond_dn2)) = (half(&far[..far.len() / 2]), half(&far[far.len() / 2..]));
    Some(FrameFit { value, sigma, pixels: n, tail: [near - beyond, near_dn2 + beyond_dn2] })
}

/// The background of each frame, DN: the mean of its group (stack and dose) plus its own deviation as far as the
/// frames differ by more than the noise. The summary is in DN as well.
fn shared(scan: &BeadScan, fits: &[Option<FrameFit>], offset_dn: f64) -> (BeadBackground, Vec<Slopes>) {
    let key = |n: usize| (scan.beads[n].stack, scan.beads[n].to_reference.to_bits());
    let mut groups: std::collections::BTreeMap<_, Vec<usize>> = std::collections::BTreeMap::new();
    (0..fits.len()).for_each(|n| groups.entry(key(n)).or_default().push(n));
    let all: Vec<&FrameFit> = fits.iter().flatten().collect();
    let count = all.len() as f64;
    let mean_of = |from: &[&FrameFit], a: usize| from.iter().map(|f| f.value[a]).sum::<f64>() / from.len() as f64;
    let mut summary =
        BeadBackground { pixels: all.iter().map(|f| f.pixels).sum::<f64>() / count, ..Default::default() };
    for a in 0..3 {
        summary.mean_e[a] = mean_of(&all, a);
        let noise2 = all.iter().map(|f| f.sigma[a].powi(2)).sum::<f64>() / count;
        // The same pixels in all frames: their offsets have the same error in each.
        let (_, single) = (noise2, all.iter().map(|f| f.sigma[a]).sum::<f64>() / count);
        let variance = scan.noise().variance_dn2(scan.noise().black_level_dn);
        let offsets2 = single * single * offset_dn * offset_dn / variance;
        summary.sigma_e[a] = (noise2 / count + offsets2).sqrt();
    }
    let mut planes = vec![[0.0; 3]; fits.len()];
    let mut scatter2 = [0.0; 3];
    for members in groups.values() {
        let known: Vec<&FrameFit> = members.iter().filter_map(|n| fits[*n].as_ref()).collect();
        if known.is_empty() {
            members.iter().for_each(|n| planes[*n] = summary.mean_e);
            continue;
        }
        for a in 0..3 {
            let mean = mean_of(&known, a);
            let spread = known.iter().map(|f| (f.value[a] - mean).powi(2)).sum::<f64>();
            let noise2 = known.iter().map(|f| f.sigma[a].powi(2)).sum::<f64>() / known.len() as f64;
            let between = (spread / (known.len() as f64 - 1.0).max(1.0) - noise2).max(0.0);
            scatter2[a] += between * known.len() as f64 / count;
            for n in members {
                let own = fits[*n].as_ref().map_or(0.0, |f| {
                    let kept = between / (between + f.sigma[a].powi(2)).max(f64::MIN_POSITIVE);
                    kept * (f.value[a] - mean)
                });
                planes[*n][a] = mean + own;
            }
        }
    }
    summary.scatter_e = scatter2.map(f64::sqrt);
    (summary, planes)
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use ommatidia_session::rng;
    use rand_distr::{Distribution, Normal, Poisson};

    /// A frame of `rows` x 60 with a plane in electrons, read noise of 2 e- and a gain of 1, and some hot pixels.
    fn frame([level, row, col]: Slopes, seed: u64) -> Array2<f32> {
        let mut rng = rng::stream(seed, "background", 0);
        Array2::from_shape_fn((50, 60), |at| {
            let x = slope_terms((50, 60), [at.0, at.1]);
            let e: f64 = level + row * x[1] + col * x[2];
            let photons = if e > 0.0 { Poisson::new(e).unwrap().sample(&mut rng) } else { 0.0 };
            let read: f64 = Normal::new(0.0, 2.0).unwrap().sample(&mut rng);
            let hot = if (at.0 * 60 + at.1) % 301 == 7 { 300.0 } else { 0.0 };
            (photons + read + hot) as f32
        })
    }

    #[test]
    fn level_and_slopes_are_unbiased_and_their_errors_are_right() {
        let far = far_pixels(frame([0.0; 3], 0).view(), &[[25.0, 30.0]], 12.0, |_| true);
        for truth in [[0.0, 0.0, 0.0], [2.0, 0.5, -1.0], [20.0, 8.0, 12.0]] {
            let (mut pull, mut square) = ([0.0; 3], [0.0; 3]);
            let count = 100;
            for seed in 0..count {
                let f = fit(frame(truth, seed).view(), &far, |dn| 4.0 + dn).unwrap();
                for a in 0..3 {
                    let p = (f.value[a] - truth[a]) / f.sigma[a];
                    pull[a] += p / count as f64;
                    square[a] += p * p / count as f64;
                }
            }
            // Means of 100 pulls scatter by 0.1, mean squares by 0.14.
            assert!(pull.iter().all(|p| p.abs() < 0.4), "{truth:?}: {pull:?}");
            assert!(square.iter().all(|s| (0.5..1.6).contains(s)), "{truth:?}: {square:?}");
        }
    }

    #[test]
    fn windows_are_left_out_and_a_frame_full_of_them_has_no_background() {
        let frame = frame([0.0; 3], 1);
        let far = far_pixels(frame.view(), &[[10.0, 10.0], [40.0, 50.0]], 8.0, |_| true);
        let off = |p: &[usize; 2], f: [f64; 2]| (p[0] as f64 - f[0]).abs().max((p[1] as f64 - f[1]).abs());
        assert!(far.iter().all(|p| off(p, [10.0, 10.0]) > 8.0 && off(p, [40.0, 50.0]) > 8.0));
        assert_eq!(far.len(), 50 * 60 - 2 * 17 * 17);
        assert!(fit(frame.view(), &far_pixels(frame.view(), &[[25.0, 30.0]], 28.0, |_| true), |_| 4.0).is_none());
    }
}
