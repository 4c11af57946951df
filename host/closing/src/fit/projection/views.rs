//! The optics as an explicit matrix: for each object pixel the window of light behind each lens.
//!
//! The rows of a window are filled up with zeros to whole vectors.

use ndarray::Array2;

/// The rows of windows are filled up to a multiple of so many values.
const VECTOR: usize = 8;

/// The light of unit sources at all object pixels behind all lenses, electrons at the exposure of the calibration.
#[derive(PartialEq)]
pub(crate) struct Views {
    object: [usize; 2],
    sensor: [usize; 2],
    /// Rows and columns of a window.
    side: usize,
    /// For each lens the sensor pixel at which the window of object pixel (0, 0) begins, [row, col]. That of pixel
    /// (r, c) begins r rows and c columns further.
    corners: Vec<[isize; 2]>,
    /// For each lens [object pixels, side, width].
    windows: Vec<Vec<f32>>,
}

impl Views {
    /// Number of values that a matrix of this size takes.
    pub(crate) fn values(object: [usize; 2], side: usize, lenses: usize) -> usize {
        object[0] * object[1] * lenses * side * side.next_multiple_of(VECTOR)
    }

    /// Dark windows of `side` pixels that begin at `corners` for object pixel (0, 0).
    pub(crate) fn dark(object: [usize; 2], sensor: [usize; 2], side: usize, corners: Vec<[isize; 2]>) -> Self {
        let windows = vec![vec![0.0; Self::values(object, side, 1)]; corners.len()];
        Self { object, sensor, side, corners, windows }
    }

    /// Number of object pixels.
    pub(crate) fn unknowns(&self) -> usize {
        self.object[0] * self.object[1]
    }

    /// Rows and columns of the object.
    pub(crate) fn object(&self) -> [usize; 2] {
        self.object
    }

    /// Rows and columns of the sensor.
    pub(crate) fn sensor(&self) -> [usize; 2] {
        self.sensor
    }

    /// Takes the window of an object pixel from the image of a lens.
    pub(crate) fn take(&mut self, lens: usize, [r, c]: [usize; 2], image: &Array2<f32>) {
        let (area, width, x) = (self.side * self.width(), self.width(), r * self.object[1] + c);
        let [top, left] = self.corner(lens, x);
        for (i, row) in self.windows[lens][x * area..(x + 1) * area].chunks_exact_mut(width).enumerate() {
            for (j, v) in row[..self.side].iter_mut().enumerate() {
                if let (Ok(row), Ok(col)) = (usize::try_from(top + i as isize), usize::try_from(left + j as isize)) {
                    *v = image.get((row, col)).copied().unwrap_or(0.0);
                }
            }
        }
    }

    /// Number of values in which a row of a window is stored.
    pub(super) fn width(&self) -> usize {
        self.side.next_multiple_of(VECTOR)
    }

    /// Number of lenses.
    pub(super) fn lenses(&self) -> usize {
        self.corners.len()
    }

    /// Rows and columns of a window.
    pub(super) fn side(&self) -> usize {
        self.side
    }

    /// The sensor pixel at which the window of object pixel `x` begins.
    #[inline(always)]
    pub(super) fn corner(&self, lens: usize, x: usize) -> [isize; 2] {
        let [row, col] = self.corners[lens];
        [row + (x / self.object[1]) as isize, col + (x % self.object[1]) as isize]
    }

    /// The window of an object pixel, [side, width].
    #[inline(always)]
    pub(super) fn window(&self, lens: usize, x: usize) -> &[f32] {
        let area = self.side * self.width();
        &self.windows[lens][x * area..(x + 1) * area]
    }
}
