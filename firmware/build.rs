//! Gives the linker the memory map of the board; does nothing on the workstation.

use std::path::Path;
use std::{env, fs, io};

fn main() -> io::Result<()> {
    println!("cargo:rerun-if-changed=memory");
    if env::var("CARGO_CFG_TARGET_OS").as_deref() != Ok("none") {
        return Ok(());
    }
    let Some(map) = memory_map()? else { return Ok(()) };
    let out = env::var("OUT_DIR").map_err(io::Error::other)?;
    fs::copy(map, Path::new(&out).join("memory.x"))?;
    println!("cargo:rustc-link-search={out}");
    println!("cargo:rustc-link-arg-bins=-Tlink.x");
    println!("cargo:rustc-link-arg-bins=--nmagic");
    if env::var_os("CARGO_FEATURE_PROBE").is_some() {
        println!("cargo:rustc-link-arg-bins=-Tdefmt.x");
    }
    Ok(())
}

/// The map named like the board whose feature is on; the sources refuse more than one.
fn memory_map() -> io::Result<Option<std::path::PathBuf>> {
    for entry in fs::read_dir("memory")? {
        let path = entry?.path();
        let board = path.file_stem().unwrap_or_default().to_string_lossy().replace('-', "_").to_uppercase();
        if env::var_os(format!("CARGO_FEATURE_{board}")).is_some() {
            return Ok(Some(path));
        }
    }
    Ok(None)
}
