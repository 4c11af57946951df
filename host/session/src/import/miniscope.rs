//! `metaData.json` of a UCLA Miniscope recording (version 4).

use crate::error::SessionError;
use serde_json::Value;
use std::path::{Path, PathBuf};

/// Name of the file.
const NAME: &str = "metaData.json";

/// What the recorder says of a recording.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Metadata {
    /// The file.
    pub path: PathBuf,
    /// Type of the device, such as `Miniscope_V4_BNO`, or its name.
    pub device: Option<String>,
    /// Frame rate that was set, Hz. The timestamps say which was reached.
    pub frame_rate_hz: Option<f64>,
    /// Number of frames in each file but the last.
    pub frames_per_file: Option<usize>,
    /// Rows and columns of the frames.
    pub roi: Option<[usize; 2]>,
    /// Code of the compression.
    pub compression: Option<String>,
    /// What could not be understood, and is not used: names with their values.
    pub unused: Vec<String>,
    /// Why nothing could be read, where the file is no JSON.
    pub unread: Option<String>,
}

impl Metadata {
    /// The time from one frame to the next that was set, s.
    pub(super) fn interval_s(&self) -> Option<f64> {
        self.frame_rate_hz.map(|rate| 1.0 / rate)
    }
}

/// Whether a folder has metadata.
pub(super) fn is_there(folder: &Path) -> bool {
    folder.join(NAME).is_file()
}

/// Reads the metadata of a folder; `None` where it has none.
///
/// # Errors
/// The file cannot be read.
pub(super) fn metadata(folder: &Path) -> Result<Option<Metadata>, SessionError> {
    let path = folder.join(NAME);
    if !path.is_file() {
        return Ok(None);
    }
    // A name with an umlaut in an older encoding is no reason to lose a recording.
    let text = crate::table::text_of(&std::fs::read(&path).map_err(|e| SessionError::io(&path, e))?);
    let json: Value = match serde_json::from_str(&text) {
        Ok(json) => json,
        // What it states is also in the frames and their times, or can be given: a recording is not lost with it.
        Err(e) => return Ok(Some(Metadata { path, unread: Some(e.to_string()), ..Metadata::default() })),
    };
    let text = |name: &str| json[name].as_str().map(str::to_string);
    // Versions of the recorder write 20, 20.0, "20", "20FPS" or "FPS20".
    let number = |value: &Value| {
        let digits = |s: &str| s.trim_matches(|c: char| c.is_alphabetic() || c.is_whitespace()).parse().ok();
        value.as_f64().or_else(|| digits(value.as_str()?)).filter(|v: &f64| v.is_finite())
    };
    let whole =
        |value: &Value| number(value).filter(|v| v.fract() == 0.0 && (0.0..1e9).contains(v)).map(|v| v as usize);
    let (rate, per_file) = (&json["frameRate"], &json["framesPerFile"]);
    let frame_rate_hz = number(rate).filter(|rate| *rate > 0.0);
    let frames_per_file = whole(per_file).filter(|n| *n > 0);
    let unused = [("frameRate", rate, frame_rate_hz.is_none()), ("framesPerFile", per_file, frames_per_file.is_none())];
    let unused = unused.into_iter().filter(|(_, value, unread)| *unread && !value.is_null());
    let roi = &json["ROI"];
    Ok(Some(Metadata {
        device: text("deviceType").or_else(|| text("deviceName")),
        frame_rate_hz,
        frames_per_file,
        unused: unused.map(|(name, value, _)| format!("{name} {value}")).collect(),
        roi: whole(&roi["height"]).zip(whole(&roi["width"])).map(|(h, w)| [h, w]),
        compression: text("compression"),
        unread: None,
        path,
    }))
}
