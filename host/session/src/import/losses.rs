//! What is lost of a recording: frames that are missing, left out or damaged, and how that is said. Every verb that
//! reads a recording names its losses from here.

use super::times::{Gap, Times, first_without_table};
use super::{metadata_of, times_or_why};
use crate::error::SessionError;
use crate::stack::{DECODED_FROM, FrameReader, Part};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// What is lost of a recording. Nothing is lost by default.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Losses {
    /// Number of frames that were recorded, or should have been, and are not among those of the stack, as far as the
    /// table of timestamps and the lengths of the files show it.
    pub lost: usize,
    /// Number of timestamps before that of the first frame.
    pub lost_before: usize,
    /// Number of timestamps after that of the last frame.
    pub lost_after: usize,
    /// Times between frames that are longer than others.
    pub gaps: Vec<Gap>,
    /// Frames whose timestamp is not later than that of the frame before.
    pub backwards: Vec<usize>,
    /// Frames that were left out since they end too early, have a damaged head, or have no data.
    pub torn: Vec<Torn>,
    /// Frames whose compressed data are damaged. They are in the stack, with wrong pixels.
    pub damaged_frames: Vec<DamagedFrame>,
    /// Files that are damaged at their end, or as a whole.
    pub damaged: Vec<String>,
    /// Files with fewer frames than they should have: name, whole frames, and how many a full file has, or the
    /// timestamps of the last.
    pub short: Vec<(String, usize, usize)>,
    /// Files that are missing.
    pub missing_files: Vec<u64>,
}

/// A frame whose compressed data are damaged.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DamagedFrame {
    /// Number of the frame in the stack, from 0.
    pub index: usize,
    /// The file.
    pub file: String,
    /// Number of the frame in the file, from 0.
    pub frame: usize,
    /// What is wrong, as the decoder has it.
    pub what: String,
}

/// A frame that was left out.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Torn {
    /// The file.
    pub file: String,
    /// Number of the frame in the file, from 0.
    pub frame: usize,
    /// Whether it has no data at all.
    pub empty: bool,
}

/// What is lost of a recording that is open, with the table of timestamps and the metadata in its folder.
///
/// # Errors
/// The table or the metadata cannot be opened.
pub fn losses_of(frames: &FrameReader) -> Result<Losses, SessionError> {
    let (times, _) = times_or_why(frames)?;
    let per_file = metadata_of(frames.path())?.and_then(|m| m.frames_per_file);
    Ok(Losses::of(frames, times.as_ref(), per_file))
}

impl Losses {
    /// What is lost of `frames`, with their times where they have some, and the number of frames that the recorder puts
    /// into each file, where it is known. Compressed frames are known to be damaged once they were read.
    pub fn of(frames: &FrameReader, times: Option<&Times>, per_file: Option<usize>) -> Self {
        let parts = frames.parts();
        let full = per_file.unwrap_or_else(|| parts.iter().map(|p| p.listed).max().unwrap_or(0));
        // Files of a folder of AVIs are filled one after the other; those of TIFFs need not be.
        let filled = parts.iter().all(|p| p.path.extension().is_some_and(|e| e.eq_ignore_ascii_case("avi")));
        let cut = parts.iter().rev().skip(1).rev().filter(|p| filled && p.listed < full);
        let mut short: Vec<_> = cut.map(|p| (name(&p.path), p.frames, full)).collect();
        let should_have = times.and_then(|t| t.last_should_have);
        if let Some((part, frames)) = parts.last().filter(|_| filled).zip(should_have) {
            short.push((name(&part.path), part.frames, frames));
        }
        let torn = torn(parts);
        let mut losses = Self {
            damaged_frames: damaged(parts),
            damaged: parts.iter().filter_map(|p| Some(format!("{}: {}", name(&p.path), p.damage.as_ref()?))).collect(),
            missing_files: missing(parts, filled, times),
            ..Self::default()
        };
        losses.lost = match times.filter(|times| times.timestamps > 0) {
            // The recorder wrote a row for each frame, and left out those that it missed.
            Some(times) => {
                (losses.lost_before, losses.lost_after) = (times.before, times.after);
                (losses.gaps, losses.backwards) = (times.gaps.clone(), times.backwards.clone());
                let missing: usize = times.gaps.iter().map(|gap| gap.missing).sum();
                times.unused.max(times.before + missing + times.after)
            }
            None => {
                let unread = parts.iter().filter(|p| !filled && p.listed == 0).count();
                let of_files = losses.missing_files.len() * if filled { full } else { 1 } + unread;
                let of_short: usize = short.iter().map(|(_, frames, full)| full.saturating_sub(*frames)).sum();
                let elsewhere = torn.iter().filter(|t| short.iter().all(|(file, ..)| *file != t.file)).count();
                of_files + of_short + elsewhere
            }
        };
        Self { torn, short, ..losses }
    }

    /// Whether any frame is lost, left out or damaged.
    pub fn any(&self) -> bool {
        // Files that are short by the metadata alone are not: the timestamps would show it.
        let listed = self.torn.len() + self.damaged_frames.len() + self.damaged.len() + self.missing_files.len();
        self.lost + listed > 0
    }

