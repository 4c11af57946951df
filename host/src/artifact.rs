//! Artifacts: every file that one verb writes and another reads.
//!
//! One mechanism for instruments, data-set shards and checkpoints: a safetensors file whose metadata hold a JSON
//! header (kind, version, provenance, and the small numbers of that kind), and whose tensors are the arrays. Python reads it
//! with `safetensors.numpy.load_file`. Files appear whole or not at all.

use ndarray::{ArrayBase, ArrayD, Data, IxDyn};
use safetensors::tensor::{Dtype, Metadata, TensorInfo};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::borrow::Cow;
use std::collections::{BTreeMap, HashMap};
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use thiserror::Error;

/// Where an artifact came from.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Provenance {
    /// Version of the program that wrote it.
    pub program: String,
    /// The verb that wrote it.
    pub verb: String,
    /// Seed of all that was drawn.
    pub seed: u64,
    /// SHA-256 (hexadecimal) of each input file, by the name it was given under.
    pub inputs: BTreeMap<String, String>,
    /// Configuration of the verb, as JSON.
    pub config: serde_json::Value,
}

impl Provenance {
    /// The provenance of an artifact that `verb` writes.
    pub fn new(verb: &str, seed: u64, config: &impl Serialize) -> Self {
        Self {
            program: concat!("ommatidia ", env!("CARGO_PKG_VERSION")).into(),
            verb: verb.into(),
            seed,
            inputs: BTreeMap::new(),
            config: serde_json::to_value(config).unwrap_or(serde_json::Value::Null),
        }
    }

    /// Adds the hash of an input file.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn with_input(mut self, path: &Path) -> Result<Self, ArtifactError> {
        self.inputs.insert(path.display().to_string(), file_hash(path)?);
        Ok(self)
    }
}

/// The header of an artifact: what it is, where it came from, and the small numbers `T` of its kind.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Header<T> {
    /// Kind: `instrument`, `shard`, `checkpoint`.
    pub kind: String,
    /// Version of this kind's layout.
    pub version: u32,
    /// Where it came from.
    pub provenance: Provenance,
    /// What this kind stores besides its tensors.
    pub body: T,
}

/// Tensors by name, f32, in C order.
pub type Tensors = BTreeMap<String, ArrayD<f32>>;

/// Why an artifact could not be read or written.
#[derive(Debug, Error)]
pub enum ArtifactError {
    /// The file could not be opened, read or written.
    #[error("{path}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The file is no artifact, or is cut short.
    #[error("{path}: not an Ommatidia artifact, or cut short ({detail}); write it again with the verb that makes it")]
    Format {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        detail: String,
    },
    /// The file is an artifact of another kind.
    #[error("{path}: expected an artifact of kind `{expected}`, found `{found}`")]
    Kind {
        /// The file.
        path: PathBuf,
        /// Kind that was asked for.
        expected: String,
        /// Kind of the file.
        found: String,
    },
    /// The file was written by another version.
    #[error("{path}: expected {kind} version {expected}, found {found}; write it again with this program")]
    Version {
        /// The file.
        path: PathBuf,
        /// Kind of the file.
        kind: String,
        /// Version that this program reads.
        expected: u32,
        /// Version of the file.
        found: u32,
    },
    /// A tensor is missing or has the wrong shape or values.
    #[error("{path}: tensor `{name}`: expected {expected}, found {found}")]
    Tensor {
        /// The file.
        path: PathBuf,
        /// Name of the tensor.
        name: String,
        /// What was expected.
        expected: String,
        /// What was found.
        found: String,
    },
}

const HEADER_KEY: &str = "ommatidia";

/// Writes an artifact: whole, or not at all.
///
/// # Errors
/// The folder is missing or not writable, or the disk is full; nothing is left behind.
pub fn write<T: Serialize, S: Data<Elem = f32>>(
    path: &Path,
    header: &Header<T>,
    tensors: &BTreeMap<String, ArrayBase<S, IxDyn>>,
) -> Result<(), ArtifactError> {
    let json = serde_json::to_string(header).map_err(|e| format_error(path, e))?;
    write_tensors(path, HashMap::from([(HEADER_KEY.to_string(), json)]), tensors)
}

/// Writes tensors as safetensors, whole or not at all, one after the other: besides them no memory is needed.
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
    let meta = Metadata::new(Some(metadata), infos.collect()).map_err(|e| format_error(path, e))?;
    let mut json = serde_json::to_vec(&meta).map_err(|e| format_error(path, e))?;
    // The format wants what follows aligned.
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

