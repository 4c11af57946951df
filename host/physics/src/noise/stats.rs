//! Mean and variance of each pixel over the frames of one light level, and their summary over the pixels.

use ndarray::{Array2, Axis, Zip};

/// Per-pixel variances are clipped at this many standard deviations of their sampling distribution above the mean.
const CLIP: f64 = 12.0;

/// Running sums over frames, each [rows, cols]; the frames themselves are not stored.
pub(super) struct PixelStats {
    first: Option<Array2<f32>>,
    sum: Array2<f64>,
    squares: Array2<f64>,
    top: Array2<f32>,
    frame_means: Vec<f64>,
}

/// Black level and fixed pattern of offsets.
pub(super) struct Offsets {
    /// Robust mean over the pixels, DN.
    pub black_dn: f64,
    /// Offset of each pixel from the black level, [rows, cols], DN.
    pub offset_dn: Array2<f32>,
    /// Rms difference between these offsets and the true ones, DN.
    pub error_dn: f64,
}

/// Summary of one light level over the pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Summary {
    /// Mean light above black, DN.
    pub mean: f64,
    /// Temporal variance of a pixel without the flicker of the lamp, DN^2.
    pub variance: f64,
    /// Standard error of the variance, DN^2.
    pub sigma: f64,
}

impl PixelStats {
    pub(super) fn new(shape: [usize; 2]) -> Self {
        Self {
            first: None,
            sum: Array2::zeros(shape),
            squares: Array2::zeros(shape),
            top: Array2::from_elem(shape, f32::NEG_INFINITY),
            frame_means: Vec::new(),
        }
    }

    /// Adds a frame. Sums are of differences from the first frame, so that squares keep their precision.
    pub(super) fn add(&mut self, frame: &Array2<f32>) {
        let first = self.first.get_or_insert_with(|| frame.clone());
        Zip::from(&mut self.sum).and(&mut self.squares).and(&mut self.top).and(frame).and(&*first).for_each(
            |s, q, t, v, f| {
                let d = f64::from(v - f);
                *s += d;
                *q += d * d;
                *t = t.max(*v);
            },
        );
        self.frame_means.push(frame.iter().map(|v| f64::from(*v)).sum::<f64>() / frame.len().max(1) as f64);
    }

    fn frames(&self) -> f64 {
        self.frame_means.len() as f64
    }

    fn means(&self) -> Array2<f64> {
        let n = self.frames();
        match &self.first {
            Some(first) => Zip::from(&self.sum).and(first).map_collect(|s, f| f64::from(*f) + s / n),
            None => self.sum.clone(),
        }
    }

    /// Mean light above black level and offset, [rows, cols], DN; NaN where any frame was saturated.
    pub(super) fn light(&self, black: f64, offset: &Array2<f32>, saturation_dn: f64) -> Array2<f32> {
        let mut light = Zip::from(&self.means()).and(offset).map_collect(|m, o| (m - black) as f32 - o);
        Zip::from(&mut light).and(&self.top).for_each(|l, t| {
            if f64::from(*t) >= saturation_dn {
                *l = f32::NAN;
            }
        });
        light
    }

    /// Temporal variance of each pixel, DN^2, and its degrees of freedom. Needs two frames or more.
    pub(super) fn variances(&self) -> (Array2<f64>, f64) {
        let (n, freedom) = (self.frames(), self.frames() - 1.0);
        (Zip::from(&self.sum).and(&self.squares).map_collect(|s, q| (q - s * s / n) / freedom), freedom)
    }

