//! Reads the frames of an OME-Zarr image, or of a plain array.

use super::array::Array;
use super::image::Image;
use super::json::{ARRAY_2, ATTRIBUTES_2, GROUP_2, METADATA};
use crate::error::SessionError;
use crate::stack::chunks::Chunks;
use crate::stack::layout::{Shape, StackScale};
use std::io::{Error, ErrorKind};
use std::path::Path;

const KIND: &str = "Zarr";
const NAMES: [&str; 4] = [METADATA, ARRAY_2, ATTRIBUTES_2, GROUP_2];

/// An open array of Zarr.
#[derive(Debug)]
pub(in super::super) struct ZarrSource {
    array: Array,
    chunks: Chunks,
    /// Which axes of the array are those of frames, rows and columns. Without frames there is one.
    axes: [Option<usize>; 3],
    pub scale: StackScale,
}

/// Whether a folder is one of Zarr: of an image, an array, or a group of them.
pub fn is_zarr(folder: &Path) -> bool {
    NAMES.iter().any(|name| folder.join(name).is_file())
}

impl ZarrSource {
    pub fn open(path: &Path) -> Result<(Shape, Self), SessionError> {
        let failed = |e| error(path, e);
        let (array, names, scale) = match Image::open(path).map_err(failed)? {
            Some(image) => {
                let array = Array::open(&path.join(&image.path)).map_err(failed)?;
                let missing = || SessionError::format(path, KIND, format!("no array at `{}`", image.path));
                (array.ok_or_else(missing)?, image.axes, image.scale)
            }
            None => (Array::open(path).map_err(failed)?.ok_or_else(|| group(path))?, Vec::new(), StackScale::default()),
        };
        let axes = axes(path, &array, &names)?;
        let along = |sizes: &[usize]| axes.map(|axis| axis.map_or(1, |axis| sizes[axis]));
        let [len, rows, cols] = along(&array.shape);
        let chunks = Chunks::new([len, rows, cols], along(&array.chunk), array.number).map_err(failed)?;
        let shape = Shape { len, rows, cols, samples: array.number.samples() };
        Ok((shape, Self { array, chunks, axes, scale }))
    }

    pub fn read(&mut self, path: &Path, i: usize) -> Result<Vec<f32>, SessionError> {
        let (array, axes, bytes) = (&self.array, self.axes, self.chunks.chunk_bytes());
        let fetch = |at: [usize; 3]| {
            let mut place = vec![0; array.shape.len()];
            axes.iter().zip(at).for_each(|(axis, at)| axis.iter().for_each(|axis| place[*axis] = at));
            let named = |e: Error| Error::new(e.kind(), format!("chunk {place:?}: {e}"));
            array.chunk(&place, bytes).map_err(|e| if e.raw_os_error().is_some() { e } else { named(e) })
        };
        let frame = self.chunks.frame(i, &array.fill, fetch).map_err(|e| error(path, e))?;
        Ok(array.number.decode(frame, array.big_endian))
    }
}

/// Which axes are those of frames, rows and columns. The others must have one place.
fn axes(path: &Path, array: &Array, names: &[String]) -> Result<[Option<usize>; 3], SessionError> {
    let (shape, chunk) = (&array.shape, &array.chunk);
    let wrong = |found: String| SessionError::Shape {
        path: path.into(),
        expected: "axes t, c, z, y, x, with one channel and one focal plane, or [frames, rows, cols]".into(),
        found,
        remedy: "save one channel in one focal plane as a stack of its own",
    };
    if chunk.len() != shape.len() {
        return Err(wrong(format!("an array {shape:?} with chunks of {chunk:?}")));
    }
    if names.is_empty() {
        let plain = (shape.len() == 3).then_some([Some(0), Some(1), Some(2)]);
        return plain.ok_or_else(|| wrong(format!("{shape:?}")));
    }
    let found = ["t", "y", "x"].map(|name| names.iter().position(|n| n.eq_ignore_ascii_case(name)));
    let [t, Some(y), Some(x)] = found else { return Err(wrong(names.join(", "))) };
    let others = (0..shape.len()).filter(|axis| !found.contains(&Some(*axis)));
    let single = others.into_iter().all(|axis| shape[axis] == 1 && chunk[axis] == 1);
    if names.len() != shape.len() || !single || y > x || t.is_some_and(|t| t > y) {
        return Err(wrong(format!("{} of {shape:?}, in chunks of {chunk:?}", names.join(", "))));
    }
    Ok(found)
}

/// A folder of Zarr that is neither an image nor an array.
fn group(path: &Path) -> SessionError {
    let entries = std::fs::read_dir(path).into_iter().flatten().flatten().map(|e| e.path());
    let mut inner: Vec<String> = entries
        .filter(|p| p.is_dir() && is_zarr(p))
        .filter_map(|p| Some(p.file_name()?.to_string_lossy().into_owned()))
        .take(12)
        .collect();
    inner.sort();
    let found = if inner.is_empty() { "an empty group".into() } else { format!("a group of {}", inner.join(", ")) };
    let expected = "an image of OME-Zarr, or an array [frames, rows, cols]";
    SessionError::value(path, "Zarr", expected, found, "name the folder of one of its images or arrays")
}

fn error(path: &Path, e: Error) -> SessionError {
    match e.kind() {
        _ if e.raw_os_error().is_some() => SessionError::io(path, e),
        ErrorKind::Unsupported => SessionError::value(
            path,
            "Zarr",
            "uint8, uint16, int8, int16, float32 or float64, not compressed or with zstd, gzip, zlib, lz4 or Blosc",
            e,
            "write the array again in such a form",
        ),
        _ => SessionError::format(path, KIND, e),
    }
}
