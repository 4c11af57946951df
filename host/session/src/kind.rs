//! Kinds of files, recognised by their content.

use crate::artifact::{self, ArtifactError};
use ommatidia_shared::blob;
use std::fmt;
use std::io::Read;
use std::path::Path;

/// Kind of a file or folder that the verbs read or write.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum FileKind {
    /// A safetensors artifact, with the kind in its header: `instrument`, `checkpoint`, `shard`, `evaluation`,
    /// `closing` or `uncertainty`.
    Artifact(String),
    /// The network file of a device.
    Blob,
    /// The folder of a measured session.
    Session,
    /// A folder without a session.toml.
    Folder,
    /// The output of a verb with `--json`.
    Json,
    /// A stack of frames, .npy, .tif, .avi, .mp4 or .mat.
    Stack,
    /// A page for a browser.
    Page,
    /// A picture, .png.
    Picture,
    /// A safetensors file without an Ommatidia header.
    Tensors,
    /// Any other file.
    Unknown,
}

impl fmt::Display for FileKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Artifact(kind) => write!(f, "an artifact of kind `{kind}`"),
            Self::Blob => f.write_str("a network file (blob)"),
            Self::Session => f.write_str("a session folder"),
            Self::Folder => f.write_str("a folder without a session.toml"),
            Self::Json => f.write_str("a JSON object"),
            Self::Stack => f.write_str("a stack of frames"),
            Self::Page => f.write_str("an HTML page"),
            Self::Picture => f.write_str("a PNG picture"),
            Self::Tensors => f.write_str("a safetensors file of another program"),
            Self::Unknown => f.write_str("an unknown file"),
        }
    }
}

impl FileKind {
    /// Recognises a file by its first bytes, and a folder by its content.
    ///
    /// # Errors
    /// The file cannot be read, or it is an artifact whose header is damaged.
    pub fn of(path: &Path) -> Result<Self, ArtifactError> {
        if path.is_dir() {
            return Ok(if path.join(crate::MANIFEST).exists() { Self::Session } else { Self::Folder });
        }
        let mut start = Vec::new();
        let read = std::fs::File::open(path).and_then(|f| f.take(16).read_to_end(&mut start));
        read.map_err(|source| ArtifactError::Io { path: path.into(), source })?;
        Ok(match start.as_slice() {
            s if s.starts_with(&blob::MAGIC) => Self::Blob,
            s if s.starts_with(b"MATLAB 5.0 MAT") || s.starts_with(b"MATLAB 7.3 MAT") => Self::Stack,
            s if s.starts_with(b"\x93NUMPY") || s.starts_with(b"II") || s.starts_with(b"MM") => Self::Stack,
            [_, _, _, _, b'f', b't', b'y', b'p', ..] => Self::Stack,
            [b'R', b'I', b'F', b'F', _, _, _, _, b'A', b'V', b'I', b' ', ..] => Self::Stack,
            // A safetensors file: eight bytes of length, then JSON.
            [_, _, _, _, _, _, _, _, b'{', ..] => match artifact::find_header(path)? {
                Some(header) => Self::Artifact(header.get("kind").and_then(|k| k.as_str()).unwrap_or("").into()),
                None => Self::Tensors,
            },
            s if s.trim_ascii_start().starts_with(b"{") => Self::Json,
            s if s.starts_with(b"\x89PNG") => Self::Picture,
            s if s.to_ascii_lowercase().starts_with(b"<!doctype html") => Self::Page,
            _ => Self::Unknown,
        })
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::artifact::{Header, Provenance, Tensors};

    #[test]
    fn each_kind_is_recognised_by_its_content() {
        let folder = tempfile::tempdir().unwrap();
        let file = |name: &str, bytes: &[u8]| {
            let path = folder.path().join(name);
            std::fs::write(&path, bytes).unwrap();
            FileKind::of(&path).unwrap()
        };
        assert_eq!(file("a", b"OMMATIDI and more"), FileKind::Blob);
        assert_eq!(file("b", b"\x93NUMPY\x01\x00"), FileKind::Stack);
        assert_eq!(file("c", b"II*\0"), FileKind::Stack);
        assert_eq!(file("d", b" {\"bit_exact\": true}"), FileKind::Json);
        assert_eq!(file("e", b"hello"), FileKind::Unknown);
        assert_eq!(file("g", b"<!DOCTYPE html><p>"), FileKind::Page);
        let mut foreign = 16u64.to_le_bytes().to_vec();
        foreign.extend(b"{}              ");
        assert_eq!(file("h", &foreign), FileKind::Tensors);
        assert_eq!(file("f", b""), FileKind::Unknown);
        assert_eq!(FileKind::of(folder.path()).unwrap(), FileKind::Folder);
        file("session.toml", b"format = 1");
        assert_eq!(FileKind::of(folder.path()).unwrap(), FileKind::Session);
        let path = folder.path().join("x.safetensors");
        let header =
            Header { kind: "shard".into(), version: 1, provenance: Provenance::new("simulate", 0, &()), body: () };
        artifact::write(&path, &header, &Tensors::new()).unwrap();
        assert_eq!(FileKind::of(&path).unwrap(), FileKind::Artifact("shard".into()));
        assert!(FileKind::of(&folder.path().join("missing")).is_err());
    }
}
