//! Whether two frames of unknown specimens show the same one, so that their difference is noise.

use ndarray::{Array2, Axis};
use ommatidia_physics::effects::blur_within;
use ommatidia_physics::noise::NoiseModel;

/// Standard deviation of the Gaussian blur that removes the motion of an unknown specimen, pixels.
pub(super) const SMOOTH_PX: f64 = 4.0;
/// Most noise that the difference of two repeats shows, standard deviations of the noise model: the median is robust
/// against parts of a specimen that move, and a noise model may be somewhat wrong. Frames of different specimens differ
/// by far more.
const REPEAT_SIGMA: f64 = 2.0;
/// Mean product of the signs at diagonal neighbours that the difference of two repeats shows at most: a tenth of a
/// specimen may move. That of white noise is zero within this many standard deviations.
const LIKE_SIGNS: f64 = 0.05;
const LIKE_SIGMAS: f64 = 3.0;

/// Whether two frames show the same specimen, up to smooth changes and motion of some of its parts: the sharp part of
/// their difference at lit pixels is about as large as noise, and its signs at diagonal neighbours are alike as often
/// as not. The detail of another specimen, blurred by the optics, has like signs at neighbours, however dim it is.
/// Medians and signs hold where parts of a specimen move; the means of rows and columns, and next neighbours, are left
/// out, because noise may be common to them. Frames DN, `inverse_sigma` 1/DN, all [sensor rows, sensor cols].
pub(super) fn shows_the_same(
    a: &Array2<f32>,
    b: &Array2<f32>,
    inverse_sigma: &Array2<f32>,
    noise: &NoiseModel,
) -> bool {
    let mut d = b - a;
    d.zip_mut_with(inverse_sigma, |d, w| *d *= w * std::f32::consts::FRAC_1_SQRT_2);
    let mut sharp = &d - &blur_within(&d, SMOOTH_PX);
    for axis in [Axis(0), Axis(1)] {
        for mut line in sharp.axis_iter_mut(axis) {
            let mean = line.mean().unwrap_or(0.0);
            line -= mean;
        }
    }
    let least = noise.black_level_dn + 3.0 * noise.read_noise_e * noise.gain_dn_per_e;
    let lit = |at: [usize; 2]| inverse_sigma[at] > 0.0 && f64::from(a[at].max(b[at])) > least;
    let [rows, cols] = [sharp.nrows(), sharp.ncols()];
    let (mut off, mut alike, mut pairs) = (Vec::new(), 0.0f64, 0.0f64);
    for (r, c) in (0..rows).flat_map(|r| (0..cols).map(move |c| (r, c))).filter(|(r, c)| lit([*r, *c])) {
        off.push(sharp[[r, c]].abs());
        for next in [Some(c + 1), c.checked_sub(1)].into_iter().flatten() {
            if r + 1 < rows && next < cols && lit([r + 1, next]) {
                alike += f64::from((sharp[[r, c]] * sharp[[r + 1, next]]).signum());
                pairs += 1.0;
            }
        }
    }
    // The median of the absolute value of a normal variable is 0.6745 standard deviations.
    off.sort_by(f32::total_cmp);
    let small = off.get(off.len() / 2).is_none_or(|median| f64::from(*median) < REPEAT_SIGMA * 0.6745);
    small && alike < LIKE_SIGNS * pairs.max(1.0) + LIKE_SIGMAS * pairs.sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use ommatidia_session::rng::stream;
    use rand_distr::{Distribution, StandardNormal};

    /// Frames of blobs of `peak_e` electrons, DN, whose places depend on `specimen`, with nominal noise.
    fn frame(specimen: usize, peak_e: f64, draw: u64, noise: &NoiseModel) -> Array2<f32> {
        let mut random = stream(9, "same/tests", draw);
        Array2::from_shape_fn((64, 64), |(r, c)| {
            let near = |k: usize| {
                let [y, x] = [(k * 23 + specimen * 31) % 64, (k * 37 + specimen * 17) % 64].map(|v| v as f64);
                (-((r as f64 - y).powi(2) + (c as f64 - x).powi(2)) / 8.0).exp()
            };
            let electrons = 60.0 + peak_e * (0..12).map(near).sum::<f64>();
            let z: f64 = StandardNormal.sample(&mut random);
            let dn = noise.black_level_dn + noise.gain_dn_per_e * electrons;
            (dn + noise.variance_dn2(dn).sqrt() * z).round() as f32
        })
    }

    #[test]
    fn frames_of_different_specimens_are_no_repeats() {
        let noise = NoiseModel::nominal();
        // Of dim specimens the difference is hardly larger than the noise.
        for peak_e in [2000.0, 100.0] {
            let a = frame(1, peak_e, 1, &noise);
            let inverse_sigma = a.mapv(|dn| 1.0 / (noise.variance_dn2(f64::from(dn)).sqrt() as f32));
            let same = |b: &Array2<f32>| shows_the_same(&a, b, &inverse_sigma, &noise);
            assert!(same(&frame(1, peak_e, 2, &noise)) && !same(&frame(2, peak_e, 3, &noise)), "{peak_e}");
            // A light that changes smoothly is no other specimen, nor is noise that is common to rows.
            assert!(same(&frame(1, peak_e, 4, &noise).mapv(|dn| dn + 3.0)), "{peak_e}");
            let mut rows = frame(1, peak_e, 5, &noise);
            rows.outer_iter_mut().enumerate().for_each(|(r, mut row)| row += (r * 7 % 11) as f32 - 5.0);
            assert!(same(&rows), "{peak_e}");
        }
    }
}
