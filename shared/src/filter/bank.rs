//! The computation of the filter bank.

use core::ops::Range;

use super::geometry::{Axis, FilterError, Geometry};
use super::kernel::{Filters, Kernel, Kernels};
use crate::blob::{Bank, Size, Tap};
use crate::fft::{Fft2, ProductSource, RowSource};
use crate::image::{ChwMut, Region};
use crate::num::simd::Simd;
use crate::num::{f16, narrow_slice};

/// Source of the rows of a frame.
pub trait FrameRows {
    /// Writes columns `first..first + to.len()` of row `row` of the frame into `to`.
    fn load(&self, row: usize, first: usize, to: &mut [f32]);
}

/// Plan of a filter bank for an object, or for a part of it.
#[derive(Clone, Copy, Debug)]
pub struct FilterBank<'a> {
    bank: &'a Bank,
    geometry: Geometry,
    part: Region,
    fft: Fft2,
}

impl<'a> FilterBank<'a> {
    /// Plans a bank for a frame and an object.
    ///
    /// # Errors
    /// [`FilterError::Step`], [`FilterError::Channel`], [`FilterError::Order`], [`FilterError::NoTap`],
    /// [`FilterError::Kernels`] or [`FilterError::Fft`] where the bank is impossible, [`FilterError::TooLarge`] where
    /// its arena or its output would have 4 GiB or more.
    pub fn new(bank: &'a Bank, frame: Size, object: Size) -> Result<Self, FilterError> {
        let geometry = Geometry::new(bank, frame, object)?;
        let part = Region::whole(object.rows, object.cols);
        let plan = Self { bank, geometry, part, fft: Fft2::new(usize::from(bank.tile))? };
        plan.check_size().map(|()| plan)
    }

    /// Checks that no length of the plan overflows 32 bits. All later arithmetic is on these lengths and their parts,
    /// in `usize`, which has 32 bits on a microcontroller.
    fn check_size(&self) -> Result<(), FilterError> {
        let Geometry { rows, cols } = self.geometry;
        // No factor has more than 21 bits: T is at most 1024, there are at most 65,791 windows a row and 256 rows.
        let spectrum = self.spectrum_len() as u64;
        let cache = rows.span() as u64 * cols.window_count() as u64 * spectrum;
        let arena = cache + self.fft.spectrum_len(rows.valid()) as u64 + self.kernel_len() as u64;
        let output = u64::from(self.bank.channels) * rows.object as u64 * cols.object as u64;
        let needed = arena.max(output) * size_of::<f16>() as u64;
        if needed > u64::from(u32::MAX) { Err(FilterError::TooLarge { needed }) } else { Ok(()) }
    }

    /// The plan of the same bank for a part of the object. Only the tiles that the part touches are computed. The
    /// result has the bits of the whole.
    ///
    /// # Errors
    /// [`FilterError::Part`] where the part is empty or reaches beyond the object.
    pub fn of_part(self, part: Region) -> Result<Self, FilterError> {
        let [rows, cols] = [self.geometry.rows, self.geometry.cols].map(|axis| axis.object as u16);
        if part.lies_in(rows, cols) { Ok(Self { part, ..self }) } else { Err(FilterError::Part { found: part }) }
    }

    /// The geometry.
    pub const fn geometry(&self) -> &Geometry {
        &self.geometry
    }

    /// Length of the spectrum of one tap, halves.
    pub const fn spectrum_len(&self) -> usize {
        self.fft.spectrum_len(self.fft.len())
    }

    /// Checks that these are filters of this bank: their length, and the order of the index of the blocks.
    ///
    /// # Errors
    /// [`FilterError::Length`], [`FilterError::Index`].
    pub fn check(&self, filters: Filters<'_>) -> Result<(), FilterError> {
        self.kernels(filters).map(|_| ())
    }

