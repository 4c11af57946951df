//! Checks a session before anything is calibrated: does the table of bead positions agree with the frames, do the
//! frames hold what the manifest says, and is anything missing?
//!
//! | file | what it looks at |
//! |---|---|
//! | [`scan`] | the bead frames, small, and how well they coincide when each is moved back by its position |
//! | [`hypotheses`] | what people do to a table: axes, mirrors, order, units; the one that fits best is named |
//! | [`positions`] | single positions that disagree with their frames |
//! | [`depths`] | the same at the other depths of a scan, and what was not looked at |
//! | [`drift`] | slow motion of the foci during the scan |
//! | [`mod@array`] | the lenses that the foci form, against those that the manifest declares |
//! | [`light`] | what changes over the scan: the light of the beads, and the level between them |
//! | [`frames`] | the values of all frames: bit depth, saturation, black level, light levels |
//! | [`constant`] | frames whose pixels all have one value |
//! | [`recording`] | what is lost of the recordings |
//!
//! `calibrate` runs the same checks first: what is an error here stops it.
//!
//! ```
//! use ommatidia_model::check::{Severity, check};
//! use ommatidia_model::testing::Testbed;
//! use ommatidia_session::Session;
//!
//! let folder = tempfile::tempdir()?;
//! Testbed { scan: 5, scenes: 0, ..Testbed::new() }.write(folder.path());
//! let found = check(&Session::open(folder.path())?, || ())?;
//! assert!(found.findings.iter().all(|f| f.severity < Severity::Warning), "{:?}", found.findings);
//! assert!(found.scan.is_some_and(|scan| scan.coincidence > 0.5));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod array;
pub mod constant;
pub mod depths;
pub mod drift;
pub mod frames;
pub mod hypotheses;
pub mod light;
pub mod positions;
pub mod recording;
pub mod scan;

pub use array::Shown;
pub use drift::Drift;
pub use hypotheses::{Hypothesis, Order, Turn};
pub use positions::Outlier;

use ommatidia_session::{Role, Session, SessionError};
use serde::Serialize;

/// Mean correlation of the frames from which their sum shows the lenses.
const RELIABLE: f64 = 0.4;

/// How bad a finding is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Severity {
    /// A fact that judges nothing, such as a number of frames in a respect in which something else is wrong.
    Fact,
    /// All is well.
    Ok,
    /// Nothing that stops a calibration.
    Warning,
    /// A calibration would be wrong.
    Error,
}

/// What was found in one respect.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Finding {
    /// What was looked at, in one or two words.
    pub topic: &'static str,
    /// How bad it is.
    pub severity: Severity,
    /// What was found, and what to do.
    pub text: String,
}

impl Finding {
    pub(crate) fn new(topic: &'static str, severity: Severity, text: impl Into<String>) -> Self {
        Self { topic, severity, text: text.into() }
    }
}

/// The focus of one bead frame behind one lens, sensor pixels [row, col].
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct FocusPair {
    /// Index of the bead frame among all bead frames.
    pub bead: usize,
    /// Lens.
    pub lens: usize,
    /// Where table and manifest put it.
    pub predicted_px: [f64; 2],
    /// Where it was found; None where the frames show no lens.
    pub found_px: Option<[f64; 2]>,
}

/// What the bead scan shows.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ScanFindings {
    /// Bead frames that were looked at.
    pub frames: usize,
    /// Depths at which the positions were judged, um. Figures that are not of single positions are those of the first.
    pub depths_um: Vec<f64>,
    /// Mean correlation of each frame with the sum of all others, each moved back by its position in the table: near 1
    /// where table and foci agree, near 0 where they do not.
    pub coincidence: f64,
    /// What the table would have to be for the best agreement.
    pub best: Hypothesis,
    /// The mean correlation then.
    pub best_coincidence: f64,
    /// Single positions that disagree with their frames.
    pub outliers: Vec<Outlier>,
    /// Slow motion of the foci beyond the table; None where it cannot be judged.
    pub drift: Option<Drift>,
    /// Places of the lenses, sensor pixels [row, col], as the foci show them.
    pub lenses_px: Vec<[f64; 2]>,
    /// Predicted and found foci, for a picture.
    #[serde(skip)]
    pub shown: Shown,
}

