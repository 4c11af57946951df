//! What the firmware needs beyond the host's Rust: the ARM targets and the emulator. Installed where they are missing.

use anyhow::{Context, Result, bail};
use ommatidia_shared::boards::{BOARDS, Board};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// Debian's packages that build for ARM where rustup cannot fetch the target.
const DEBIAN_RUST: &[&str] = &["rustc-web", "cargo-web", "rust-web-src", "gcc-arm-none-eabi"];

/// A compiler for the boards.
pub enum Toolchain {
    /// The host's own toolchain with the targets' core libraries.
    Rustup,
    /// Debian's compiler, which builds `core` from source.
    Debian,
}

impl Toolchain {
    /// `cargo` of this toolchain, building for `board`; the caller adds the arguments.
    pub fn cargo(&self, board: Board) -> Command {
        let mut command = match self {
            Self::Rustup => Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into())),
            Self::Debian => {
                let mut command = Command::new("/usr/bin/cargo");
                command
                    .env("PATH", "/usr/bin:/bin")
                    .env("RUSTC", "/usr/bin/rustc")
                    .env("RUSTC_BOOTSTRAP", "1")
                    .env("CARGO_UNSTABLE_BUILD_STD", "core")
                    .env("CARGO_TARGET_THUMBV7EM_NONE_EABIHF_LINKER", "arm-none-eabi-ld")
                    .env("CARGO_TARGET_THUMBV8M_MAIN_NONE_EABIHF_LINKER", "arm-none-eabi-ld");
                command
            }
        };
        command.env("CARGO_TARGET_DIR", self.images().join(board.name));
        command.env("CARGO_ENCODED_RUSTFLAGS", board.rustflags.join("\x1f"));
        // Incremental builds divide the code otherwise: the counts of instructions would be those of another image.
        command.env("CARGO_INCREMENTAL", "0");
        command
    }

    /// Whether `cargo clippy` of this toolchain knows the boards' targets.
    pub fn has_clippy(&self) -> bool {
        matches!(self, Self::Rustup)
    }

    /// Where the firmware images that this toolchain builds lie, a folder a board.
    pub fn images(&self) -> PathBuf {
        self.target_dir().join("boards")
    }

    /// The two toolchains' target folders are kept apart.
    fn target_dir(&self) -> PathBuf {
        match self {
            Self::Rustup => target_dir(),
            Self::Debian => target_dir().join("debian"),
        }
    }
}

/// Cargo's target folder.
pub fn target_dir() -> PathBuf {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap_or(Path::new("."));
    std::env::var_os("CARGO_TARGET_DIR").map_or_else(|| root.join("target"), PathBuf::from)
}

/// What `cargo fuzz` gives the compiler: coverage for libFuzzer, and the address sanitizer.
pub const FUZZ_FLAGS: &str = "-Zsanitizer=address -Cpasses=sancov-module -Cllvm-args=-sanitizer-coverage-level=4 \
    -Cllvm-args=-sanitizer-coverage-inline-8bit-counters -Cllvm-args=-sanitizer-coverage-pc-table \
    -Cllvm-args=-sanitizer-coverage-trace-compares --cfg fuzzing";

/// The triple of this machine.
pub fn host() -> Result<String> {
    let output = Command::new("rustc").arg("-vV").output().context("rustc could not be started")?;
    let text = String::from_utf8_lossy(&output.stdout);
    let host = text.lines().find_map(|line| line.strip_prefix("host: "));
    Ok(host.context("rustc does not say what it runs on")?.to_string())
}

/// Finds or installs everything that the steps need, but for Python.
pub fn ensure_all() -> Result<()> {
    ensure_qemu()?;
    ensure_qemu_user()?;
    ensure_ffmpeg()?;
    ensure_cpp()?;
    thumb()?;
    [NARROW, AARCH64].into_iter().chain(OTHER_CORES.map(|(target, _)| target)).try_for_each(ensure_target)
}

/// Finds or installs the C++ compiler that libFuzzer is built with.
fn ensure_cpp() -> Result<()> {
    let version = || Command::new("c++").arg("--version").stdout(Stdio::null()).status();
    if version().is_err() {
        apt_install(&["g++"]);
    }
    version().context("no C++ compiler: install one (Debian: `apt-get install g++`)")?;
    Ok(())
}

/// A 32-bit program that this machine runs itself: it needs no C library and no C linker of 32 bits.
pub const NARROW: &str = "i686-unknown-linux-musl";