    /// Mean and temporal variance over the pixels; `None` with fewer than two frames, or if more than 1 % of the pixels
    /// are saturated.
    ///
    /// Saturated pixels are left out, and so are pixels with a variance that the common noise cannot explain (pixels
    /// with telegraph noise, hot pixels).
    pub(super) fn summary(&self, black: f64, offset: Option<&Array2<f32>>, saturation_dn: f64) -> Option<Summary> {
        let n = self.frames();
        if n < 2.0 {
            return None;
        }
        let (variances, freedom) = self.variances();
        let unsaturated = self.top.mapv(|t| f64::from(t) < saturation_dn);
        let usable = unsaturated.iter().filter(|u| **u).count();
        if (usable as f64) < 0.99 * unsaturated.len() as f64 {
            return None;
        }
        let limit = clip_limit(variances.iter().zip(&unsaturated).filter(|(_, u)| **u).map(|(v, _)| *v), freedom);
        let mut means = self.means() - black;
        if let Some(offset) = offset {
            Zip::from(&mut means).and(offset).for_each(|m, o| *m -= f64::from(*o));
        }
        let (mut count, mut mean, mut square, mut variance) = (0.0, 0.0, 0.0, 0.0);
        for ((m, v), u) in means.iter().zip(&variances).zip(&unsaturated) {
            if *u && *v <= limit {
                count += 1.0;
                mean += m;
                square += m * m;
                variance += v;
            }
        }
        let (mean, square, variance) = (mean / count, square / count, variance / count);
        let flicker = (self.frame_variance() - variance / count).max(0.0);
        let shape = if mean.abs() > 1e-9 { square / (mean * mean) } else { 0.0 };
        let white = (variance - flicker * shape).max(0.0);
        Some(Summary { mean, variance: white, sigma: white * (2.0 / (freedom * count)).sqrt() })
    }

    /// Standard error of the mean over all frames and pixels, DN, by the scatter of the frames. Needs two frames or
    /// more.
    pub(super) fn mean_error(&self) -> f64 {
        (self.frame_variance() / self.frames()).sqrt()
    }

    /// Variance of the frame means over time: lamp flicker and a small share of the pixel noise.
    fn frame_variance(&self) -> f64 {
        let n = self.frames();
        let mean = self.frame_means.iter().sum::<f64>() / n;
        self.frame_means.iter().map(|m| (m - mean).powi(2)).sum::<f64>() / (n - 1.0)
    }

    /// Black level and offset of each pixel; `variance` is the temporal variance of a pixel, DN^2.
    ///
    /// The mean of n frames has noise of variance `variance / n`. Offsets are therefore shrunk by the share of noise in
    /// their spread, except those of outliers (hot pixels): those that a row or a column shares, which many pixels
    /// show, and what is left of each pixel, each by the share of noise in its own spread.
    pub(super) fn offsets(&self, variance: Option<f64>) -> Offsets {
        let means = self.means();
        let mut sorted: Vec<f64> = means.iter().copied().collect();
        sorted.sort_by(f64::total_cmp);
        let at = |q: f64| sorted[((sorted.len() - 1) as f64 * q) as usize];
        let (median, spread) = (at(0.5), (at(0.8413) - at(0.1587)) / 2.0);
        let inside = |m: f64| (m - median).abs() <= 6.0 * spread;
        let (sum, count) = sorted.iter().filter(|m| inside(**m)).fold((0.0, 0.0), |(s, c), m| (s + m, c + 1.0));
        let black = sum / f64::max(count, 1.0);
        let noise = variance.map_or(0.0, |v| v / self.frames());
        // NaN: an outlier.
        let mut rest = means.mapv(|m| if inside(m) { m - black } else { f64::NAN });
        let mut shared = Array2::<f64>::zeros(rest.dim());
        let mut error2 = 0.0;
        for axis in [Axis(0), Axis(1)] {
            let mean = rest.map_axis(axis, |line| mean_and_count(line.iter().copied()));
            let noise = mean.mapv(|(_, count)| noise / f64::max(count, 1.0)).mean().unwrap_or(0.0);
            let kept = kept(mean.iter().map(|(m, _)| *m), noise);
            error2 += noise * kept;
            for (i, (mean, _)) in mean.iter().enumerate() {
                let line = Axis(1 - axis.0);
                rest.index_axis_mut(line, i).mapv_inplace(|v| v - mean);
                shared.index_axis_mut(line, i).mapv_inplace(|v| v + kept * mean);
            }
        }
        let kept = kept(rest.iter().copied().filter(|v| !v.is_nan()), noise);
        let offset_dn = Zip::from(&means)
            .and(&rest)
            .and(&shared)
            .map_collect(|m, rest, shared| (if rest.is_nan() { m - black } else { shared + kept * rest }) as f32);
        // The posterior spread of a normal offset: nearly the smaller of the two spreads.
        Offsets { black_dn: black, offset_dn, error_dn: (error2 + noise * kept).max(0.0).sqrt() }
    }
}