/// Reads an artifact of the given kind and version.
///
/// # Errors
/// The file is missing, no artifact, of another kind or version, cut short, or holds values that are no numbers.
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
    serde_json::from_value(raw).map_err(|e| format_error(path, e))
}

/// The header of an artifact of any kind, as JSON.
///
/// # Errors
/// The file is missing or no artifact.
pub fn inspect(path: &Path) -> Result<serde_json::Value, ArtifactError> {
    ommatidia_header(path, &metadata(path)?.0)
}

/// Names and shapes of the tensors of an artifact, by name.
///
/// # Errors
/// The file is missing or no artifact.
pub fn shapes(path: &Path) -> Result<BTreeMap<String, Vec<usize>>, ArtifactError> {
    Ok(metadata(path)?.0.tensors().into_iter().map(|(name, info)| (name, info.shape.clone())).collect())
}

/// What a file says of its tensors, and where their bytes begin; the file is as long as it says.
fn metadata(path: &Path) -> Result<(Metadata, u64), ArtifactError> {
    let mut file = std::fs::File::open(path).map_err(|e| io_error(path, e))?;
    let size = file.metadata().map_err(|e| io_error(path, e))?.len();
    let mut start = [0u8; 8];
    file.read_exact(&mut start).map_err(|e| format_error(path, e))?;
    let length = u64::from_le_bytes(start);
    if length > size {
        return Err(format_error(path, "its header is longer than the file"));
    }
    let mut bytes = Vec::new();
    file.take(length).read_to_end(&mut bytes).map_err(|e| io_error(path, e))?;
    let meta: Metadata = serde_json::from_slice(&bytes).map_err(|e| format_error(path, e))?;
    let data = 8 + length;
    let expected = data.saturating_add(meta.data_len() as u64);
    if size != expected {
        return Err(format_error(path, format!("expected {expected} bytes, found {size}")));
    }
    Ok((meta, data))
}

fn ommatidia_header(path: &Path, meta: &Metadata) -> Result<serde_json::Value, ArtifactError> {
    let json = meta
        .metadata()
        .as_ref()
        .and_then(|m| m.get(HEADER_KEY))
        .ok_or_else(|| format_error(path, "no Ommatidia header in its metadata"))?;
    serde_json::from_str(json).map_err(|e| format_error(path, e))
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

/// Takes a tensor of the expected shape out of `tensors`; `None` in `shape` lets that axis be of any length.
///
/// # Errors
/// It is missing or has another shape.
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
    let t = tensors.remove(name).ok_or_else(|| wrong("no such tensor".into()))?;
    let fits = t.ndim() == shape.len() && t.shape().iter().zip(shape).all(|(n, s)| s.is_none_or(|s| s == *n));
    if fits { Ok(t) } else { Err(wrong(format!("shape {:?}", t.shape()))) }
}

/// An artifact whose tensors are read piece by piece: shards of a data set larger than memory.
#[derive(Clone, Debug)]
pub struct Index<T> {
    path: PathBuf,
    header: Header<T>,
    tensors: BTreeMap<String, (Vec<usize>, u64)>,
}

impl<T: DeserializeOwned> Index<T> {
    /// Reads the header of an artifact and checks that the file is as long as it says.
    ///
    /// # Errors
    /// As [`read`], except for the values, which are checked when they are read.
    pub fn open(path: &Path, kind: &str, version: u32) -> Result<Self, ArtifactError> {
        let (meta, data) = metadata(path)?;
        let header = checked_header(path, ommatidia_header(path, &meta)?, kind, version)?;
        let mut tensors = BTreeMap::new();
        for (name, info) in meta.tensors() {
            let bytes = info.shape.iter().try_fold(4usize, |n, s| n.checked_mul(*s));
            let (from, to) = info.data_offsets;
            if info.dtype != Dtype::F32 || bytes != to.checked_sub(from) {
                return Err(format_error(path, format!("tensor `{name}` is no float32 of shape {:?}", info.shape)));
            }
            tensors.insert(name, (info.shape.clone(), data + from as u64));
        }
        Ok(Self { path: path.into(), header, tensors })
    }
}

impl<T> Index<T> {
    /// The header.
    pub fn header(&self) -> &Header<T> {
        &self.header
    }