/// The result of all checks.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SessionCheck {
    /// One entry or more for each topic.
    pub findings: Vec<Finding>,
    /// What the bead scan shows; None without one, and where its frames show nothing.
    pub scan: Option<ScanFindings>,
}

impl SessionCheck {
    /// The findings of at least this severity.
    pub fn at_least(&self, severity: Severity) -> impl Iterator<Item = &Finding> {
        self.findings.iter().filter(move |f| f.severity >= severity)
    }
}

/// Looks at a session. Calls `step` after each frame that is read.
///
/// # Errors
/// A frame cannot be read.
pub fn check(session: &Session, mut step: impl FnMut()) -> Result<SessionCheck, SessionError> {
    check_with(session, &mut step)
}

/// As [`check`]. It is compiled once, and not again for each crate that calls it.
fn check_with(session: &Session, step: &mut dyn FnMut()) -> Result<SessionCheck, SessionError> {
    let (of_values, levels) = frames::look(session, step)?;
    let mut findings: Vec<Finding> = levels.iter().flat_map(constant::describe).collect();
    findings.extend(of_values);
    findings.extend(frames::pixel_sizes(session)?);
    findings.extend(frames::damaged(session));
    findings.extend(recording::losses(session));
    let mut found = None;
    if session.stacks_of(Role::Bead).next().is_some() {
        let mut scan = scan::Scan::read(session, step)?;
        findings.extend(light::lost(&mut scan));
        findings.extend(light::drift(&scan));
        // Where all frames are constant, that is said already.
        if !scan.frames.is_empty() {
            let depths = scan.by_depth();
            let (more, mut seen) = look(session, &depths[0]);
            findings.extend(more);
            findings.extend(depths::look(session, &depths, &mut seen));
            found = Some(seen);
        }
    }
    findings.extend(frames::counts(session, &levels));
    without_contradictions(&mut findings);
    findings.sort_by_key(|f| std::cmp::Reverse(f.severity));
    Ok(SessionCheck { findings, scan: found })
}

/// Where something is wrong in one respect, nothing is well in that respect: what else is known of it is a fact.
fn without_contradictions(findings: &mut [Finding]) {
    // Several topics judge the table of positions.
    let respect = |topic: &'static str| match topic {
        "orientation" | "order" | "units" | "single positions" => "positions",
        other => other,
    };
    let wrong: Vec<&str> = findings.iter().filter(|f| f.severity > Severity::Ok).map(|f| respect(f.topic)).collect();
    for finding in findings.iter_mut().filter(|f| f.severity == Severity::Ok) {
        if wrong.contains(&respect(finding.topic)) {
            finding.severity = Severity::Fact;
        }
    }
}

/// The checks of the bead scan.
fn look(session: &Session, scan: &scan::Scan) -> (Vec<Finding>, ScanFindings) {
    let mut findings = Vec::new();
    let tried = hypotheses::best(scan, session.manifest());
    let outliers = positions::outliers(scan, &tried);
    findings.extend(hypotheses::describe(&tried, scan, &outliers, session));
    findings.extend(positions::describe(&outliers, scan, &tried));
    let lattice = array::lattice(scan, &tried, session.manifest());
    let drift = drift::drift(scan, &tried, &outliers, (&lattice, session.manifest().array.lenses()));
    findings.extend(drift::describe(drift.as_ref()));
    // Frames that are moved back by wrong positions add up to spots where no lens is.
    if tried.coincidence > RELIABLE && outliers.len() * 10 <= scan.frames.len() {
        findings.extend(array::describe(&lattice, session.manifest(), scan));
    }
    let shown = array::foci(scan, &tried, &lattice, &outliers, session.manifest());
    let seen = ScanFindings {
        frames: scan.frames.len(),
        depths_um: if tried.testable { vec![scan.z_um()] } else { Vec::new() },
        coincidence: tried.as_is,
        best: tried.best.clone(),
        best_coincidence: tried.coincidence,
        outliers,
        drift,
        lenses_px: lattice.lenses_px.clone(),
        shown,
    };
    (findings, seen)
}
