//! Weight maps, and the statistics of a frame under them.

use crate::blob::Size;
use bytemuck::{Pod, Zeroable};

/// Largest number of lenses: their sums lie on the stack of the device.
pub const MAX_LENSES: usize = 9;
/// Largest number of statistics: two displacements and a gain of each lens.
pub const MAX_STATISTICS: usize = 3 * MAX_LENSES;
/// Moments of a block.
pub const MOMENTS: usize = 3;
/// Largest side of a block, pixels: with it every moment fits into 32 bits.
pub const MAX_BLOCK: u8 = 32;
/// Largest frame, pixels: with it every sum fits into 64 bits.
pub const MAX_PIXELS: u64 = 1 << 24;
/// The sum of a block counts so many times, so that the weights of all moments have about the same size.
const SUM_FACTOR: i32 = 16;

/// What belongs to a statistic besides its map. The unit of a displacement is a pixel, that of a gain 1.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Statistic {
    /// Unit of the parameter for a quotient of map sum and light of 1; 0: this statistic is not used.
    pub scale: f32,
    /// Variance of the statistic by shot noise, times the light of the frame in DN.
    pub shot: f32,
    /// Variance of the statistic by the reading of the pixels, times the square of the light.
    pub reading: f32,
    /// Standard deviation of the difference between two specimens.
    pub specimens: f32,
}

impl Statistic {
    /// Whether every number is finite and none is negative. Scales may be.
    pub fn is_possible(&self) -> bool {
        let Self { scale, shot, reading, specimens } = *self;
        scale.is_finite() && [shot, reading, specimens].iter().all(|v| v.is_finite() && *v >= 0.0)
    }

    /// Whether it is watched.
    pub fn is_used(&self) -> bool {
        self.scale != 0.0
    }
}

/// Number of blocks of side `block` along the rows and the columns of a frame; 0 where the side is 0.
pub const fn blocks(frame: Size, block: u8) -> [usize; 2] {
    if block == 0 {
        return [0; 2];
    }
    [(frame.rows as usize).div_ceil(block as usize), (frame.cols as usize).div_ceil(block as usize)]
}

/// The maps of all statistics, borrowed from a network file.
#[derive(Clone, Copy, Debug)]
pub struct Maps<'a> {
    /// Size of a frame, pixels.
    pub frame: Size,
    /// Side B of a block, pixels.
    pub block: u8,
    /// Black level, DN.
    pub black_dn: u16,
    /// Frames with less light than this do not count, DN.
    pub least_light_dn: f32,
    /// Logarithm of the odds against a false alarm: ln(2 J / rate of false alarms).
    pub log_odds: f32,
    /// Weights q, for each block row by row: those of the three moments for each displacement, then those of the sum
    /// for each gain.
    pub weights: &'a [i16],
    /// The statistics: displacements along the rows of all lenses, then along the columns, then gains.
    pub statistics: &'a [Statistic],
}

/// The statistics of one frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Projection {
    /// Light of the frame above the black level, DN.
    pub light_dn: i64,
    /// Map sums; only as many as there are statistics mean something.
    pub sums: [i64; MAX_STATISTICS],
}

impl Projection {
    /// Statistic `j`, in the unit of its parameter; 0 for a frame without light.
    pub fn value(&self, j: usize, statistic: &Statistic) -> f32 {
        let sum = self.sums.get(j).copied().unwrap_or(0);
        if self.light_dn <= 0 { 0.0 } else { statistic.scale * (sum as f32 / self.light_dn as f32) }
    }
}

impl Maps<'_> {
    /// Weights of each block, with so many statistics: three for each displacement, one for each gain.
    pub const fn weights_of_block(statistics: usize) -> usize {
        statistics / 3 * (2 * MOMENTS + 1)
    }

    /// Number of lenses.
    pub fn lenses(&self) -> usize {
        self.statistics.len() / 3
    }

    /// The statistics of a raw frame, codes row by row.
    pub fn project(&self, frame: &[u16]) -> Projection {
        let (cols, side) = (usize::from(self.frame.cols).max(1), usize::from(self.block.clamp(1, MAX_BLOCK)));
        let (across, moving) = (cols.div_ceil(side), 2 * self.lenses());
        let of_block = Self::weights_of_block(self.statistics.len());
        let mut projection = Projection { light_dn: 0, sums: [0; MAX_STATISTICS] };
        if of_block == 0 {
            return projection;
        }
        let mut maps = self.weights.chunks_exact(of_block);
        for band in frame.chunks(cols * side) {
            for first in (0..across).map(|i| i * side) {
                let [sum, down, right] = moments(band, cols, first..cols.min(first + side), self.black_dn);
                projection.light_dn += i64::from(sum / SUM_FACTOR);
                let product = |q: i16, moment: i32| i64::from(q) * i64::from(moment);
                let weights = maps.next().unwrap_or_default();
                let (moved, gains) = weights.split_at_checked(MOMENTS * moving).unwrap_or_default();
                let (of_moves, of_gains) = projection.sums.split_at_mut_checked(moving).unwrap_or_default();
                for (to, q) in of_moves.iter_mut().zip(moved.as_chunks::<MOMENTS>().0) {
                    *to += product(q[0], sum) + product(q[1], down) + product(q[2], right);
                }
                for (to, q) in of_gains.iter_mut().zip(gains) {
                    *to += product(*q, sum);
                }
            }
        }
        projection
    }
}

/// The three moments of the block of a band of rows that lies in columns `at`.
///
/// Sums of running sums weigh the pixels by their places: of n pixels, the first counts n times. At most 32 x 32 codes
/// of 16 bits are summed, so nothing exceeds 32 bits: the running sums are below 2^31, what is subtracted from them
/// below 2^32, and the differences within 2^30.
#[inline(always)]
fn moments(band: &[u16], cols: usize, at: core::ops::Range<usize>, black_dn: u16) -> [i32; MOMENTS] {
    let (width, mut height) = (at.len() as u32, 0);
    let (mut sum, mut from_below, mut from_right) = (0u32, 0u32, 0u32);
    for row in band.chunks(cols) {
        let (mut of_row, mut running) = (0u32, 0u32);
        for &code in row.get(at.clone()).unwrap_or_default() {
            of_row += u32::from(code);
            running += of_row;
        }
        sum += of_row;
        from_below += sum;
        from_right += running;
        height += 1;
    }
    let centred = |n: u32, running: u32| ((n + 1) * sum).wrapping_sub(2 * running) as i32;
    let light = sum as i32 - (width * height * u32::from(black_dn)) as i32;
    [SUM_FACTOR * light, centred(height, from_below), centred(width, from_right)]
}
