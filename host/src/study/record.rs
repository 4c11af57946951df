//! What came of one session, and the file of all of them: one JSON object a line, appended as sessions end.

use super::downstream::Reconstruction;
use super::plan::{Case, Injected};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

/// An effect that the loop found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FoundEffect {
    /// Its id, or `unknown-1`, ..
    pub id: String,
    /// Whether the catalogue knows it.
    pub known: bool,
    /// Strength of the evidence, standard deviations.
    pub z: f64,
    /// What it could also be.
    pub ambiguity: Vec<String>,
    /// Largest squared correlation with one of those.
    pub overlap: f64,
    /// Share of the excess on held-out data that it is said to explain.
    pub excess_explained: Option<f64>,
    /// Value and standard error by parameter.
    pub params: BTreeMap<String, [f64; 2]>,
    /// In words.
    pub description: String,
}

/// chi-squared a pixel on held-out scenes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct HeldOut {
    /// The instrument as it was.
    pub before: f64,
    /// Closed.
    pub after: f64,
    /// The bench's own noise-free frames: nothing can be better, but by chance.
    pub floor: f64,
    /// The instrument with what was put in, its values fitted: what can be explained. None: nothing was.
    #[serde(default)]
    pub truth: Option<f64>,
    /// Pixels.
    pub pixels: usize,
}

impl HeldOut {
    /// Share of the explainable excess that was removed. None: there is none beyond five of its standard errors; the difference d of two
    /// chi-squareds of the same frames has an error of 2 sqrt(d).
    pub fn explained(&self) -> Option<f64> {
        let excess = self.before - self.truth?;
        let fall = excess.max(0.0) * self.pixels as f64;
        (fall > 5.0 * 2.0 * fall.sqrt()).then(|| (self.before - self.after) / excess)
    }
}

/// What came of one case.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Outcome {
    /// The case.
    pub case: Case,
    /// Effects that were found, in order.
    pub found: Vec<FoundEffect>,
    /// Whether the loop says that its catalogue is incomplete.
    pub incomplete: bool,
    /// Covariates on which the residual depends afterwards (beyond five standard deviations).
    pub structure: Vec<String>,
    /// Figures on held-out scenes.
    pub held_out: HeldOut,
    /// What the picture gains, where that was asked.
    #[serde(default)]
    pub reconstruction: Option<Reconstruction>,
    /// Time to close, s; measuring the session is not in it.
    pub seconds: f64,
    /// Why there is no outcome.
    pub error: Option<String>,
}

impl Outcome {
    /// Whether anything was found.
    pub fn detected(&self) -> bool {
        !self.found.is_empty()
    }

    /// Id of what was found first.
    pub fn first(&self) -> &str {
        self.found.first().map_or("nothing", |f| if f.known { f.id.as_str() } else { "unknown" })
    }

    /// Whether an effect was found, or told as what a found one could also be.
    pub fn covers(&self, id: &str) -> bool {
        self.found.iter().any(|f| f.id == id || f.ambiguity.iter().any(|a| a == id))
    }

    /// Whether a known effect is named and nothing says that this may be wrong.
    pub fn names_confidently(&self) -> bool {
        self.found.iter().any(|f| f.known) && !self.incomplete
    }

    /// (value - truth) / sigma of an injected effect's strength, where it was found under its own name.
    pub fn pull(&self, injected: &Injected) -> Option<f64> {
        let found = self.found.iter().find(|f| f.id == injected.id)?;
        let [value, sigma] = *found.params.get(&injected.param)?;
        (sigma > 0.0).then(|| (value - injected.value) / sigma)
    }
}

/// Outcomes on disk.
pub struct Ledger {
    file: Mutex<File>,
}

impl Ledger {
    /// Opens the ledger of a shard in a folder, to append to.
    ///
    /// # Errors
    /// The folder cannot be written.
    pub fn open(dir: &Path, shard: [usize; 2]) -> std::io::Result<Self> {
        let name = match shard {
            [0, 1] => "sessions.jsonl".to_string(),
            [i, n] => format!("sessions-{i}-of-{n}.jsonl"),
        };
        let path = dir.join(name);
        // A study that was killed in the middle of a line leaves half of one; the next begins on a line of its own.
        let torn = std::fs::read(&path).is_ok_and(|b| b.last().is_some_and(|c| *c != b'\n'));
        let mut file = OpenOptions::new().create(true).append(true).open(path)?;
        if torn {
            file.write_all(b"\n")?;
        }
        Ok(Self { file: Mutex::new(file) })
    }

    /// Appends an outcome.
    ///
    /// # Errors
    /// The disk is full.
    pub fn push(&self, outcome: &Outcome) -> std::io::Result<()> {
        let mut line = serde_json::to_string(outcome).map_err(std::io::Error::other)?;
        line.push('\n');
        self.file.lock().unwrap_or_else(PoisonError::into_inner).write_all(line.as_bytes())
    }
}

/// Outcomes of all shards in a folder, the last of each case; lines that are no outcome are left out.
///
/// # Errors
/// The folder cannot be read.
pub fn read_all(dir: &Path) -> std::io::Result<Vec<Outcome>> {
    let mut files: Vec<PathBuf> = std::fs::read_dir(dir)?.filter_map(|e| Some(e.ok()?.path())).collect();
    files.retain(|p| {
        p.file_name().and_then(|n| n.to_str()).is_some_and(|n| n.starts_with("sessions") && n.ends_with(".jsonl"))
    });
    files.sort();
    let mut all: BTreeMap<String, Outcome> = BTreeMap::new();
    for file in files {
        for line in std::fs::read_to_string(file)?.lines() {
            if let Ok(outcome) = serde_json::from_str::<Outcome>(line) {
                all.insert(outcome.case.key.clone(), outcome);
            }
        }
    }
    Ok(all.into_values().collect())
}
