//! The counter of sealed seeds: how often they were opened.
//!
//! Thresholds are set on development seeds; sealed seeds tell how good they are, once. Whoever looks at them, changes
//! something and looks again has made them development seeds. So each sealed study draws seeds of its own, and the
//! counter says which it is.

use anyhow::{Context, bail};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// The counter, as a JSON file.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sealed {
    /// What this file is, for its reader.
    pub what: String,
    /// How often the sealed seeds were opened.
    pub opened: usize,
    /// The program of each time.
    pub programs: Vec<String>,
}

/// What the file says about itself.
const WHAT: &str = "how often the sealed seeds of `ommatidia study --sealed` were opened; see docs/study.md";

impl Sealed {
    /// Reads the counter; a file that does not exist counts nothing.
    ///
    /// # Errors
    /// The file is not a counter.
    pub fn read(file: &Path) -> anyhow::Result<Self> {
        match std::fs::read(file) {
            Ok(bytes) => {
                let found: Self = serde_json::from_slice(&bytes).with_context(|| file.display().to_string())?;
                if found.opened != found.programs.len() {
                    bail!("{}: {} openings, {} programs", file.display(), found.opened, found.programs.len());
                }
                Ok(found)
            }
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => Ok(Self { what: WHAT.into(), ..Self::default() }),
            Err(e) => Err(e).with_context(|| file.display().to_string()),
        }
    }

    /// Counts one more opening, and writes the counter.
    ///
    /// # Errors
    /// The file cannot be read or written.
    pub fn open(file: &Path) -> anyhow::Result<Self> {
        let mut sealed = Self::read(file)?;
        sealed.opened += 1;
        sealed.programs.push(concat!("ommatidia ", env!("CARGO_PKG_VERSION")).into());
        let mut text = serde_json::to_vec_pretty(&sealed)?;
        text.push(b'\n');
        ommatidia_session::artifact::write_whole(file, &text)?;
        Ok(sealed)
    }
}
