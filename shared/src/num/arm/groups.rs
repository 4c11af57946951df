//! What the inner loops of the integer convolution read and write.

/// The input of one row of a 3x3 correlation of integers, in groups of channels.
#[derive(Clone, Copy)]
pub(crate) struct Groups<'a> {
    /// Three rows of all groups, `[3, groups, pitch, channels of a group]`.
    pub(crate) input: &'a [i16],
    /// Distance between the rows, columns.
    pub(crate) pitch: usize,
    /// Weights of two output channels, `[groups, 3, 3, 2, channels of a group]`.
    pub(crate) weights: &'a [i16],
}

/// Columns of a block.
pub(super) const COLUMNS: usize = 3;

impl Groups<'_> {
    /// The number of groups of `group` channels. Panics unless the slices hold everything that the loops read and
    /// write, for two rows of sums that begin `distance` apart.
    pub(super) fn check(&self, group: usize, distance: usize, sums: usize) -> usize {
        let groups = self.weights.len() / (18 * group);
        let words = [self.input, self.weights].iter().all(|numbers| numbers.as_ptr().addr().is_multiple_of(4));
        assert!(groups > 0 && words && distance >= COLUMNS && self.pitch >= distance + 2, "rows of {distance}");
        assert!(self.input.len() >= 3 * groups * self.pitch * group && sums >= 2 * distance, "{sums} sums");
        groups
    }
}

/// First column and number of blocks, in up to two parts: blocks side by side, and one that ends where the row does.
/// What the last one shares with the one before comes out the same.
pub(super) fn blocks(cols: usize, distance: usize) -> [(usize, usize); 2] {
    let count = cols.div_ceil(COLUMNS).min(distance / COLUMNS);
    [(0, count), (distance - COLUMNS, usize::from(count * COLUMNS < cols))]
}
