//! The plan of a data set: its contents and its settings.

use crate::forward::ForwardError;
use ommatidia_physics::effects::EffectError;
use ommatidia_physics::noise::NoiseModel;
use ommatidia_physics::scene::SceneError;
use ommatidia_session::artifact::{self, ArtifactError, Provenance};
use ommatidia_session::remedy;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::path::{Path, PathBuf};
use thiserror::Error;

/// Name of the plan in a data set's folder.
pub const PLAN_FILE: &str = "dataset.json";

/// Version of the data set's layout.
pub(super) const VERSION: u32 = 1;

/// Kind of the shards' artifacts.
pub(super) const SHARD_KIND: &str = "shard";

/// Contents and settings of a data set.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DataSetPlan {
    /// `dataset`.
    pub kind: String,
    /// Version of the layout.
    pub version: u32,
    /// Program, seed, hash of the instrument, and configuration.
    pub provenance: Provenance,
    /// Number of pairs.
    pub count: usize,
    /// Pairs per shard; the last one may hold fewer.
    pub shard_pairs: usize,
    /// Rows and columns of an object.
    pub object: [usize; 2],
    /// Rows and columns of a frame.
    pub frame: [usize; 2],
    /// Noise model that training draws from.
    pub noise: NoiseModel,
    /// Range of the brightest pixel of each frame, electrons.
    pub peak_e: [f64; 2],
}

impl DataSetPlan {
    /// Number of shards.
    pub fn shards(&self) -> usize {
        self.count.div_ceil(self.shard_pairs)
    }

    /// The pairs of shard `k`.
    pub fn pairs_of(&self, k: usize) -> std::ops::Range<usize> {
        (k * self.shard_pairs).min(self.count)..((k + 1) * self.shard_pairs).min(self.count)
    }

    pub(super) fn shard_path(dir: &Path, k: usize) -> PathBuf {
        dir.join(format!("shard-{k:05}.safetensors"))
    }

    pub(super) fn to_json(&self) -> Result<String, serde_json::Error> {
        serde_json::to_string_pretty(self).map(|s| s + "\n")
    }

    /// SHA-256 of the plan without the number of pairs. Shards store it, so that a shard of another plan is detected.
    pub(super) fn hash(&self) -> Result<String, serde_json::Error> {
        Self { count: 0, ..self.clone() }.hash_with_count()
    }

    /// SHA-256 of the whole plan, which shards of version 0.1.0 store.
    pub(super) fn hash_with_count(&self) -> Result<String, serde_json::Error> {
        let digest = Sha256::digest(self.to_json()?.as_bytes());
        Ok(digest.iter().map(|b| format!("{b:02x}")).collect())
    }

    /// Reads the plan of the data set in `dir`.
    ///
    /// # Errors
    /// The plan is missing, damaged, of another version, or has a size of zero.
    pub fn read(dir: &Path) -> Result<Self, DataSetError> {
        let path = dir.join(PLAN_FILE);
        let text = std::fs::read_to_string(&path).map_err(|source| DataSetError::Io { path: path.clone(), source })?;
        let damaged = |e: serde_json::Error| DataSetError::Plan { path: path.clone(), detail: e.to_string() };
        let raw: serde_json::Value = serde_json::from_str(&text).map_err(damaged)?;
        let found = raw.get("version").and_then(serde_json::Value::as_u64).unwrap_or(0);
        if raw.get("kind").and_then(|k| k.as_str()) != Some("dataset") || found != u64::from(VERSION) {
            let detail = format!("expected a `dataset` of version {VERSION}, found version {found}");
            return Err(DataSetError::Plan { path, detail });
        }
        let plan: Self = serde_json::from_value(raw).map_err(damaged)?;
        if plan.count == 0 || plan.shard_pairs == 0 || plan.object.contains(&0) || plan.frame.contains(&0) {
            return Err(DataSetError::Plan { path, detail: "a size is zero".into() });
        }
        Ok(plan)
    }

