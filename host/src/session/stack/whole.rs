//! Whole stacks at once, for stacks that fit into memory.

use super::layout::{SampleType, StackSpec};
use super::reader::FrameReader;
use super::writer::FrameWriter;
use crate::session::error::SessionError;
use ndarray::{Array3, ArrayView3};
use std::path::Path;

/// Reads a whole stack into memory, [frames, rows, cols]. Use [`FrameReader`] for stacks that may be large.
///
/// # Errors
/// As [`FrameReader::open`] and [`FrameReader::read`].
pub fn read(path: &Path) -> Result<Array3<f32>, SessionError> {
    let mut reader = FrameReader::open(path)?;
    let mut stack = Array3::zeros((reader.len(), reader.rows(), reader.cols()));
    for (i, mut frame) in stack.outer_iter_mut().enumerate() {
        frame.assign(&reader.read(i)?);
    }
    Ok(stack)
}

/// Writes a whole stack, [frames, rows, cols], as float32: .npy or OME-TIFF by the suffix of `path`. The file appears
/// complete or not at all.
///
/// # Errors
/// As [`FrameWriter::create`], [`FrameWriter::push`] and [`FrameWriter::finish`].
pub fn write(path: &Path, stack: ArrayView3<'_, f32>) -> Result<(), SessionError> {
    let (frames, rows, cols) = stack.dim();
    let mut writer =
        FrameWriter::create(path, StackSpec { frames, rows, cols, samples: SampleType::F32, pixel_um: None })?;
    for frame in stack.outer_iter() {
        writer.push(frame)?;
    }
    writer.finish()
}
