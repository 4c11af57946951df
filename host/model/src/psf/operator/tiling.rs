//! How an object is cut into blocks, and what the transforms of the blocks cost.

use super::image::Span;
use ommatidia_physics::fft2::fast_size;

/// Most blocks along an axis beyond the fewest that are tried.
const MORE_BLOCKS: usize = 6;
/// A multiplication and addition of [`super::mix`], in units of one value of a pass of a transform, roughly: it only
/// decides between tilings.
const MIX_COST: f64 = 0.035;

/// A block of the object: its rows and its columns.
pub(super) type Block = (Span, Span);

/// Blocks of an object, all but the last ones of the same size, and the transforms that hold one of them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Tiling {
    object: [usize; 2],
    /// Rows and columns of a transform.
    pub transform: [usize; 2],
    /// Rows and columns of a block.
    step: [usize; 2],
}

impl Tiling {
    /// For terms that are the same in all blocks: the blocks that cost least. Large ones waste little on the margin of
    /// the window; a transform has no side above `most`, unless the window needs it.
    pub fn coarse(object: [usize; 2], window: usize, most: usize) -> Self {
        let transform = object.map(|n| best_transform(n, window, most));
        Self { object, transform, step: [0, 1].map(|a| (transform[a] + 1 - window).min(object[a])) }
    }

    /// Tilings for terms that differ from block to block, from the fewest blocks on: smaller ones need fewer terms.
    pub fn candidates(object: [usize; 2], window: usize, most: usize) -> Vec<Self> {
        let fewest = object.map(|n| fewest_blocks(n, window, most));
        let of = |more: usize| {
            let step = [0, 1].map(|a| object[a].div_ceil(fewest[a] + more));
            Self { object, transform: step.map(|n| fast_size(n + window - 1)), step }
        };
        let small = |t: &Self| t.step.iter().all(|n| 2 * n >= window);
        (0..=MORE_BLOCKS)
            .map(|more| (more, of(more)))
            .filter(|(more, t)| *more == 0 || small(t))
            .map(|(_, t)| t)
            .collect()
    }

    /// The blocks, row by row.
    pub fn blocks(&self) -> impl Iterator<Item = Block> + '_ {
        let spans = move |a: usize| {
            (0..self.object[a]).step_by(self.step[a]).map(move |i| i..(i + self.step[a]).min(self.object[a]))
        };
        spans(0).flat_map(move |r| spans(1).map(move |c| (r.clone(), c)))
    }

    /// Work with the terms of each lens, in units of one value of a pass along the columns; the spectra of the terms
    /// are computed, too.
    pub fn cost_of_terms(&self, window: usize, lenses: usize, terms: usize) -> f64 {
        let blocks = self.blocks().count();
        (lenses * terms) as f64 * (blocks as f64 * self.transform_cost(self.step[0]) + self.transform_cost(window))
            + (lenses * blocks) as f64 * self.transform_cost(self.step[0] + window - 1)
    }

    /// Work with functions that all lenses share, as many in each block as `functions` says; the same units.
    pub fn cost_of_functions(&self, window: usize, functions: &[usize], [lenses, terms]: [usize; 2]) -> f64 {
        let all: usize = functions.iter().sum();
        let [rows, cols] = self.transform.map(|n| n as f64);
        let mix = lenses as f64 * terms as f64 * (all + 2 * functions.len()) as f64;
        all as f64 * self.transform_cost(self.step[0])
            + (lenses * functions.len()) as f64 * self.transform_cost(self.step[0] + window - 1)
            + MIX_COST * mix * rows * cols
    }

    /// Work of a transform of an image with so many rows that are not zero.
    fn transform_cost(&self, rows: usize) -> f64 {
        let [all, cols] = self.transform.map(|n| n as f64);
        cols / 2.0 * all * all.ln() + rows as f64 / 2.0 * cols * cols.ln()
    }
}

/// The fewest blocks for an object of `n` pixels a side.
fn fewest_blocks(n: usize, window: usize, most: usize) -> usize {
    n.div_ceil(most.max(2 * window) + 1 - window).max(1)
}

/// Side of the cheapest transform for an object of `n` pixels a side, all blocks having the same terms.
fn best_transform(n: usize, window: usize, most: usize) -> usize {
    let fewest = fewest_blocks(n, window, most);
    let of = |blocks: usize| fast_size(n.div_ceil(blocks) + window - 1);
    let cost = |blocks: &usize| (blocks * of(*blocks)) as f64 * (of(*blocks) as f64).ln();
    let best = (fewest..=fewest + 2).min_by(|a, b| cost(a).total_cmp(&cost(b)));
    of(best.unwrap_or(fewest))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn transforms_hold_the_object_in_few_blocks() {
        // The paper's size: two blocks of 1200 and the window make 1440.
        assert_eq!(best_transform(2400, 241, 1536), 1440);
        assert_eq!(best_transform(96, 21, 1536), 120);
        // A window that is larger than the bound has its way.
        assert!(best_transform(100, 61, 32) >= 100usize.div_ceil(3) + 60);
    }

    #[test]
    fn blocks_cover_the_object_once_and_fit_their_transforms() {
        for (object, window, most) in [([2400, 2400], 241, 1536), ([31, 8], 7, 18), ([5, 3], 9, 8), ([1, 1], 1, 8)] {
            for t in Tiling::candidates(object, window, most).into_iter().chain([Tiling::coarse(object, window, most)])
            {
                let mut seen = vec![0; object[0] * object[1]];
                for (r, c) in t.blocks() {
                    assert!(r.len() + window - 1 <= t.transform[0] && c.len() + window - 1 <= t.transform[1]);
                    r.flat_map(|r| c.clone().map(move |c| r * object[1] + c)).for_each(|i| seen[i] += 1);
                }
                assert!(seen.iter().all(|n| *n == 1), "{t:?}");
            }
        }
    }
}
