//! Share of a Gaussian in each pixel of a line.

/// Integral of a normal density, from a table.
#[derive(Clone, Debug)]
pub(crate) struct Edges {
    cumulative: Vec<f64>,
}

/// Steps of the table for each standard deviation. Linear interpolation errs by at most step^2 max|phi'| / 8 = 2e-7.
const STEPS: f64 = 400.0;
/// Standard deviations beyond which there is no light.
const REACH: f64 = 5.0;

impl Edges {
    /// Tabulates the integral by Simpson's rule, scaled so that it ends at 1.
    pub(crate) fn tabulate() -> Self {
        let density = |t: f64| (-0.5 * t * t).exp();
        let (n, step) = ((2.0 * REACH * STEPS) as usize, 1.0 / STEPS);
        let mut cumulative = vec![0.0];
        let mut sum = 0.0;
        for i in 0..n {
            let t = -REACH + i as f64 * step;
            sum += (density(t) + 4.0 * density(t + 0.5 * step) + density(t + step)) / 6.0;
            cumulative.push(sum);
        }
        cumulative.iter_mut().for_each(|v| *v /= sum);
        Self { cumulative }
    }

    fn below(&self, t: f64) -> f64 {
        let at = ((t + REACH) * STEPS).clamp(0.0, (self.cumulative.len() - 1) as f64);
        let i = (at as usize).min(self.cumulative.len() - 2);
        let f = at - i as f64;
        self.cumulative[i] * (1.0 - f) + self.cumulative[i + 1] * f
    }

    /// Writes the share of a Gaussian at `at` in pixels `0..line.len()` (pixel 0 reaches from -0.5 to 0.5), and returns
    /// the range of pixels that have light. Pixels outside that range are left as they are.
    pub(crate) fn shares(&self, at: f64, sigma: f64, line: &mut [f64]) -> std::ops::Range<usize> {
        let clip = |v: f64| v.clamp(0.0, line.len() as f64) as usize;
        let range = clip((at - REACH * sigma + 0.5).floor())..clip((at + REACH * sigma + 0.5).ceil());
        let mut low = self.below((range.start as f64 - 0.5 - at) / sigma);
        for i in range.clone() {
            let high = self.below((i as f64 + 0.5 - at) / sigma);
            line[i] = high - low;
            low = high;
        }
        range
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_holds_all_light_of_a_gaussian_with_its_mean_and_variance() {
        let edges = Edges::tabulate();
        for (at, sigma) in [(20.0, 0.7), (19.63, 1.3), (20.4, 2.9)] {
            let mut line = [0.0; 41];
            let range = edges.shares(at, sigma, &mut line);
            assert!(range.start > 0 && range.end < 41);
            let sum: f64 = line.iter().sum();
            let mean: f64 = line.iter().enumerate().map(|(i, v)| i as f64 * v).sum();
            let variance: f64 = line.iter().enumerate().map(|(i, v)| (i as f64 - at).powi(2) * v).sum();
            assert!((sum - 1.0).abs() < 1e-12 && (mean - at).abs() < 1e-5, "{sum} {mean}");
            // A pixel adds the variance of an even density of width 1 (Sheppard).
            assert!((variance - sigma * sigma - 1.0 / 12.0).abs() < 2e-3 * sigma * sigma, "{variance}");
        }
    }
}