/// A 64-bit Arm program, which this machine runs under QEMU's user mode.
pub const AARCH64: &str = "aarch64-unknown-linux-musl";

/// Cores that no board has yet: they take the portable loops. Target, and flags for the core.
pub const OTHER_CORES: [(&str, &str); 4] = [
    ("thumbv8m.main-none-eabihf", "-Ctarget-cpu=cortex-m33"),
    ("thumbv8m.main-none-eabi", ""),
    ("armv7-unknown-linux-gnueabihf", ""),
    ("riscv32imafc-unknown-none-elf", ""),
];

/// Finds or installs the user-mode emulator for [`AARCH64`].
fn ensure_qemu_user() -> Result<()> {
    let version = || Command::new("qemu-aarch64").arg("--version").stdout(Stdio::null()).status();
    if version().is_err() {
        apt_install(&["qemu-user"]);
    }
    version().context("no qemu-aarch64: install it (Debian: `apt-get install qemu-user`)")?;
    Ok(())
}

/// `cargo` that builds for a target of Linux which the linker of the compiler itself can link. The caller adds the
/// arguments. The target is installed where it is missing.
pub fn linux(target: &str) -> Result<Command> {
    ensure_target(target)?;
    let mut command = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    let variable = format!("CARGO_TARGET_{}_LINKER", target.replace('-', "_").to_uppercase());
    command.env(variable, "rust-lld").env("CARGO_TARGET_DIR", target_dir().join("narrow"));
    Ok(command)
}

/// Finds or installs the core library of a target.
pub fn ensure_target(target: &str) -> Result<()> {
    if has_target(target) || run("rustup", &["target", "add", target]) {
        return Ok(());
    }
    bail!("no compiler for {target}: run `rustup target add {target}`")
}

/// Finds or installs a compiler for the boards.
pub fn thumb() -> Result<Toolchain> {
    let mut targets: Vec<&str> = BOARDS.iter().map(|board| board.target).collect();
    targets.sort_unstable();
    targets.dedup();
    if targets.iter().all(|target| has_target(target) || run("rustup", &["target", "add", target])) {
        return Ok(Toolchain::Rustup);
    }
    println!("rustup cannot add {}; trying Debian's packages", targets.join(" or "));
    let debian = || Path::new("/usr/bin/cargo").exists() && Path::new("/usr/bin/arm-none-eabi-ld").exists();
    if debian() || (apt_install(DEBIAN_RUST) && debian()) {
        return Ok(Toolchain::Debian);
    }
    bail!(
        "no compiler for {0}: run `rustup target add {0}`, or on Debian `apt-get install {1}`",
        targets.join(" "),
        DEBIAN_RUST.join(" ")
    )
}

/// Finds or installs the emulator, and prints its version. The tests ask it whether it counts instructions.
fn ensure_qemu() -> Result<()> {
    let version = || Command::new("qemu-system-arm").arg("--version").output();
    if version().is_err() {
        apt_install(&["qemu-system-arm"]);
    }
    let output = version().context("no qemu-system-arm: install it (Debian: `apt-get install qemu-system-arm`)")?;
    if !output.status.success() {
        bail!("`qemu-system-arm --version` failed: {}", String::from_utf8_lossy(&output.stderr).trim());
    }
    println!("{}", String::from_utf8_lossy(&output.stdout).lines().next().unwrap_or_default());
    Ok(())
}

/// Finds or installs ffmpeg, which the tests of videos need.
fn ensure_ffmpeg() -> Result<()> {
    let version = || Command::new("ffmpeg").arg("-version").output();
    if version().is_err() {
        apt_install(&["ffmpeg"]);
    }
    version().context("no ffmpeg: install it (Debian: `apt-get install ffmpeg`)")?;
    Ok(())
}

fn has_target(target: &str) -> bool {
    Command::new("rustup")
        .args(["target", "list", "--installed"])
        .output()
        .is_ok_and(|o| String::from_utf8_lossy(&o.stdout).lines().any(|l| l.trim() == target))
}

/// Installs Debian's packages, where this is Debian and may be changed.
pub fn apt_install(packages: &[&str]) -> bool {
    let mut install = vec!["install", "-y", "--no-install-recommends"];
    install.extend(packages);
    run("apt-get", &["update"]) && run("apt-get", &install)
}

fn run(program: &str, args: &[&str]) -> bool {
    println!("$ {program} {}", args.join(" "));
    Command::new(program).args(args).status().is_ok_and(|s| s.success())
}
