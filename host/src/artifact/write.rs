//! Writes artifacts; a file appears complete or not at all.

use super::error::ArtifactError;
use super::header::{HEADER_KEY, Header};
use super::place::temporary_beside;
use ndarray::{ArrayBase, Data, IxDyn};
use safetensors::tensor::{Dtype, Metadata, TensorInfo};
use serde::Serialize;
use std::borrow::Cow;
use std::collections::{BTreeMap, HashMap};
use std::io::Write;
use std::path::Path;

/// Writes an artifact; the file appears complete or not at all.
///
/// # Errors
/// The folder is missing or not writable, or the disk is full. Nothing is left behind.
pub fn write<T: Serialize, S: Data<Elem = f32>>(
    path: &Path,
    header: &Header<T>,
    tensors: &BTreeMap<String, ArrayBase<S, IxDyn>>,
) -> Result<(), ArtifactError> {
    let json = serde_json::to_string(header).map_err(|e| ArtifactError::format(path, e))?;
    write_tensors(path, HashMap::from([(HEADER_KEY.to_string(), json)]), tensors)
}

/// Writes tensors and `metadata` as a safetensors file, which appears complete or not at all. The tensors are written
/// one after the other, without a copy of all of them in memory.
///
/// # Errors
/// As [`write()`].
pub fn write_tensors<S: Data<Elem = f32>>(
    path: &Path,
    metadata: HashMap<String, String>,
    tensors: &BTreeMap<String, ArrayBase<S, IxDyn>>,
) -> Result<(), ArtifactError> {
    let mut end = 0;
    let infos = tensors.iter().map(|(name, t)| {
        let begin = end;
        end += size_of::<f32>() * t.len();
        (name.clone(), TensorInfo { dtype: Dtype::F32, shape: t.shape().to_vec(), data_offsets: (begin, end) })
    });
    let meta = Metadata::new(Some(metadata), infos.collect()).map_err(|e| ArtifactError::format(path, e))?;
    let mut json = serde_json::to_vec(&meta).map_err(|e| ArtifactError::format(path, e))?;
    // The format requires aligned data.
    json.resize(json.len().next_multiple_of(8), b' ');
    write_parts(path, |file| {
        file.write_all(&(json.len() as u64).to_le_bytes())?;
        file.write_all(&json)?;
        tensors.values().try_for_each(|t| file.write_all(&bytes(t)))
    })
}

/// The values of a tensor, little-endian.
fn bytes<S: Data<Elem = f32>>(tensor: &ArrayBase<S, IxDyn>) -> Cow<'_, [u8]> {
    match tensor.as_slice() {
        Some(values) if cfg!(target_endian = "little") => Cow::Borrowed(bytemuck::cast_slice(values)),
        _ => Cow::Owned(tensor.iter().flat_map(|v| v.to_le_bytes()).collect()),
    }
}

/// Writes `bytes` to a temporary file in the same folder, synchronises it to disk and renames it to `path`, so that the
/// file appears complete or not at all.
///
/// # Errors
/// The folder is missing or not writable, or the disk is full. Nothing is left behind.
pub fn write_whole(path: &Path, bytes: &[u8]) -> Result<(), ArtifactError> {
    write_parts(path, |file| file.write_all(bytes))
}

/// As [`write_whole`], for content that `parts` writes piece by piece.
fn write_parts(
    path: &Path,
    parts: impl FnOnce(&mut std::fs::File) -> std::io::Result<()>,
) -> Result<(), ArtifactError> {
    let io = |e| ArtifactError::io(path, e);
    let mut file = temporary_beside(path).map_err(io)?;
    parts(file.as_file_mut()).and_then(|()| file.as_file().sync_all()).map_err(io)?;
    file.persist(path).map_err(|e| io(e.error))?;
    Ok(())
}
