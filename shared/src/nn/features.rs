//! Features of a window of the frame.

use super::error::NnError;
use crate::image::{ChwMut, Region};
use crate::num::f16;

/// A tensor (channels, window rows, window cols) at the front of a buffer.
///
/// A convolution lacks its neighbours at an edge of the window that is not an edge of the frame. So the window shrinks
/// by one feature at each such edge before the next convolution.
#[derive(Debug)]
pub struct Features<'a, T = f16> {
    data: &'a mut [T],
    channels: usize,
    window: Region,
}

impl<'a, T: Copy> Features<'a, T> {
    /// The content of `data` as the features of a window.
    pub fn new(data: &'a mut [T], channels: usize, window: Region) -> Self {
        Self { data, channels, window }
    }

    /// Cuts the features to a window inside their own, and borrows them.
    ///
    /// # Errors
    /// [`NnError::Scratch`] where the buffer does not hold them.
    pub fn cut(&mut self, window: Region) -> Result<ChwMut<'_, T>, NnError> {
        let from = core::mem::replace(&mut self.window, window);
        let (expected, found) = (self.channels * from.pixels(), self.data.len());
        let data = self.data.get_mut(..expected).ok_or(NnError::Scratch { expected, found })?;
        let tensor = ChwMut::new(data, self.channels, from.rows.into(), from.cols.into());
        let tensor = tensor.map_err(|error| NnError::Scratch { expected: error.expected, found })?;
        Ok(tensor.cut(window.inside(from)))
    }

    /// Copies another tensor with the same number of channels.
    ///
    /// # Errors
    /// [`NnError::Scratch`] where one of the buffers does not hold it.
    pub fn copy_from(&mut self, other: &Features<'_, T>) -> Result<(), NnError> {
        let (expected, found) = (other.channels * other.window.pixels(), self.data.len().min(other.data.len()));
        let (Some(to), Some(from)) = (self.data.get_mut(..expected), other.data.get(..expected)) else {
            return Err(NnError::Scratch { expected, found });
        };
        to.copy_from_slice(from);
        self.window = other.window;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    extern crate std;

    use super::*;

    #[test]
    fn a_window_is_cut_from_the_window_before() {
        let mut data: [f16; 42] = core::array::from_fn(|i| f16::from_f32(i as f32));
        let window = |row, col, rows, cols| Region { row, col, rows, cols };
        let mut features = Features::new(&mut data, 2, window(3, 5, 4, 5));
        assert_eq!(features.cut(window(4, 6, 2, 3)).unwrap().as_chw().channel(1)[0].to_f32(), 26.0);
        let mut copy = [f16::ZERO; 12];
        let mut copy = Features::new(&mut copy, 2, window(0, 0, 1, 1));
        copy.copy_from(&features).unwrap();
        let last = copy.cut(window(5, 8, 1, 1)).unwrap();
        assert_eq!((last.shape(), last.as_chw().channel(1)[0].to_f32()), ([2, 1, 1], 33.0));
        assert!(Features::new(&mut [f16::ZERO; 3], 1, window(0, 0, 2, 2)).cut(window(0, 0, 1, 1)).is_err());
    }
}
