//! Planes of (row, col) with a stride.

use core::ops::{Deref, DerefMut};

use super::error::ShapeError;

/// A plane over a borrowed buffer `D`: element (r, c) lies at `r * stride + c`.
#[derive(Clone, Copy, Debug)]
pub struct Strided<D> {
    data: D,
    rows: usize,
    cols: usize,
    stride: usize,
}

/// A plane that can be read.
pub type Plane<'a, T> = Strided<&'a [T]>;

/// A plane that can be read and written.
pub type PlaneMut<'a, T> = Strided<&'a mut [T]>;

/// Elements from the first to the last of a plane, or an impossible number where `stride < cols` or the product
/// overflows.
fn span(rows: usize, cols: usize, stride: usize) -> usize {
    if rows == 0 || cols == 0 {
        return 0;
    }
    let last_row = (rows - 1).checked_mul(stride).and_then(|start| start.checked_add(cols));
    if stride < cols { usize::MAX } else { last_row.unwrap_or(usize::MAX) }
}

impl<T, D: Deref<Target = [T]>> Strided<D> {
    /// A plane without gaps between its rows.
    ///
    /// # Errors
    /// [`ShapeError`] where `data` has less than `rows * cols` elements.
    pub fn new(data: D, rows: usize, cols: usize) -> Result<Self, ShapeError> {
        Self::with_stride(data, rows, cols, cols)
    }

    /// A plane whose rows begin `stride >= cols` elements apart.
    ///
    /// # Errors
    /// [`ShapeError`] where `data` is too short or `stride < cols`.
    pub fn with_stride(data: D, rows: usize, cols: usize, stride: usize) -> Result<Self, ShapeError> {
        let (expected, found) = (span(rows, cols, stride), data.len());
        if expected > found { Err(ShapeError { expected, found }) } else { Ok(Self { data, rows, cols, stride }) }
    }

    /// Number of rows.
    #[inline(always)]
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Number of columns.
    #[inline(always)]
    pub fn cols(&self) -> usize {
        self.cols
    }

    /// Row `r`, `cols` elements. Panics where `r >= rows`.
    #[inline(always)]
    pub fn row(&self, r: usize) -> &[T] {
        assert!(r < self.rows, "row {r} of {}", self.rows);
        &self.data[r * self.stride..][..self.cols]
    }

    /// Row `r` for writing, `cols` elements. Panics where `r >= rows`.
    #[inline(always)]
    pub fn row_mut(&mut self, r: usize) -> &mut [T]
    where
        D: DerefMut,
    {
        assert!(r < self.rows, "row {r} of {}", self.rows);
        &mut self.data[r * self.stride..][..self.cols]
    }

    /// The same plane for reading.
    pub fn as_plane(&self) -> Plane<'_, T> {
        Strided { data: &self.data, rows: self.rows, cols: self.cols, stride: self.stride }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_begin_a_stride_apart() {
        let data = [0, 1, 2, 9, 4, 5, 6];
        let plane = Plane::with_stride(&data, 2, 3, 4).unwrap();
        assert_eq!(plane.row(0), [0, 1, 2]);
        assert_eq!(plane.row(1), [4, 5, 6]);
        let mut data = data;
        let mut plane = PlaneMut::with_stride(&mut data, 2, 3, 4).unwrap();
        plane.row_mut(1).fill(8);
        assert_eq!(data, [0, 1, 2, 9, 8, 8, 8]);
    }

    #[test]
    fn shapes_that_do_not_fit_are_refused() {
        let data = [0_u8; 6];
        assert_eq!(Plane::new(&data, 2, 4).unwrap_err(), ShapeError { expected: 8, found: 6 });
        assert!(Plane::with_stride(&data, 2, 3, 2).is_err(), "rows would overlap");
        assert!(Plane::new(&data, usize::MAX, 2).is_err(), "the size overflows");
        assert!(Plane::new(&data, 0, 100).is_ok());
    }
}
