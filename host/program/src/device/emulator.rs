//! The emulator on this computer: where it lies, and which version it is.

use super::error::DeviceError;
use std::fmt;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// `qemu-system-arm`, if it is on the `PATH`.
pub fn find_qemu() -> Option<PathBuf> {
    std::env::split_paths(&std::env::var_os("PATH")?).map(|dir| dir.join("qemu-system-arm")).find(|file| file.is_file())
}

/// An emulator that was asked for its version.
#[derive(Clone, Debug)]
pub struct Emulator {
    path: PathBuf,
    version: String,
}

impl Emulator {
    /// The emulator on the `PATH`.
    ///
    /// # Errors
    /// There is none, or it cannot be started.
    pub fn find() -> Result<Self, DeviceError> {
        Self::at(&find_qemu().ok_or(DeviceError::NoQemu)?)
    }

    /// The emulator that is this file.
    ///
    /// # Errors
    /// It cannot be started.
    pub fn at(path: &Path) -> Result<Self, DeviceError> {
        let output = Command::new(path).arg("--version").stdin(Stdio::null()).output().map_err(|source| {
            let program = path.display().to_string();
            DeviceError::Start { program, source }
        })?;
        let version = version(&String::from_utf8_lossy(&output.stdout)).unwrap_or("of unknown version").to_string();
        Ok(Self { path: path.into(), version })
    }

    /// The program.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// A command line that starts it; the caller adds the arguments.
    pub(super) fn command(&self) -> Command {
        Command::new(&self.path)
    }
}

impl fmt::Display for Emulator {
    /// For example `QEMU 10.0.2`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "QEMU {}", self.version)
    }
}

/// The version in the first line that `qemu-system-arm --version` prints.
fn version(text: &str) -> Option<&str> {
    let words = text.lines().next()?.split_once("version ")?.1;
    words.split([' ', '(']).next().filter(|word| word.starts_with(|c: char| c.is_ascii_digit()))
}

#[cfg(test)]
mod tests {
    use super::version;

    #[test]
    fn the_version_is_the_number_in_the_first_line() {
        let text = "QEMU emulator version 10.0.2 (Debian 1:10.0.2+ds-2+deb13u1)\nCopyright (c) 2003-2025\n";
        assert_eq!(version(text), Some("10.0.2"));
        assert_eq!(version("QEMU emulator version 7.2.22(Debian)\n"), Some("7.2.22"));
        assert_eq!(version("something else"), None);
        assert_eq!(version(""), None);
    }
}
