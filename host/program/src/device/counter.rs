//! Counts the instructions of the emulated core: a plugin of QEMU, built from source when it is needed.
//!
//! QEMU's plugin interface has changed six times. [`Counter::build`] asks the emulator first which versions it takes,
//! and declares one of them.

use super::emulator::Emulator;
use super::error::DeviceError;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// Source of the plugin.
const SOURCE: &str = include_str!("counter.c");
/// The newest version of QEMU's plugin interface that the plugin speaks (`NEWEST` in its source).
const NEWEST: u32 = 7;
/// An emulator that is asked answers within this time.
const ANSWERS_WITHIN: Duration = Duration::from_secs(10);

/// A built plugin, and the file that it writes.
#[derive(Debug)]
pub struct Counter {
    dir: TempDir,
}

impl Counter {
    /// Builds the plugin with the system's C compiler, for the plugin interface of this emulator.
    ///
    /// # Errors
    /// There is no compiler, or it fails; or the emulator takes no plugin whose interface is known.
    pub fn build(emulator: &Emulator) -> Result<Self, DeviceError> {
        let counter = Self { dir: tempfile::tempdir()? };
        std::fs::write(counter.source(), SOURCE)?;
        let mut said = String::new();
        for declared in 1..=NEWEST {
            counter.compile(declared)?;
            match counter.ask(emulator)? {
                Answer::Takes { newest } if newest <= NEWEST => return Ok(counter),
                Answer::Takes { newest } => {
                    said = format!("it has plugin interface {newest}, and 1 to {NEWEST} are known here");
                    break;
                }
                Answer::Refuses(text) => said = text,
                Answer::Silent => {
                    said = format!("it does not answer within {} s", ANSWERS_WITHIN.as_secs());
                    break;
                }
            }
        }
        Err(DeviceError::Uncountable { emulator: emulator.to_string(), detail: said })
    }

    /// Compiles the plugin; it declares version `declared` of the interface.
    fn compile(&self, declared: u32) -> Result<(), DeviceError> {
        let failed = |detail: String| DeviceError::Counter { detail };
        let mut cc = Command::new("cc");
        cc.args(["-O2", "-fPIC", "-shared", &format!("-DDECLARED={declared}"), "-o"]);
        let output = cc.args([&self.plugin(), &self.source()]).output().map_err(|error| {
            failed(format!(
                "the C compiler `cc` cannot be started ({error}); install one (Debian: `apt-get install gcc`)"
            ))
        })?;
        if output.status.success() {
            return Ok(());
        }
        Err(failed(format!("`cc` fails: {}", String::from_utf8_lossy(&output.stderr).trim())))
    }

    /// Starts the emulator with the plugin and without a board, and reads which versions it takes.
    fn ask(&self, emulator: &Emulator) -> Result<Answer, DeviceError> {
        let (answer, log) = (self.dir.path().join("answer.txt"), self.dir.path().join("log.txt"));
        let plugin = format!("{},ask={}", self.plugin().display(), answer.display());
        let mut command = emulator.command();
        command.args(["-M", "none", "-display", "none", "-monitor", "none", "-serial", "none", "-plugin", &plugin]);
        let output = std::fs::File::create(&log)?;
        command.stdin(Stdio::null()).stdout(output.try_clone()?).stderr(output);
        let start = |source| DeviceError::Start { program: emulator.path().display().to_string(), source };
        let mut child = command.spawn().map_err(start)?;
        let deadline = Instant::now() + ANSWERS_WITHIN;
        while child.try_wait()?.is_none() {
            if Instant::now() > deadline {
                child.kill()?;
                child.wait()?;
                return Ok(Answer::Silent);
            }
            std::thread::sleep(Duration::from_millis(5));
        }
        // No file: the emulator did not let the plugin in.
        let text = std::fs::read_to_string(&answer).unwrap_or_default();
        if let Some(newest) = text.split_whitespace().nth(1).and_then(|number| number.parse().ok()) {
            return Ok(Answer::Takes { newest });
        }
        Ok(Answer::Refuses(last_line(&log, &self.plugin())))
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
        let wrong = |detail: String| DeviceError::Counter { detail };
        let text = std::fs::read_to_string(self.output())
            .map_err(|error| wrong(format!("the emulator wrote no counts ({error})")))?;
        text.lines().map(|line| line.parse().map_err(|_| wrong(format!("expected a count, found `{line}`")))).collect()
    }

    fn source(&self) -> PathBuf {
        self.dir.path().join("counter.c")
    }

    fn plugin(&self) -> PathBuf {
        self.dir.path().join("counter.so")
    }

    fn output(&self) -> PathBuf {
        self.dir.path().join("regions.txt")
    }
}

/// What an emulator makes of a plugin.
enum Answer {
    /// It takes the plugin.
    Takes {
        /// The newest version of the interface that it has, and so the one that it speaks.
        newest: u32,
    },
    /// It does not, and says why.
    Refuses(String),
    /// It says nothing and does not end.
    Silent,
}

/// The last line of what the emulator printed, without the names of itself and of the temporary file.
fn last_line(log: &Path, plugin: &Path) -> String {
    let text = std::fs::read_to_string(log).unwrap_or_default();
    let line = text.lines().rev().find(|line| !line.trim().is_empty()).unwrap_or("it says nothing");
    let said = line.rsplit_once(&format!("{}: ", plugin.display())).map_or(line, |(_, said)| said);
    said.trim().to_string()
}

#[cfg(test)]
#[cfg(unix)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    /// An emulator that counts how often it is asked (`$n`) and then does `script`.
    fn emulator(folder: &Path, script: &str) -> Emulator {
        let path = folder.join("qemu-system-arm");
        let text = format!(
            "#!/bin/sh\ncase $1 in --version) echo 'QEMU emulator version 99.1'; exit;; esac\n\
             echo >> {0}/asked; n=$(wc -l < {0}/asked); file=\"${{*##*ask=}}\"\n{script}\n",
            folder.display()
        );
        std::fs::write(folder.join("script"), text).unwrap();
        // `install` writes the program, so that no test beside this one can inherit a descriptor that is open for
        // writing: while one is, the system refuses to start the program ("text file busy").
        let mut install = Command::new("install");
        install.args(["-m", "755", "script", "qemu-system-arm"]).current_dir(folder);
        assert!(install.status().unwrap().success());
        Emulator::at(&path).unwrap()
    }

    fn asked(folder: &Path) -> usize {
        std::fs::read_to_string(folder.join("asked")).unwrap().lines().count()
    }

    #[test]
    fn versions_are_tried_until_one_is_taken() {
        let folder = tempfile::tempdir().unwrap();
        // As QEMU 10: at least version 2, and version 4 is spoken.
        let script = "[ $n -ge 2 ] && echo '2 4' > $file; exit 1";
        Counter::build(&emulator(folder.path(), script)).unwrap();
        assert_eq!(asked(folder.path()), 2);
    }

    #[test]
    fn an_emulator_that_takes_no_known_version_is_reported_with_its_words() {
        let script = "echo \"qemu: Could not load plugin ${file%answer.txt}counter.so: too old\" >&2; exit 1";
        let cases =
            [(script, "QEMU 99.1 counts no instructions: too old", 7), ("echo '1 12' > $file", "interface 12", 1)];
        for (script, words, times) in cases {
            let folder = tempfile::tempdir().unwrap();
            let error = Counter::build(&emulator(folder.path(), script)).unwrap_err();
            assert!(matches!(error, DeviceError::Uncountable { .. }), "{error}");
            assert!(error.to_string().contains(words), "{error}");
            assert_eq!(asked(folder.path()), times);
        }
    }
}
