//! Every half through the conversions and the storing loops, on this machine and on each emulated board.
#![allow(clippy::unwrap_used)]

use ommatidia::device::{DeviceError, Firmware, find_qemu, run_to_end};
use ommatidia_firmware::numbers::digests;
use ommatidia_shared::boards::BOARDS;
use std::collections::BTreeSet;

#[test]
fn every_half_converts_alike_on_every_board() {
    let expected: Vec<String> = digests().map(|(name, digest)| format!("{name} {digest:016x}")).to_vec();
    // FNV-1a of nothing: a loop that was refused its input.
    assert!(digests().iter().all(|(_, digest)| *digest != 0xcbf2_9ce4_8422_2325));
    // A digest of nothing would agree everywhere: those of different loops differ, but for the loops over slices.
    assert_eq!(digests().map(|(_, digest)| digest).into_iter().collect::<BTreeSet<_>>().len(), 14);
    let boards = BOARDS.into_iter().filter(|board| board.emulated);
    let missing = match boards.map(|board| Firmware::build(board, "numbers")).collect::<Result<Vec<_>, _>>() {
        Ok(images) if find_qemu().is_some() => {
            for image in images {
                let found = run_to_end(&image, None).unwrap();
                let found: Vec<&str> = found.lines().map(str::trim).filter(|line| !line.is_empty()).collect();
                assert_eq!(found, expected, "{}", image.board().name);
            }
            return;
        }
        Ok(_) => "qemu-system-arm is not on the PATH".to_string(),
        Err(DeviceError::NoFirmware { detail }) => detail,
        Err(error) => panic!("{error}"),
    };
    assert!(std::env::var_os("OMMATIDIA_REQUIRE_QEMU").is_none(), "{missing}");
    ommatidia_tests::skip("every_half_converts_alike_on_every_board", &missing);
}
