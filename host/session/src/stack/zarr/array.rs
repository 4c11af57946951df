//! One array of Zarr 2 or 3: its size, the type of its numbers, and how its chunks are stored.

use super::json::{ARRAY_2, METADATA, need, read, sizes, text, unsupported};
use crate::stack::codec::{self, damaged};
use crate::stack::number::Number;
use crc::{CRC_32_ISCSI, Crc};
use serde_json::Value;
use std::fs::File;
use std::io::{ErrorKind, Read, Result, Seek, SeekFrom};
use std::path::{Path, PathBuf};

/// Most chunks of a shard, whose index is read for each.
const MOST_PER_SHARD: usize = 1 << 20;

/// An array, and the folder of its chunks.
#[derive(Debug)]
pub(super) struct Array {
    folder: PathBuf,
    pub shape: Vec<usize>,
    /// Size of what is decoded at once.
    pub chunk: Vec<usize>,
    pub number: Number,
    pub big_endian: bool,
    /// The number of chunks that are not there, as its bytes.
    pub fill: Vec<u8>,
    /// What stands before the places in the name of a chunk, and between them.
    prefix: &'static str,
    separator: String,
    /// What was done to the bytes of a chunk, in the order in which it was done.
    codecs: Vec<Codec>,
    shard: Option<Shard>,
}

/// What was done to the bytes of a chunk.
#[derive(Clone, Copy, Debug)]
enum Codec {
    Zlib,
    Gzip,
    Zstd,
    Blosc,
    /// Of the Python package numcodecs: the length, then a block.
    Lz4,
    Crc32c,
}

/// A file that holds several chunks, with an index of their places.
#[derive(Clone, Debug)]
struct Shard {
    /// Number of chunks along each axis.
    chunks: Vec<usize>,
    index_codecs: Vec<Codec>,
    at_end: bool,
}

impl Array {
    /// The array in a folder; `None` if there is none.
    pub fn open(folder: &Path) -> Result<Option<Self>> {
        if let Some(metadata) = read(&folder.join(METADATA))? {
            return match text(&metadata, "node_type") {
                "array" => Self::of_3(folder, &metadata).map(Some),
                _ => Ok(None),
            };
        }
        let metadata = read(&folder.join(ARRAY_2))?;
        metadata.map(|metadata| Self::of_2(folder, &metadata)).transpose()
    }

    fn of_2(folder: &Path, metadata: &Value) -> Result<Self> {
        let kind = text(metadata, "dtype");
        let number = match kind.trim_start_matches(['<', '>', '|', '=']) {
            "u1" => "uint8",
            "i1" => "int8",
            "u2" => "uint16",
            "i2" => "int16",
            "f4" => "float32",
            "f8" => "float64",
            _ => kind,
        };
        let number = number_of(number)?;
        if text(metadata, "order") == "F" {
            return Err(unsupported("chunks in Fortran order"));
        }
        if metadata.get("filters").and_then(Value::as_array).is_some_and(|filters| !filters.is_empty()) {
            return Err(unsupported("filters"));
        }
        let codecs = match metadata.get("compressor").unwrap_or(&Value::Null) {
            Value::Null => Vec::new(),
            compressor => vec![codec(text(compressor, "id"))?],
        };
        let separator = metadata.get("dimension_separator").and_then(Value::as_str).unwrap_or(".");
        let big_endian = kind.starts_with('>');
        Ok(Self {
            folder: folder.into(),
            shape: sizes(metadata, "shape")?,
            chunk: sizes(metadata, "chunks")?,
            number,
            big_endian,
            fill: fill(metadata, number, big_endian)?,
            prefix: "",
            separator: separator.into(),
            codecs,
            shard: None,
        })
    }

