//! Whatever emulator is installed, `device run` works: it counts where the emulator can, and says why where it cannot.
//!
//! The stand-ins are shell scripts around the installed emulator. Where that or the firmware is missing the test is
//! reported as skipped.
#![allow(clippy::unwrap_used)]
#![cfg(unix)]

mod networks;
mod program;

use networks::DENSE;
use ommatidia::device::{DeviceError, Firmware, find_qemu};
use ommatidia_session::stack;
use ommatidia_shared::boards::MPS2_AN500;
use serde_json::Value;
use std::path::Path;
use std::process::Command;

/// A version of QEMU with no plugins: it knows no such option.
const WITHOUT_PLUGINS: &str = r#"case "$*" in *-plugin*) echo "qemu: -plugin: invalid option" >&2; exit 1;; esac"#;
/// It takes the plugin when it is asked, and crashes when it counts.
const CRASHES: &str = r#"case "$*" in *counter.so,out=*) echo "Segmentation fault" >&2; kill -9 $$;; esac"#;
/// Its plugin interface is of a time to come.
const TOO_NEW: &str = r#"case "$*" in *ask=*) echo "50 60" > "${*##*ask=}"; exit 1;; esac"#;

#[test]
fn an_emulator_that_cannot_count_runs_uncounted() {
    let name = "an_emulator_that_cannot_count_runs_uncounted";
    let firmware = match (find_qemu(), Firmware::build(MPS2_AN500, "app")) {
        (Some(_), Ok(firmware)) => firmware,
        (None, _) => return missing(name, "qemu-system-arm is not on the PATH"),
        (_, Err(DeviceError::NoFirmware { detail })) => return missing(name, &detail),
        (_, Err(error)) => panic!("{error}"),
    };
    for (script, why) in [(WITHOUT_PLUGINS, "invalid option"), (CRASHES, "stopped"), (TOO_NEW, "interface 60")] {
        let folder = tempfile::tempdir().unwrap();
        let run = device_run(folder.path(), script, firmware.path());
        let reason = run["uncounted"].as_str().unwrap_or_default();
        assert!(reason.contains(why), "expected `{why}`, found {run}");
        assert!(run["instructions"].is_null() && run["bit_exact"] == true && run["ran_on"] == "emulator", "{run}");
    }
    let counted = device_run(tempfile::tempdir().unwrap().path(), "", firmware.path());
    assert!(counted["instructions"].as_u64() > Some(100_000) && counted["uncounted"].is_null(), "{counted}");
}

fn missing(test: &str, what: &str) {
    assert!(std::env::var_os("OMMATIDIA_REQUIRE_QEMU").is_none(), "{what}");
    ommatidia_tests::skip(test, what);
}

/// What `device run --json` prints with an emulator that does `script` first.
fn device_run(folder: &Path, script: &str, firmware: &Path) -> Value {
    let emulator = folder.join("qemu-system-arm");
    let real = find_qemu().unwrap();
    std::fs::write(folder.join("script"), format!("#!/bin/sh\n{script}\nexec {} \"$@\"\n", real.display())).unwrap();
    // `install` writes the program: see the tests of `device::counter`.
    let install = Command::new("install").arg("-m").arg("755").arg(folder.join("script")).arg(&emulator).status();
    assert!(install.unwrap().success());
    networks::network(&DENSE, 40).write(&folder.join("net.omm")).unwrap();
    let frame = networks::frames(&DENSE, 1, 40).remove(0).into_iter().map(f32::from).collect();
    let [rows, cols] = DENSE.frame.map(usize::from);
    let frames = ndarray::Array3::from_shape_vec((1, rows, cols), frame).unwrap();
    stack::write(&folder.join("frames.npy"), frames.view()).unwrap();
    let others = std::env::var_os("PATH").unwrap_or_default();
    let path = std::iter::once(folder.to_path_buf()).chain(std::env::split_paths(&others));
    let mut command = Command::new(program::program());
    command.args(["device", "run", "--json", "--with", "net.omm", "--frames", "frames.npy", "--firmware"]);
    command.arg(firmware).current_dir(folder).env("PATH", std::env::join_paths(path).unwrap());
    let output = command.output().unwrap();
    assert!(output.status.success(), "{script}: {}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}
