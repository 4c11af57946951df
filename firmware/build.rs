//! Gives the linker the memory map of the board; does nothing on the workstation.
//!
//! The linker script of `cortex-m-rt` includes `memory.x`, and the linker takes the one at the top of the repository,
//! where cargo starts it, whatever its search path. That file holds the map of the default board and includes
//! `board.x`, which is the file in `memory/` that is named like the board. `board.x` and what it includes are copied to
//! the output folder, which is on the search path.

use std::path::{Path, PathBuf};
use std::{env, fs, io};

/// The map of the default board, which the linker reads for all boards.
const DEFAULT_MAP: &str = "../memory.x";
/// One file a board, named like it, and what these files include.
const BOARDS: &str = "memory";

fn main() -> io::Result<()> {
    println!("cargo:rerun-if-changed={DEFAULT_MAP}");
    println!("cargo:rerun-if-changed={BOARDS}");
    if env::var("CARGO_CFG_TARGET_OS").as_deref() != Ok("none") {
        return Ok(());
    }
    let Some(board) = board_file()? else { return Ok(()) };
    let out = PathBuf::from(env::var("OUT_DIR").map_err(io::Error::other)?);
    // A build that starts elsewhere, with this package as a dependency, finds the copy.
    fs::copy(DEFAULT_MAP, out.join("memory.x"))?;
    fs::copy(board, out.join("board.x"))?;
    fs::copy(Path::new(BOARDS).join("mps.x"), out.join("mps.x"))?;
    println!("cargo:rustc-link-search={}", out.display());
    println!("cargo:rustc-link-arg-bins=-Tlink.x");
    println!("cargo:rustc-link-arg-bins=--nmagic");
    if env::var_os("CARGO_FEATURE_PROBE").is_some() {
        println!("cargo:rustc-link-arg-bins=-Tdefmt.x");
    }
    Ok(())
}

/// The file of the board whose feature is on, if one is. The sources refuse two boards.
fn board_file() -> io::Result<Option<PathBuf>> {
    for entry in fs::read_dir(BOARDS)? {
        let path = entry?.path();
        let board = path.file_stem().unwrap_or_default().to_string_lossy().replace('-', "_").to_uppercase();
        if env::var_os(format!("CARGO_FEATURE_{board}")).is_some() {
            return Ok(Some(path));
        }
    }
    Ok(None)
}
