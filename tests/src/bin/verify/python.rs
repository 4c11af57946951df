//! The Python package: its wheel, its tests and the examples of its page, in a virtual environment below the target
//! folder.

use crate::counts::Counts;
use crate::toolchain::{apt_install, target_dir};
use anyhow::{Context, Result, bail, ensure};
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// What the wheel is built and tested with. Packages that only some tests need are not installed: those are skipped.
const PACKAGES: [&str; 4] = ["maturin", "numpy", "pytest", "scipy"];

/// Builds the wheel, installs it, and runs its tests, which compare it with the program.
pub fn package() -> Result<Counts> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let folder = std::path::absolute(target_dir())?.join("python");
    let python = environment(&folder)?;
    let mut build = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    succeeds(build.args(["build", "--release", "-p", "ommatidia"]))?;
    // A wheel of an earlier run must not be mistaken for this one.
    let wheels = folder.join("wheels");
    let _ = std::fs::remove_dir_all(&wheels);
    let mut maturin = Command::new(&python);
    maturin.args(["-m", "maturin", "build", "--release", "-m"]).arg(root.join("host/python/Cargo.toml"));
    succeeds(maturin.arg("-o").arg(&wheels))?;
    let wheel = std::fs::read_dir(&wheels)?.next().context("maturin has made no wheel")??.path();
    let mut install = Command::new(&python);
    install.args(["-m", "pip", "install", "--quiet", "--no-deps", "--force-reinstall"]);
    succeeds(install.arg(wheel))?;
    let mut tests = Command::new(&python);
    tests.args(["-m", "pytest", "-q", "-rs", "-p", "no:cacheprovider"]).arg(root.join("host/python/tests"));
    tests.env("OMMATIDIA_PROGRAM", folder.with_file_name("release").join("ommatidia"));
    counted(tests)
}

/// The Python of the virtual environment, with [`PACKAGES`]. It is made where it is missing.
fn environment(folder: &Path) -> Result<PathBuf> {
    let environment = folder.join("environment");
    let python = environment.join(if cfg!(windows) { "Scripts/python.exe" } else { "bin/python" });
    let has_packages = || {
        let script = format!("import {}", PACKAGES.join(", "));
        let found = Command::new(&python).args(["-c", &script]).stderr(Stdio::null()).status();
        found.is_ok_and(|status| status.success())
    };
    if has_packages() {
        return Ok(python);
    }
    let new_enough = || {
        let script = "import sys, venv, ensurepip; sys.exit(sys.version_info < (3, 10))";
        let found = Command::new("python3").args(["-c", script]).stderr(Stdio::null()).status();
        found.is_ok_and(|status| status.success())
    };
    if !new_enough() {
        apt_install(&["python3-venv", "python3-pip"]);
    }
    ensure!(
        new_enough(),
        "no Python 3.10 or later with `venv` and `pip`: install it (Debian: `apt-get install python3-venv python3-pip`)"
    );
    succeeds(Command::new("python3").args(["-m", "venv", "--clear"]).arg(&environment))?;
    let mut install = Command::new(&python);
    install.args(["-m", "pip", "install", "--quiet"]).args(PACKAGES);
    if succeeds(&mut install).is_err() || !has_packages() {
        bail!("pip cannot install {}: check the network, or install them into {environment:?}", PACKAGES.join(", "));
    }
    Ok(python)
}

fn succeeds(command: &mut Command) -> Result<()> {
    let status = command.status().with_context(|| format!("{command:?} could not be started"))?;
    ensure!(status.success(), "{command:?} failed");
    Ok(())
}

/// Runs pytest and counts its tests.
fn counted(mut command: Command) -> Result<Counts> {
    let mut child =
        command.stdout(Stdio::piped()).spawn().with_context(|| format!("{command:?} could not be started"))?;
    let mut counts = Counts::default();
    if let Some(stdout) = child.stdout.take() {
        for line in BufReader::new(stdout).lines() {
            let line = line.context("reading what the tests print")?;
            println!("{line}");
            counts.add_pytest_line(&line);
        }
    }
    if !child.wait()?.success() && counts.failed == 0 {
        counts += Counts::check(false); // no test said so: none could be collected
    }
    Ok(counts)
}
