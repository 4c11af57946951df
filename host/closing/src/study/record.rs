//! Outcomes of sessions, and their file: one JSON object per line, appended as sessions end.

use super::downstream::Reconstruction;
use super::instruments::Kind;
use super::plan::{Case, Injected};
use super::shard::Shard;
use super::size::Question;
use crate::Verdict;
use crate::evidence::{rises, worse};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

/// An effect that the loop found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FoundEffect {
    /// Its id; `unknown-1` and so on for effects outside the catalogue.
    pub id: String,
    /// Whether it is in the catalogue.
    pub known: bool,
    /// Strength of the evidence, standard deviations.
    pub z: f64,
    /// Ids of effects that explain the data about as well.
    pub ambiguity: Vec<String>,
    /// Largest squared correlation with one of those.
    pub overlap: f64,
    /// Share of the excess on held-out data that it explains, as `close` reports it.
    pub excess_explained: Option<f64>,
    /// Value and standard error by parameter.
    pub params: BTreeMap<String, [f64; 2]>,
    /// Description.
    pub description: String,
}

/// chi-squared per pixel on held-out scenes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct HeldOut {
    /// Of the calibrated instrument; NaN: the session holds nothing that is known.
    #[serde(deserialize_with = "nullable")]
    pub before: f64,
    /// Of the closed instrument; NaN as before. Where a session withholds its truths, both are of these.
    #[serde(deserialize_with = "nullable")]
    pub after: f64,
    /// Of the bench's noise-free frames, which only chance can improve on.
    pub floor: f64,
    /// Of the calibrated instrument with the injected effects, their values fitted; None: no effect was injected, or
    /// it changes noise alone.
    #[serde(default)]
    pub truth: Option<f64>,
    /// Pixels.
    pub pixels: usize,
    /// Figures of `close` itself, on what this session holds: chi-squared per pixel and NRMSE, before and after. None:
    /// the session holds nothing that is known.
    #[serde(default)]
    pub own: [[Option<f64>; 2]; 2],
}

/// JSON has no NaN.
fn nullable<'de, D: serde::Deserializer<'de>>(from: D) -> Result<f64, D::Error> {
    Ok(Option::deserialize(from)?.unwrap_or(f64::NAN))
}

impl HeldOut {
    /// Whether the closed instrument predicts held-out data worse than the calibrated one, in chi-squared or in NRMSE,
    /// as `close` judges it.
    pub fn is_worse(&self) -> bool {
        // A figure that is absent is no worse.
        let [before, after] = self.own.map(|f| f.map(|v| v.unwrap_or(0.0)));
        worse(before, after)
    }

    /// Whether it predicts the withheld truths worse than the calibrated one does, in chi-squared; chance improves on
    /// neither.
    pub fn is_worse_with_truths(&self) -> bool {
        rises(self.before, self.after)
    }

    /// Share of the explainable excess that was removed. None: the excess is below five standard errors; the difference
    /// d of two chi-squareds of the same frames has an error of 2 sqrt(d).
    pub fn explained(&self) -> Option<f64> {
        let excess = self.before - self.truth?;
        let fall = excess.max(0.0) * self.pixels as f64;
        (fall > 5.0 * 2.0 * fall.sqrt()).then(|| (self.before - self.after) / excess)
    }
}

/// The outcome of one case.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Outcome {
    /// The case.
    pub case: Case,
    /// Kind of the instrument.
    #[serde(default)]
    pub kind: Kind,
    /// Effects that were found, in order.
    pub found: Vec<FoundEffect>,
    /// Ids of effects that `close` calls nearest, not the cause: no names.
    #[serde(default)]
    pub nearest: Vec<String>,
    /// The verdict of `close`.
    #[serde(default)]
    pub verdict: Verdict,
    /// Whether `close` reports that the catalogue is incomplete.
    pub incomplete: bool,
    /// Covariates on which the residual depends afterwards (beyond five standard deviations).
    pub structure: Vec<String>,
    /// Figures on held-out scenes.
    pub held_out: HeldOut,
    /// PSNR of fine-tuned networks, for that question only.
    #[serde(default)]
    pub reconstruction: Option<Reconstruction>,
    /// Time to close, s, without the measurement of the session.
    pub seconds: f64,
    /// Why the session could not be closed; None if it could.
    pub error: Option<String>,
}

impl Outcome {
    /// Whether anything was found.
    pub fn detected(&self) -> bool {
        !self.found.is_empty()
    }

    /// Id of the effect that was found first; `nothing` or `unknown`.
    pub fn first(&self) -> &str {
        self.found.first().map_or("nothing", |f| if f.known { f.id.as_str() } else { "unknown" })
    }

    /// Whether an effect was found or is in the ambiguity set of a found one.
    pub fn covers(&self, id: &str) -> bool {
        self.found.iter().any(|f| f.id == id || f.ambiguity.iter().any(|a| a == id))
    }

    /// Ids that were named and are not true, flagged or not. Terms without a name are no names.
    pub fn false_names(&self) -> Vec<&str> {
        let named = self.found.iter().filter(|f| f.known && !f.id.starts_with("unknown")).map(|f| f.id.as_str());
        // A gain that the calibration states wrongly is the effect of that name.
        let gain = |id: &str| self.case.question == Question::Gain && id == "noise_scale";
        let excluded = |id: &str| self.case.excluded.iter().any(|e| e == id);
        let truth = |id: &str| self.case.injected.iter().any(|i| i.id == id) && !excluded(id) || gain(id);
        named.filter(|id| !truth(id)).collect()
    }

    /// Whether any name is not true.
    pub fn names_falsely(&self) -> bool {
        !self.false_names().is_empty()
    }

    /// (value - truth) / sigma of the strength of an injected effect; None if it was not found under its name.
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
    pub fn open(dir: &Path, shard: Shard) -> std::io::Result<Self> {
        let name = match shard {
            Shard { index: 0, count: 1 } => "sessions.jsonl".to_string(),
            Shard { index, count } => format!("sessions-{index}-of-{count}.jsonl"),
        };
        let path = dir.join(name);
        // A study that was killed while writing leaves an incomplete line; the next outcome starts on a new line.
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

/// Outcomes of all shards in a folder, the last one of each case. Incomplete lines are skipped.
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
