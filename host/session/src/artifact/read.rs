//! Reads artifacts, whole or piece by piece.

use super::error::ArtifactError;
use super::header::{HEADER_KEY, Header, Tensors};
use crate::signature::FileKind;
use ndarray::{ArrayD, IxDyn};
use safetensors::tensor::{Dtype, Metadata};
use serde::de::DeserializeOwned;
use std::collections::BTreeMap;
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

/// Reads the header and all tensors of an artifact of this kind and version.
///
/// # Errors
/// The file is missing, is not an artifact, has another kind or version, is cut short, or holds non-finite values.
pub fn read<T: DeserializeOwned>(path: &Path, kind: &str, version: u32) -> Result<(Header<T>, Tensors), ArtifactError> {
    let index = Index::open(path, kind, version)?;
    let read = |name: &String| Ok((name.clone(), index.read(name)?));
    let tensors = index.tensors.keys().map(read).collect::<Result<Tensors, ArtifactError>>()?;
    Ok((index.header, tensors))
}

fn checked_header<T: DeserializeOwned>(
    path: &Path,
    raw: serde_json::Value,
    kind: &str,
    version: u32,
) -> Result<Header<T>, ArtifactError> {
    let found_kind = raw.get("kind").and_then(|v| v.as_str()).unwrap_or("").to_string();
    if found_kind != kind {
        return Err(ArtifactError::Kind { path: path.into(), expected: kind.into(), found: found_kind });
    }
    let found = raw.get("version").and_then(serde_json::Value::as_u64).unwrap_or(0) as u32;
    if found != version {
        return Err(ArtifactError::Version { path: path.into(), kind: kind.into(), expected: version, found });
    }
    serde_json::from_value(raw).map_err(|e| ArtifactError::format(path, e))
}

/// The header of an artifact of any kind, as JSON.
///
/// # Errors
/// The file is missing or is not an artifact.
pub fn inspect(path: &Path) -> Result<serde_json::Value, ArtifactError> {
    ommatidia_header(path, &metadata(path)?.0)
}

/// The header of a safetensors file, as JSON; `None` if the file is of another program.
///
/// # Errors
/// The file is missing or is not a safetensors file.
pub(crate) fn find_header(path: &Path) -> Result<Option<serde_json::Value>, ArtifactError> {
    header_of(path, &metadata(path)?.0)
}

fn header_of(path: &Path, meta: &Metadata) -> Result<Option<serde_json::Value>, ArtifactError> {
    let json = meta.metadata().as_ref().and_then(|m| m.get(HEADER_KEY));
    json.map(|json| serde_json::from_str(json).map_err(|e| ArtifactError::format(path, e))).transpose()
}

/// Shapes of the tensors of an artifact, by name.
///
/// # Errors
/// The file is missing or is not an artifact.
pub fn shapes(path: &Path) -> Result<BTreeMap<String, Vec<usize>>, ArtifactError> {
    Ok(metadata(path)?.0.tensors().into_iter().map(|(name, info)| (name, info.shape.clone())).collect())
}

/// Reads the safetensors metadata and the offset of the tensor data, bytes; checks the length of the file.
fn metadata(path: &Path) -> Result<(Metadata, u64), ArtifactError> {
    let other = |found| ArtifactError::Other { path: path.into(), found };
    if let Some(folder) = FileKind::of_folder(path) {
        return Err(other(folder));
    }
    let mut file = std::fs::File::open(path).map_err(|e| ArtifactError::io(path, e))?;
    let size = file.metadata().map_err(|e| ArtifactError::io(path, e))?.len();
    let mut head = Vec::new();
    (&file).take(16).read_to_end(&mut head).map_err(|e| ArtifactError::io(path, e))?;
    if let Some(found) = FileKind::by_start(&head) {
        return Err(other(found));
    }
    let Some(start) = head.first_chunk::<8>() else {
        return Err(ArtifactError::format(path, "it has fewer than eight bytes"));
    };
    file.seek(SeekFrom::Start(8)).map_err(|e| ArtifactError::io(path, e))?;
    let length = u64::from_le_bytes(*start);
    if length > size {
        return Err(ArtifactError::format(path, "its header is longer than the file"));
    }
    let mut bytes = Vec::new();
    file.take(length).read_to_end(&mut bytes).map_err(|e| ArtifactError::io(path, e))?;
    let meta: Metadata = serde_json::from_slice(&bytes).map_err(|e| ArtifactError::format(path, e))?;
    let data = 8 + length;
    let expected = data.saturating_add(meta.data_len() as u64);
    if size != expected {
        return Err(ArtifactError::format(path, format!("expected {expected} bytes, found {size}")));
    }
    Ok((meta, data))
}

fn ommatidia_header(path: &Path, meta: &Metadata) -> Result<serde_json::Value, ArtifactError> {
    header_of(path, meta)?.ok_or_else(|| ArtifactError::format(path, "no Ommatidia header in its metadata"))
}