    fn of_3(folder: &Path, metadata: &Value) -> Result<Self> {
        let number = number_of(text(metadata, "data_type"))?;
        let grid = need(metadata, "chunk_grid")?;
        if text(grid, "name") != "regular" {
            return Err(unsupported(format!("chunks of the grid `{}`", text(grid, "name"))));
        }
        let mut chunk = sizes(need(grid, "configuration")?, "chunk_shape")?;
        let (mut big_endian, mut codecs, mut shard) = (false, Vec::new(), None);
        for step in need(metadata, "codecs")?.as_array().into_iter().flatten() {
            if text(step, "name") != "sharding_indexed" {
                one_step(step, &mut big_endian, &mut codecs)?;
                continue;
            }
            let sharding = need(step, "configuration")?;
            let inner = sizes(sharding, "chunk_shape")?;
            let fits = |(outer, inner): (&usize, &usize)| *outer > 0 && *inner > 0 && outer.is_multiple_of(*inner);
            if !codecs.is_empty()
                || shard.is_some()
                || inner.len() != chunk.len()
                || !chunk.iter().zip(&inner).all(fits)
            {
                return Err(damaged(format!("shards of {chunk:?} with chunks of {inner:?}")));
            }
            let (mut index_codecs, mut ignored) = (Vec::new(), false);
            for step in need(sharding, "index_codecs")?.as_array().into_iter().flatten() {
                one_step(step, &mut ignored, &mut index_codecs)?;
            }
            for step in need(sharding, "codecs")?.as_array().into_iter().flatten() {
                one_step(step, &mut big_endian, &mut codecs)?;
            }
            let chunks: Vec<usize> = chunk.iter().zip(&inner).map(|(outer, inner)| outer / inner).collect();
            let count = chunks.iter().try_fold(1usize, |n, axis| n.checked_mul(*axis));
            if count.is_none_or(|n| n > MOST_PER_SHARD) {
                return Err(damaged(format!("shards of {chunks:?} chunks; at most {MOST_PER_SHARD} are read")));
            }
            shard = Some(Shard { chunks, index_codecs, at_end: text(sharding, "index_location") != "start" });
            chunk = inner;
        }
        let keys = need(metadata, "chunk_key_encoding")?;
        let stated = keys.get("configuration").and_then(|c| c.get("separator")).and_then(Value::as_str);
        let (prefix, separator) = match text(keys, "name") {
            "default" => ("c", "/"),
            "v2" => ("", "."),
            other => return Err(unsupported(format!("names of chunks of the encoding `{other}`"))),
        };
        Ok(Self {
            folder: folder.into(),
            shape: sizes(metadata, "shape")?,
            chunk,
            number,
            big_endian,
            fill: fill(metadata, number, big_endian)?,
            prefix,
            separator: stated.unwrap_or(separator).into(),
            codecs,
            shard,
        })
    }

    /// Reads a chunk of so many bytes by its place in the grid; `None` if it is not there.
    pub fn chunk(&self, place: &[usize], bytes: usize) -> Result<Option<Vec<u8>>> {
        // What does not shrink grows by less than this.
        let limit = bytes + bytes / 8 + 4096;
        let stored = match &self.shard {
            None => match open(&self.file(place))? {
                Some(file) => Some(part(file, 0, u64::MAX, limit)?),
                None => None,
            },
            Some(shard) => {
                let outer: Vec<usize> = place.iter().zip(&shard.chunks).map(|(at, n)| at / n).collect();
                let inner = place.iter().zip(&shard.chunks).fold(0, |index, (at, n)| index * n + at % n);
                match open(&self.file(&outer))? {
                    Some(file) => shard.part(file, inner, limit)?,
                    None => None,
                }
            }
        };
        stored.map(|stored| decoded(stored, &self.codecs, limit)).transpose()
    }

    fn file(&self, place: &[usize]) -> PathBuf {
        let places = place.iter().map(usize::to_string);
        let prefix = (!self.prefix.is_empty()).then(|| self.prefix.to_string());
        let parts: Vec<String> = prefix.into_iter().chain(places).collect();
        self.folder.join(parts.join(if self.separator == "/" { "/" } else { "." }))
    }
}

impl Shard {
    /// The bytes of a chunk; `None` if it is not there.
    fn part(&self, mut file: File, inner: usize, limit: usize) -> Result<Option<Vec<u8>>> {
        let bytes = 16 * self.chunks.iter().product::<usize>();
        // Each checksum adds four bytes; an index that is compressed has no known length.
        if self.index_codecs.iter().any(|codec| !matches!(codec, Codec::Crc32c)) {
            return Err(unsupported("an index of shards that is compressed"));
        }
        let length = (bytes + 4 * self.index_codecs.len()) as u64;
        let size = file.metadata()?.len();
        let start = if self.at_end { size.checked_sub(length) } else { Some(0) };
        let start = start.ok_or_else(|| damaged("a shard ends before its index"))?;
        let index = part(file.try_clone()?, start, length, length as usize)?;
        let index = decoded(index, &self.index_codecs, length as usize)?;
        let entry = index.get(16 * inner..16 * inner + 16).ok_or_else(|| damaged("the index of a shard ends early"))?;
        let words: Vec<u64> = entry.as_chunks::<8>().0.iter().map(|b| u64::from_le_bytes(*b)).collect();
        if words == [u64::MAX; 2] {
            return Ok(None);
        }
        file.rewind()?;
        part(file, words[0], words[1], limit).map(Some)
    }
}

