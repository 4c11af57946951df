//! A session: its stacks of frames, with their truths and noise-free frames where it has some.

use super::source::{Description, Group, Pane, Picture, Source};
use super::stack::times_and_notes;
use anyhow::Context;
use ommatidia_report::number;
use ommatidia_session::{FrameInfo, FrameReader, Manifest, Session, Stack, TruthReader};
use std::path::Path;

/// An open session.
pub struct SessionSource {
    session: Session,
    description: Description,
    /// The stack that was read last, and its readers.
    open: Option<(usize, Readers)>,
}

struct Readers {
    frames: FrameReader,
    truth: Option<TruthReader>,
    expected: Option<FrameReader>,
}

impl SessionSource {
    /// Opens a session.
    ///
    /// # Errors
    /// It cannot be read.
    pub fn open(path: &Path) -> anyhow::Result<Self> {
        let session = Session::open(path)?;
        let groups = session.stacks().iter().map(|stack| group(stack, session.manifest())).collect::<Result<_, _>>()?;
        let facts = super::facts::of_manifest(session.manifest());
        let mut notes = session.notes();
        for stack in session.stacks() {
            notes.extend(of_frames(stack)?);
        }
        let description = Description { facts, notes, groups };
        Ok(Self { session, description, open: None })
    }
}

/// What a person should know of the frames of a stack: what the table marks as damaged, and what is damaged or missing
/// in the recording that it refers to.
fn of_frames(stack: &Stack) -> anyhow::Result<Vec<String>> {
    let (_, notes) = times_and_notes(&stack.frames()?);
    let marked = stack.damaged_note("they are shown as they are");
    Ok(marked.into_iter().chain(notes.into_iter().map(|note| format!("{}: {note}", stack.entry().file))).collect())
}

/// What a stack shows.
fn group(stack: &Stack, m: &Manifest) -> anyhow::Result<Group> {
    let sensor = [m.sensor.rows, m.sensor.cols];
    let samples = stack.frames()?.samples();
    let mut panes = vec![Pane { samples, ..Pane::raw("frame", sensor, m.sensor.pixel_pitch_um) }];
    if stack.entry().truth.is_some() {
        panes.push(Pane::object("truth", [m.object.rows, m.object.cols], Some(m.object.pixel_um), "unit of the truth"));
    }
    if stack.entry().expected.is_some() {
        panes.push(Pane::raw("noise-free frame", sensor, m.sensor.pixel_pitch_um));
    }
    let z_um: Vec<f64> = stack.info().iter().map(|info| info.z_um).collect();
    let several = z_um.windows(2).any(|two| two[0] != two[1]);
    let name = format!("{}: {}", stack.role().name(), stack.entry().file);
    Ok(Group { name, frames: stack.len(), z_um: if several { z_um } else { Vec::new() }, panes, swipe: None })
}

impl Source for SessionSource {
    fn description(&self) -> &Description {
        &self.description
    }

    fn read(&mut self, group: usize, pane: usize, frame: usize) -> anyhow::Result<Picture> {
        let stack = self.session.stacks().get(group).context("no such stack")?;
        let label = stack.info().get(frame).map(label).unwrap_or_default();
        let (_, readers) = match self.open.take().filter(|(at, _)| *at == group) {
            Some(open) => self.open.insert(open),
            None => {
                let readers = Readers { frames: stack.frames()?, truth: stack.truth()?, expected: stack.expected()? };
                self.open.insert((group, readers))
            }
        };
        let Readers { frames, truth, expected } = readers;
        let values = match (pane, truth, expected) {
            (0, ..) => frames.read(frame)?,
            (1, Some(truth), _) => truth.read(frame)?,
            (1 | 2, _, Some(expected)) => expected.read(frame)?,
            _ => anyhow::bail!("no such picture"),
        };
        Ok(Picture { values, label })
    }
}

/// What the table says of a frame.
fn label(info: &FrameInfo) -> String {
    let mut parts = Vec::new();
    for (name, value, unit, usual) in [
        ("x", info.x_um, " um", 0.0),
        ("y", info.y_um, " um", 0.0),
        ("z", info.z_um, " um", 0.0),
        ("exposure", info.exposure_ms, " ms", f64::NAN),
        ("light", info.illumination, "", 1.0),
        ("time", info.time_s, " s", 0.0),
    ] {
        if value != usual {
            parts.push(format!("{name} {}{unit}", number(value)));
        }
    }
    parts.join(", ")
}
