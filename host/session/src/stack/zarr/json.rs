//! The metadata files of Zarr 2 and 3.

use crate::stack::codec::damaged;
use serde_json::Value;
use std::fs::File;
use std::io::{Error, ErrorKind, Read, Result};
use std::path::Path;

/// Name of the file of metadata of Zarr 3 in the folder, by which it is recognised.
pub(in super::super) const METADATA: &str = "zarr.json";
/// Names of the metadata of an array of Zarr 2, and of the attributes of any folder of it.
pub(super) const ARRAY_2: &str = ".zarray";
pub(super) const ATTRIBUTES_2: &str = ".zattrs";
pub(super) const GROUP_2: &str = ".zgroup";

/// Longest file of metadata, bytes.
const MOST_METADATA: u64 = 1 << 24;

/// Reads a file of metadata; `None` if there is none.
pub(super) fn read(path: &Path) -> Result<Option<Value>> {
    let file = match File::open(path) {
        Err(e) if e.kind() == ErrorKind::NotFound => return Ok(None),
        other => other?,
    };
    let mut text = Vec::new();
    file.take(MOST_METADATA).read_to_end(&mut text)?;
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    serde_json::from_slice(&text).map(Some).map_err(|e| damaged(format!("{name}: {e}")))
}

/// The value of a key, which must be there.
pub(super) fn need<'a>(value: &'a Value, key: &str) -> Result<&'a Value> {
    value.get(key).ok_or_else(|| damaged(format!("its metadata lack `{key}`")))
}

/// The text of a key; empty if there is none.
pub(super) fn text<'a>(value: &'a Value, key: &str) -> &'a str {
    value.get(key).and_then(Value::as_str).unwrap_or("")
}

/// The sizes that a key lists.
pub(super) fn sizes(value: &Value, key: &str) -> Result<Vec<usize>> {
    let sizes = need(value, key)?.as_array().and_then(|all| all.iter().map(Value::as_u64).collect::<Option<Vec<_>>>());
    let sizes = sizes.ok_or_else(|| damaged(format!("`{key}` is no list of sizes")))?;
    sizes.into_iter().map(|n| usize::try_from(n).map_err(|_| damaged(format!("`{key}` holds {n}")))).collect()
}

/// A part of Zarr that is not read.
pub(super) fn unsupported(what: impl Into<String>) -> Error {
    Error::new(ErrorKind::Unsupported, what.into())
}