    /// Removes the plan from `dir`, and the folder too where `folder` says so and it is empty then. What cannot be
    /// removed stays.
    pub(super) fn remove(dir: &Path, folder: bool) {
        let _ = std::fs::remove_file(dir.join(PLAN_FILE));
        if folder {
            let _ = std::fs::remove_dir(dir);
        }
    }

    /// Writes the plan into `dir`, accepts an existing equal one, or extends one that differs in a smaller number of
    /// pairs alone.
    pub(super) fn write_or_resume(&self, dir: &Path) -> Result<(), DataSetError> {
        let path = dir.join(PLAN_FILE);
        std::fs::create_dir_all(dir).map_err(|source| DataSetError::Io { path: dir.into(), source })?;
        if path.exists() {
            let existing = Self::read(dir)?;
            if existing == *self {
                return Ok(());
            }
            if (Self { count: self.count, ..existing.clone() }) != *self {
                return Err(DataSetError::Other { path });
            }
            if existing.count > self.count {
                return Err(DataSetError::Larger { path, count: existing.count });
            }
        }
        artifact::remove_leftovers(&path);
        let json = self.to_json().map_err(|e| DataSetError::Plan { path: path.clone(), detail: e.to_string() })?;
        Ok(artifact::write_whole(&path, json.as_bytes())?)
    }
}

/// Why a data set could not be made or read.
#[derive(Debug, Error)]
pub enum DataSetError {
    /// A file or folder could not be read or written.
    #[error("{path}: cannot be read or written ({source}); {}", remedy(.source))]
    Io {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        source: std::io::Error,
    },
    /// The plan is damaged or of another version.
    #[error("{path}: not a readable plan of a data set ({detail}); run `simulate` again")]
    Plan {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        detail: String,
    },
    /// The folder holds a data set that was planned differently.
    #[error(
        "{path}: this folder holds a data set with another instrument, seed or configuration; choose another folder, \
         or remove this one"
    )]
    Other {
        /// Its plan.
        path: PathBuf,
    },
    /// The folder holds more pairs than were asked for.
    #[error("{path}: the data set has {count} pairs already; ask for as many or more, or choose another folder")]
    Larger {
        /// Its plan.
        path: PathBuf,
        /// Its number of pairs.
        count: usize,
    },
    /// A setting is out of range.
    #[error("{field}: expected {expected}, found {found}")]
    Config {
        /// The field.
        field: &'static str,
        /// What was expected.
        expected: &'static str,
        /// What was found.
        found: String,
    },
    /// Shards are missing.
    #[error(
        "{path}: {missing} of {shards} shards are missing; run `simulate` again with the same options to write them"
    )]
    Incomplete {
        /// The folder.
        path: PathBuf,
        /// Number of missing shards.
        missing: usize,
        /// Number of shards of the plan.
        shards: usize,
    },
    /// A shard does not belong to this plan.
    #[error("{path}: this shard is of another data set, or has the wrong shape; remove it and run `simulate` again")]
    Foreign {
        /// The shard.
        path: PathBuf,
    },
    /// There is no such pair.
    #[error("pair {index}: the data set has {count}")]
    NoPair {
        /// The requested index.
        index: usize,
        /// Number of pairs.
        count: usize,
    },
    /// No light of a specimen reaches the sensor.
    #[error("pair {index}: no light reaches the sensor; calibrate again, or leave out the dead lenses")]
    Black {
        /// The pair.
        index: usize,
    },
    /// With a drawn effect no light reaches the sensor.
    #[error("pair {index}: no light reaches the sensor with `{effect}`; give a smaller largest strength")]
    Dark {
        /// The pair.
        index: usize,
        /// The effect.
        effect: String,
    },
    /// A shard could not be read or written.
    #[error(transparent)]
    Artifact(#[from] ArtifactError),
    /// There are no scenes.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// An effect that pairs may have.
    #[error(transparent)]
    Effect(#[from] EffectError),
    /// The forward model.
    #[error(transparent)]
    Forward(#[from] ForwardError),
}