    /// Shape of a tensor.
    ///
    /// # Errors
    /// It is missing.
    pub fn shape(&self, name: &str) -> Result<&[usize], ArtifactError> {
        self.tensors.get(name).map(|t| t.0.as_slice()).ok_or_else(|| self.wrong(name, "a tensor", "none".into()))
    }

    /// A whole tensor.
    ///
    /// # Errors
    /// There is no such tensor, it cannot be read, or it holds values that are no numbers.
    pub fn read(&self, name: &str) -> Result<ArrayD<f32>, ArtifactError> {
        self.read_from(name, self.shape(name)?, 0)
    }

    /// Entry `i` along the first axis of a tensor.
    ///
    /// # Errors
    /// There is no such tensor or entry, it cannot be read, or it holds values that are no numbers.
    pub fn read_entry(&self, name: &str, i: usize) -> Result<ArrayD<f32>, ArtifactError> {
        let shape = self.shape(name)?;
        let (Some(&len), Some(entry)) = (shape.first(), shape.get(1..)) else {
            return Err(self.wrong(name, "at least one axis", "a number".into()));
        };
        if i >= len {
            return Err(self.wrong(name, "an entry that is there", format!("{i} of {len}")));
        }
        self.read_from(name, entry, 4 * (i * entry.iter().product::<usize>()) as u64)
    }

    /// The part of a tensor of this shape that begins `skip` bytes behind its own begin.
    fn read_from(&self, name: &str, shape: &[usize], skip: u64) -> Result<ArrayD<f32>, ArtifactError> {
        let mut buffer = vec![0u8; 4 * shape.iter().product::<usize>()];
        std::fs::File::open(&self.path)
            .and_then(|mut f| {
                f.seek(SeekFrom::Start(self.tensors[name].1 + skip)).and_then(|_| f.read_exact(&mut buffer))
            })
            .map_err(|e| io_error(&self.path, e))?;
        let values = finite_values(&self.path, name, &buffer)?;
        ArrayD::from_shape_vec(IxDyn(shape), values).map_err(|e| format_error(&self.path, e))
    }

    fn wrong(&self, name: &str, expected: &str, found: String) -> ArtifactError {
        ArtifactError::Tensor { path: self.path.clone(), name: name.into(), expected: expected.into(), found }
    }
}

/// Writes a file whole or not at all: to a temporary file beside it, synced, then renamed.
///
/// # Errors
/// The folder is missing or not writable, or the disk is full; nothing is left behind.
pub fn write_whole(path: &Path, bytes: &[u8]) -> Result<(), ArtifactError> {
    write_parts(path, |file| file.write_all(bytes))
}

/// [`write_whole`] of what comes piece by piece.
fn write_parts(
    path: &Path,
    parts: impl FnOnce(&mut std::fs::File) -> std::io::Result<()>,
) -> Result<(), ArtifactError> {
    let mut file = temporary_beside(path).map_err(|e| io_error(path, e))?;
    parts(file.as_file_mut()).and_then(|()| file.as_file().sync_all()).map_err(|e| io_error(path, e))?;
    file.persist(path).map_err(|e| io_error(path, e.error))?;
    Ok(())
}

/// The folder that a file lies in.
pub(crate) fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// A temporary file in the folder of `path`, readable by whom any new file is, gone unless persisted.
pub(crate) fn temporary_beside(path: &Path) -> std::io::Result<tempfile::NamedTempFile> {
    let mut builder = tempfile::Builder::new();
    builder.prefix(".ommatidia-");
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        // Private by default; this is a result that is only not finished yet. The umask still applies.
        builder.permissions(std::fs::Permissions::from_mode(0o666));
    }
    builder.tempfile_in(folder_of(path))
}

/// SHA-256 of a file, hexadecimal.
///
/// # Errors
/// The file cannot be read.
pub fn file_hash(path: &Path) -> Result<String, ArtifactError> {
    let mut file = std::fs::File::open(path).map_err(|e| io_error(path, e))?;
    let mut hash = Sha256::new();
    let mut buffer = vec![0u8; 1 << 20];
    loop {
        match file.read(&mut buffer).map_err(|e| io_error(path, e))? {
            0 => return Ok(hash.finalize().iter().map(|b| format!("{b:02x}")).collect()),
            n => hash.update(&buffer[..n]),
        }
    }
}

fn io_error(path: &Path, source: std::io::Error) -> ArtifactError {
    ArtifactError::Io { path: path.into(), source }
}

fn format_error(path: &Path, detail: impl ToString) -> ArtifactError {
    ArtifactError::Format { path: path.into(), detail: detail.to_string() }
}
