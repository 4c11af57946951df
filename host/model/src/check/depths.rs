//! The positions at the other depths of a scan, and what was not looked at.

use super::hypotheses::{self, Hypothesis, Order, Tried, Turn};
use super::scan::{Scan, same_depth};
use super::{Finding, ScanFindings, Severity, positions};
use ommatidia_session::Session;

/// Fewest frames of a depth whose positions are judged.
const LEAST: usize = 6;
/// Most depths that are listed one by one.
const LISTED: usize = 8;

/// Judges the positions at all depths but the first, and adds what it finds to `seen`. Says what was not judged.
pub fn look(session: &Session, depths: &[Scan], seen: &mut ScanFindings) -> Vec<Finding> {
    let mut findings = Vec::new();
    for scan in depths.iter().skip(1).filter(|scan| scan.frames.len() >= LEAST) {
        let tried = hypotheses::best(scan, session.manifest());
        if !tried.testable || tried.is_unrelated() {
            continue;
        }
        let outliers = positions::outliers(scan, &tried);
        let whole = hypotheses::describe(&tried, scan, &outliers, session)
            .into_iter()
            .map(|f| at_depth(f, scan.z_um(), &tried));
        // What is wrong with the whole table in the same way at several depths is said once.
        let known = tried.best != Hypothesis::AS_IS && tried.best == seen.best;
        findings.extend(whole.filter(|f| f.severity > Severity::Ok && !known));
        findings.extend(positions::describe(&outliers, scan, &tried));
        seen.outliers.extend(outliers);
        seen.frames += scan.frames.len();
        seen.depths_um.push(scan.z_um());
    }
    seen.depths_um.sort_by(f64::total_cmp);
    findings.extend(depths.first().and_then(|first| judged(first, &seen.depths_um)));
    let (read, all) = (depths[0].read, depths[0].all_z_um.len());
    if read < all {
        let text = format!(
            "{read} of {all} bead frames were looked at, evenly over the scan: a wrong position of another one was not \
             seen"
        );
        findings.push(Finding::new("sample", Severity::Ok, text));
    }
    findings
}

/// A finding about the whole table at one depth.
fn at_depth(finding: Finding, z_um: f64, tried: &Tried) -> Finding {
    let Finding { topic, severity, text } = finding;
    let h = &tried.best;
    let scale_alone = (h.turn, h.order) == (Turn::NONE, Order::AsIs) && topic == "units";
    if scale_alone && (0.5..2.0).contains(&h.scale) {
        let text = format!("at z_um = {z_um}: {text}; a magnification that changes with depth is no fault");
        return Finding::new(topic, severity.min(Severity::Warning), text);
    }
    Finding::new(topic, severity, format!("at z_um = {z_um}: {text}"))
}

/// At which depths the positions were judged; None for a scan of one depth.
fn judged(scan: &Scan, judged_um: &[f64]) -> Option<Finding> {
    let mut all_um = scan.all_z_um.clone();
    all_um.sort_by(f64::total_cmp);
    all_um.dedup_by(|a, b| same_depth(*a, *b));
    if all_um.len() < 2 {
        return None;
    }
    let is_judged = |z: &f64| judged_um.iter().any(|j| same_depth(*j, *z));
    let (yes, no): (Vec<f64>, Vec<f64>) = all_um.into_iter().partition(is_judged);
    if no.is_empty() {
        return Some(Finding::new("depths", Severity::Ok, format!("positions were judged at {}", list(&yes))));
    }
    let rows = |z: &f64| scan.all_z_um.iter().filter(|other| same_depth(**other, *z)).count();
    let severity = if no.iter().any(|z| rows(z) >= LEAST) { Severity::Warning } else { Severity::Ok };
    let done = if yes.is_empty() { String::new() } else { format!("positions were judged at {}, ", list(&yes)) };
    let text = format!(
        "{done}positions were not judged at {}: there fewer than {LEAST} frames were looked at, they show too little \
         motion, or no foci are seen",
        list(&no)
    );
    Some(Finding::new("depths", severity, text))
}

/// Depths, for a sentence.
fn list(depths_um: &[f64]) -> String {
    match depths_um {
        [first, .., last] if depths_um.len() > LISTED => {
            format!("{} depths from z_um = {first} to {last}", depths_um.len())
        }
        _ => format!("z_um = {}", depths_um.iter().map(f64::to_string).collect::<Vec<_>>().join(", ")),
    }
}
