//! Writes a stack as OME-Zarr 0.5: a folder of Zarr 3 arrays at several resolutions, with axes and units.
//!
//! The chunks are not compressed. A chunk holds several frames, about four megabytes, so that a long stack is not a
//! folder of a hundred thousand files.

use super::METADATA;
use crate::stack::layout::{SampleType, StackSpec};
use serde_json::{Value, json};
use std::fs;
use std::io::Result;
use std::path::{Path, PathBuf};

/// Bytes of a chunk of the finest resolution, about.
const CHUNK_BYTES: usize = 4 << 20;
/// Most frames of a chunk.
const CHUNK_FRAMES: usize = 64;
/// Coarser resolutions are added while the shorter side has more than this many pixels.
const COARSEST: usize = 128;

/// Writes frames one at a time into a folder.
#[derive(Debug)]
pub(in super::super) struct ZarrWriter {
    folder: PathBuf,
    spec: StackSpec,
    levels: Vec<Level>,
    chunk_frames: usize,
    pushed: usize,
    /// Smallest and largest value.
    range: [f32; 2],
}

/// One resolution.
#[derive(Debug)]
struct Level {
    rows: usize,
    cols: usize,
    /// Frames of the chunk that is being filled.
    chunk: Vec<u8>,
}

impl ZarrWriter {
    /// Starts a stack in an empty folder.
    pub fn create(folder: &Path, spec: StackSpec) -> Result<Self> {
        let frame = spec.rows * spec.cols * spec.samples.bytes();
        let (mut rows, mut cols, mut levels) = (spec.rows, spec.cols, Vec::new());
        loop {
            levels.push(Level { rows, cols, chunk: Vec::new() });
            if rows.min(cols) <= COARSEST {
                break;
            }
            (rows, cols) = (rows.div_ceil(2), cols.div_ceil(2));
        }
        let chunk_frames = (CHUNK_BYTES / frame.max(1)).clamp(1, CHUNK_FRAMES).min(spec.frames.max(1));
        let range = [f32::INFINITY, f32::NEG_INFINITY];
        Ok(Self { folder: folder.into(), spec, levels, chunk_frames, pushed: 0, range })
    }

    /// Appends a frame, row by row.
    pub fn push(&mut self, mut values: Vec<f32>) -> Result<()> {
        for v in &values {
            self.range = [self.range[0].min(*v), self.range[1].max(*v)];
        }
        for i in 0..self.levels.len() {
            if i > 0 {
                let (finer, level) = (&self.levels[i - 1], &self.levels[i]);
                values = halved(&values, [finer.rows, finer.cols], [level.rows, level.cols]);
            }
            append(&mut self.levels[i].chunk, &values, self.spec.samples);
        }
        self.pushed += 1;
        if self.pushed.is_multiple_of(self.chunk_frames) { self.flush() } else { Ok(()) }
    }

    /// Writes the chunks that are being filled; the last ones are filled up with zeros.
    fn flush(&mut self) -> Result<()> {
        let index = (self.pushed - 1) / self.chunk_frames;
        for (i, level) in self.levels.iter_mut().enumerate() {
            let folder = self.folder.join(format!("{i}/c/{index}/0/0"));
            fs::create_dir_all(&folder)?;
            level.chunk.resize(self.chunk_frames * level.rows * level.cols * self.spec.samples.bytes(), 0);
            fs::write(folder.join("0"), &level.chunk)?;
            level.chunk.clear();
        }
        Ok(())
    }

    /// Writes what is left, and the metadata.
    pub fn finish(mut self, name: &str, interval_s: Option<f64>) -> Result<()> {
        if !self.levels[0].chunk.is_empty() {
            self.flush()?;
        }
        for (i, level) in self.levels.iter().enumerate() {
            let folder = self.folder.join(i.to_string());
            fs::create_dir_all(&folder)?;
            fs::write(folder.join(METADATA), format!("{:#}\n", self.array(level)))?;
        }
        fs::write(self.folder.join(METADATA), format!("{:#}\n", self.group(name, interval_s)))
    }

    fn array(&self, level: &Level) -> Value {
        let kind = match self.spec.samples {
            SampleType::U8 => "uint8",
            SampleType::U16 => "uint16",
            SampleType::F32 => "float32",
        };
        let bytes = match self.spec.samples {
            SampleType::U8 => json!({ "name": "bytes" }),
            _ => json!({ "name": "bytes", "configuration": { "endian": "little" } }),
        };
        json!({
            "zarr_format": 3, "node_type": "array", "attributes": {},
            "shape": [self.pushed, 1, level.rows, level.cols], "data_type": kind, "fill_value": 0,
            "chunk_grid": {
                "name": "regular", "configuration": { "chunk_shape": [self.chunk_frames, 1, level.rows, level.cols] },
            },
            "chunk_key_encoding": { "name": "default", "configuration": { "separator": "/" } },
            "codecs": [bytes], "dimension_names": ["t", "c", "y", "x"],
        })
    }