/// Mean of values that are numbers, and how many there are; 0 without any.
fn mean_and_count(values: impl Iterator<Item = f64>) -> (f64, f64) {
    let (sum, count) = values.filter(|v| !v.is_nan()).fold((0.0, 0.0), |(s, c), v| (s + v, c + 1.0));
    (sum / f64::max(count, 1.0), count)
}

/// The share of values about zero that is no noise of variance `noise`.
fn kept(values: impl Iterator<Item = f64>, noise: f64) -> f64 {
    let (scatter, _) = mean_and_count(values.map(|v| v * v));
    if scatter > 0.0 { (1.0 - noise / scatter).max(0.0) } else { 0.0 }
}

/// Largest per-pixel variance that the common noise can explain: [`CLIP`] standard deviations of a chi-squared variable
/// of `freedom` degrees of freedom above the mean of the variances below the limit.
fn clip_limit(variances: impl Iterator<Item = f64>, freedom: f64) -> f64 {
    let mut sorted: Vec<f64> = variances.collect();
    sorted.sort_by(f64::total_cmp);
    if sorted.is_empty() {
        return 0.0;
    }
    // Wilson and Hilferty's approximation of the median of chi-squared over its mean.
    let mut mean = sorted[sorted.len() / 2] / (1.0 - 2.0 / (9.0 * freedom)).powi(3);
    let limit = |mean: f64| mean * (1.0 + CLIP * (2.0 / freedom).sqrt());
    for _ in 0..4 {
        let below = &sorted[..sorted.partition_point(|v| *v <= limit(mean)).max(1)];
        mean = below.iter().sum::<f64>() / below.len() as f64;
    }
    limit(mean)
}

#[cfg(test)]
mod tests {
    use super::*;
    use ommatidia_session::rng;
    use rand_distr::{Distribution, StandardNormal};

    /// Few darks of a sensor whose columns differ by less than the noise of a pixel: the columns are known far better
    /// than single pixels, and the error says how well both are.
    #[test]
    fn offsets_of_columns_are_not_shrunk_with_those_of_pixels() {
        let mut rng = rng::stream(7, "offsets", 0);
        let mut normal = || -> f32 { StandardNormal.sample(&mut rng) };
        let columns: Vec<f32> = (0..120).map(|_| 0.3 * normal()).collect();
        let truth = Array2::from_shape_fn((150, 120), |(r, c)| match (r, c) {
            (40, 50) => 60.0,
            _ => columns[c] + 0.1 * normal(),
        });
        let mut stats = PixelStats::new([150, 120]);
        for _ in 0..16 {
            stats.add(&truth.mapv(|o| 100.0 + o + 1.5 * normal()));
        }
        let found = stats.offsets(Some(1.5 * 1.5));
        let means = |map: &Array2<f32>| map.mean_axis(Axis(0)).map(|m| m.mapv(f64::from)).unwrap_or_default();
        let (of_truth, of_found) = (means(&truth), means(&found.offset_dn));
        let (of_truth, of_found) =
            (&of_truth - of_truth.mean().unwrap_or(0.0), &of_found - of_found.mean().unwrap_or(0.0));
        let slope = of_truth.dot(&of_found) / of_truth.dot(&of_truth);
        // A column is known to 1.5 / sqrt(16 * 150) = 0.03 DN. With one share for all it was 0.42 of the truth.
        assert!((slope - 1.0).abs() < 0.03, "{slope}");
        assert!((found.offset_dn[[40, 50]] - 60.0).abs() < 2.0);
        let inside = truth.indexed_iter().filter(|(at, _)| *at != (40, 50));
        let shift = found.black_dn as f32 - 100.0;
        let (square, count) = mean_and_count(inside.map(|(at, t)| f64::from(found.offset_dn[at] + shift - t).powi(2)));
        assert!(count > 17_000.0 && (square.sqrt() / found.error_dn - 1.0).abs() < 0.15, "{square} {}", found.error_dn);
    }
}
