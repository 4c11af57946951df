//! The frames that are reconstructed: a file, a folder of a recording, or the scenes of a session; and their times.

use anyhow::bail;
use ommatidia_session::import::{Times, notes_on, set_interval_s, times_of};
use ommatidia_session::kind::FileKind;
use ommatidia_session::{FrameReader, Role, Session};
use std::fmt::Write;
use std::path::Path;

/// Frames with what is known of their times.
pub struct Input {
    /// The frames.
    pub frames: FrameReader,
    /// Times of the frames, where a table has them.
    pub times: Option<Times>,
    /// The time from one frame to the next by the metadata or the files, s, where they state it.
    set_interval_s: Option<f64>,
    /// What is said of frames that the table of a session marks as damaged.
    damaged: Option<String>,
}

impl Input {
    /// Opens a file, a folder of numbered files, or a session with one stack of scenes.
    ///
    /// # Errors
    /// It cannot be read, or the session has no or several stacks of scenes.
    pub fn open(path: &Path) -> anyhow::Result<Self> {
        if path.is_dir() && FileKind::of(path)? == FileKind::Session {
            return Self::of_session(path);
        }
        let frames = FrameReader::open(path)?;
        let times = times_of(&frames)?;
        let set_interval_s = set_interval_s(&frames)?;
        Ok(Self { frames, times, set_interval_s, damaged: None })
    }

    fn of_session(path: &Path) -> anyhow::Result<Self> {
        let session = Session::open(path)?;
        let scenes = session.need(Role::Scene)?;
        let [stack] = scenes[..] else {
            let names: Vec<String> = scenes.iter().map(|s| s.path().display().to_string()).collect();
            bail!("{}: has {} stacks of scenes; name one: {}", path.display(), scenes.len(), names.join(", "));
        };
        let time_s: Vec<f64> = stack.info().iter().map(|info| info.time_s).collect();
        // Without a column of times all are zero.
        let times = time_s.windows(2).any(|w| w[0] != w[1]).then(|| Times::of_frames(&time_s));
        let frames = stack.frames()?;
        let set_interval_s = set_interval_s(&frames)?;
        let damaged = stack.damaged_note("their reconstructions show what was never measured");
        Ok(Self { frames, times, set_interval_s, damaged })
    }

    /// The time from one frame to the next, s, where it is the same for all.
    pub fn interval_s(&self) -> Option<f64> {
        match &self.times {
            Some(times) if times.gaps.is_empty() && times.backwards.is_empty() => times.interval_s,
            Some(_) => None,
            None => self.set_interval_s,
        }
    }

    /// What is not reconstructed since it is not whole, which frames are damaged, and where frames are missing.
    pub fn warnings(&self) -> Vec<String> {
        let mut warnings = Vec::new();
        for part in self.frames.parts() {
            let (torn, empty) = (part.torn.len(), part.empty.len());
            let mut what = Vec::new();
            if torn + empty > 0 {
                what.push(format!("{torn} frames that are not whole and {empty} without data were left out"));
            }
            if let Some((frame, first)) = part.damaged.first() {
                let others = match part.damaged.len() - 1 {
                    0 => String::new(),
                    n => format!("; so are {n} more of its frames"),
                };
                what.push(format!("frame {frame} is damaged: {first}{others}"));
            }
            what.extend(part.damage.clone());
            if !what.is_empty() {
                warnings.push(format!("{}: {}", part.path.display(), what.join("; ")));
            }
        }
        warnings.extend(notes_on(&self.frames));
        warnings.extend(self.damaged.clone());
        let table = self.times.iter().flat_map(Times::table_notes);
        warnings.extend(table.map(|note| format!("{}: {note}", self.frames.path().display())));
        if let Some(times) = self.times.as_ref().filter(|t| !t.gaps.is_empty()) {
            let missing: usize = times.gaps.iter().map(|g| g.missing).sum();
            let path = self.frames.path().display();
            let gaps = times.gaps.len();
            warnings.push(format!(
                "{path}: {missing} frames are missing in {gaps} gaps; the output holds the frames one after another \
                 (--times FILE writes the time of each)"
            ));
        }
        warnings
    }

    /// A table with the time of each frame.
    ///
    /// # Errors
    /// No times are known.
    pub fn table(&self) -> anyhow::Result<String> {
        let Some(times) = &self.times else {
            bail!("{}: has no timestamps, which --times writes; leave the option out", self.frames.path().display());
        };
        let mut text = format!("{TABLE}\n");
        for (i, time) in times.time_s.iter().enumerate() {
            // Writing to a string cannot fail.
            let _ = writeln!(text, "{i},{}", (time * 1e7).round() / 1e7);
        }
        Ok(text)
    }
}

/// Header of a table of times.
pub const TABLE: &str = "frame,time_s";
