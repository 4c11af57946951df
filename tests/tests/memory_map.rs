//! Each image is linked with the memory map of its own board. The linker reads `memory.x`, the map of the default
//! board, for every board (see there); this test finds an image that was put into the regions of another one.
#![allow(clippy::unwrap_used)]

use ommatidia_host::device::{DeviceError, Firmware};
use ommatidia_shared::boards::{BOARDS, Board, MPS2_AN500};
use std::path::Path;

#[test]
fn each_image_lies_in_the_memory_of_its_board() {
    for board in BOARDS {
        match Firmware::build(board, "app") {
            Ok(firmware) => check(board, &std::fs::read(firmware.path()).unwrap()),
            Err(DeviceError::NoFirmware { detail }) => {
                assert!(std::env::var_os("OMMATIDIA_REQUIRE_QEMU").is_none(), "{detail}");
                return ommatidia_tests::skip("each_image_lies_in_the_memory_of_its_board", &detail);
            }
            Err(error) => panic!("{error}"),
        }
    }
}

fn check(board: Board, image: &[u8]) {
    let program = region(board, if board == MPS2_AN500 { "AN500_SSRAM1" } else { "FLASH" });
    let networks = region(board, if board == MPS2_AN500 { "AN500_NOR" } else { "NOR" });
    assert_eq!(symbol(image, "__vector_table"), Some(program), "{}: where the program begins", board.name);
    assert_eq!(symbol(image, "_flash_start"), Some(networks), "{}: where the network files lie", board.name);
}

/// Address of a region in the memory map of a board.
fn region(board: Board, name: &str) -> u32 {
    let top = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let map = if board == MPS2_AN500 { "memory.x".into() } else { format!("firmware/memory/{}.x", board.name) };
    let map = std::fs::read_to_string(top.join(map)).unwrap();
    let line =
        map.lines().find(|line| line.trim_start().strip_prefix(name).is_some_and(|l| l.trim_start().starts_with(':')));
    let (_, origin) = line.unwrap().split_once("ORIGIN = 0x").unwrap();
    u32::from_str_radix(origin.split(',').next().unwrap(), 16).unwrap()
}

/// Value of a symbol of a 32-bit ELF image.
fn symbol(image: &[u8], name: &str) -> Option<u32> {
    let word = |at: usize| image.get(at..at + 4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]));
    let (table, count) = (word(32)? as usize, word(48)? as usize & 0xffff);
    // Section headers have 40 bytes: type at 4, offset at 16, length at 20, linked section at 24. Symbol tables are of
    // type 2.
    let section = |i: usize| table + 40 * i;
    let symbols = (0..count).map(section).find(|at| word(at + 4) == Some(2))?;
    let names = word(section(word(symbols + 24)? as usize) + 16)? as usize;
    let (first, len) = (word(symbols + 16)? as usize, word(symbols + 20)? as usize);
    // Symbols have 16 bytes: offset of the name at 0, value at 4.
    (first..first + len).step_by(16).find_map(|at| {
        let text = image.get(names + word(at)? as usize..)?;
        if text.strip_prefix(name.as_bytes())?.first() == Some(&0) { word(at + 4) } else { None }
    })
}
