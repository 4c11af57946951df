//! The header of an artifact: kind, version, provenance, and the small numbers of its kind.

use super::error::ArtifactError;
use super::hash::file_hash;
use ndarray::ArrayD;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;

/// Key of the JSON header in the metadata of the safetensors file.
pub(super) const HEADER_KEY: &str = "ommatidia";

/// Tensors of an artifact by name: float32, in C order.
pub type Tensors = BTreeMap<String, ArrayD<f32>>;

/// Where an artifact came from.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Provenance {
    /// Name and version of the program that wrote it.
    pub program: String,
    /// The verb that wrote it.
    pub verb: String,
    /// Seed of all random numbers in it.
    pub seed: u64,
    /// SHA-256 (hexadecimal) of each input file, by the path that was given.
    pub inputs: BTreeMap<String, String>,
    /// Configuration of the verb, as JSON.
    pub config: serde_json::Value,
}

impl Provenance {
    /// Provenance of an artifact that `verb` writes, without inputs.
    pub fn new(verb: &str, seed: u64, config: &impl Serialize) -> Self {
        Self {
            program: concat!("ommatidia ", env!("CARGO_PKG_VERSION")).into(),
            verb: verb.into(),
            seed,
            inputs: BTreeMap::new(),
            config: serde_json::to_value(config).unwrap_or(serde_json::Value::Null),
        }
    }

    /// Adds an input file with its hash.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn with_input(mut self, path: &Path) -> Result<Self, ArtifactError> {
        self.inputs.insert(path.display().to_string(), file_hash(path)?);
        Ok(self)
    }
}

/// The header of an artifact: its kind, its provenance, and the body `T`, which depends on the kind.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Header<T> {
    /// Kind, e.g. `instrument`, `shard` or `checkpoint`.
    pub kind: String,
    /// Version of this kind's layout.
    pub version: u32,
    /// Where the artifact came from.
    pub provenance: Provenance,
    /// What this kind stores besides its tensors.
    pub body: T,
}
