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
    let text = std::fs::read_to_string(&path).map_err(|e| SessionError::io(&path, e))?;
    let json: Value = match serde_json::from_str(text.trim_start_matches('\u{feff}')) {
        Ok(json) => json,
        // What it states is also in the frames and their times, or can be given: a recording is not lost with it.
        Err(e) => return Ok(Some(Metadata { path, unread: Some(e.to_string()), ..Metadata::default() })),
    };
    let text = |name: &str| json[name].as_str().map(str::to_string);
    let whole = |value: &Value| value.as_u64().and_then(|n| usize::try_from(n).ok());
    // Versions of the recorder write 20, "20" or "20FPS".
    let rate = || {
        let digits = |s: &str| s.trim().trim_end_matches(|c: char| c.is_alphabetic()).trim().parse().ok();
        json["frameRate"].as_f64().or_else(|| digits(json["frameRate"].as_str()?)).filter(|r| *r > 0.0)
    };
    let roi = &json["ROI"];
    Ok(Some(Metadata {
        device: text("deviceType").or_else(|| text("deviceName")),
        frame_rate_hz: rate(),
        frames_per_file: whole(&json["framesPerFile"]).filter(|n| *n > 0),
        roi: whole(&roi["height"]).zip(whole(&roi["width"])).map(|(h, w)| [h, w]),
        compression: text("compression"),
        unread: None,
        path,
    }))
}