    /// Checks as [`Self::check`] does, and returns the kernels where the file holds kernels.
    fn kernels<'f>(&self, filters: Filters<'f>) -> Result<Option<Kernels<'f>>, FilterError> {
        let expected = match self.bank.blocks {
            None => self.spectrum_len() as u64 * self.bank.taps.len() as u64,
            Some(blocks) => u64::from(blocks.count) * u64::from(blocks.side).pow(2),
        };
        // More than memory can hold is more than was found.
        check_len(usize::try_from(expected).unwrap_or(usize::MAX), filters.halves.len())?;
        self.bank.blocks.map(|blocks| Kernels::new(self.bank, blocks, filters)).transpose()
    }

    /// Length of the output, halves.
    pub const fn output_len(&self) -> usize {
        self.bank.channels as usize * self.part.pixels()
    }

    /// Length of the arena for [`Self::process`], halves, the same for a part as for the whole: the spectra of the
    /// windows in use, one half-transformed tile and, where the file holds kernels, the spectrum of one of them.
    pub const fn arena_len(&self) -> usize {
        self.prepared_len() + self.fft.spectrum_len(self.geometry.rows.valid()) + self.kernel_len()
    }

    const fn kernel_len(&self) -> usize {
        if self.bank.blocks.is_some() { self.spectrum_len() } else { 0 }
    }

    /// Length of the spectra of all rows of windows that one row of tiles reads, halves: the start of the arena.
    pub const fn prepared_len(&self) -> usize {
        self.geometry.rows.span() * self.geometry.cols.window_count() * self.spectrum_len()
    }

    /// Length of scratch needed at least by [`Self::process`], numbers.
    pub const fn scratch_len(&self) -> usize {
        self.fft.scratch_len()
    }

    /// Length of scratch beyond which more does not help, numbers.
    pub const fn scratch_len_wide(&self) -> usize {
        self.fft.scratch_len_wide()
    }

    /// Whether one tile reads one window that holds the whole frame.
    pub fn is_whole(&self) -> bool {
        let Geometry { rows, cols } = &self.geometry;
        rows.is_whole() && cols.is_whole()
    }

    /// Transforms the frame of a bank that [`Self::is_whole`] to the first [`Self::prepared_len`] halves of the arena,
    /// for a later [`Self::process`] with the same arena and no frame, so that the frame need not be kept.
    ///
    /// # Errors
    /// [`FilterError::Length`] where the arena is too short or the bank has several windows,
    /// [`FilterError::Fft`] where the scratch is too short.
    pub fn prepare<F: FrameRows>(
        &self,
        simd: Simd,
        frame: &F,
        arena: &mut [f16],
        scratch: &mut [f32],
    ) -> Result<(), FilterError> {
        check_len(usize::from(self.is_whole()), 1)?;
        check_len(self.prepared_len(), arena.len().min(self.prepared_len()))?;
        self.transform_windows(simd, frame, 0, &(0..1), &mut arena[..self.prepared_len()], scratch)
    }

    /// Filters a frame; none: the one that was prepared ([`Self::prepare`]). `output` is (channels, rows, columns) of
    /// the object, or of the part of it that was planned for.
    ///
    /// # Errors
    /// [`FilterError::Length`] where the filters, the output or the arena have a wrong length, [`FilterError::Index`]
    /// where the index of the blocks is out of order, [`FilterError::Fft`] where the scratch is too short.
    pub fn process<F: FrameRows>(
        &self,
        simd: Simd,
        frame: Option<&F>,
        filters: Filters<'_>,
        mut output: ChwMut<'_, f16>,
        arena: &mut [f16],
        scratch: &mut [f32],
    ) -> Result<(), FilterError> {
        let Geometry { rows, cols } = self.geometry;
        let kernels = self.kernels(filters)?;
        check_len(self.output_len(), output.shape().iter().product())?;
        check_len(self.arena_len(), arena.len().min(self.arena_len()))?;
        let (cache, arena) = arena.split_at_mut(self.prepared_len());
        let (spectrum, halfway) = arena.split_at_mut(self.kernel_len());
        let [part_rows, part_cols] = self.part.ranges();
        let [top, left] = self.valid_from();
        let (down, across) = (rows.tiles_of(&part_rows), cols.tiles_of(&part_cols));
        for i in down.clone() {
            // The rows of windows that the row of tiles before has not read.
            let first = if i == down.start { *rows.windows(i).start() } else { *rows.windows(i).end() };
            for m in first..=*rows.windows(i).end() {
                if let Some(frame) = frame {
                    self.transform_windows(simd, frame, m, &across, cache, scratch)?;
                }
            }
            for j in across.clone() {
                let (valid, columns) = (rows.results(i, &part_rows, top), cols.results(j, &part_cols, left));
                for channel in 0..self.bank.channels {
                    let taps = self.taps(channel);
                    let spectra = match &kernels {
                        None => &filters.halves[taps.start * self.spectrum_len()..],
                        Some(kernels) => {
                            let kernel = kernels.of(channel);
                            let occupied = kernel.occupied();
                            self.transform(simd, &Rows::Kernel::<F>(kernel), occupied, spectrum, scratch)?;
                            &*spectrum
                        }
                    };
                    let sum =
                        TapSum { plan: self, taps: &self.bank.taps[taps], spectra, cache, tile: (i as i32, j as i32) };
                    self.fft.inverse(simd, &sum, valid.clone(), halfway, scratch, &mut |row, values| {
                        let to = output.row_mut(usize::from(channel), i * rows.step + row - top - part_rows.start);
                        let to = &mut to[j * cols.step + columns.start - left - part_cols.start..];
                        narrow_slice(&values[columns.clone()], &mut to[..columns.len()]);
                    })?;
                }
            }
        }
        Ok(())
    }

    /// Numbers of the taps of a channel.
    fn taps(&self, channel: u8) -> Range<usize> {
        let before = |channel| self.bank.taps.partition_point(|tap| u16::from(tap.channel) < channel);
        before(channel.into())..before(u16::from(channel) + 1)
    }

    /// First row and first column of the valid part of a tile.
    fn valid_from(&self) -> [usize; 2] {
        let Geometry { rows, cols } = self.geometry;
        // A kernel in space begins with lag -L: see `super::kernel`.
        [rows, cols].map(|axis| if self.bank.blocks.is_some() { 2 * axis.lead() } else { axis.lead() })
    }

    /// Transforms the windows of row `m` that overlap the frame and that the tiles in columns `across` read.
    fn transform_windows(
        &self,
        simd: Simd,
        frame: &impl FrameRows,
        m: i32,
        across: &Range<usize>,
        cache: &mut [f16],
        scratch: &mut [f32],
    ) -> Result<(), FilterError> {
        let Geometry { rows, cols } = self.geometry;
        for n in *cols.windows(across.start).start()..=*cols.windows(across.end - 1).end() {
            if let Some(slot) = self.slot(m, n) {
                let window = WindowRows { frame, rows, cols, m, occupied: cols.occupied(n), n };
                self.transform(simd, &Rows::Window(window), rows.occupied(m), &mut cache[slot], scratch)?;
            }
        }
        Ok(())
    }

    /// Transforms a plane. It is the only call of the transform, whose code is large and inlined.
    #[inline(never)]
    fn transform<F: FrameRows>(
        &self,
        simd: Simd,
        rows: &Rows<'_, F>,
        occupied: Range<usize>,
        spectrum: &mut [f16],
        scratch: &mut [f32],
    ) -> Result<(), FilterError> {
        Ok(self.fft.forward(simd, rows, occupied, spectrum, scratch)?)
    }

    /// Place of the spectrum of window (m, n) in the cache; `None` where the window does not overlap the frame and is
    /// zero.
    fn slot(&self, m: i32, n: i32) -> Option<Range<usize>> {
        let Geometry { rows, cols } = self.geometry;
        if rows.occupied(m).is_empty() || cols.occupied(n).is_empty() {
            return None;
        }
        let row = m.rem_euclid(rows.span() as i32) as usize;
        let slot = row * cols.window_count() + (n - cols.offsets.0) as usize;
        Some(slot * self.spectrum_len()..(slot + 1) * self.spectrum_len())
    }
}

