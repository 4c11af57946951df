//! Rectangles of a plane.

use core::ops::Range;

use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// A rectangle of a plane, pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct Region {
    /// First row.
    pub row: u16,
    /// First column.
    pub col: u16,
    /// Number of rows.
    pub rows: u16,
    /// Number of columns.
    pub cols: u16,
}

impl Region {
    /// The whole of a plane of `rows` x `cols`.
    pub const fn whole(rows: u16, cols: u16) -> Self {
        Self { row: 0, col: 0, rows, cols }
    }

    /// Number of pixels.
    pub const fn pixels(&self) -> usize {
        self.rows as usize * self.cols as usize
    }

    /// Whether it is not empty and lies in a plane of `rows` x `cols`.
    pub fn lies_in(&self, rows: u16, cols: u16) -> bool {
        let fits = |first: u16, len: u16, all: u16| len > 0 && u32::from(first) + u32::from(len) <= u32::from(all);
        fits(self.row, self.rows, rows) && fits(self.col, self.cols, cols)
    }

    /// Its range of rows and its range of columns.
    pub fn ranges(&self) -> [Range<usize>; 2] {
        [(self.row, self.rows), (self.col, self.cols)].map(|(first, len)| {
            let first = usize::from(first);
            first..first + usize::from(len)
        })
    }

    /// The same rectangle relative to the first pixel of `outer`, in which it lies.
    pub const fn inside(&self, outer: Self) -> Self {
        Self { row: self.row.saturating_sub(outer.row), col: self.col.saturating_sub(outer.col), ..*self }
    }
}

impl core::fmt::Display for Region {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "{},{},{},{}", self.row, self.col, self.rows, self.cols)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_empty_or_reaches_out_lies_in_no_plane() {
        let lies = |row, col, rows, cols| Region { row, col, rows, cols }.lies_in(10, 12);
        assert!(lies(0, 0, 10, 12) && lies(9, 11, 1, 1));
        assert!(!lies(9, 0, 2, 1) && !lies(0, 12, 1, 1) && !lies(0, 0, 0, 5) && !lies(65535, 0, 65535, 1));
    }
}