    /// How many of the recorded frames are used: `160 of 260 frames`, of a stack of `frames` frames.
    pub fn used(&self, frames: usize) -> String {
        match self.lost {
            0 => count(frames, "frame"),
            lost => format!("{frames} of {} frames", frames + lost),
        }
    }

    /// The losses in sentences, each with the file at `path` that it is of.
    pub fn warnings(&self, path: &Path) -> Vec<String> {
        let whole = path.display();
        // A recording of one file is that file.
        let of = |file: &str| if name(path) == file { path.into() } else { path.join(file) };
        let mut out = Vec::new();
        let mut files: Vec<&str> = self.torn.iter().map(|t| t.file.as_str()).collect();
        files.dedup();
        for file in files.iter().take(LINES) {
            for (empty, one, many) in [(false, "is not whole", "are not whole"), (true, "has no data", "have no data")]
            {
                let all = self.torn.iter().filter(|t| t.file == **file && t.empty == empty).map(|t| t.frame);
                let file = of(file);
                match &all.collect::<Vec<usize>>()[..] {
                    [] => {}
                    [frame] => out.push(format!("{}: frame {frame} {one}, and is left out", file.display())),
                    all => {
                        let (n, which) = (all.len(), list(all));
                        out.push(format!("{}: {n} frames {many}, and are left out: {which}", file.display()));
                    }
                }
            }
        }
        more(&mut out, path, files.len(), "files with frames that were left out");
        let runs: Vec<&[DamagedFrame]> = self.damaged_frames.chunk_by(follows).collect();
        out.extend(runs.iter().take(LINES).map(|run| format!("{whole}: {}", of_run(run))));
        more(&mut out, path, runs.len(), "damaged places");
        for damage in self.damaged.iter().take(LINES) {
            let (file, what) = damage.split_once(": ").unwrap_or(("", damage));
            out.push(format!("{}: {what}", of(file).display()));
        }
        more(&mut out, path, self.damaged.len(), "damaged files");
        for (file, frames, full) in self.short.iter().take(LINES) {
            let has = count(*frames, "whole frame");
            out.push(format!("{}: it is short: it has {has}, and should have {full}", of(file).display()));
        }
        more(&mut out, path, self.short.len(), "files that are short");
        match &self.missing_files[..] {
            [] => {}
            [one] => out.push(format!("{whole}: file {one} is missing")),
            all => out.push(format!("{whole}: files {} are missing", list(all))),
        }
        let are_missing =
            |n: usize| if n == 1 { "1 frame is missing".into() } else { format!("{n} frames are missing") };
        for (n, place) in [(self.lost_before, "before the first"), (self.lost_after, "after the last")] {
            if n > 0 {
                out.push(format!("{whole}: {} {place}, by the table of timestamps", are_missing(n)));
            }
        }
        if !self.gaps.is_empty() {
            let missing: usize = self.gaps.iter().map(|gap| gap.missing).sum();
            let of_gap = |g: &Gap| {
                format!("{} after frame {} (at {:.3} s, for {:.3} s)", g.missing, g.after_frame, g.time_s, g.seconds)
            };
            let each: Vec<String> = self.gaps.iter().map(of_gap).collect();
            let (n, gaps) = (are_missing(missing), count(each.len(), "gap"));
            out.push(format!("{whole}: {n} in {gaps}: {}", list(&each)));
        }
        if !self.backwards.is_empty() {
            let n = match self.backwards.len() {
                1 => "the time of 1 frame is".into(),
                n => format!("the times of {n} frames are"),
            };
            out.push(format!("{whole}: {n} not later than that of the frame before: {}", list(&self.backwards)));
        }
        out
    }
}

fn torn(parts: &[Part]) -> Vec<Torn> {
    let mut found = Vec::new();
    for part in parts {
        let of = |empty| move |frame: &usize| (*frame, empty);
        let mut all: Vec<(usize, bool)> =
            part.torn.iter().map(of(false)).chain(part.empty.iter().map(of(true))).collect();
        all.sort_unstable();
        found.extend(all.into_iter().map(|(frame, empty)| Torn { file: name(&part.path), frame, empty }));
    }
    found
}

fn damaged(parts: &[Part]) -> Vec<DamagedFrame> {
    let (mut found, mut before) = (Vec::new(), 0);
    for part in parts.iter() {
        for (index, place) in part.places().enumerate().filter(|_| !part.damaged.is_empty()) {
            if let Ok(at) = part.damaged.binary_search_by_key(&place, |(frame, _)| *frame) {
                let (index, what) = (before + index, part.damaged[at].1.clone());
                found.push(DamagedFrame { index, file: name(&part.path), frame: place, what });
            }
        }
        before += part.frames;
    }
    found
}

/// Numbers of files that a recorder counts up to.
const MOST_FILES: u64 = 100_000;

