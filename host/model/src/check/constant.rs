//! Frames whose pixels all have one value: no sensor delivers that.
//!
//! This comes before all rules on scale and bit depth: such a frame has neither.

use super::frames::StackLevels;
use super::{Finding, Severity};
use ommatidia_physics::sensor::constant_words;
use ommatidia_session::Role;

/// Most frames that are named.
const NAMED: usize = 8;

/// The constant frames of a stack, and how many frames were looked at where these are not all.
pub(super) fn describe(s: &StackLevels) -> Vec<Finding> {
    let mut findings = Vec::new();
    if let Some((frame, value)) = s.constant.first() {
        let words = constant_words(f64::from(*value));
        let names: Vec<String> = s.constant.iter().take(NAMED).map(|(frame, _)| frame.to_string()).collect();
        let more = if s.constant.len() > NAMED { ", ..." } else { "" };
        let (count, file) = (s.constant.len(), &s.file);
        let which = match count {
            all if all == s.looked && all > 1 => {
                format!("all {all} frames{}", if all < s.count { " that were looked at" } else { "" })
            }
            1 => format!("frame {frame}"),
            _ => format!("frames {}{more} ({count} of {} that were looked at)", names.join(", "), s.looked),
        };
        let same = s.constant.iter().all(|(_, other)| other == value);
        let first = if same { String::new() } else { format!(" have one value each; in frame {frame}") };
        // A black level below 0 DN, without noise, is nothing that stops a calibration.
        let severity = if s.is_constant() && s.role != Role::Dark { Severity::Error } else { Severity::Warning };
        let remedy = match (s.role, count) {
            (Role::Bead, 1) if !s.is_constant() => " Remove it with its row, or measure it again",
            (Role::Bead, _) if !s.is_constant() => " Remove them with their rows, or measure them again",
            _ => "",
        };
        let text = format!("{file}: {which}{first}: {words}{remedy}");
        findings.push(Finding::new("constant frames", severity, text));
    }
    if s.looked < s.count && s.role != Role::Bead {
        let text = format!("{}: {} of {} frames were looked at, evenly over the stack", s.file, s.looked, s.count);
        findings.push(Finding::new("sample", Severity::Fact, text));
    }
    findings
}
