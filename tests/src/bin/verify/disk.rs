//! Whether the disk has room for everything that is built. On a full disk builds fail late, and say little.

use anyhow::{Context, Result, bail};
use std::path::Path;

/// Room that all steps need, bytes: an estimate, from the 4.5 GB that they leave in the target folder.
const ALL: u64 = 7_000_000_000;

/// Checks that the disk of the target folder has room for what is not built yet.
///
/// # Errors
/// There is too little room, or it cannot be told.
pub fn has_room(target: &Path) -> Result<()> {
    std::fs::create_dir_all(target).with_context(|| format!("{} cannot be created", target.display()))?;
    let free = fs4::available_space(target).with_context(|| format!("room on the disk of {}", target.display()))?;
    let needed = ALL.saturating_sub(size(target));
    if free < needed {
        let gb = |bytes: u64| bytes as f64 / 1e9;
        bail!(
            "{} has {:.1} GB of room, and the builds need about {:.1} GB: make room, or set CARGO_TARGET_DIR to a \
             folder on another disk",
            target.display(),
            gb(free),
            gb(needed)
        );
    }
    Ok(())
}

/// Bytes of all files in a folder. What cannot be read counts as nothing.
fn size(folder: &Path) -> u64 {
    let Ok(entries) = std::fs::read_dir(folder) else { return 0 };
    let of = |entry: std::fs::DirEntry| match entry.file_type() {
        Ok(kind) if kind.is_dir() => size(&entry.path()),
        Ok(kind) if kind.is_file() => entry.metadata().map_or(0, |m| m.len()),
        _ => 0,
    };
    entries.flatten().map(of).sum()
}
