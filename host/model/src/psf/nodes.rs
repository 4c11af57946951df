//! Local cubic (Lagrange) interpolation along one axis, from values at nodes to any point between them.
//!
//! Coefficient maps are stored on a coarse grid and interpolated row by row, so that the memory of a model does not
//! grow with the object. Four nodes reproduce cubics exactly; the error falls with the fourth power of their spacing.
//!
//! ```
//! use ommatidia_model::psf::nodes::Taps;
//!
//! let nodes = [0.0, 10.0, 20.0, 30.0];
//! let cubes = nodes.map(|x: f64| (x / 10.0).powi(3) as f32);
//! let value = Taps::at(&nodes, 15.0).apply(&cubes);
//! assert!((value - 3.375).abs() < 1e-5); // 1.5^3
//! ```

/// Weights of up to four neighbouring nodes for one point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Taps {
    /// Index of the first node.
    pub first: usize,
    /// Number of nodes used, 1 to 4.
    pub count: usize,
    /// Weight of each node used; their sum is 1.
    pub weights: [f32; 4],
}

impl Taps {
    /// The weight of a node, 0 where it is not used.
    pub fn weight_of(&self, node: usize) -> f32 {
        node.checked_sub(self.first).filter(|i| *i < self.count).map_or(0.0, |i| self.weights[i])
    }

    /// Weights that interpolate values at `nodes` (ascending, not empty) at `x`. Outside the nodes the value of the
    /// last node holds.
    pub fn at(nodes: &[f64], x: f64) -> Self {
        let count = nodes.len().clamp(1, 4);
        let Some((&low, &high)) = nodes.first().zip(nodes.last()) else {
            return Self { first: 0, count: 1, weights: [1.0, 0.0, 0.0, 0.0] };
        };
        let x = x.clamp(low, high);
        let right = nodes.partition_point(|n| *n <= x);
        let first = right.saturating_sub(count / 2).min(nodes.len() - count);
        let near = &nodes[first..first + count];
        let mut weights = [0.0; 4];
        for (i, w) in weights.iter_mut().enumerate().take(count) {
            let others = (0..count).filter(|j| *j != i);
            *w = others.map(|j| (x - near[j]) / (near[i] - near[j])).product::<f64>() as f32;
        }
        Self { first, count, weights }
    }

    /// Weights for each of the `n` pixels 0, 1, .. n-1.
    pub fn for_pixels(nodes: &[f64], n: usize) -> Vec<Self> {
        (0..n).map(|i| Self::at(nodes, i as f64)).collect()
    }

    /// The interpolated value; `values` holds one entry for each node.
    pub fn apply(&self, values: &[f32]) -> f32 {
        let used = &values[self.first..self.first + self.count];
        used.iter().zip(&self.weights).map(|(v, w)| v * w).sum()
    }
}

/// Interpolation weights of a row of pixels, grouped into runs of pixels that lie between the same nodes.
#[derive(Clone, Debug)]
pub struct TapRow {
    /// First node of each run, and the pixel where it ends.
    runs: Vec<(usize, usize)>,
    /// Number of nodes used.
    count: usize,
    /// Weight of each node used, by pixel.
    weights: [Vec<f32>; 4],
}

impl TapRow {
    /// Weights for each of `n` pixels.
    pub fn for_pixels(nodes: &[f64], n: usize) -> Self {
        let taps = Taps::for_pixels(nodes, n);
        let mut runs: Vec<(usize, usize)> = Vec::new();
        for (i, tap) in taps.iter().enumerate() {
            match runs.last_mut() {
                Some((first, end)) if *first == tap.first => *end = i + 1,
                _ => runs.push((tap.first, i + 1)),
            }
        }
        let weights = [0, 1, 2, 3].map(|k| taps.iter().map(|t| t.weights[k]).collect());
        Self { runs, count: taps.first().map_or(1, |t| t.count), weights }
    }

    /// Interpolates `values` (one for each node) at `pixels`, with the same bits as [`Taps::apply`].
    pub fn apply(&self, pixels: std::ops::Range<usize>, values: &[f32], out: &mut [f32]) {
        let mut from = pixels.start;
        for (first, end) in &self.runs {
            let to = (*end).min(pixels.end);
            if to <= from {
                continue;
            }
            let out = &mut out[from - pixels.start..to - pixels.start];
            for (k, weights) in self.weights.iter().enumerate().take(self.count) {
                let value = values[first + k];
                let terms = out.iter_mut().zip(&weights[from..to]);
                match k {
                    0 => terms.for_each(|(o, w)| *o = value * w),
                    _ => terms.for_each(|(o, w)| *o += value * w),
                }
            }
            from = to;
        }
    }
}

/// `n` nodes spaced evenly over `size` pixels, both ends included; a single node lies in the middle.
pub fn even_nodes(pixels: usize, n: usize) -> Vec<f64> {
    let last = pixels.saturating_sub(1) as f64;
    if n < 2 {
        return vec![last / 2.0];
    }
    (0..n).map(|i| last * i as f64 / (n - 1) as f64).collect()
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn cubics_come_back_exactly_on_uneven_nodes() {
        let nodes = [-3.0, -1.5, 0.0, 1.0, 4.0, 6.0];
        let f = |x: f64| 1.0 + x - 0.5 * x * x + 0.1 * x * x * x;
        let values: Vec<f32> = nodes.iter().map(|x| f(*x) as f32).collect();
        for i in 0..=90 {
            let x = -3.0 + i as f64 / 10.0;
            assert!((f64::from(Taps::at(&nodes, x).apply(&values)) - f(x)).abs() < 1e-5);
        }
    }

    #[test]
    fn a_row_at_once_has_the_bits_of_its_pixels() {
        for nodes in [vec![4.0], vec![0.0, 7.5, 20.0], even_nodes(30, 7)] {
            let values: Vec<f32> = (0..nodes.len()).map(|i| (i as f32 * 1.7).sin()).collect();
            let (row, taps) = (TapRow::for_pixels(&nodes, 30), Taps::for_pixels(&nodes, 30));
            for pixels in [0..30, 5..6, 3..29] {
                let mut out = vec![9.0; pixels.len()];
                row.apply(pixels.clone(), &values, &mut out);
                let want: Vec<f32> = pixels.map(|i| taps[i].apply(&values)).collect();
                assert_eq!(out, want);
            }
        }
    }

    #[test]
    fn few_nodes_and_points_outside_are_held() {
        assert_eq!(Taps::at(&[5.0], 9.0).apply(&[2.5]), 2.5);
        assert_eq!(Taps::at(&[0.0, 2.0], 1.0).apply(&[1.0, 3.0]), 2.0);
        assert_eq!(Taps::at(&[0.0, 1.0, 2.0, 3.0, 4.0], 99.0).apply(&[1.0, 0.0, 0.0, 0.0, 7.0]), 7.0);
        assert_eq!(even_nodes(96, 3), vec![0.0, 47.5, 95.0]);
        assert_eq!(even_nodes(96, 1), vec![47.5]);
    }
}
