//! No byte from outside leads to a panic of the firmware: the code that handles bytes from outside has no place that
//! can panic.
//!
//! Every place that can panic passes its source location to the panic. So the locations in the linked image are the
//! places that can be reached. Messages, network file, flash, state machine and boards must have none. The arithmetic
//! has bounds checks of indices that follow only from shapes, which `Pipeline::new` checks, and not from the values of
//! pixels, weights or messages. The test `strange_headers_are_refused_or_run` and the fuzz target `blob` try unusual
//! shapes. If one should panic nevertheless, the watchdog restarts the device, and the network is still in its flash.
#![allow(clippy::unwrap_used)]

use ommatidia::device::{DeviceError, Firmware};
use ommatidia_shared::boards::{BOARDS, Board, MPS3_AN547};
use std::collections::{BTreeMap, BTreeSet};

/// Largest number of bounds checks of the arithmetic in each folder of `shared/src`, without Helium and with it.
const ARITHMETIC: [(&str, [usize; 2]); 8] = [
    ("fft", [23, 30]),
    ("filter", [26; 2]),
    ("image", [15; 2]),
    ("nn", [85, 96]),
    ("num", [30, 35]),
    ("pipeline", [23; 2]),
    ("predict", [10; 2]),
    ("sensor", [4, 6]),
];
/// Code in `core` that these bounds checks call, and the code that prints a failure under the emulator.
const BEHIND: [&str; 3] = ["core/src/slice/", "core/src/iter/", "cortex-m-semihosting-"];

#[test]
fn no_byte_from_outside_reaches_a_panic() {
    for board in BOARDS.into_iter().filter(|board| board.emulated) {
        match Firmware::build(board, "app") {
            Ok(firmware) => check(board, &std::fs::read(firmware.path()).unwrap()),
            Err(DeviceError::NoFirmware { detail }) => {
                assert!(std::env::var_os("OMMATIDIA_REQUIRE_QEMU").is_none(), "{detail}");
                return ommatidia_tests::skip("no_byte_from_outside_reaches_a_panic", &detail);
            }
            Err(error) => panic!("{error}"),
        }
    }
}

fn check(board: Board, image: &[u8]) {
    let (helium, board) = (usize::from(board == MPS3_AN547), board.name);
    let places = locations(image);
    assert!(!places.is_empty(), "the image was not understood: some arithmetic has bounds checks");
    let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
    let mut doors = Vec::new();
    for place in &places {
        let folder = place.file.split_once("shared/src/").and_then(|(_, path)| path.split('/').next());
        match ARITHMETIC.iter().find(|(name, _)| Some(*name) == folder) {
            Some((name, _)) => *counts.entry(name).or_default() += 1,
            None if BEHIND.iter().any(|behind| place.file.contains(behind)) => {}
            None => doors.push(place),
        }
    }
    assert!(doors.is_empty(), "{board}: places that can panic where bytes come in: {doors:#?}");
    println!("{board}: {counts:?}");
    let most = |name: &str| ARITHMETIC.iter().find(|(known, _)| *known == name).map_or(0, |(_, most)| most[helium]);
    let more: Vec<_> = counts.iter().filter(|(name, count)| **count > most(name)).collect();
    assert!(
        more.is_empty(),
        "{board}: {counts:?} places can panic, of these more than are known: {more:?}; {places:#?}"
    );
}

/// A place in the sources.
#[derive(Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Place {
    file: String,
    line: u32,
    col: u32,
}

/// All `core::panic::Location`s in the loaded segments of a 32-bit ELF image: pointer and length of a file's name,
/// line, column.
fn locations(image: &[u8]) -> BTreeSet<Place> {
    let word = |at: usize| image.get(at..at + 4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]) as usize);
    let (table, count) = (word(28).unwrap(), word(44).unwrap() & 0xffff);
    // Address, offset and length of what is loaded.
    let loaded: Vec<[usize; 3]> = (0..count)
        .map(|i| table + 32 * i)
        .filter(|at| word(*at) == Some(1))
        .map(|at| [word(at + 8).unwrap(), word(at + 4).unwrap(), word(at + 16).unwrap()])
        .collect();
    let text = |address: usize, len: usize| {
        let [start, offset, _] = loaded.iter().find(|[start, _, size]| (*start..start + size).contains(&address))?;
        std::str::from_utf8(image.get(offset + address - start..)?.get(..len)?).ok()
    };
    let mut places = BTreeSet::new();
    for [_, offset, size] in &loaded {
        for at in (*offset..offset + size).step_by(4) {
            let [Some(name), Some(len), Some(line), Some(col)] = [0, 4, 8, 12].map(|field| word(at + field)) else {
                continue;
            };
            if !(4..400).contains(&len) || !(1..10_000).contains(&line) || !(1..300).contains(&col) {
                continue;
            }
            // The length of a name may include a zero at its end.
            if let Some(file) = text(name, len).map(|name| name.trim_end_matches('\0')).filter(|n| n.ends_with(".rs")) {
                places.insert(Place { file: file.into(), line: line as u32, col: col as u32 });
            }
        }
    }
    places
}
