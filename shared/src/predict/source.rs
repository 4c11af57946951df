//! The planes that are transformed.

use crate::fft::RowSource;
use crate::num::{f16, widen, widen_slice};

/// An object times a coefficient map, at the top left of a plane.
pub(super) struct Weighted<'a> {
    /// The object, row by row.
    pub object: &'a [f16],
    /// Columns of the object.
    pub cols: usize,
    /// The map at its nodes, row by row.
    pub nodes: &'a [f16],
    /// Columns of nodes.
    pub node_cols: usize,
    /// Pixels from node to node.
    pub step: usize,
}

impl Weighted<'_> {
    /// The map at column `node` of the nodes, between two rows of nodes.
    #[inline(always)]
    fn between(rows: [&[f16]; 2], node: usize, down: f32) -> f32 {
        // On the last row or column of nodes there is no next one, and its weight is 0.
        let value = |row: &[f16]| row.get(node).map_or(0.0, |value| widen(*value));
        let [above, below] = rows.map(value);
        above + (below - above) * down
    }
}

impl RowSource for Weighted<'_> {
    fn load(&self, row: usize, to: &mut [f32]) {
        let part = 1.0 / self.step as f32;
        let (first, down) = (row / self.step, (row % self.step) as f32 * part);
        let mut rows = self.nodes.chunks_exact(self.node_cols).skip(first);
        let above = rows.next().unwrap_or_default();
        let rows = [above, rows.next().unwrap_or(above)];
        let object = self.object.chunks_exact(self.cols).nth(row).unwrap_or_default();
        let (lit, dark) = to.split_at_mut_checked(self.cols).unwrap_or_default();
        dark.fill(0.0);
        let mut left = Self::between(rows, 0, down);
        for (node, (object, to)) in object.chunks(self.step).zip(lit.chunks_mut(self.step)).enumerate() {
            let right = Self::between(rows, node + 1, down);
            for (across, (x, to)) in object.iter().zip(to).enumerate() {
                *to = (left + (right - left) * (across as f32 * part)) * widen(*x);
            }
            left = right;
        }
    }
}

/// A basis PSF at the top left of a plane.
pub(super) struct Basis<'a> {
    /// Its lags, row by row.
    pub lags: &'a [f16],
    /// Its side.
    pub window: usize,
}

impl RowSource for Basis<'_> {
    fn load(&self, row: usize, to: &mut [f32]) {
        let (lags, rest) = to.split_at_mut_checked(self.window).unwrap_or_default();
        rest.fill(0.0);
        if let Some(from) = self.lags.chunks_exact(self.window).nth(row) {
            widen_slice(from, lags);
        }
    }
}
