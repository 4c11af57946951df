//! Tensors of (channel, row, col).

use super::{Region, ShapeError};

/// A borrowed tensor: element (k, r, c) lies at `(k * rows + r) * cols + c`.
#[derive(Clone, Copy, Debug)]
pub struct Chw<'a, T> {
    data: &'a [T],
    channels: usize,
    rows: usize,
    cols: usize,
}

/// A borrowed tensor that can be written.
#[derive(Debug)]
pub struct ChwMut<'a, T> {
    data: &'a mut [T],
    channels: usize,
    rows: usize,
    cols: usize,
}

fn check(found: usize, channels: usize, rows: usize, cols: usize) -> Result<usize, ShapeError> {
    let expected = channels.checked_mul(rows).and_then(|n| n.checked_mul(cols)).unwrap_or(usize::MAX);
    if expected == found { Ok(expected) } else { Err(ShapeError { expected, found }) }
}

impl<'a, T> Chw<'a, T> {
    /// A tensor over the whole of `data`.
    ///
    /// # Errors
    /// [`ShapeError`] where `data` is not `channels * rows * cols` long.
    pub fn new(data: &'a [T], channels: usize, rows: usize, cols: usize) -> Result<Self, ShapeError> {
        check(data.len(), channels, rows, cols)?;
        Ok(Self { data, channels, rows, cols })
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

    /// One row of one channel; panics outside the shape.
    #[inline(always)]
    pub fn row(&self, channel: usize, row: usize) -> &'a [T] {
        assert!(row < self.rows, "row {row} of {}", self.rows);
        &self.data[(channel * self.rows + row) * self.cols..][..self.cols]
    }

    /// All rows of one channel; panics outside the shape.
    #[inline(always)]
    pub fn channel(&self, channel: usize) -> &'a [T] {
        let len = self.rows * self.cols;
        &self.data[channel * len..][..len]
    }
}

impl<'a, T> ChwMut<'a, T> {
    /// A tensor over the whole of `data`.
    ///
    /// # Errors
    /// [`ShapeError`] where `data` is not `channels * rows * cols` long.
    pub fn new(data: &'a mut [T], channels: usize, rows: usize, cols: usize) -> Result<Self, ShapeError> {
        check(data.len(), channels, rows, cols)?;
        Ok(Self { data, channels, rows, cols })
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

    /// One row of one channel for writing; panics outside the shape.
    #[inline(always)]
    pub fn row_mut(&mut self, channel: usize, row: usize) -> &mut [T] {
        assert!(row < self.rows, "row {row} of {}", self.rows);
        &mut self.data[(channel * self.rows + row) * self.cols..][..self.cols]
    }

    /// All rows of one channel for writing; panics outside the shape.
    #[inline(always)]
    pub fn channel_mut(&mut self, channel: usize) -> &mut [T] {
        let len = self.rows * self.cols;
        &mut self.data[channel * len..][..len]
    }

    /// The same tensor for reading.
    #[inline(always)]
    pub fn as_chw(&self) -> Chw<'_, T> {
        Chw { data: self.data, channels: self.channels, rows: self.rows, cols: self.cols }
    }

    /// Keeps a window of each channel, moved to the front of the buffer; panics where the window does not lie in the shape.
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
        ChwMut { data: self.data, channels: self.channels, rows: self.rows, cols: self.cols }
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