/// Numbers of files that are missing, at most a thousand.
fn missing(parts: &[Part], filled: bool, times: Option<&Times>) -> Vec<u64> {
    if !filled {
        return between(&parts.iter().map_while(|p| p.number).collect::<Vec<u64>>());
    }
    let numbers: Vec<u64> = parts.iter().filter_map(|p| p.number).collect();
    let first = times.map_or_else(|| first_without_table(parts), |times| times.first_file);
    let of_table = times.and_then(|times| times.last_file);
    let last = numbers.last().map(|last| of_table.map_or(*last, |of_table| of_table.max(*last)));
    // Recorders count up by one; a number with more digits is a date or a time.
    let Some(last) = last.filter(|last| *last < MOST_FILES) else { return Vec::new() };
    let absent = |n: &u64| numbers.binary_search(n).is_err();
    (first..=last).filter(absent).take(1000).collect()
}

/// Numbers that are missing between those of files of one frame each, at most a thousand: where most follow each other
/// at one step, which may be more than 1.
fn between(numbers: &[u64]) -> Vec<u64> {
    let steps: Vec<u64> = numbers.windows(2).filter_map(|w| w[1].checked_sub(w[0])).collect();
    let Some(step) = steps.iter().copied().min().filter(|step| *step > 0) else { return Vec::new() };
    let regular = steps.iter().filter(|s| **s == step).count();
    if steps.len() + 1 < numbers.len() || 2 * regular <= steps.len() {
        return Vec::new();
    }
    let missing = numbers.windows(2).flat_map(|w| (w[0] + step..w[1]).step_by(step as usize));
    missing.take(1000).collect()
}

/// Whether a damaged frame is the next one, and damaged since it is decoded from the one before.
fn follows(a: &DamagedFrame, b: &DamagedFrame) -> bool {
    a.file == b.file && a.index + 1 == b.index && b.what == DECODED_FROM
}

/// A damaged frame, and those that are decoded from it.
fn of_run(run: &[DamagedFrame]) -> String {
    let [first, rest @ ..] = run else { return String::new() };
    let DamagedFrame { index, file, frame, what } = first;
    let others = match rest {
        [] => String::new(),
        [one] => format!("; so is frame {}, which is decoded from it", one.index),
        [.., last] => format!("; so are frames {} to {}, which are decoded from it", index + 1, last.index),
    };
    format!("frame {index}, {frame} of {file}, is damaged: {what}{others}")
}

/// Most lines of one kind, and most places in a line; the JSON has all.
const LINES: usize = 12;

fn more(out: &mut Vec<String>, path: &Path, count: usize, what: &str) {
    if count > LINES {
        out.push(format!("{}: and more: {count} {what} in all", path.display()));
    }
}

/// The first of many values, with commas between.
pub(super) fn list<T: ToString>(values: &[T]) -> String {
    let first: Vec<String> = values.iter().take(LINES).map(ToString::to_string).collect();
    let rest = if values.len() > LINES { ", ..." } else { "" };
    format!("{}{rest}", first.join(", "))
}

/// A number of things: `1 frame`, `2 frames`.
pub(super) fn count(n: usize, thing: &str) -> String {
    if n == 1 { format!("1 {thing}") } else { format!("{n} {thing}s") }
}

fn name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_that_are_missing_are_those_between_regular_ones() {
        assert_eq!(between(&[0, 1, 2, 5, 6, 7]), [3, 4]);
        assert_eq!(between(&[0, 10, 20, 40]), [30]);
        assert!(between(&[3, 4, 5]).is_empty() && between(&[7]).is_empty() && between(&[]).is_empty());
        // Numbers that mean something else: positions of beads, or the same number in each name.
        assert!(between(&[0, 7, 9, 30]).is_empty() && between(&[1, 1, 2, 3]).is_empty());
        assert!(between(&[0, 20, 40, 0, 20, 40]).is_empty());
    }

    #[test]
    fn each_loss_has_a_sentence_that_counts_right() {
        let torn = |frame| Torn { file: "1.avi".into(), frame, empty: false };
        let gap = Gap { after_frame: 4, time_s: 0.2, seconds: 0.1, missing: 1 };
        let losses =
            Losses { lost: 1, gaps: vec![gap], torn: vec![torn(3)], missing_files: vec![2], ..Losses::default() };
        let said = losses.warnings("rec".as_ref());
        assert_eq!(
            said,
            [
                "rec/1.avi: frame 3 is not whole, and is left out",
                "rec: file 2 is missing",
                "rec: 1 frame is missing in 1 gap: 1 after frame 4 (at 0.200 s, for 0.100 s)",
            ]
        );
        assert!(losses.any() && losses.used(9) == "9 of 10 frames");
        // A recording of one file, with two of them.
        let two = Losses { torn: vec![torn(3), torn(5)], ..Losses::default() };
        assert_eq!(two.warnings("rec/1.avi".as_ref()), ["rec/1.avi: 2 frames are not whole, and are left out: 3, 5"]);
        let none = Losses::default();
        assert!(!none.any() && none.warnings("rec".as_ref()).is_empty() && none.used(1) == "1 frame");
    }
}
