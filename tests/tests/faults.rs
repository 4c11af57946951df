//! Injected faults lose no network and no frame: the figures of `docs/faults.md`.
#![allow(clippy::unwrap_used)]

use ommatidia::device::faults::{complaints, page, try_boards, try_here};
use ommatidia::device::{DeviceError, Firmware, find_qemu};
use ommatidia_shared::boards::BOARDS;
use std::path::Path;

/// The images, or what is missing to run them.
fn images(bin: &str) -> Result<Vec<Firmware>, String> {
    let boards = BOARDS.into_iter().filter(|board| board.emulated);
    match boards.map(|board| Firmware::build(board, bin)).collect() {
        Ok(_) if find_qemu().is_none() => Err("qemu-system-arm is not on the PATH".into()),
        Ok(images) => Ok(images),
        Err(DeviceError::NoFirmware { detail }) => Err(detail),
        Err(error) => panic!("{error}"),
    }
}

#[test]
fn no_network_and_no_frame_is_lost() {
    let mut rows = try_here().unwrap();
    match (images("app"), images("watchdog"), images("faults")) {
        (Ok(apps), Ok(watchdogs), Ok(faults)) => rows.extend(try_boards(&apps, &watchdogs, &faults).unwrap()),
        (Err(missing), ..) | (_, Err(missing), _) | (.., Err(missing)) => {
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
