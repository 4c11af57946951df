//! Which frames of a compressed file are damaged.
//!
//! ffmpeg decodes ahead of what it delivers, so that its errors do not say which frame they are of. ffprobe decodes one
//! frame after another and lists the errors of each.

use super::{KIND, Movie};
use crate::error::SessionError;
use crate::ffmpeg::{self, FFPROBE};
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::Path;

/// What is said of a frame that is decoded from a damaged one.
pub(crate) const DECODED_FROM: &str = "it is decoded from a frame before that is damaged";

/// What is wrong with frames that are decoded, by their places among those that the file lists.
#[derive(Debug)]
pub(super) struct Faults(BTreeMap<usize, String>);

impl Faults {
    /// Decodes the whole file once. Places are times in units of the stream, or counted where frames are stored in
    /// another order than they are shown in.
    pub fn of(path: &Path, movie: &Movie, counted: bool) -> Result<Self, SessionError> {
        let mut probe = ffmpeg::command(FFPROBE);
        // Level 16: errors.
        probe.args(["-v", "error", "-select_streams", "v:0", "-show_frames", "-show_log", "16", "-of", "json"]);
        probe.args(["-show_entries", "frame=best_effort_timestamp,key_frame:log"]).arg(ffmpeg::file(path));
        let out = probe.output().map_err(|e| ffmpeg::missing(path, FFPROBE, &e))?;
        let list: Value = serde_json::from_slice(&out.stdout)
            .map_err(|e| SessionError::format(path, KIND, format!("ffprobe lists its frames in a way unknown: {e}")))?;
        let frames = list["frames"].as_array().map_or(&[][..], Vec::as_slice);
        Ok(Self::in_list(frames, movie.chunks.iter().map(|(place, _)| *place), counted))
    }

    /// What a list of ffprobe says, for a file with whole frames at `places`.
    fn in_list(frames: &[Value], places: impl Iterator<Item = usize>, counted: bool) -> Self {
        let mut faults = BTreeMap::new();
        let mut expected = places.enumerate().map(|(index, place)| if counted { index } else { place });
        // Whether the frame before is damaged, or cannot be decoded.
        let mut doubtful = false;
        for (index, frame) in frames.iter().enumerate() {
            let stated = frame["best_effort_timestamp"].as_u64().and_then(|time| usize::try_from(time).ok());
            let place = stated.filter(|_| !counted).unwrap_or(index);
            let skipped = expected.by_ref().take_while(|at| *at < place).count();
            let logs = frame["logs"].as_array().map_or(&[][..], Vec::as_slice);
            let errors: Vec<String> = logs
                .iter()
                .filter_map(|log| log["message"].as_str())
                .map(ffmpeg::plain)
                .filter(|m| !m.is_empty())
                .collect();
            // Frames that are no key frames are decoded from those before.
            let alone = frame["key_frame"].as_u64() == Some(1);
            if !errors.is_empty() {
                faults.insert(place, format!("it is decoded with errors (ffmpeg: {})", errors.join("; ")));
            } else if !alone && (doubtful || skipped > 0) {
                faults.insert(place, DECODED_FROM.into());
            }
            doubtful = faults.contains_key(&place);
        }
        Self(faults)
    }

    /// What is wrong with the frame at a place.
    pub fn at(&self, place: usize) -> Option<&str> {
        self.0.get(&place).map(String::as_str)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn errors_and_what_follows_from_them_are_found() {
        let at = |time: u64, key: u64, logs: &[&str]| {
            let logs: Vec<Value> = logs.iter().map(|text| json!({ "message": text })).collect();
            json!({ "best_effort_timestamp": time, "key_frame": key, "logs": logs })
        };
        // The file lists nine frames; the third has no data, and the fourth cannot be decoded.
        let places = || [0, 1, 3, 4, 5, 6, 7, 8].into_iter();
        let list = [
            at(0, 1, &[]),
            at(1, 0, &[]),
            at(4, 0, &[]),
            at(5, 1, &[]),
            at(6, 0, &["[ffv1 @ 0x55] slice CRC mismatch 8C3036CA!", "at 0.1 seconds\n"]),
            at(7, 0, &[]),
            at(8, 1, &[]),
        ];
        let found = Faults::in_list(&list, places(), false);
        let of = |place: usize| found.at(place);
        assert_eq!([0, 1, 5, 8].map(of), [None; 4]);
        assert_eq!(of(6), Some("it is decoded with errors (ffmpeg: slice CRC mismatch 8C3036CA!)"));
        assert_eq!([4, 7].map(of), [Some(DECODED_FROM); 2]);
        // A frame without data alone is no damage.
        let list = [at(0, 1, &[]), at(1, 0, &[]), at(3, 0, &[])];
        assert_eq!(Faults::in_list(&list, places(), false).0, BTreeMap::new());
    }
}
