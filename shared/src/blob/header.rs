//! The header of a network file: every shape that the device needs before it reads a weight.

use crate::nn::integer::Convolutions;
use crate::watch::Statistic;
use heapless::{String, Vec};
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// Largest number of taps of a filter bank.
pub const MAX_TAPS: usize = 128;

/// Rows and columns, in pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct Size {
    /// Number of rows.
    pub rows: u16,
    /// Number of columns.
    pub cols: u16,
}

/// The correction of raw frames before the network ([`crate::sensor`]).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Sensor {
    /// Mean signal without light, DN.
    pub black_level_dn: f32,
    /// The highest code, `2^bit_depth - 1`, DN.
    pub saturation_dn: u16,
    /// The weights hold an offset of each pixel (DN, relative to the black level).
    pub has_offset_map: bool,
    /// The weights hold an inverse relative gain of each pixel (1: nominal).
    pub has_gain_map: bool,
}

/// One partition of the filter of one channel: it convolves the input window that lies `dy, dx` steps from the output
/// tile ([`crate::filter`]).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct Tap {
    /// Output channel.
    pub channel: u8,
    /// Offset of the input window along the rows, steps of the bank.
    pub dy: i8,
    /// Offset of the input window along the columns, steps of the bank.
    pub dx: i8,
}

impl Tap {
    /// Sort key: taps are stored in ascending order of (channel, dy, dx).
    pub fn order(self) -> (u8, i8, i8) {
        (self.channel, self.dy, self.dx)
    }
}

/// Kernels stored in space, as a few blocks of lags each; all other lags are zero ([`crate::filter`]).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct Blocks {
    /// Side B of a block, lags; a power of two, at most T.
    pub side: u16,
    /// Number of blocks of all channels together.
    pub count: u16,
}

impl Blocks {
    /// Blocks along each side of a kernel of side `tile`; 0 where the side of a block is 0, which [`Header::check`]
    /// refuses.
    pub const fn across(self, tile: u16) -> usize {
        match tile.checked_div(self.side) {
            Some(across) => across as usize,
            None => 0,
        }
    }
}

/// The Fourier filter bank: uniformly partitioned overlap-save convolution.
///
/// With `tile` = the padded frame and one tap at (0, 0) in each channel it is the dense Fourier layer of SV-FourierNet
/// (Yang et al. 2024, section 3B).
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct Bank {
    /// Side T of the transform, pixels; a power of two.
    pub tile: u16,
    /// Side S of the valid output block of a tile, pixels; 1 to T.
    pub step: u16,
    /// Number of output channels C.
    pub channels: u8,
    /// Taps in ascending order of (channel, dy, dx). Each has a spectrum of T x (T/2 + 1) complex halves in the weights
    /// or, with `blocks`, a kernel.
    pub taps: Vec<Tap, MAX_TAPS>,
    /// Given where the weights hold kernels in space instead of spectra. The bank then has one tap at (0, 0) in each
    /// channel, and one tile that holds the whole frame.
    pub blocks: Option<Blocks>,
}

/// The enhancement network: a light residual channel-attention network.
///
/// PixelUnshuffle 2 -> conv 4C->W -> `groups` x (`blocks` RCAB + conv, skip) -> conv -> long skip -> conv W->4W ->
/// PixelShuffle 2 -> conv W->1 -> sigmoid. RCAB = conv, ReLU, conv, channel attention (W -> W/reduction -> W), skip.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct Rcan {
    /// Feature channels W.
    pub width: u8,
    /// Number of residual groups.
    pub groups: u8,
    /// Residual channel-attention blocks (RCAB) in a group.
    pub blocks: u8,
    /// Reduction r of the channels in the bottleneck of the attention, W -> W/r -> W.
    pub reduction: u8,
}

