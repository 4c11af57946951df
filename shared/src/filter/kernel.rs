//! Pruned filters, stored as blocks of their kernels.
//!
//! Learned kernels consist of a few foci, and nearly all other lags are small. The spectrum of a pruned kernel has as
//! many numbers as that of a full one, but the kernel itself has few. So the file holds blocks of B x B lags and a
//! compressed sparse row index of their positions. The device transforms one kernel at a time to the spectrum that it
//! would otherwise have read from the file.
//!
//! Element (r, c) of the T x T plane holds lag (r - Lr, c - Lc), where L is the first valid result of a tile. Kernels
//! around lag zero then occupy neighbouring rows, all other rows need no transform, and the valid part moves from L to
//! 2 L.

use core::ops::Range;

use super::geometry::FilterError;
use crate::blob::{Bank, Blocks};
use crate::num::{f16, widen_slice};

/// The filters of a bank as they are stored.
#[derive(Clone, Copy, Debug)]
pub struct Filters<'a> {
    /// Spectra of the taps, or blocks.
    pub halves: &'a [f16],
    /// Positions of the blocks ([`crate::blob::Weights::index`]); empty for spectra.
    pub index: &'a [u16],
}

/// The blocks of a bank.
#[derive(Clone, Copy, Debug)]
pub(super) struct Kernels<'a> {
    side: usize,
    /// Rows of blocks in a kernel.
    rows: usize,
    /// Number of blocks before each row of blocks of all channels, and the number of all blocks.
    starts: &'a [u16],
    /// Column of each block.
    columns: &'a [u16],
    lags: &'a [f16],
}

impl<'a> Kernels<'a> {
    /// The blocks at the positions in the index.
    ///
    /// # Errors
    /// [`FilterError::Index`] unless the blocks of each row follow those of the row before, in ascending order of their
    /// columns and inside the kernel.
    pub(super) fn new(bank: &Bank, blocks: Blocks, filters: Filters<'a>) -> Result<Self, FilterError> {
        let (side, rows) = (usize::from(blocks.side), blocks.across(bank.tile));
        let starts = rows * usize::from(bank.channels) + 1;
        let (starts, columns) = filters.index.split_at_checked(starts).ok_or(FilterError::Index { row: 0 })?;
        let kernels = Self { side, rows, starts, columns, lags: filters.halves };
        let ends = starts.first() == Some(&0) && starts.last() == Some(&blocks.count);
        if !ends || columns.len() != usize::from(blocks.count) {
            return Err(FilterError::Index { row: 0 });
        }
        for row in 0..starts.len() - 1 {
            let columns = columns.get(kernels.blocks(row)).ok_or(FilterError::Index { row })?;
            if !columns.is_sorted_by(|a, b| a < b) || columns.last().is_some_and(|last| usize::from(*last) >= rows) {
                return Err(FilterError::Index { row });
            }
        }
        Ok(kernels)
    }

    /// Numbers of the blocks in a row of blocks.
    fn blocks(&self, row: usize) -> Range<usize> {
        usize::from(self.starts[row])..usize::from(self.starts[row + 1])
    }

    /// The kernel of a channel.
    pub(super) fn of(&self, channel: u8) -> Kernel<'a> {
        Kernel { all: *self, first: usize::from(channel) * self.rows }
    }
}

/// The kernel of one channel.
pub(super) struct Kernel<'a> {
    all: Kernels<'a>,
    /// Its first row of blocks.
    first: usize,
}

impl Kernel<'_> {
    /// The rows of the plane from the first block to the last.
    pub(super) fn occupied(&self) -> Range<usize> {
        let mut lit = (0..self.all.rows).filter(|row| !self.all.blocks(self.first + row).is_empty());
        match (lit.next(), lit.next_back()) {
            (Some(first), last) => first * self.all.side..(last.unwrap_or(first) + 1) * self.all.side,
            (None, _) => 0..0,
        }
    }

    /// Writes one whole row of the plane.
    pub(super) fn load(&self, row: usize, to: &mut [f32]) {
        to.fill(0.0);
        let Kernels { side, columns, lags, .. } = self.all;
        for block in self.all.blocks(self.first + row / side) {
            let (column, lags) = (usize::from(columns[block]), &lags[block * side * side..]);
            widen_slice(&lags[row % side * side..][..side], &mut to[column * side..][..side]);
        }
    }
}
