//! Measured PSFs from files.

use super::image::{Set, moments, normalise};
use crate::error::BenchError;
use crate::family::config::{KernelsConfig, StackOf};
use ndarray::{Array2, Axis};
use ommatidia_session::stack;
use std::path::{Path, PathBuf};

/// Smallest distance between samples, sensor pixels: finer images are binned, so that no sample is passed over.
const FINEST_PX: f64 = 0.2;
/// Largest side of a kernel, samples.
const LARGEST: usize = 257;

/// Reads every stack, those of a folder in the order of their names.
///
/// The background of a frame is the median of its border, and light below it counts as none. A stack is centred on the
/// light of its middle frame; what the other frames of a stack of depths are displaced by stays, that of a field does
/// not: there the place of a focus is that of its chief ray.
pub(super) fn read(config: &KernelsConfig) -> Result<Set, BenchError> {
    let mut files: Vec<PathBuf> = Vec::new();
    for path in config.psfs.iter().map(PathBuf::from) {
        if path.is_file() {
            files.push(path);
            continue;
        }
        let io = |source| BenchError::Io { path: path.clone(), source };
        let entries = std::fs::read_dir(&path).map_err(io)?.map(|e| Ok(e.map_err(io)?.path()));
        let mut inside = entries.collect::<Result<Vec<_>, BenchError>>()?;
        inside.retain(|f| f.extension().and_then(|e| e.to_str()).is_some_and(|e| ["npy", "tif", "tiff"].contains(&e)));
        if inside.is_empty() {
            return Err(wrong(&path, "stacks of PSFs (.npy, .tif)", "none"));
        }
        inside.sort();
        files.extend(inside);
    }
    let stacks = files.iter().map(|f| frames(f, config.stack_of)).collect::<Result<Vec<_>, _>>()?;
    // Stacks of depths have the focus in their middle, and may reach to different depths on either side.
    let count = stacks.iter().map(Vec::len).min().unwrap_or(0);
    let of_field = config.stack_of == StackOf::Field;
    if let Some((file, stack)) = files.iter().zip(&stacks).find(|(_, s)| of_field && s.len() != count) {
        return Err(wrong(file, &format!("{count} frames, as in another file"), &stack.len().to_string()));
    }
    let stacks: Vec<&[Array2<f32>]> = stacks.iter().map(|s| &s[(s.len() - count) / 2..][..count]).collect();
    let side = stacks.iter().copied().flatten().map(Array2::nrows).max().unwrap_or(1);
    // The width of the middle frames sets the scale.
    let widths = stacks.iter().map(|s| square(&s[count / 2], side)).map(|k| moments(&k, side).1);
    let width = widths.sum::<f64>() / stacks.len() as f64;
    let fine_px = config.rms_px / width.max(1e-3);
    // An odd number of samples has a middle one.
    let bin = (((FINEST_PX / fine_px).floor() as usize).max(2) - 1) | 1;
    let binned_side = ((side / bin) | 1).min(LARGEST);
    let image = |frame: &Array2<f32>| binned(&square(frame, side), side, bin, binned_side);
    let images = stacks.iter().map(|stack| match config.stack_of {
        StackOf::Depths => stack.iter().map(|frame| vec![image(frame)]).collect(),
        StackOf::Field => vec![stack.iter().map(image).collect::<Vec<_>>()],
    });
    Ok(Set { images: images.collect(), side: binned_side, step_px: fine_px * bin as f64 })
}

fn wrong(path: &Path, expected: &str, found: &str) -> BenchError {
    let expected = format!("{expected} in {}", path.display());
    BenchError::Config { field: "kernels.psfs", expected, found: found.into() }
}

