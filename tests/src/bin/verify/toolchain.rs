//! What the firmware needs beyond the host's Rust: the ARM target and the emulator. Installed where they are missing.

use anyhow::{Context, Result, bail};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// The default target of the firmware: Cortex-M7 with its FPU.
pub const THUMB: &str = "thumbv7em-none-eabihf";

/// Debian's packages that build for ARM where rustup cannot fetch the target.
const DEBIAN_RUST: &[&str] = &["rustc-web", "cargo-web", "rust-web-src", "gcc-arm-none-eabi"];

/// A compiler for [`THUMB`].
pub enum Toolchain {
    /// The host's own toolchain with the target's standard library.
    Rustup,
    /// Debian's compiler, which builds `core` from source.
    Debian,
}

impl Toolchain {
    /// `cargo` of this toolchain; the caller adds the arguments.
    pub fn cargo(&self) -> Command {
        match self {
            Self::Rustup => Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into())),
            Self::Debian => {
                let mut command = Command::new("/usr/bin/cargo");
                command
                    .env("PATH", "/usr/bin:/bin")
                    .env("RUSTC", "/usr/bin/rustc")
                    .env("RUSTC_BOOTSTRAP", "1")
                    .env("CARGO_UNSTABLE_BUILD_STD", "core")
                    .env("CARGO_TARGET_DIR", self.target_dir())
                    .env("CARGO_TARGET_THUMBV7EM_NONE_EABIHF_LINKER", "arm-none-eabi-ld");
                command
            }
        }
    }

    /// Where the firmware images that this toolchain builds lie.
    pub fn images(&self) -> PathBuf {
        self.target_dir().join(THUMB).join("firmware")
    }

    /// The two toolchains' target folders are kept apart.
    fn target_dir(&self) -> PathBuf {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
        let target = std::env::var_os("CARGO_TARGET_DIR").map_or_else(|| root.join("target"), PathBuf::from);
        match self {
            Self::Rustup => target,
            Self::Debian => target.join("debian"),
        }
    }
}

/// Finds or installs a compiler for [`THUMB`].
pub fn thumb() -> Result<Toolchain> {
    if has_target() || run("rustup", &["target", "add", THUMB]) {
        return Ok(Toolchain::Rustup);
    }
    println!("rustup cannot add {THUMB}; trying Debian's packages");
    let debian = || Path::new("/usr/bin/cargo").exists() && Path::new("/usr/bin/arm-none-eabi-ld").exists();
    if debian() || (apt_install(DEBIAN_RUST) && debian()) {
        return Ok(Toolchain::Debian);
    }
    bail!(
        "no compiler for {THUMB}: run `rustup target add {THUMB}`, or on Debian `apt-get install {}`",
        DEBIAN_RUST.join(" ")
    )
}

/// Finds or installs the emulator.
pub fn ensure_qemu() -> Result<()> {
    let version = || Command::new("qemu-system-arm").arg("--version").stdout(Stdio::null()).status();
    if version().is_err() {
        apt_install(&["qemu-system-arm"]);
    }
    let status = version().context("no qemu-system-arm: install it (Debian: `apt-get install qemu-system-arm`)")?;
    if !status.success() {
        bail!("`qemu-system-arm --version` failed");
    }
    Ok(())
}

fn has_target() -> bool {
    Command::new("rustup")
        .args(["target", "list", "--installed"])
        .output()
        .is_ok_and(|o| String::from_utf8_lossy(&o.stdout).lines().any(|l| l.trim() == THUMB))
}

fn apt_install(packages: &[&str]) -> bool {
    let mut install = vec!["install", "-y", "--no-install-recommends"];
    install.extend(packages);
    run("apt-get", &["update"]) && run("apt-get", &install)
}

fn run(program: &str, args: &[&str]) -> bool {
    println!("$ {program} {}", args.join(" "));
    Command::new(program).args(args).status().is_ok_and(|s| s.success())
}
