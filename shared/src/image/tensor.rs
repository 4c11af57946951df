//! Tensors of (channel, row, col).

use core::ops::Deref;

use super::error::ShapeError;
use super::region::Region;

/// A tensor over a borrowed buffer `D`: element (k, r, c) lies at `(k * rows + r) * cols + c`.
///
/// ```
/// use ommatidia_shared::image::{Chw, ChwMut};
///
/// let mut data = [0; 24];
/// let mut tensor = ChwMut::new(&mut data, 2, 3, 4).unwrap();
/// tensor.row_mut(1, 2)[3] = 7;
/// assert_eq!(data[23], 7);
///
/// let tensor = Chw::new(&data, 2, 3, 4).unwrap();
/// assert_eq!(tensor.shape(), [2, 3, 4]);
/// assert_eq!(tensor.row(1, 2), [0, 0, 0, 7]);
/// assert!(Chw::new(&data, 2, 3, 5).is_err(), "30 elements are not 24");
/// ```
#[derive(Clone, Copy, Debug)]
pub struct Tensor<D> {
    data: D,
    channels: usize,
    rows: usize,
    cols: usize,
}

/// A tensor that can be read.
pub type Chw<'a, T> = Tensor<&'a [T]>;

/// A tensor that can be read and written.
pub type ChwMut<'a, T> = Tensor<&'a mut [T]>;

impl<T, D: Deref<Target = [T]>> Tensor<D> {
    /// A tensor over the whole of `data`.
    ///
    /// # Errors
    /// [`ShapeError`] where `data` does not have `channels * rows * cols` elements.
    pub fn new(data: D, channels: usize, rows: usize, cols: usize) -> Result<Self, ShapeError> {
        let expected = channels.checked_mul(rows).and_then(|n| n.checked_mul(cols)).unwrap_or(usize::MAX);
        let found = data.len();
        if expected == found { Ok(Self { data, channels, rows, cols }) } else { Err(ShapeError { expected, found }) }
    }

    /// Channels, rows, columns.
    #[inline(always)]
    pub fn shape(&self) -> [usize; 3] {
        [self.channels, self.rows, self.cols]
    }

    /// Number of channels.
    #[inline(always)]
    pub fn channels(&self) -> usize {
        self.channels
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
}

impl<'a, T> Tensor<&'a [T]> {
    /// One row of one channel, `cols` elements. Panics where the row is outside the shape.
    #[inline(always)]
    pub fn row(&self, channel: usize, row: usize) -> &'a [T] {
        assert!(row < self.rows, "row {row} of {}", self.rows);
        &self.data[(channel * self.rows + row) * self.cols..][..self.cols]
    }

    /// All rows of one channel, `rows * cols` elements. Panics where there is no such channel.
    #[inline(always)]
    pub fn channel(&self, channel: usize) -> &'a [T] {
        let len = self.rows * self.cols;
        &self.data[channel * len..][..len]
    }
}

impl<T> Tensor<&mut [T]> {
    /// One row of one channel for writing, `cols` elements. Panics where the row is outside the shape.
    #[inline(always)]
    pub fn row_mut(&mut self, channel: usize, row: usize) -> &mut [T] {
        assert!(row < self.rows, "row {row} of {}", self.rows);
        &mut self.data[(channel * self.rows + row) * self.cols..][..self.cols]
    }

    /// All rows of one channel for writing, `rows * cols` elements. Panics where there is no such channel.
    #[inline(always)]
    pub fn channel_mut(&mut self, channel: usize) -> &mut [T] {
        let len = self.rows * self.cols;
        &mut self.data[channel * len..][..len]
    }

    /// The same tensor for reading.
    #[inline(always)]
    pub fn as_chw(&self) -> Chw<'_, T> {
        Tensor { data: self.data, channels: self.channels, rows: self.rows, cols: self.cols }
    }

    /// Keeps a window of each channel, which moves to the front of the buffer: a tensor of (channels, window rows,
    /// window columns). Panics where the window does not lie in the shape.
    pub fn cut(self, window: Region) -> Self
    where
        T: Copy,
    {
        let Self { data, channels, rows, cols } = self;
        let [row, col, height, width] = [window.row, window.col, window.rows, window.cols].map(usize::from);
        if [height, width] == [rows, cols] {
            return Self { data, channels, rows, cols };
        }
        for channel in 0..channels {
            for r in 0..height {
                // No row moves backwards, so none is overwritten before it has moved.
                let from = (channel * rows + row + r) * cols + col;
                data.copy_within(from..from + width, (channel * height + r) * width);
            }
        }
        Self { data: &mut data[..channels * height * width], channels, rows: height, cols: width }
    }

    /// Lends the tensor for writing.
    #[inline(always)]
    pub fn reborrow(&mut self) -> ChwMut<'_, T> {
        Tensor { data: self.data, channels: self.channels, rows: self.rows, cols: self.cols }
    }
}

#[cfg(test)]
mod tests {
    extern crate std;

    use super::*;

    #[test]
    fn elements_lie_channel_row_col() {
        let mut data: [usize; 24] = core::array::from_fn(|i| i);
        let tensor = Chw::new(&data, 2, 3, 4).unwrap();
        assert_eq!(tensor.row(1, 2), [20, 21, 22, 23]);
        assert_eq!(tensor.channel(1)[0], 12);
        let mut tensor = ChwMut::new(&mut data, 2, 3, 4).unwrap();
        tensor.row_mut(0, 1)[3] = 99;
        assert_eq!(tensor.as_chw().channel(0)[7], 99);
        assert_eq!(Chw::new(&data, 2, 3, 5).unwrap_err(), ShapeError { expected: 30, found: 24 });
    }

    #[test]
    fn a_window_is_cut_out_of_every_channel() {
        let mut data: [usize; 24] = core::array::from_fn(|i| i);
        let tensor = ChwMut::new(&mut data, 2, 3, 4).unwrap().cut(Region { row: 1, col: 1, rows: 2, cols: 2 });
        assert_eq!(tensor.shape(), [2, 2, 2]);
        assert_eq!([0, 1].map(|k| tensor.as_chw().channel(k).to_vec()), [[5, 6, 9, 10], [17, 18, 21, 22]]);
        let mut data: [usize; 24] = core::array::from_fn(|i| i);
        assert_eq!(
            ChwMut::new(&mut data, 2, 3, 4).unwrap().cut(Region::whole(3, 4)).as_chw().row(1, 2),
            [20, 21, 22, 23]
        );
    }
}
