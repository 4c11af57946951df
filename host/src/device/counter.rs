//! Counts the instructions of the emulated core: a plugin of QEMU, built from source when it is needed.

use super::error::DeviceError;
use std::path::PathBuf;
use std::process::Command;
use tempfile::TempDir;

/// Source of the plugin.
const SOURCE: &str = include_str!("counter.c");

/// A built plugin, and the file that it writes.
#[derive(Debug)]
pub struct Counter {
    dir: TempDir,
}

impl Counter {
    /// Builds the plugin with the system's C compiler.
    ///
    /// # Errors
    /// There is none, or it fails.
    pub fn build() -> Result<Self, DeviceError> {
        let counter = Self { dir: tempfile::tempdir()? };
        let source = counter.dir.path().join("counter.c");
        std::fs::write(&source, SOURCE)?;
        let output = Command::new("cc")
            .args(["-O2", "-fPIC", "-shared", "-o"])
            .args([&counter.plugin(), &source])
            .output()
            .map_err(|source| DeviceError::Start { program: "cc".into(), source })?;
        if output.status.success() {
            return Ok(counter);
        }
        let detail = String::from_utf8_lossy(&output.stderr).trim().to_string();
        Err(DeviceError::Counter { path: counter.plugin(), detail })
    }

    /// What QEMU's `-plugin` takes.
    pub(super) fn argument(&self) -> String {
        format!("{},out={}", self.plugin().display(), self.output().display())
    }

    /// Instructions of each region that has ended, in the order of execution.
    ///
    /// # Errors
    /// QEMU did not take the plugin.
    pub fn regions(&self) -> Result<Vec<u64>, DeviceError> {
        let wrong = |detail: String| DeviceError::Counter { path: self.output(), detail };
        let text = std::fs::read_to_string(self.output()).map_err(|e| wrong(e.to_string()))?;
        text.lines().map(|line| line.parse().map_err(|_| wrong(format!("expected a count, found `{line}`")))).collect()
    }

    fn plugin(&self) -> PathBuf {
        self.dir.path().join("counter.so")
    }

    fn output(&self) -> PathBuf {
        self.dir.path().join("regions.txt")
    }
}
