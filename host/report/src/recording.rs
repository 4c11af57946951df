//! Recordings of one's own: thumbnails of frames or objects whose truth nobody knows.

use super::error::ReportError;
use super::look::Look;
use super::page::Numbers;
use super::picture::{Scale, number, picture, scale_bar};
use maud::{Markup, html};
use ndarray::{Array2, Axis};
use ommatidia_session::{FrameReader, ObjectGrid, SensorSpec};
use std::path::{Path, PathBuf};

/// Most frames that are shown.
const SHOWN: usize = 8;

/// Frames of a recording, evenly spread over it.
#[derive(Clone, Debug)]
pub struct Recording {
    path: PathBuf,
    /// Frames, rows, columns.
    shape: [usize; 3],
    /// Number of each frame that is shown, and the frame.
    frames: Vec<(usize, Array2<f32>)>,
}

impl Recording {
    /// Reads at most eight frames of a stack, the first among them.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn read(path: &Path) -> Result<Self, ReportError> {
        let mut reader = FrameReader::open(path)?;
        let (len, shown) = (reader.len(), SHOWN.min(reader.len()));
        let numbers = (0..shown).map(|i| i * len / shown);
        let frames = numbers.map(|i| Ok((i, reader.read(i)?))).collect::<Result<_, ReportError>>()?;
        Ok(Self { path: path.into(), shape: [len, reader.rows(), reader.cols()], frames })
    }

    /// Its shape in words.
    pub fn describe(&self) -> String {
        let [frames, rows, cols] = self.shape;
        format!("{frames} frames of {rows} × {cols} pixels")
    }

    fn name(&self) -> String {
        self.path.file_name().unwrap_or_default().to_string_lossy().into_owned()
    }
}

/// What the pixels of a recording are, judged by their number.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Pixels {
    /// Of a sensor with this pitch, um.
    Sensor(f64),
    /// Of an object with pixels of this side, um.
    Object(f64),
    /// Of neither, or of both: their size is not known.
    Unknown,
}

impl Pixels {
    /// The pixels of frames of this size, if `grids` has just one sensor or just one object of the same size.
    pub fn of(rows: usize, cols: usize, grids: &[(SensorSpec, ObjectGrid)]) -> Self {
        let object = grids.iter().map(|(_, o)| o).find(|o| (o.rows, o.cols) == (rows, cols));
        let sensor = grids.iter().map(|(s, _)| s).find(|s| (s.rows, s.cols) == (rows, cols));
        match (object, sensor) {
            (Some(object), None) => Self::Object(object.pixel_um),
            (None, Some(sensor)) => Self::Sensor(sensor.pixel_pitch_um),
            _ => Self::Unknown,
        }
    }
}

/// Thumbnails of a recording, all on one colour scale. Its lengths come from an instrument, session or evaluation of
/// the same size among the inputs.
///
/// # Errors
/// A picture cannot be encoded.
pub fn recording(
    r: &Recording,
    grids: &[(SensorSpec, ObjectGrid)],
    numbers: &mut Numbers,
) -> Result<Markup, ReportError> {
    let [_, rows, cols] = r.shape;
    let pixels = Pixels::of(rows, cols, grids);
    let (scale, unit) = scale(&r.frames, pixels);
    let bar = match pixels {
        Pixels::Sensor(um) | Pixels::Object(um) => Some(scale_bar(cols as f64 * um)),
        Pixels::Unknown => None,
    };
    let marks: Vec<_> = bar.into_iter().collect();
    let plates = r.frames.iter().map(|(i, frame)| -> Result<Markup, ReportError> {
        let high = frame.iter().copied().filter(|v| v.is_finite()).fold(f32::NEG_INFINITY, f32::max);
        let alt = format!("{}, frame {i}", r.name());
        Ok(html! {
            div.plate {
                p.name { "Frame " (i) span { "max " (number(f64::from(high))) } }
                (picture(frame.view(), &scale, &alt, &marks)?)
            }
        })
    });
    let plates = plates.collect::<Result<Vec<_>, _>>()?;
    let columns = plates.len().clamp(1, 4);
    let body = html! {
        div.plates style={ "grid-template-columns:repeat(" (columns) ",1fr)" } { @for plate in plates { (plate) } }
        (scale.bar(unit))
    };
    let what = match pixels {
        Pixels::Sensor(_) => "Raw frames; scale bar on the sensor.",
        Pixels::Object(_) => "Objects; scale bar in the object.",
        Pixels::Unknown => {
            "No instrument, session or evaluation in this report has frames of this size: the lengths \
                            are unknown."
        }
    };
    let range = match pixels {
        Pixels::Sensor(_) => "from the 1st to the 99.8th percentile",
        _ => "from 0 (or the 1st percentile, if that is negative) to the 99.7th percentile",
    };
    let text = format!(
        "{}, {} of them shown, evenly spread. {what} One linear colour scale for all, {range} of the frames shown. The \
         truth of a recording is not known: nothing here says how right it is.",
        r.describe(),
        r.frames.len()
    );
    Ok(numbers.figure(&format!("{}.", r.name()), &text, body))
}

/// One scale for all frames, and its unit.
fn scale(frames: &[(usize, Array2<f32>)], pixels: Pixels) -> (Scale, &'static str) {
    let views: Vec<_> = frames.iter().map(|(_, frame)| frame.view()).collect();
    let all = ndarray::concatenate(Axis(0), &views).unwrap_or_default();
    match pixels {
        Pixels::Sensor(_) => (Look::Raw.scale(all.view()), "DN"),
        _ => (Look::Light.scale(all.view()), "(unit of the recording)"),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use ndarray::Array3;
    use ommatidia_session::stack;

    #[test]
    fn a_recording_shows_frames_over_its_whole_length_with_a_scale() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("mine.npy");
        stack::write(&path, Array3::from_shape_fn((20, 6, 9), |(i, r, c)| (i + r * c) as f32).view()).unwrap();
        let recording = Recording::read(&path).unwrap();
        assert_eq!(recording.frames.iter().map(|f| f.0).collect::<Vec<_>>(), [0, 2, 5, 7, 10, 12, 15, 17]);
        let sensor = SensorSpec { rows: 30, cols: 30, pixel_pitch_um: 1.85, bit_depth: 12 };
        let object = ObjectGrid { rows: 6, cols: 9, pixel_um: 20.0 };
        let page = |grids: &[(SensorSpec, ObjectGrid)]| {
            super::recording(&recording, grids, &mut Numbers::default()).unwrap().into_string()
        };
        let known = page(&[(sensor, object)]);
        for text in ["mine.npy.", "20 frames of 6 × 9 pixels", " µm</b>", "Frame 17", "scale bar in the object"] {
            assert!(known.contains(text), "{text} is missing: {known}");
        }
        assert_eq!(known.matches("<img").count(), 8);
        let unknown = page(&[]);
        assert!(unknown.contains("lengths are unknown") && !unknown.contains("µm"));
        assert!(page(&[(SensorSpec { rows: 6, cols: 9, ..sensor }, ObjectGrid { rows: 5, ..object })]).contains("DN"));
    }
}
