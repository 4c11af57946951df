//! The frames that are reconstructed: a file, a folder of a recording, or the scenes of a session; and their times.

use anyhow::bail;
use ommatidia_session::import::{Losses, Times, losses_of, notes_on, set_interval_s, times_or_why};
use ommatidia_session::kind::FileKind;
use ommatidia_session::{FrameReader, Role, Session};
use std::fmt::Write;
use std::path::Path;

/// Frames with what is known of their times.
pub struct Input {
    /// The frames.
    pub frames: FrameReader,
    /// Times of the frames, where a table has them.
    times: Option<Times>,
    /// The time from one frame to the next by the metadata or the files, s, where they state it.
    set_interval_s: Option<f64>,
    /// What is lost of the recording, without damage that shows when frames are read.
    lost: Losses,
    /// What is said of frames that the table of a session marks as damaged.
    damaged: Option<String>,
    /// What is to be known of the files, as they were when they were opened.
    notes: Vec<String>,
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
        let (times, unread) = times_or_why(&frames)?;
        let set_interval_s = set_interval_s(&frames)?;
        let lost = losses_of(&frames)?;
        let mut notes: Vec<String> = unread.into_iter().chain(notes_on(&frames)).collect();
        let table = times.iter().flat_map(Times::table_notes);
        notes.extend(table.map(|note| format!("{}: {note}", path.display())));
        Ok(Self { frames, times, set_interval_s, lost, damaged: None, notes })
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
        let notes = notes_on(&frames);
        let mut lost = stack.losses();
        if let Some(times) = times.as_ref().filter(|_| lost.gaps.is_empty()) {
            // The table of a session that was not imported may have gaps, too.
            let missing = times.gaps.iter().map(|gap| gap.missing).sum();
            (lost.gaps, lost.lost) = (times.gaps.clone(), lost.lost.max(missing));
        }
        Ok(Self { frames, times, set_interval_s, lost, damaged, notes })
    }

    /// The time from one frame to the next, s, where it is the same for all.
    pub fn interval_s(&self) -> Option<f64> {
        match &self.times {
            Some(times) if times.gaps.is_empty() && times.backwards.is_empty() => {
                // Nanoseconds: the rest is the error of the mean's binary fractions.
                times.interval_s.map(|s| (s * 1e9).round() / 1e9)
            }
            Some(_) => None,
            None => self.set_interval_s,
        }
    }

    /// Whether the table of a session marks frames as damaged.
    pub fn is_damaged(&self) -> bool {
        self.damaged.is_some()
    }

    /// What is lost of the frames; damage of compressed frames is known of those that were read.
    pub fn losses(&self) -> Losses {
        // What the table of a session marks is said once.
        let damaged_frames = match self.damaged {
            Some(_) => Vec::new(),
            None => Losses::of(&self.frames, None, None).damaged_frames,
        };
        Losses { damaged_frames, ..self.lost.clone() }
    }

    /// What is lost, and what is to be known of the files. `timed` says whether the times of the frames are written.
    pub fn warnings(&self, losses: &Losses, timed: bool) -> Vec<String> {
        let path = self.frames.path();
        let mut warnings = losses.warnings(path);
        if !losses.gaps.is_empty() {
            let hint = if timed { "" } else { " (--times FILE writes the time of each)" };
            warnings.push(format!("{}: the output holds the frames one after another{hint}", path.display()));
        }
        warnings.extend(self.notes.iter().chain(&self.damaged).cloned());
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