/// Scales of a network whose 3x3 convolutions are integers ([`crate::nn::integer`]).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Integers {
    /// 1 of the input of the network is 2 to this power; 0 to 24.
    pub input_log2: i8,
    /// A mean of 1 of a channel, as its attention takes it, is 2 to this power units of its features; -16 to 24.
    pub feature_log2: i8,
    /// Argument of the last logistic function for a sum of 1; positive.
    pub output: f32,
    /// Bits of a stored feature. Files of version 3 lack this field, and have features of 16 bits.
    pub features: FeatureBits,
}

/// Bits of a stored feature of a network in integers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub enum FeatureBits {
    /// 16 bits.
    #[default]
    Sixteen,
    /// 8 bits.
    Eight,
}

/// Largest number of lenses whose light a network with several passes predicts.
pub const MAX_LENSES: usize = 25;
/// Largest number of passes after the first one.
pub const MAX_LATER: u8 = 7;

/// Where the image of a lens lies.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct Corner {
    /// Row of the frame under row 0 of the object; it may lie outside the frame.
    pub row: i16,
    /// Column of the frame under column 0 of the object.
    pub col: i16,
}

/// The passes after the first one, and the shape of the model of the PSFs that predicts frames for them
/// ([`crate::predict`]).
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct Passes {
    /// Number of passes after the first one, 1 to [`MAX_LATER`].
    pub later: u8,
    /// Number of terms of each lens.
    pub terms: u8,
    /// Side W of the basis PSFs, pixels; odd.
    pub window: u16,
    /// Pixels of the object from node to node of the coefficient maps; a power of two.
    pub node_step: u16,
    /// The lenses.
    pub corners: Vec<Corner, MAX_LENSES>,
}

impl Passes {
    /// Rows and columns of the nodes of a coefficient map; the last ones lie on or beyond the last pixel. 1 where the
    /// step is 0, which [`Header::check`] refuses.
    pub fn nodes(&self, object: Size) -> [usize; 2] {
        let axis = |n: u16| match n.saturating_sub(1).checked_div(self.node_step) {
            Some(whole) if whole * self.node_step == n.saturating_sub(1) => usize::from(whole) + 1,
            Some(whole) => usize::from(whole) + 2,
            None => 1,
        };
        [axis(object.rows), axis(object.cols)]
    }

    /// Side of the transforms: the smallest power of two, and at least 8, that holds the image of a lens. None where
    /// it is larger than the largest transform.
    pub fn tile(&self, object: Size) -> Option<u16> {
        let side = u32::from(object.rows.max(object.cols)) + u32::from(self.window).saturating_sub(1);
        let tile = side.next_power_of_two().max(8);
        u16::try_from(tile).ok().filter(|&tile| usize::from(tile) <= crate::fft::MAX_LEN)
    }

    /// Halves of each term in the file: its coefficient map, then its basis PSF.
    pub fn term_len(&self, object: Size) -> u64 {
        let [rows, cols] = self.nodes(object);
        rows as u64 * cols as u64 + u64::from(self.window).pow(2)
    }
}

/// A watch on the optics ([`crate::watch`]).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Watching {
    /// Number of lenses, 3 to [`crate::watch::MAX_LENSES`].
    pub lenses: u8,
    /// Side of a block of pixels, 1 to [`crate::watch::MAX_BLOCK`].
    pub block: u8,
    /// Black level, DN.
    pub black_dn: u16,
    /// Frames with less light than this do not count, DN.
    pub least_light_dn: f32,
    /// Logarithm of the odds against a false alarm; positive.
    pub log_odds: f32,
}

/// Memory that the pipeline needs besides the network file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct MemoryPlan {
    /// Fast scratch (tightly coupled memory), bytes.
    pub fast_bytes: u32,
    /// Bulk arena (SRAM or memory-mapped PSRAM), bytes.
    pub bulk_bytes: u32,
}

