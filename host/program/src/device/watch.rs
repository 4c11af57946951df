//! What a device's watch on the optics says, in a sentence.

use ommatidia_shared::watch::{Alarm, BASELINE, Report};

/// The sentence; `None` where the network has no watch. `since` names the frame since which something has moved.
pub fn watch_text(report: &Report, since: impl Fn(&Alarm) -> String) -> Option<String> {
    let Report { lenses, frames, left_out, alarm } = *report;
    let counted = format!("{frames} frames, {left_out} left out");
    match alarm {
        _ if lenses == 0 => None,
        Some(alarm) => {
            Some(format!("{} since {}; close the loop again ({counted})", moved(&alarm, lenses), since(&alarm)))
        }
        None if frames < BASELINE => {
            Some(format!("learning, {frames} of {BASELINE} frames so far, {left_out} left out"))
        }
        None => Some(format!("nothing has moved ({counted}; a false alarm comes in 10^6 frames)")),
    }
}

/// Which lens, and by how much.
fn moved(alarm: &Alarm, lenses: u8) -> String {
    let (kind, lens) = (alarm.statistic / lenses.max(1), alarm.statistic % lenses.max(1));
    let value = f64::from(alarm.millionths) / 1e6;
    let [noise, specimens] = alarm.error_millionths.map(|v| f64::from(v) / 1e6);
    let error = noise.hypot(specimens);
    match kind {
        0 => format!("lens {lens} moved by about {value:+.2} +- {error:.2} px along the rows' axis (down)"),
        1 => format!("lens {lens} moved by about {value:+.2} +- {error:.2} px along the columns' axis (right)"),
        _ => format!("the light of lens {lens} changed by about {:+.1} +- {:.1} %", 100.0 * value, 100.0 * error),
    }
}

/// The watch as JSON.
pub fn watch_json(report: &Report) -> serde_json::Value {
    let Report { lenses, frames, left_out, alarm } = *report;
    if lenses == 0 {
        return serde_json::Value::Null;
    }
    let alarm = alarm.map(|alarm| {
        let [kind, unit] =
            [["row_px", "px"], ["col_px", "px"], ["gain", "1"]][usize::from(alarm.statistic / lenses).min(2)];
        serde_json::json!({
            "lens": alarm.statistic % lenses, "param": kind, "unit": unit, "value": f64::from(alarm.millionths) / 1e6,
            "sigma_noise": f64::from(alarm.error_millionths[0]) / 1e6,
            "sigma_specimens": f64::from(alarm.error_millionths[1]) / 1e6,
            "since_run": alarm.since, "frames_since": alarm.frames,
        })
    });
    serde_json::json!({ "frames": frames, "left_out": left_out, "learning": frames < BASELINE, "alarm": alarm })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn the_sentence_names_the_lens_and_the_frame() {
        let alarm =
            Alarm { statistic: 13, since: 1201, frames: 40, millionths: -123_000, error_millionths: [3_000, 9_000] };
        let report = Report { lenses: 9, frames: 1240, left_out: 2, alarm: Some(alarm) };
        let text = watch_text(&report, |alarm| format!("frame {}", alarm.since - 1)).unwrap();
        assert!(
            text.starts_with(
                "lens 4 moved by about -0.12 +- 0.01 px along the columns' axis (right) since frame 1200;"
            )
        );
        assert!(text.contains("close the loop again"));
        assert_eq!(watch_json(&report)["alarm"]["param"], "col_px");
        let dimmed = Report { alarm: Some(Alarm { statistic: 18, millionths: -31_000, ..alarm }), ..report };
        assert!(
            watch_text(&dimmed, |_| "here".into()).unwrap().starts_with("the light of lens 0 changed by about -3.1")
        );
        assert!(watch_text(&Report::default(), |_| String::new()).is_none());
        let learning = Report { frames: 3, alarm: None, ..report };
        assert!(watch_text(&learning, |_| String::new()).unwrap().contains("3 of 128"));
    }
}
