//! The steps of `cargo verify`.

use crate::counts::Counts;
use crate::{disk, python, toolchain};
use anyhow::{Context, Result, ensure};
use ommatidia_shared::boards::{BOARDS, NUCLEO_H743ZI};
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Command, Stdio};

/// The programs in `fuzz/fuzz_targets`, and how long each runs.
const FUZZ_TARGETS: [&str; 5] = ["blob", "wire", "device", "session", "recording"];
const FUZZ_SECONDS: u32 = 8;

/// One step: it either counts tests or is one check.
pub struct Step {
    pub name: &'static str,
    /// The names of the steps that must have ended before this one begins.
    pub after: &'static [&'static str],
    pub run: fn() -> Result<Counts>,
}

/// What runs alone, before everything else: whether there is room, and the tools.
pub fn first() -> Vec<Step> {
    let step = |name, run| Step { name, after: &[], run };
    vec![
        step("disk space", || disk::has_room(&toolchain::target_dir()).map(|()| Counts::check(true))),
        step("formatting", || check(cargo(["fmt", "--all", "--check"]))),
        step("tools", || toolchain::ensure_all().map(|()| Counts::check(true))),
    ]
}

/// What follows. The first step that can begin is taken, so that the longest ones stand in front. Nothing here installs
/// tools with the package manager of the system, but for Python. A step that builds in a target folder in which another
/// one builds waits for it: what needs the folder of the tests comes after their build, and the lints, which take long
/// in it, beside the longest tests.
pub fn rest() -> Vec<Step> {
    const BUILD: &str = "build of all tests";
    const IMAGES: &str = "firmware images";
    const HOSTILE: &str = "hostile input";
    let step = |name, after, run| Step { name, after, run };
    vec![
        step(BUILD, &[], || check(cargo(["test", "--release", "--workspace", "--no-run"]))),
        step(IMAGES, &[], firmware_images),
        step("tests of shared with overflow checks, 32-bit program", &[], narrow_tests),
        step("bits and plans of shared with overflow checks, AArch64, emulated", &[], aarch64_tests),
        step("shared on other cores", &[], other_cores),
        step(HOSTILE, &[], hostile_input),
        step("hostile input, 32-bit program", &[HOSTILE], narrow_hostile_input),
        step("lints of the boards", &[IMAGES], lints_of_boards),
        step("sessions that are closed", &[BUILD], closed_sessions),
        step("lints", &[BUILD], || {
            check(cargo(["clippy", "--release", "--workspace", "--all-targets", "--", "-D", "warnings"]))
        }),
        step("documentation", &[BUILD], documentation),
        step("other integration tests", &[BUILD, IMAGES], || {
            tests(&["--workspace", "--exclude", "ommatidia-closing", "--test", "*"])
        }),
        step("unit tests", &[BUILD], || tests(&["--workspace", "--lib", "--bins"])),
        step("examples in the documentation", &[BUILD], || tests(&["--workspace", "--doc"])),
        step("Python package", &[BUILD], python::package),
    ]
}

fn cargo<const N: usize>(args: [&str; N]) -> Command {
    let mut command = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    command.args(args);
    command
}

fn check(mut command: Command) -> Result<Counts> {
    let status = command.status().with_context(|| format!("{command:?} could not be started"))?;
    Ok(Counts::check(status.success()))
}

fn documentation() -> Result<Counts> {
    let mut command = cargo(["doc", "--release", "--workspace", "--no-deps"]);
    command.env("RUSTDOCFLAGS", "-D warnings");
    check(command)
}

/// The programs of every board: one check a board.
fn firmware_images() -> Result<Counts> {
    let toolchain = toolchain::thumb()?;
    // The program with its log, for the board that has a probe. Its profile is that of the others, but for the size of
    // the program itself, so that they share what both depend on; the image without the log then takes its place.
    let mut command = toolchain.cargo(NUCLEO_H743ZI);
    command.args(["build", "--profile", "firmware", "-p", "ommatidia-firmware", "--bin", "app"]);
    command.args(["--features", "nucleo-h743zi,probe", "--target", NUCLEO_H743ZI.target]);
    command.args(["--config", "profile.firmware.package.ommatidia-firmware.opt-level='z'"]);
    let mut counts = check(command)?;
    for board in BOARDS {
        let mut command = toolchain.cargo(board);
        command.args(["build", "--profile", "firmware", "-p", "ommatidia-firmware", "--features", board.name]);
        command.args(["--bins", "--target", board.target]);
        counts += check(command)?;
    }
    Ok(counts)
}

