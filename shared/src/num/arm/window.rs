//! The input of the inner loops of the convolution.

/// The input of one row of a 3x3 correlation.
#[derive(Clone, Copy)]
pub(crate) struct Rows<'a> {
    /// Three widened rows of all channels, `[3, channels, pitch]`.
    pub(crate) input: &'a [f32],
    /// Distance between the rows: the columns rounded up to a multiple of eight and two more.
    pub(crate) pitch: usize,
    /// Weights, `[channels, 3, 3, outputs]`.
    pub(crate) weights: &'a [f32],
}

impl Rows<'_> {
    /// The number of input channels. Panics unless the slices hold everything that the loops read and write, for
    /// `outputs` channels and rows of sums that begin `distance` apart.
    pub(super) fn check(&self, outputs: usize, distance: usize, sums: usize) -> usize {
        let channels = self.weights.len() / (9 * outputs);
        assert!(channels > 0 && self.pitch >= distance + 2 && distance.is_multiple_of(8), "rows of {distance}");
        assert!(self.input.len() >= 3 * channels * self.pitch && sums >= outputs * distance, "{sums} sums");
        channels
    }
}