fn open(path: &Path) -> Result<Option<File>> {
    match File::open(path) {
        Err(e) if e.kind() == ErrorKind::NotFound => Ok(None),
        other => other.map(Some),
    }
}

/// Bytes of a file: at most so many, and no more memory than there are bytes.
fn part(mut file: File, start: u64, length: u64, limit: usize) -> Result<Vec<u8>> {
    file.seek(SeekFrom::Start(start)).map_err(|_| damaged("a chunk lies beyond the end of its shard"))?;
    let mut bytes = Vec::new();
    file.take(length.min(limit as u64 + 1)).read_to_end(&mut bytes)?;
    if bytes.len() > limit {
        return Err(damaged(format!("a chunk of more than {limit} bytes")));
    }
    if length != u64::MAX && (bytes.len() as u64) < length {
        return Err(damaged("a shard ends early"));
    }
    Ok(bytes)
}

fn one_step(step: &Value, big_endian: &mut bool, codecs: &mut Vec<Codec>) -> Result<()> {
    match text(step, "name") {
        "bytes" => *big_endian = step.get("configuration").is_some_and(|c| text(c, "endian") == "big"),
        name => codecs.push(codec(name)?),
    }
    Ok(())
}

fn codec(name: &str) -> Result<Codec> {
    Ok(match name.trim_start_matches("numcodecs.") {
        "zlib" => Codec::Zlib,
        "gzip" => Codec::Gzip,
        "zstd" => Codec::Zstd,
        "blosc" => Codec::Blosc,
        "lz4" => Codec::Lz4,
        "crc32c" => Codec::Crc32c,
        _ => return Err(unsupported(format!("the codec `{name}`"))),
    })
}

fn decoded(mut bytes: Vec<u8>, codecs: &[Codec], limit: usize) -> Result<Vec<u8>> {
    for step in codecs.iter().rev() {
        bytes = match step {
            Codec::Zlib => codec::zlib(&bytes, limit)?,
            Codec::Gzip => codec::gzip(&bytes, limit)?,
            Codec::Zstd => codec::zstd(&bytes, limit)?,
            Codec::Blosc => codec::blosc(&bytes, limit)?,
            Codec::Lz4 => {
                let (length, block) = bytes.split_first_chunk::<4>().ok_or_else(|| damaged("a chunk ends early"))?;
                codec::lz4(block, limit.min(u32::from_le_bytes(*length) as usize))?
            }
            Codec::Crc32c => {
                let at = bytes.len().checked_sub(4).ok_or_else(|| damaged("a chunk ends before its checksum"))?;
                let stated = bytes.split_off(at);
                if Crc::<u32>::new(&CRC_32_ISCSI).checksum(&bytes).to_le_bytes() != *stated {
                    return Err(damaged("the checksum of a chunk is wrong"));
                }
                bytes
            }
        };
    }
    Ok(bytes)
}

fn number_of(name: &str) -> Result<Number> {
    Ok(match name {
        "uint8" => Number::U8,
        "int8" => Number::I8,
        "uint16" => Number::U16,
        "int16" => Number::I16,
        "float32" => Number::F32,
        "float64" => Number::F64,
        _ => return Err(unsupported(format!("numbers of type `{name}`"))),
    })
}

/// The bytes of the number that stands for chunks that are not there.
fn fill(metadata: &Value, number: Number, big_endian: bool) -> Result<Vec<u8>> {
    let value = match metadata.get("fill_value") {
        None | Some(Value::Null) => 0.0,
        Some(Value::Number(n)) => n.as_f64().unwrap_or(0.0),
        Some(Value::String(s)) => s.parse().map_err(|_| unsupported(format!("the fill value `{s}`")))?,
        Some(other) => return Err(unsupported(format!("the fill value `{other}`"))),
    };
    let mut bytes = match number {
        Number::U8 => (value as u8).to_le_bytes().to_vec(),
        Number::I8 => (value as i8).to_le_bytes().to_vec(),
        Number::U16 => (value as u16).to_le_bytes().to_vec(),
        Number::I16 => (value as i16).to_le_bytes().to_vec(),
        Number::U32 => (value as u32).to_le_bytes().to_vec(),
        Number::I32 => (value as i32).to_le_bytes().to_vec(),
        Number::F32 => (value as f32).to_le_bytes().to_vec(),
        Number::F64 => value.to_le_bytes().to_vec(),
    };
    if big_endian {
        bytes.reverse();
    }
    Ok(bytes)
}