/// The lints of the firmware for every board: one check for each.
fn lints_of_boards() -> Result<Counts> {
    let toolchain = toolchain::thumb()?;
    if !toolchain.has_clippy() {
        println!("skipped: Debian's compiler for the boards has no clippy; `rustup target add` gives one that has");
        return Ok(Counts { skipped: BOARDS.len() as u64, ..Counts::default() });
    }
    let mut counts = Counts::default();
    for board in BOARDS {
        let mut command = toolchain.cargo(board);
        command.args(["clippy", "--profile", "firmware", "-p", "ommatidia-firmware", "--features", board.name]);
        command.args(["--bins", "--target", board.target, "--", "-D", "warnings"]);
        counts += check(command)?;
    }
    Ok(counts)
}

/// Optimisation of the fuzz targets: their builds take longer than their runs. Runs of hours take the level of
/// `fuzz/Cargo.toml`.
const FUZZ_LEVEL: [&str; 2] = ["CARGO_PROFILE_RELEASE_OPT_LEVEL", "1"];

/// Builds the fuzz targets with coverage and the address sanitizer, and runs each for [`FUZZ_SECONDS`] from its seeds.
fn hostile_input() -> Result<Counts> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let (target, host) = (toolchain::target_dir().join("fuzz"), toolchain::host()?);
    let mut build = cargo(["build", "--release", "--manifest-path"]);
    build.arg(root.join("fuzz/Cargo.toml")).args(["--target", &host, "--target-dir"]).arg(&target);
    // The sanitizer is not stable; the compiler that has it is.
    build.env("RUSTC_BOOTSTRAP", "1").env("RUSTFLAGS", toolchain::FUZZ_FLAGS).env(FUZZ_LEVEL[0], FUZZ_LEVEL[1]);
    let mut counts = check(build)?;
    for name in FUZZ_TARGETS {
        let (corpus, found) = (target.join("corpus").join(name), target.join("found"));
        std::fs::create_dir_all(&corpus)?;
        std::fs::create_dir_all(&found)?;
        let mut run = Command::new(target.join(&host).join("release").join(name));
        run.arg(format!("-max_total_time={FUZZ_SECONDS}")).args([
            "-max_len=32768",
            "-rss_limit_mb=4096",
            "-timeout=30",
        ]);
        run.args(["-verbosity=0", "-print_final_stats=1"]).arg(format!("-artifact_prefix={}/{name}-", found.display()));
        run.arg(corpus).arg(root.join("fuzz/seeds").join(name));
        counts += check(run)?;
    }
    Ok(counts)
}

/// The tests of `shared` as a 32-bit program: lengths wrap there as they do on the boards. `shared` has no loops of its
/// own for this machine's processor, so that no debug build for it is tested beside this one and that for AArch64.
fn narrow_tests() -> Result<Counts> {
    let mut command = toolchain::linux(toolchain::NARROW)?;
    command.args(["test", "--no-fail-fast", "-p", "ommatidia-shared", "--lib", "--tests"]);
    command.args(["--target", toolchain::NARROW]).env("CARGO_PROFILE_DEV_DEBUG", "0");
    counted(command)
}

/// Builds `shared` for cores without loops of their own: one check a core.
fn other_cores() -> Result<Counts> {
    let mut counts = Counts::default();
    for (target, flags) in toolchain::OTHER_CORES {
        let mut command = toolchain::linux(target)?;
        command.args(["build", "-p", "ommatidia-shared", "--target", target]).env("CARGO_ENCODED_RUSTFLAGS", flags);
        // Nothing runs it.
        command.env("CARGO_PROFILE_DEV_OPT_LEVEL", "0").env("CARGO_PROFILE_DEV_DEBUG", "0");
        counts += check(command)?;
    }
    Ok(counts)
}