/// The frames of a file without background, centred.
fn frames(file: &Path, stack_of: StackOf) -> Result<Vec<Array2<f32>>, BenchError> {
    let stack = stack::read(file)?;
    let n = stack.len_of(Axis(0));
    let grid = (n as f64).sqrt().round() as usize;
    if n == 0 || (stack_of == StackOf::Field && grid * grid != n) {
        return Err(wrong(file, "one or more frames; of a field, a square number of them", &n.to_string()));
    }
    if stack.len_of(Axis(1)).max(stack.len_of(Axis(2))) > 1024 {
        return Err(wrong(file, "frames of at most 1024 pixels a side", &format!("{:?}", stack.dim())));
    }
    let mut clean: Vec<Array2<f32>> = Vec::with_capacity(n);
    for (i, frame) in stack.outer_iter().enumerate() {
        let level = border(&frame.to_owned());
        let frame = frame.mapv(|v| if v.is_finite() { (v - level).max(0.0) } else { 0.0 });
        if frame.sum() <= 0.0 {
            return Err(wrong(file, "light above the border of each frame", &format!("none in frame {i}")));
        }
        clean.push(frame);
    }
    let middle = centroid(&clean[n / 2]);
    let centre = |frame: &Array2<f32>| match stack_of {
        StackOf::Depths => middle,
        StackOf::Field => centroid(frame),
    };
    Ok(clean.iter().map(|frame| centred(frame, centre(frame))).collect())
}

/// Median of the border of a frame.
fn border(frame: &Array2<f32>) -> f32 {
    let (rows, cols) = frame.dim();
    let at_edge = |(r, c): (usize, usize)| r == 0 || c == 0 || r + 1 == rows || c + 1 == cols;
    let mut edge: Vec<f32> =
        frame.indexed_iter().filter(|(at, v)| at_edge(*at) && v.is_finite()).map(|(_, v)| *v).collect();
    edge.sort_by(f32::total_cmp);
    edge.get(edge.len() / 2).copied().unwrap_or(0.0)
}

fn centroid(frame: &Array2<f32>) -> [f64; 2] {
    let total: f64 = frame.iter().map(|v| f64::from(*v)).sum();
    let mean =
        |axis: usize| frame.indexed_iter().map(|((r, c), v)| f64::from(*v) * [r, c][axis] as f64).sum::<f64>() / total;
    [mean(0), mean(1)]
}

/// A square frame of odd side with `at` in its middle, by bilinear interpolation.
fn centred(frame: &Array2<f32>, at: [f64; 2]) -> Array2<f32> {
    let side = frame.nrows().max(frame.ncols()) | 1;
    let value = |r: i64, c: i64| match (usize::try_from(r), usize::try_from(c)) {
        (Ok(r), Ok(c)) => frame.get([r, c]).copied().unwrap_or(0.0),
        _ => 0.0,
    };
    Array2::from_shape_fn((side, side), |(r, c)| {
        let [y, x] = [(r, at[0]), (c, at[1])].map(|(i, at)| i as f64 - (side / 2) as f64 + at);
        let (r0, c0) = (y.floor(), x.floor());
        let (fr, fc) = ((y - r0) as f32, (x - c0) as f32);
        let (r0, c0) = (r0 as i64, c0 as i64);
        let line = |r: i64| value(r, c0) * (1.0 - fc) + value(r, c0 + 1) * fc;
        line(r0) * (1.0 - fr) + line(r0 + 1) * fr
    })
}

/// A frame in the middle of a square of `side`, row by row.
fn square(frame: &Array2<f32>, side: usize) -> Vec<f32> {
    let mut out = vec![0.0; side * side];
    let off = (side - frame.nrows()) / 2;
    for ((r, c), v) in frame.indexed_iter() {
        out[(r + off) * side + c + off] = *v;
    }
    out
}

/// Sums of `bin` x `bin` samples around the middle, [to, to], with a sum of 1.
fn binned(image: &[f32], side: usize, bin: usize, to: usize) -> Vec<f32> {
    let mut out = vec![0.0f32; to * to];
    // The middle sample of the result holds the middle of the image.
    let first = (side / 2) as i64 - ((to / 2) * bin + bin / 2) as i64;
    for (i, v) in out.iter_mut().enumerate() {
        let start = [i / to, i % to].map(|k| first + (k * bin) as i64);
        for r in (start[0]..start[0] + bin as i64).filter(|r| (0..side as i64).contains(r)) {
            for c in (start[1]..start[1] + bin as i64).filter(|c| (0..side as i64).contains(c)) {
                *v += image[r as usize * side + c as usize];
            }
        }
    }
    normalise(&mut out);
    out
}
