//! What the inner loops of the integer convolution read and write.

/// The input of one row of a 3x3 correlation of integers, in groups of channels.
#[derive(Clone, Copy)]
pub(crate) struct Groups<'a, T = i16> {
    /// Three rows of all groups, `[3, groups, pitch, channels of a group]`.
    pub(crate) input: &'a [T],
    /// Distance between the rows, columns.
    pub(crate) pitch: usize,
    /// Weights of `outputs` output channels, `[3, groups, 3, outputs, channels of a group]`.
    pub(crate) weights: &'a [T],
}

impl<T> Groups<'_, T> {
    /// The number of groups of `group` channels. Panics unless the slices hold everything that the loops read and
    /// write, for blocks of `outputs` by `columns` sums, in rows of sums that begin `distance` apart.
    pub(super) fn check(&self, group: usize, [outputs, columns]: [usize; 2], distance: usize, sums: usize) -> usize {
        let groups = self.weights.len() / (9 * outputs * group);
        let words = [self.input, self.weights].iter().all(|numbers| numbers.as_ptr().addr().is_multiple_of(4));
        assert!(groups > 0 && words && distance >= columns && self.pitch >= distance + 2, "rows of {distance}");
        assert!(self.input.len() >= 3 * groups * self.pitch * group && sums >= outputs * distance, "{sums} sums");
        groups
    }
}

/// First column and number of blocks of `columns`, in up to two parts: blocks side by side, and one that ends where the
/// row does. What the last one shares with the one before comes out the same.
pub(super) fn blocks(cols: usize, columns: usize, distance: usize) -> [(usize, usize); 2] {
    let count = cols.div_ceil(columns).min(distance / columns);
    [(0, count), (distance - columns, usize::from(count * columns < cols))]
}