/// The bits of reconstructions and the sizes of plans, as a program for AArch64: its loops are the portable ones, as
/// those of this machine and of the 32-bit program are, which run the other tests of `shared`.
fn aarch64_tests() -> Result<Counts> {
    let mut command = toolchain::linux(toolchain::AARCH64)?;
    command.args(["test", "--no-fail-fast", "-p", "ommatidia-shared", "--test", "*"]);
    command
        .args(["--target", toolchain::AARCH64])
        .env("CARGO_PROFILE_DEV_DEBUG", "0")
        .env("CARGO_TARGET_AARCH64_UNKNOWN_LINUX_MUSL_RUNNER", "qemu-aarch64");
    counted(command)
}

/// The fuzz targets as a 32-bit program, from the seeds and from what the step before has found.
fn narrow_hostile_input() -> Result<Counts> {
    let fuzz = Path::new(env!("CARGO_MANIFEST_DIR")).join("../fuzz");
    let mut command = toolchain::linux(toolchain::NARROW)?;
    command.args(["test", "--release", "--no-fail-fast", "--no-default-features", "--test", "narrow"]);
    command.args(["--target", toolchain::NARROW, "--manifest-path"]).arg(fuzz.join("Cargo.toml"));
    let target = toolchain::target_dir().join("fuzz");
    command.env("OMMATIDIA_CORPUS", target.join("corpus")).env("OMMATIDIA_SECONDS", FUZZ_SECONDS.to_string());
    // As for the step before, so that what both build for this machine is built once.
    command.env("RUSTC_BOOTSTRAP", "1");
    command.env("CARGO_TARGET_DIR", target).env(FUZZ_LEVEL[0], FUZZ_LEVEL[1]).args(["--", "--nocapture"]);
    counted(command)
}

/// The integration tests of closing: half of the time of all. They are chosen by the names of their programs, since a
/// choice of packages would change the features of dependencies, and build them again.
fn closed_sessions() -> Result<Counts> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../host/closing/tests");
    let mut which = vec!["--workspace".to_string()];
    for entry in std::fs::read_dir(&folder).with_context(|| folder.display().to_string())? {
        let path = entry?.path();
        let is_program = path.extension().is_some_and(|e| e == "rs") || path.join("main.rs").is_file();
        if let Some(name) = path.file_stem().filter(|_| is_program) {
            which.extend(["--test".to_string(), name.to_string_lossy().into_owned()]);
        }
    }
    ensure!(which.len() > 1, "{}: no tests are there", folder.display());
    tests(&which.iter().map(String::as_str).collect::<Vec<_>>())
}

/// Runs the tests of some packages and kinds, and counts them. A test that finds no measured data writes its name and
/// the reason to the file in `OMMATIDIA_SKIPPED`; those are reported as skipped, not as passed.
fn tests(which: &[&str]) -> Result<Counts> {
    let mut command = cargo(["test", "--no-fail-fast", "--release"]);
    command.args(which);
    counted(command)
}

/// Runs a test runner and counts its tests.
fn counted(mut command: Command) -> Result<Counts> {
    let skips = std::env::temp_dir().join(format!("ommatidia-skipped-{}", std::process::id()));
    let _ = std::fs::remove_file(&skips);
    command.env("OMMATIDIA_SKIPPED", &skips).env("OMMATIDIA_REQUIRE_QEMU", "1");
    command.env("OMMATIDIA_FIRMWARE", toolchain::thumb()?.images()).stdout(Stdio::piped());
    let mut child = command.spawn().with_context(|| format!("{command:?} could not be started"))?;
    let mut counts = Counts::default();
    if let Some(stdout) = child.stdout.take() {
        for line in BufReader::new(stdout).lines() {
            let line = line.context("reading what the tests print")?;
            println!("{line}");
            counts.add_line(&line);
        }
    }
    let status = child.wait()?;
    if !status.success() && counts.failed == 0 {
        counts += Counts::check(false); // a build error or a crash: no test said so
    }
    let skipped = std::fs::read_to_string(&skips).unwrap_or_default();
    for line in skipped.lines() {
        println!("skipped: {line}");
    }
    counts.skip(skipped.lines().count() as u64);
    let _ = std::fs::remove_file(&skips);
    Ok(counts)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_have_names_of_their_own_and_wait_for_earlier_ones() {
        let steps = rest();
        for (index, step) in steps.iter().enumerate() {
            let before: Vec<_> = steps[..index].iter().map(|s| s.name).collect();
            assert!(!before.contains(&step.name), "two steps: {}", step.name);
            for name in step.after {
                assert!(before.contains(name), "{}: no step before it is {name}", step.name);
            }
        }
    }
}
