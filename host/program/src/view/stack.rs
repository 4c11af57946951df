//! A stack of frames or a recording: read frame by frame.

use super::source::{Description, Group, Pane, Picture, Plane, Source};
use ommatidia_report::{Look, Pixels};
use ommatidia_session::import::{Times, losses_of, notes_on, times_or_why};
use ommatidia_session::{FrameReader, ObjectGrid, SampleType, SensorSpec};
use std::path::Path;

/// The times of the frames of a recording, and what a person should know of it: what is lost of it, and what was found
/// in its files.
pub(super) fn times_and_notes(reader: &FrameReader) -> (Option<Times>, Vec<String>) {
    let (times, unread) = times_or_why(reader).unwrap_or_else(|e| (None, Some(format!("{e}; its times are left out"))));
    let mut notes = losses_of(reader).map_or_else(|_| Vec::new(), |losses| losses.warnings(reader.path()));
    notes.extend(unread.into_iter().chain(notes_on(reader)));
    notes.extend(times.iter().flat_map(Times::table_notes));
    (times, notes)
}

/// An open stack.
pub struct StackSource {
    reader: FrameReader,
    times: Option<Times>,
    description: Description,
}

impl StackSource {
    /// Opens a stack. The size of its pixels is that of the instrument or session among `grids` that has frames of this
    /// size, or that which the file states.
    ///
    /// # Errors
    /// It cannot be read.
    pub fn open(path: &Path, grids: &[(SensorSpec, ObjectGrid)]) -> anyhow::Result<Self> {
        let reader = FrameReader::open(path)?;
        let (times, notes) = times_and_notes(&reader);
        let size = [reader.rows(), reader.cols()];
        let stated = reader.scale().pixel_um;
        let whole = reader.samples() != SampleType::F32;
        let (plane, pixel_um) = match Pixels::of(size[0], size[1], grids) {
            Pixels::Sensor(um) => (Plane::Sensor, Some([um; 2])),
            Pixels::Object(um) => (Plane::Object, Some([um; 2])),
            Pixels::Unknown => (Plane::Unknown, stated),
        };
        let raw = plane == Plane::Sensor || (whole && plane == Plane::Unknown);
        let (look, unit) = if raw { (Look::Raw, "DN") } else { (Look::Light, "") };
        let pane =
            Pane { name: "frame".into(), unit: unit.into(), size, pixel_um, plane, look, samples: reader.samples() };
        let mut facts = vec![["frames".into(), reader.len().to_string()]];
        facts.push(["size".into(), format!("{} × {} pixels, {}", size[0], size[1], reader.samples().name())]);
        if pixel_um.is_none() {
            facts.push(["pixel".into(), "size unknown: give an instrument or session of this size, too".into()]);
        }
        let interval_s = times.as_ref().and_then(|t| t.interval_s).or(reader.scale().interval_s);
        if let Some(s) = interval_s {
            facts.push(["interval".into(), format!("{} s", ommatidia_report::number(s))]);
        }
        let name = String::from("frames");
        let groups = vec![Group { name, frames: reader.len(), z_um: Vec::new(), panes: vec![pane], swipe: None }];
        Ok(Self { reader, times, description: Description { facts, notes, groups } })
    }
}

impl Source for StackSource {
    fn description(&self) -> &Description {
        &self.description
    }

    fn read(&mut self, _group: usize, _pane: usize, frame: usize) -> anyhow::Result<Picture> {
        let time_s = self.times.as_ref().and_then(|times| times.time_s.get(frame));
        let label = time_s.map_or(String::new(), |s| format!("{s:.3} s"));
        Ok(Picture { values: self.reader.read(frame)?, label })
    }
}
