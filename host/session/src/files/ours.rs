//! Whether all that a folder holds was written by this program.

use crate::import;
use crate::stack::ZARR_METADATA;
use serde_json::Value;
use std::path::Path;

/// What a folder holds that is not of a Zarr written by this program; `None` where nothing is.
///
/// Other programs call their metadata `zarr.json`, too. The writer of this program states itself, and writes nothing
/// but the metadata and the resolutions that they list, each with its metadata and its chunks.
pub(super) fn not_of_our_zarr(folder: &Path) -> std::io::Result<Option<String>> {
    let metadata = folder.join(ZARR_METADATA);
    if !metadata.is_file() {
        return Ok(names(folder)?.into_iter().next());
    }
    // What is no JSON was not written by this program.
    let json: Value = serde_json::from_slice(&std::fs::read(metadata)?).unwrap_or_default();
    let image = &json["attributes"]["ome"]["multiscales"][0];
    let program = image["metadata"]["program"].as_str().unwrap_or_default();
    if !program.starts_with("ommatidia ") {
        return Ok(Some(format!("a {ZARR_METADATA} of another program")));
    }
    let levels = image["datasets"].as_array().into_iter().flatten();
    let levels: Vec<&str> = levels.filter_map(|level| level["path"].as_str()).collect();
    for name in names(folder)? {
        if name == ZARR_METADATA {
            continue;
        }
        let inner = folder.join(&name);
        if !levels.contains(&name.as_str()) || !inner.is_dir() {
            return Ok(Some(name));
        }
        let other = names(&inner)?.into_iter().find(|inner| inner != ZARR_METADATA && inner != "c");
        if let Some(other) = other {
            return Ok(Some(format!("{name}/{other}")));
        }
    }
    Ok(None)
}

/// What a folder holds that is not of a session as `import` wrote it; `None` where nothing is.
pub(super) fn not_of_our_import(folder: &Path) -> std::io::Result<Option<String>> {
    let not_ours = import::not_written(folder, &names(folder)?)?;
    Ok(Some(not_ours.join(", ")).filter(|all| !all.is_empty()))
}

/// The names in a folder in order, without those of locks and unfinished files.
pub(super) fn names(folder: &Path) -> std::io::Result<Vec<String>> {
    let names = std::fs::read_dir(folder)?.map(|entry| Ok(entry?.file_name().to_string_lossy().into_owned()));
    let mut names: Vec<String> = names.collect::<std::io::Result<_>>()?;
    names.retain(|name| !is_temporary(name));
    names.sort();
    Ok(names)
}

/// Whether a name is that of a lock or of an unfinished file.
fn is_temporary(name: &str) -> bool {
    name.starts_with('.') && (name.ends_with(".lock") || name.ends_with(".unfinished"))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::files::{Content, Files};
    use crate::stack;
    use ndarray::Array3;

    #[test]
    fn a_zarr_is_replaced_only_where_this_program_wrote_all_of_it() {
        let folder = tempfile::tempdir().unwrap();
        let zarr = folder.path().join("x.zarr");
        stack::write(&zarr, Array3::<f32>::zeros((2, 3, 4)).view()).unwrap();
        let held = || Files::default().writing([&zarr], Content::Zarr).hold(true).map(drop).map_err(|e| e.to_string());
        assert_eq!(held(), Ok(()));
        for (name, said) in [("labels", "found labels"), ("notes.txt", "found notes.txt"), ("0/mine", "found 0/mine")] {
            std::fs::create_dir(zarr.join(name)).unwrap();
            assert!(held().unwrap_err().contains(said), "{name}");
            std::fs::remove_dir(zarr.join(name)).unwrap();
        }
        assert_eq!(held(), Ok(()));
        // As other programs write it.
        for text in ["no json", r#"{"zarr_format": 3, "node_type": "group", "attributes": {"ome": {}}}"#] {
            std::fs::write(zarr.join(ZARR_METADATA), text).unwrap();
            let error = held().unwrap_err();
            assert!(error.contains("of another program") && error.contains("never replaced"), "{error}");
        }
        std::fs::remove_file(zarr.join(ZARR_METADATA)).unwrap();
        assert!(held().unwrap_err().contains("found 0,"));
        std::fs::remove_dir_all(zarr.join("0")).unwrap();
        assert_eq!(held(), Ok(()), "an empty folder");
    }
}