/// The header of a network file: all shapes, and the memory that the network needs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Header {
    /// Name that the user gave the network.
    pub name: String<48>,
    /// First 16 hexadecimal digits of the SHA-256 of the checkpoint that was quantized.
    pub checkpoint: String<16>,
    /// Raw frame, pixels.
    pub frame: Size,
    /// Reconstruction, pixels; even in both directions.
    pub object: Size,
    /// Sensor corrections.
    pub sensor: Sensor,
    /// Filter bank.
    pub bank: Bank,
    /// Enhancement network.
    pub rcan: Rcan,
    /// Memory plan.
    pub memory: MemoryPlan,
    /// Given where the 3x3 convolutions of the enhancement network are integers. Files of version 2 lack this field.
    pub integers: Option<Integers>,
    /// Given where the network has more than one pass. Files of versions before 5 lack this field.
    pub passes: Option<Passes>,
    /// Given where the device watches its optics. Files of versions before 6 lack this field.
    pub watch: Option<Watching>,
}

/// Number of 16-bit words in each section of the weights, in the order of the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SectionLens {
    /// Spectra of the taps, or blocks of their kernels.
    pub filters: u64,
    /// Positions of the blocks; 0 for spectra.
    pub index: u64,
    /// Weights and biases of the RCAN of each pass; of its channel attentions alone where its convolutions are
    /// integers.
    pub rcan: u64,
    /// Offset map; 0 without one.
    pub offset_dn: u64,
    /// Inverse gain map; 0 without one.
    pub inverse_gain: u64,
    /// Weights of integer convolutions, two in a word; 0 for halves.
    pub integers: u64,
    /// Output channels of integer convolutions, four words each; 0 for halves.
    pub channels: u64,
    /// Coefficient maps and basis PSFs; 0 for one pass.
    pub predictor: u64,
    /// Weight maps of the watch; 0 without one.
    pub watch: u64,
    /// Its statistics, eight words each.
    pub statistics: u64,
}

/// A part of the header.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub enum HeaderField {
    /// The encoding as a whole.
    Encoding,
    /// [`Header::frame`].
    Frame,
    /// [`Header::object`].
    Object,
    /// [`Header::sensor`].
    Sensor,
    /// [`Header::bank`].
    Bank,
    /// [`Bank::taps`].
    Taps,
    /// [`Bank::blocks`].
    Blocks,
    /// [`Header::rcan`].
    Rcan,
    /// [`Header::integers`].
    Integers,
    /// [`Header::passes`].
    Passes,
    /// [`Header::watch`].
    Watch,
}

/// The weights of a network, borrowed from the file. All but the index and integer convolutions are IEEE halves.
#[derive(Clone, Copy, Debug)]
pub struct Weights<'a> {
    /// Spectra of the taps in the order of [`Bank::taps`], each T rows of T/2 + 1 complex numbers (re, im). With
    /// [`Bank::blocks`] the blocks in the order of the index, each B rows of B lags.
    pub filters: &'a [half::f16],
    /// Positions of the blocks, as in a compressed sparse row matrix: for each row of blocks of each channel the number
    /// of blocks before it, then the number of all blocks; then the column of each block. Empty for spectra.
    pub index: &'a [u16],
    /// Weights and biases of the RCAN in the order in which they are used ([`crate::nn::rcan::layout`]); of its channel
    /// attentions alone where its convolutions are integers. Those of later passes follow, one pass after the other.
    pub rcan: &'a [half::f16],
    /// Offset of each pixel relative to the black level, DN, (frame rows, frame cols).
    pub offset_dn: Option<&'a [half::f16]>,
    /// Inverse relative gain of each pixel, (frame rows, frame cols).
    pub inverse_gain: Option<&'a [half::f16]>,
    /// The 3x3 convolutions of the RCAN where they are integers.
    pub convolutions: Option<Convolutions<'a>>,
    /// The model of the PSFs of a network with several passes, empty for others: of each term of each lens the
    /// coefficients at the nodes of its map, -1 to 1, then the basis PSF times the side of the transforms, row by row.
    pub predictor: &'a [half::f16],
    /// Maps and statistics of the watch; empty without one.
    pub watch: WatchWeights<'a>,
}

/// Maps and statistics of a watch on the optics.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct WatchWeights<'a> {
    /// Weights ([`crate::watch::Maps::weights`]).
    pub maps: &'a [i16],
    /// What belongs to each statistic.
    pub statistics: &'a [Statistic],
}
