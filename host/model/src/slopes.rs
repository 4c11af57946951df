//! A plane over a frame: a level and two slopes. Backgrounds are described by it.

/// A constant and two slopes: `level + row * u + col * v` with u and v from -0.5 at the first to 0.5 at the last row
/// and column.
pub type Slopes = [f64; 3];

/// The factors of level and slopes at a pixel [row, col] of a frame of `dim` (rows, columns).
pub fn slope_terms(dim: (usize, usize), [r, c]: [usize; 2]) -> Slopes {
    let along = |i: usize, n: usize| if n > 1 { i as f64 / (n as f64 - 1.0) - 0.5 } else { 0.0 };
    [1.0, along(r, dim.0), along(c, dim.1)]
}

/// The value of a plane at a pixel.
pub fn slope_value(plane: &Slopes, dim: (usize, usize), at: [usize; 2]) -> f64 {
    slope_terms(dim, at).iter().zip(plane).map(|(x, v)| x * v).sum()
}
