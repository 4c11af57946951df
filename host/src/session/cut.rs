//! Frames that are cut out of a larger picture: pixels outside the cut were not measured.

use ndarray::Array2;
use std::ops::Range;

/// The measured part of a frame: a box of rows and columns.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Cut([Range<usize>; 2]);

impl Cut {
    /// The smallest box outside which every pixel has exactly the same value, if the box covers at most half of
    /// `frame`.
    ///
    /// `None` means that the whole frame was measured: no sensor gives exactly the same code over half of a frame that
    /// shows light.
    pub fn of(frame: &Array2<f32>) -> Option<Self> {
        let (rows, cols) = frame.dim();
        if frame.is_empty() {
            return None;
        }
        // The box may cover one corner; the other three then agree.
        let mut corners = [(0, 0), (0, cols - 1), (rows - 1, 0), (rows - 1, cols - 1)].map(|at| frame[at]);
        corners.sort_by(f32::total_cmp);
        let outside = if corners[0] == corners[1] { corners[1] } else { corners[2] };
        // The search runs from the edges inwards, so a fully measured frame needs few comparisons.
        let row = |r: &usize| frame.row(*r).iter().any(|v| *v != outside);
        let col = |c: &usize| frame.column(*c).iter().any(|v| *v != outside);
        let span = |first: Option<usize>, last: Option<usize>| Some(first?..last? + 1);
        let found = span((0..rows).find(row), (0..rows).rev().find(row))
            .zip(span((0..cols).find(col), (0..cols).rev().find(col)))
            .map(|(r, c)| [r, c]);
        found.filter(|[y, x]| 2 * y.len() * x.len() <= rows * cols).map(Self)
    }

    /// Whether the pixel at (`row`, `col`) was measured.
    pub fn holds(&self, row: usize, col: usize) -> bool {
        self.0[0].contains(&row) && self.0[1].contains(&col)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_spot_on_exact_darkness_was_cut_out_and_a_noisy_frame_was_not() {
        let spot = |r: usize, c: usize| if (3..8).contains(&r) && c < 4 { 1.0 + (r * c) as f32 } else { 7.5 };
        let cut = Cut::of(&Array2::from_shape_fn((20, 30), |(r, c)| spot(r, c)));
        assert_eq!(cut, Some(Cut([3..8, 0..4])));
        assert!(cut.is_some_and(|c| c.holds(7, 3) && !c.holds(7, 4)));
        assert_eq!(Cut::of(&Array2::from_shape_fn((20, 30), |(r, c)| spot(r, c) + ((r + c) % 2) as f32)), None);
        assert_eq!(Cut::of(&Array2::zeros((5, 5))), None);
        // A box that covers a corner.
        let corner =
            Cut::of(&Array2::from_shape_fn((20, 30), |(r, c)| if r < 5 && c < 5 { 9.0 + c as f32 } else { 0.0 }));
        assert_eq!(corner, Some(Cut([0..5, 0..5])));
    }
}
