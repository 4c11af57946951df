//! Images with their channels last: planes of the whole field, and patches of it that stay in the cache while several
//! layers go over them.

/// Channels are stored in groups of this number: the widest vector of any instruction set, f32 lanes.
pub const GROUP: usize = 16;

/// An image, [rows, cols, channels]; channels are a multiple of [`GROUP`].
#[derive(Clone, Debug, Default)]
pub struct Patch {
    /// Number of rows.
    pub rows: usize,
    /// Number of columns.
    pub cols: usize,
    /// Number of channels, those without a meaning counted: they are zero.
    pub channels: usize,
    /// Its values.
    pub data: Vec<f32>,
}

impl Patch {
    /// Gives the patch another size; its values are of no meaning then.
    pub fn resize(&mut self, rows: usize, cols: usize, channels: usize) {
        (self.rows, self.cols, self.channels) = (rows, cols, channels);
        self.data.resize(rows * cols * channels, 0.0);
    }

    /// Row `r`, [cols, channels].
    pub fn row(&self, r: usize) -> &[f32] {
        let n = self.cols * self.channels;
        &self.data[r * n..(r + 1) * n]
    }

    /// Row `r`, [cols, channels].
    pub fn row_mut(&mut self, r: usize) -> &mut [f32] {
        let n = self.cols * self.channels;
        &mut self.data[r * n..(r + 1) * n]
    }

    /// Sets everything outside the given rows and columns to zero.
    pub fn keep(&mut self, rows: std::ops::Range<usize>, cols: std::ops::Range<usize>) {
        let n = self.channels;
        for (r, row) in self.data.chunks_exact_mut((self.cols * n).max(1)).enumerate() {
            if rows.contains(&r) {
                row[..cols.start * n].fill(0.0);
                row[cols.end * n..].fill(0.0);
            } else {
                row.fill(0.0);
            }
        }
    }
}

/// Number of channels with those that fill the last group.
pub fn padded(channels: usize) -> usize {
    channels.next_multiple_of(GROUP)
}
