//! The instructions of each operator on each microcontroller are those of `docs/instructions.md`.
#![allow(clippy::unwrap_used)]

use ommatidia::device::{BoardCounts, DeviceError, count_board, find_qemu, table};
use ommatidia_shared::boards::{BOARDS, Board};
use std::path::Path;

/// Why nothing was counted.
enum Uncounted {
    /// Something is missing that `cargo verify` installs.
    Missing(String),
    /// The installed QEMU takes no plugin, or none of a known interface.
    Emulator(String),
}

/// The counts of this tree.
fn counts(board: Board) -> Result<BoardCounts, Uncounted> {
    if find_qemu().is_none() {
        return Err(Uncounted::Missing("qemu-system-arm is not on the PATH".into()));
    }
    match count_board(board) {
        Ok(counts) => Ok(counts),
        Err(DeviceError::NoFirmware { detail }) => Err(Uncounted::Missing(detail)),
        Err(error @ DeviceError::Counter { .. }) => Err(Uncounted::Missing(error.to_string())),
        Err(error @ DeviceError::Uncountable { .. }) => Err(Uncounted::Emulator(error.to_string())),
        Err(error) => panic!("{}: {error}", board.name),
    }
}

/// Where something is missing the test is reported as skipped; under `cargo verify`, which installs it, it fails. With
/// an emulator that cannot count it is skipped always. With `OMMATIDIA_RENEW` it writes the page.
#[test]
fn no_operator_takes_more_instructions_than_the_page_says() {
    let boards = BOARDS.into_iter().filter(|board| board.emulated);
    let counts: Vec<BoardCounts> = match boards.map(counts).collect() {
        Ok(counts) => counts,
        Err(why) => {
            let why = match why {
                Uncounted::Emulator(why) => why,
                Uncounted::Missing(missing) => {
                    assert!(std::env::var_os("OMMATIDIA_REQUIRE_QEMU").is_none(), "{missing}");
                    missing
                }
            };
            return ommatidia_tests::skip("no_operator_takes_more_instructions_than_the_page_says", &why);
        }
    };
    let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/instructions.md");
    if std::env::var_os("OMMATIDIA_RENEW").is_some() {
        std::fs::write(&page, table::page(&counts).unwrap()).unwrap();
    }
    let page = std::fs::read_to_string(&page).unwrap_or_default();
    let complaint = |counts: &BoardCounts| {
        table::complaints(&page, counts)
            .into_iter()
            .map(|text| format!("{}: {text}", counts.board.name))
            .collect::<Vec<_>>()
    };
    let complaints: Vec<String> = counts.iter().flat_map(complaint).collect();
    assert!(table::rates_follow(&page).unwrap(), "the frame rates do not follow from the tables: write the page again");
    assert!(complaints.is_empty(), "docs/instructions.md against this tree:\n{}", complaints.join("\n"));
}