fn finite_values(path: &Path, name: &str, bytes: &[u8]) -> Result<Vec<f32>, ArtifactError> {
    let values: Vec<f32> = bytes.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect();
    match values.iter().position(|v| !v.is_finite()) {
        None => Ok(values),
        Some(i) => Err(ArtifactError::Tensor {
            path: path.into(),
            name: name.into(),
            expected: "finite values".into(),
            found: format!("{} at element {i}", values[i]),
        }),
    }
}

/// Removes a tensor from `tensors` and checks its shape; `None` in `shape` allows any length of that axis. `path` is
/// the file in error messages.
///
/// # Errors
/// The tensor is missing or has another shape.
pub fn take(
    path: &Path,
    tensors: &mut Tensors,
    name: &str,
    shape: &[Option<usize>],
) -> Result<ArrayD<f32>, ArtifactError> {
    let wrong = |found: String| ArtifactError::Tensor {
        path: path.into(),
        name: name.into(),
        expected: format!("shape {shape:?}"),
        found,
    };
    let t = tensors.remove(name).ok_or_else(|| wrong("no tensor of this name".into()))?;
    let fits = t.ndim() == shape.len() && t.shape().iter().zip(shape).all(|(n, s)| s.is_none_or(|s| s == *n));
    if fits { Ok(t) } else { Err(wrong(format!("shape {:?}", t.shape()))) }
}

/// An open artifact whose tensors are read one at a time, or entry by entry, e.g. a shard of a data set.
#[derive(Clone, Debug)]
pub struct Index<T> {
    path: PathBuf,
    header: Header<T>,
    tensors: BTreeMap<String, (Vec<usize>, u64)>,
}

impl<T: DeserializeOwned> Index<T> {
    /// Reads the header of an artifact and checks the length of the file.
    ///
    /// # Errors
    /// As [`read`], except that values are checked when they are read.
    pub fn open(path: &Path, kind: &str, version: u32) -> Result<Self, ArtifactError> {
        let (meta, data) = metadata(path)?;
        let header = checked_header(path, ommatidia_header(path, &meta)?, kind, version)?;
        let mut tensors = BTreeMap::new();
        for (name, info) in meta.tensors() {
            let bytes = info.shape.iter().try_fold(4usize, |n, s| n.checked_mul(*s));
            let (from, to) = info.data_offsets;
            if info.dtype != Dtype::F32 || bytes != to.checked_sub(from) {
                return Err(ArtifactError::format(
                    path,
                    format!("tensor `{name}` is not float32 of shape {:?}", info.shape),
                ));
            }
            tensors.insert(name, (info.shape.clone(), data + from as u64));
        }
        Ok(Self { path: path.into(), header, tensors })
    }
}

impl<T> Index<T> {
    /// The header of the artifact.
    pub fn header(&self) -> &Header<T> {
        &self.header
    }

    /// Shape of tensor `name`.
    ///
    /// # Errors
    /// There is no such tensor.
    pub fn shape(&self, name: &str) -> Result<&[usize], ArtifactError> {
        self.tensors.get(name).map(|t| t.0.as_slice()).ok_or_else(|| self.wrong(name, "a tensor", "none".into()))
    }

    /// Reads the whole tensor `name`.
    ///
    /// # Errors
    /// There is no such tensor, it cannot be read, or it holds non-finite values.
    pub fn read(&self, name: &str) -> Result<ArrayD<f32>, ArtifactError> {
        self.read_from(name, self.shape(name)?, 0)
    }

    /// Reads entry `i` along the first axis of tensor `name`; the result lacks that axis.
    ///
    /// # Errors
    /// There is no such tensor or entry, it cannot be read, or it holds non-finite values.
    pub fn read_entry(&self, name: &str, i: usize) -> Result<ArrayD<f32>, ArtifactError> {
        let shape = self.shape(name)?;
        let (Some(&len), Some(entry)) = (shape.first(), shape.get(1..)) else {
            return Err(self.wrong(name, "at least one axis", "a single value".into()));
        };
        if i >= len {
            return Err(self.wrong(name, &format!("an entry from 0 to {}", len.saturating_sub(1)), i.to_string()));
        }
        self.read_from(name, entry, 4 * (i * entry.iter().product::<usize>()) as u64)
    }

    /// Reads the part of a tensor that has this shape and starts `skip` bytes after the tensor's first byte.
    fn read_from(&self, name: &str, shape: &[usize], skip: u64) -> Result<ArrayD<f32>, ArtifactError> {
        let mut buffer = vec![0u8; 4 * shape.iter().product::<usize>()];
        std::fs::File::open(&self.path)
            .and_then(|mut f| {
                f.seek(SeekFrom::Start(self.tensors[name].1 + skip)).and_then(|_| f.read_exact(&mut buffer))
            })
            .map_err(|e| ArtifactError::io(&self.path, e))?;
        let values = finite_values(&self.path, name, &buffer)?;
        ArrayD::from_shape_vec(IxDyn(shape), values).map_err(|e| ArtifactError::format(&self.path, e))
    }

    fn wrong(&self, name: &str, expected: &str, found: String) -> ArtifactError {
        ArtifactError::Tensor { path: self.path.clone(), name: name.into(), expected: expected.into(), found }
    }
}
