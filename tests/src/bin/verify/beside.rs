//! Steps that run beside those in the foreground: this program again, whose output is kept and printed when they end.

use crate::counts::Counts;
use crate::steps::Step;
use crate::toolchain::target_dir;
use anyhow::{Context, Result};
use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::{Child, Command};

/// The argument that makes this program run the steps beside a round, whose number follows.
pub const FLAG: &str = "--beside";

/// Steps that run.
pub struct Beside {
    /// Where their output goes.
    log: PathBuf,
    started: Result<Child>,
}

impl Beside {
    /// Starts the steps beside round `number` with `program`, this program's file. Its path must be found before
    /// anything is built: the build of all tests puts another file in its place.
    pub fn start(program: &Path, number: usize, steps: &[Step]) -> Self {
        let log = target_dir().join(format!("verify-beside-{number}.log"));
        let names: Vec<_> = steps.iter().map(|s| s.name).collect();
        println!("\nbeside what follows: {}; their output comes after it (now in {})", names.join("; "), log.display());
        let start = || {
            let out = File::create(&log).with_context(|| format!("{} cannot be written", log.display()))?;
            let mut command = Command::new(program);
            command.args([FLAG, &number.to_string()]).stdout(out.try_clone()?).stderr(out);
            command.spawn().with_context(|| format!("{command:?} could not be started"))
        };
        Self { started: start(), log }
    }

    /// Waits for the steps, prints their output, and counts. A run that ends without a total has failed.
    pub fn finish(self) -> Counts {
        let ended = self.started.and_then(|mut child| Ok(child.wait()?));
        let text = std::fs::read(&self.log).unwrap_or_default();
        let text = String::from_utf8_lossy(&text);
        let (output, last) = text.trim_end().rsplit_once('\n').unwrap_or(("", text.trim_end()));
        let total = Counts::of_total(last);
        println!("{output}");
        match (ended, total) {
            (Ok(status), Some(total)) if status.success() || total.failed > 0 => total,
            (Ok(status), _) => {
                println!("{last}\nthe steps beside did not end: {status}");
                Counts::check(false)
            }
            (Err(error), _) => {
                println!("the steps beside could not run: {error:#}");
                Counts::check(false)
            }
        }
    }
}
