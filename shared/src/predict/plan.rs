//! The plan of a prediction, and its computation.

use super::source::{Basis, Weighted};
use crate::blob::{Corner, Passes, Size};
use crate::fft::{Fft2, FftError, ProductSource};
use crate::num::simd::Simd;
use crate::num::{f16, fused};
use core::ops::Range;

/// Terms of a lens that are summed in the spectrum. Further ones are summed in the frame.
pub const GROUP: usize = 2;

/// Plan of the prediction of frames.
#[derive(Clone, Copy, Debug)]
pub struct Predictor<'a> {
    corners: &'a [Corner],
    object: [usize; 2],
    frame: [usize; 2],
    nodes: [usize; 2],
    terms: usize,
    window: usize,
    step: usize,
    fft: Fft2,
}

impl<'a> Predictor<'a> {
    /// Plans the predictions of a network whose header has been checked.
    ///
    /// # Errors
    /// [`FftError::Size`] where no transform holds the image of a lens.
    pub fn new(passes: &'a Passes, frame: Size, object: Size) -> Result<Self, FftError> {
        let [frame_px, object_px] = [frame, object].map(|size| [size.rows, size.cols].map(usize::from));
        Ok(Self {
            corners: &passes.corners,
            object: object_px,
            frame: frame_px,
            nodes: passes.nodes(object),
            terms: passes.terms.into(),
            window: passes.window.into(),
            step: passes.node_step.max(1).into(),
            fft: Fft2::new(passes.tile(object).unwrap_or(0).into())?,
        })
    }

    /// Side T of the transforms.
    pub const fn tile(&self) -> usize {
        self.fft.len()
    }

    /// Length of a frame, halves.
    pub const fn frame_len(&self) -> usize {
        self.frame[0] * self.frame[1]
    }

    const fn group(&self) -> usize {
        if self.terms < GROUP { self.terms } else { GROUP }
    }

    /// Length of the arena for [`Self::process`], halves: two spectra of each term of a group, and one half-transformed
    /// image. At most five spectra of 2^20 halves.
    pub const fn arena_len(&self) -> usize {
        let image = self.object[0] + self.window - 1;
        2 * self.group() * self.fft.spectrum_len(self.tile()) + self.fft.spectrum_len(image)
    }

    /// Length of scratch needed at least by [`Self::process`], numbers.
    pub const fn scratch_len(&self) -> usize {
        self.fft.scratch_len()
    }

    /// Length of scratch beyond which more does not help, numbers.
    pub const fn scratch_len_wide(&self) -> usize {
        self.fft.scratch_len_wide()
    }

    /// Predicts the frame (frame rows, frame cols) of an object (object rows, object cols), both contiguous. `model` is
    /// [`Weights::predictor`](crate::blob::Weights::predictor).
    ///
    /// # Errors
    /// [`FftError::Buffer`] where the arena or the scratch is too short.
    pub fn process(
        &self,
        simd: Simd,
        model: &[f16],
        object: &[f16],
        frame: &mut [f16],
        arena: &mut [f16],
        scratch: &mut [f32],
    ) -> Result<(), FftError> {
        let (maps, term) = (self.nodes[0] * self.nodes[1], self.nodes[0] * self.nodes[1] + self.window * self.window);
        frame.fill(f16::ZERO);
        for (corner, lens) in self.corners.iter().zip(model.chunks_exact(self.terms * term)) {
            let [down, across] = [(corner.row, 0), (corner.col, 1)].map(|(corner, axis)| self.seen(corner, axis));
            if down.results.is_empty() || across.results.is_empty() {
                continue;
            }
            for group in lens.chunks(self.group() * term) {
                let mut rest = &mut *arena;
                for term in group.chunks_exact(term) {
                    let (nodes, lags) = term.split_at_checked(maps).unwrap_or_default();
                    let [cols, node_cols] = [self.object[1], self.nodes[1]];
                    let weighted = Weighted { object, cols, nodes, node_cols, step: self.step };
                    let (spectra, left) = rest.split_at_mut_checked(2 * self.spectrum_len()).ok_or(self.short())?;
                    rest = left;
                    let (weights, basis) = spectra.split_at_mut(self.spectrum_len());
                    self.fft.forward(simd, &weighted, 0..self.object[0], weights, scratch)?;
                    self.fft.forward(simd, &Basis { lags, window: self.window }, 0..self.window, basis, scratch)?;
                }
                let used = group.len() / term * 2 * self.spectrum_len();
                let (spectra, halfway) = arena.split_at_mut_checked(used).ok_or(self.short())?;
                let halfway = halfway.get_mut(..self.fft.spectrum_len(down.results.len())).ok_or(self.short())?;
                let sum = TermSum { spectra, len: self.spectrum_len() };
                self.fft.inverse(simd, &sum, down.results.clone(), halfway, scratch, &mut |row, values| {
                    let place = (row - down.results.start + down.first) * self.frame[1] + across.first;
                    let to = frame.get_mut(place..place + across.results.len()).unwrap_or_default();
                    fused::accumulate(values.get(across.results.clone()).unwrap_or_default(), to);
                })?;
            }
        }
        Ok(())
    }

    const fn spectrum_len(&self) -> usize {
        self.fft.spectrum_len(self.fft.len())
    }

    const fn short(&self) -> FftError {
        FftError::Buffer { expected: self.arena_len(), found: 0 }
    }

    /// What the frame sees of an image along one axis (0: rows) behind a lens with this corner.
    fn seen(&self, corner: i16, axis: usize) -> Seen {
        let first = i32::from(corner) - (self.window / 2) as i32;
        let (image, frame) = ((self.object[axis] + self.window - 1) as i32, self.frame[axis] as i32);
        let start = first.clamp(0, frame);
        let end = (first + image).clamp(start, frame);
        Seen { results: (start - first) as usize..(end - first) as usize, first: start as usize }
    }
}

/// The part of an image that lies in the frame, along one axis.
struct Seen {
    /// Its pixels of the image.
    results: Range<usize>,
    /// The pixel of the frame under the first of them.
    first: usize,
}

/// The spectrum of the image of a lens, as a sum over its terms.
struct TermSum<'a> {
    /// Of each term that of the weighted object, then that of the basis PSF.
    spectra: &'a [f16],
    /// Length of one.
    len: usize,
}

impl ProductSource for TermSum<'_> {
    fn count(&self) -> usize {
        self.spectra.len() / (2 * self.len)
    }

    fn product(&self, index: usize) -> Option<[&[f16]; 2]> {
        let term = self.spectra.get(2 * index * self.len..2 * (index + 1) * self.len)?;
        let (weights, basis) = term.split_at_checked(self.len)?;
        Some([basis, weights])
    }
}