fn check_len(expected: usize, found: usize) -> Result<(), FilterError> {
    if expected == found { Ok(()) } else { Err(FilterError::Length { expected, found }) }
}

/// The plane that is transformed.
enum Rows<'a, F> {
    Window(WindowRows<'a, F>),
    Kernel(Kernel<'a>),
}

impl<F: FrameRows> RowSource for Rows<'_, F> {
    fn load(&self, row: usize, to: &mut [f32]) {
        match self {
            Self::Window(window) => window.load(row, to),
            Self::Kernel(kernel) => kernel.load(row, to),
        }
    }
}

/// The rows of one window.
struct WindowRows<'a, F> {
    frame: &'a F,
    rows: Axis,
    cols: Axis,
    m: i32,
    n: i32,
    occupied: Range<usize>,
}

impl<F: FrameRows> WindowRows<'_, F> {
    fn load(&self, row: usize, to: &mut [f32]) {
        let frame_row = (self.rows.window_origin(self.m) + row as i32) as usize;
        let first = self.cols.window_origin(self.n) + self.occupied.start as i32;
        to[..self.occupied.start].fill(0.0);
        self.frame.load(frame_row, first as usize, &mut to[self.occupied.clone()]);
        to[self.occupied.end..].fill(0.0);
    }
}

/// The spectrum of one output tile of one channel, as a sum over taps.
struct TapSum<'a> {
    plan: &'a FilterBank<'a>,
    /// The taps of the channel, and their spectra.
    taps: &'a [Tap],
    spectra: &'a [f16],
    cache: &'a [f16],
    tile: (i32, i32),
}

impl ProductSource for TapSum<'_> {
    fn count(&self) -> usize {
        self.taps.len()
    }

    fn product(&self, index: usize) -> Option<[&[f16]; 2]> {
        let (tap, len) = (self.taps.get(index)?, self.plan.spectrum_len());
        let window = (self.tile.0 + i32::from(tap.dy), self.tile.1 + i32::from(tap.dx));
        let slot = self.plan.slot(window.0, window.1)?;
        Some([self.spectra.get(index * len..(index + 1) * len)?, self.cache.get(slot)?])
    }
}