    /// The metadata of OME-Zarr: axes with units, and the scale of each resolution.
    fn group(&self, name: &str, interval_s: Option<f64>) -> Value {
        let axis = |name: &str, kind: &str, unit: Option<&str>| match unit {
            Some(unit) => json!({ "name": name, "type": kind, "unit": unit }),
            None => json!({ "name": name, "type": kind }),
        };
        let length = self.spec.pixel_um.map(|_| "micrometer");
        let axes = [
            axis("t", "time", interval_s.map(|_| "second")),
            axis("c", "channel", None),
            axis("y", "space", length),
            axis("x", "space", length),
        ];
        let pixel = self.spec.pixel_um.unwrap_or(1.0);
        let dataset = |i: usize| {
            let factor = (1usize << i) as f64;
            // A pixel of a coarser resolution lies in the middle of those that it is the mean of.
            let (side, shift) = (pixel * factor, pixel * (factor - 1.0) / 2.0);
            json!({ "path": i.to_string(), "coordinateTransformations": [
                { "type": "scale", "scale": [interval_s.unwrap_or(1.0), 1.0, side, side] },
                { "type": "translation", "translation": [0.0, 0.0, shift, shift] },
            ] })
        };
        let datasets: Vec<Value> = (0..self.levels.len()).map(dataset).collect();
        let [low, high] = self.range;
        json!({
            "zarr_format": 3, "node_type": "group",
            "attributes": { "ome": {
                "version": "0.5",
                "multiscales": [{
                    "name": name, "axes": axes, "datasets": datasets, "type": "mean",
                    "metadata": { "program": concat!("ommatidia ", env!("CARGO_PKG_VERSION")) },
                }],
                "omero": { "channels": [{
                    "label": "light", "color": "FFFFFF", "active": true,
                    "window": { "min": low, "max": high, "start": low, "end": high },
                }] },
            } },
        })
    }
}

/// Means of two by two pixels; at an odd edge, of those that are there.
fn halved(values: &[f32], [rows, cols]: [usize; 2], [half_rows, half_cols]: [usize; 2]) -> Vec<f32> {
    let mut out = Vec::with_capacity(half_rows * half_cols);
    for r in 0..half_rows {
        for c in 0..half_cols {
            let (mut sum, mut count) = (0.0, 0.0);
            for r in 2 * r..(2 * r + 2).min(rows) {
                for v in &values[r * cols + 2 * c..r * cols + (2 * c + 2).min(cols)] {
                    (sum, count) = (sum + v, count + 1.0);
                }
            }
            out.push(sum / count);
        }
    }
    out
}

/// Appends values in the byte order of the array.
fn append(chunk: &mut Vec<u8>, values: &[f32], samples: SampleType) {
    match samples {
        SampleType::U8 => chunk.extend(values.iter().map(|v| v.round() as u8)),
        SampleType::U16 => chunk.extend(values.iter().flat_map(|v| (v.round() as u16).to_le_bytes())),
        SampleType::F32 => chunk.extend(values.iter().flat_map(|v| v.to_le_bytes())),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn chunks_and_resolutions_hold_the_frames_and_their_means() {
        let folder = tempfile::tempdir().unwrap();
        let (frames, rows, cols) = (70, 131, 260);
        let spec = StackSpec { frames, rows, cols, samples: SampleType::F32, pixel_um: Some(2.0) };
        let mut writer = ZarrWriter::create(folder.path(), spec).unwrap();
        let value = |f: usize, r: usize, c: usize| (1000 * f + 10 * r + c) as f32;
        for f in 0..frames {
            writer.push((0..rows * cols).map(|i| value(f, i / cols, i % cols)).collect()).unwrap();
        }
        let per_chunk = writer.chunk_frames;
        writer.finish("objects", Some(0.05)).unwrap();
        let json = |name: &str| -> Value {
            serde_json::from_str(&fs::read_to_string(folder.path().join(name)).unwrap()).unwrap()
        };
        assert_eq!(json("0/zarr.json")["shape"], json!([frames, 1, rows, cols]));
        assert_eq!(json("1/zarr.json")["shape"], json!([frames, 1, 66, 130]));
        let scale = &json("zarr.json")["attributes"]["ome"]["multiscales"][0]["datasets"][1];
        assert_eq!(scale["coordinateTransformations"][0]["scale"], json!([0.05, 1.0, 4.0, 4.0]));
        assert_eq!(scale["coordinateTransformations"][1]["translation"], json!([0.0, 0.0, 1.0, 1.0]));
        let at = |level: usize, [rows, cols]: [usize; 2], [f, r, c]: [usize; 3]| {
            let chunk = fs::read(folder.path().join(format!("{level}/c/{}/0/0/0", f / per_chunk))).unwrap();
            assert_eq!(chunk.len(), per_chunk * rows * cols * 4);
            let i = 4 * ((f % per_chunk * rows + r) * cols + c);
            f32::from_le_bytes(chunk[i..i + 4].try_into().unwrap())
        };
        assert_eq!(at(0, [rows, cols], [69, 130, 259]), value(69, 130, 259));
        assert_eq!(at(1, [66, 130], [3, 1, 2]), value(3, 2, 4) + 5.5);
        // The last row has no second row to take the mean with.
        assert_eq!(at(1, [66, 130], [69, 65, 0]), value(69, 130, 0) + 0.5);
    }
}
