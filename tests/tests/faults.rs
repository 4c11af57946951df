//! Faults put in on purpose lose no network and no frame: what `docs/faults.md` says.
#![allow(clippy::unwrap_used)]

use ommatidia_host::device::faults::{complaints, page, try_board, try_here};
use ommatidia_host::device::{DeviceError, Firmware, find_qemu};
use ommatidia_shared::boards::MPS2_AN500;
use std::path::Path;

/// The images, or what is missing to run them.
fn images() -> Result<(Firmware, Firmware), String> {
    match (Firmware::build(MPS2_AN500, "app"), Firmware::build(MPS2_AN500, "watchdog")) {
        (Ok(_), Ok(_)) if find_qemu().is_none() => Err("qemu-system-arm is not on the PATH".into()),
        (Ok(app), Ok(watchdog)) => Ok((app, watchdog)),
        (Err(DeviceError::NoFirmware { detail }), _) => Err(detail),
        (Err(error), _) | (_, Err(error)) => panic!("{error}"),
    }
}

#[test]
fn no_network_and_no_frame_is_lost() {
    let mut rows = try_here().unwrap();
    match images() {
        Ok((app, watchdog)) => rows.extend(try_board(&app, &watchdog).unwrap()),
        Err(missing) => {
            assert!(std::env::var_os("OMMATIDIA_REQUIRE_QEMU").is_none(), "{missing}");
            ommatidia_tests::skip("no_network_and_no_frame_is_lost, on the emulated board", &missing);
        }
    }
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/faults.md");
    if std::env::var_os("OMMATIDIA_RENEW").is_some() {
        std::fs::write(&path, page(&rows)).unwrap();
    }
    let complaints = complaints(&std::fs::read_to_string(&path).unwrap_or_default(), &rows);
    assert!(complaints.is_empty(), "docs/faults.md against this tree:\n{}", complaints.join("\n"));
}
