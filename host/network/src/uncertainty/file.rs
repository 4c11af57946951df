//! The file of widths, an artifact of kind `uncertainty`.

use super::UncertaintyError;
use super::observer::{FRAME, GROUPS, PIXEL};
use super::scale::{Scale, TERMS};
use super::scores::BINS;
use super::widths::{Made, Widths};
use ndarray::{ArrayD, IxDyn};
use ommatidia_session::artifact::{self, Header, Provenance, Tensors, file_hash};
use std::path::Path;

/// Kind of the artifact in its header.
pub const KIND: &str = "uncertainty";
/// Version of its layout.
pub const VERSION: u32 = 1;

/// Characters of a hash that messages show.
const SHOWN: usize = 12;

impl Widths {
    /// Writes the file, whole or not at all.
    ///
    /// Tensors: `ranges` [features of a pixel, (mean, standard deviation, least, largest)], `coefficients` [number of
    /// terms], `frames` [scenes, features of a frame], `misfits` [scenes, 2], `histograms` [scenes, groups, bins].
    ///
    /// # Errors
    /// The folder is missing or not writable.
    pub fn write(&self, path: &Path, provenance: Provenance) -> Result<(), UncertaintyError> {
        let n = self.frames.len();
        let flat = |all: &[[f64; FRAME]]| all.iter().flatten().map(|v| *v as f32).collect::<Vec<_>>();
        let misfits: Vec<f32> = self.misfits.iter().flatten().map(|v| *v as f32).collect();
        let parts = [
            ("ranges", vec![PIXEL, 4], self.scale.ranges.iter().flatten().copied().collect()),
            ("coefficients", vec![TERMS], self.scale.coefficients.to_vec()),
            ("frames", vec![n, FRAME], flat(&self.frames)),
            ("misfits", vec![n, 2], misfits),
            ("histograms", vec![n, GROUPS, BINS], self.histograms.clone()),
        ];
        let mut tensors = Tensors::new();
        for (name, shape, values) in parts {
            let wrong = |e: ndarray::ShapeError| damaged(path, format!("{name}: {e}"));
            tensors.insert(name.into(), ArrayD::from_shape_vec(IxDyn(&shape), values).map_err(wrong)?);
        }
        let header = Header { kind: KIND.into(), version: VERSION, provenance, body: self.made.clone() };
        Ok(artifact::write(path, &header, &tensors)?)
    }

    /// Reads the file.
    ///
    /// # Errors
    /// The file is missing, of another kind or version, or damaged.
    pub fn read(path: &Path) -> Result<Self, UncertaintyError> {
        let (header, mut tensors) = artifact::read::<Made>(path, KIND, VERSION)?;
        let made = header.body;
        let n = made.scenes;
        let mut take = |name: &str, shape: &[usize]| -> Result<Vec<f32>, UncertaintyError> {
            let shape: Vec<_> = shape.iter().copied().map(Some).collect();
            Ok(artifact::take(path, &mut tensors, name, &shape)?.into_raw_vec_and_offset().0)
        };
        let ranges = take("ranges", &[PIXEL, 4])?;
        let coefficients = take("coefficients", &[TERMS])?;
        let frames = take("frames", &[n, FRAME])?;
        let misfits = take("misfits", &[n, 2])?;
        let histograms = take("histograms", &[n, GROUPS, BINS])?;
        if n == 0 || made.neighbours == 0 || ranges.chunks(4).any(|r| r[1] <= 0.0 || r[2] > r[3]) {
            return Err(damaged(path, "a number is out of range".into()));
        }
        if made.units.iter().any(|u| !(u.is_finite() && *u > 0.0)) || histograms.iter().any(|n| *n < 0.0) {
            return Err(damaged(path, "a number is out of range".into()));
        }
        Ok(Self {
            scale: Scale {
                ranges: std::array::from_fn(|k| std::array::from_fn(|i| ranges[4 * k + i])),
                coefficients: std::array::from_fn(|k| coefficients[k]),
            },
            frames: frames.chunks(FRAME).map(|c| std::array::from_fn(|k| f64::from(c[k]))).collect(),
            misfits: misfits.chunks(2).map(|c| std::array::from_fn(|k| f64::from(c[k]))).collect(),
            histograms,
            made,
        })
    }

    /// Checks that the widths at `path` belong to this method, made from the file `with`, and to the file `instrument`.
    ///
    /// # Errors
    /// They belong to another one, or a file cannot be read.
    pub fn check(&self, path: &Path, method: &str, with: &Path, instrument: &Path) -> Result<(), UncertaintyError> {
        let files = [("method file", with, &self.made.method_file), ("instrument", instrument, &self.made.instrument)];
        for (what, given, expected) in files {
            let found = file_hash(given)?;
            if found != *expected {
                let short = |hash: &str| hash.chars().take(SHOWN).collect();
                let (expected, found) = (short(expected), short(&found));
                return Err(UncertaintyError::Other { path: path.into(), what, given: given.into(), expected, found });
            }
        }
        if method != self.made.method {
            let (expected, found) = (self.made.method.clone(), method.into());
            return Err(UncertaintyError::Method { path: path.into(), expected, found });
        }
        Ok(())
    }
}

fn damaged(path: &Path, detail: String) -> UncertaintyError {
    UncertaintyError::File { path: path.into(), detail }
}
