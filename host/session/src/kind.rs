//! Kinds of files, recognised by their content.

use crate::MANIFEST;
use crate::artifact::{self, ArtifactError};
use crate::signature::is_tensors;
use std::io::Read;
use std::path::Path;

pub use crate::signature::FileKind;

impl FileKind {
    /// Recognises a file by its first bytes, and a folder by its content.
    ///
    /// # Errors
    /// The file cannot be read, or it is an artifact whose header is damaged.
    pub fn of(path: &Path) -> Result<Self, ArtifactError> {
        if let Some(folder) = Self::of_folder(path) {
            return Ok(folder);
        }
        let failed = |source| ArtifactError::Io { path: path.into(), source };
        // To open a pipe would wait for a writer, without end where there is none.
        if !std::fs::metadata(path).map_err(failed)?.is_file() {
            return Ok(Self::Unknown);
        }
        let mut start = Vec::new();
        let read = std::fs::File::open(path).and_then(|f| f.take(16).read_to_end(&mut start));
        read.map_err(failed)?;
        Ok(match Self::by_start(&start) {
            Some(kind) => kind,
            None if is_tensors(&start) => match artifact::find_header(path)? {
                Some(header) => Self::Artifact(header.get("kind").and_then(|k| k.as_str()).unwrap_or("").into()),
                None => Self::Tensors,
            },
            None if path.file_name().is_some_and(|name| name == MANIFEST) => Self::Manifest,
            None => Self::Unknown,
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
        // Byte 8 is that of a safetensors file, too.
        assert_eq!(file("i", b"{\"body\":{\"array\": 1}}"), FileKind::Json);
        assert_eq!(file("j", b"[\n  {\n    \"source\": 1}]"), FileKind::Json);
        assert_eq!((file("k", b"[]"), file("l", b"[[1, 2]]")), (FileKind::Json, FileKind::Json));
        assert_eq!((file("m", b"[sensor]\n"), file("n", b"[[stack]]\n")), (FileKind::Unknown, FileKind::Unknown));
        assert_eq!(file("o", b"noise 12{ and more"), FileKind::Unknown);
        assert_eq!(file("g", b"<!DOCTYPE html><p>"), FileKind::Page);
        let mut foreign = 16u64.to_le_bytes().to_vec();
        foreign.extend(b"{}              ");
        assert_eq!(file("h", &foreign), FileKind::Tensors);
        assert_eq!(file("f", b""), FileKind::Unknown);
        assert_eq!(FileKind::of(folder.path()).unwrap(), FileKind::Folder);
        assert_eq!(file("session.toml", b"format = 1"), FileKind::Manifest);
        assert_eq!(FileKind::of(folder.path()).unwrap(), FileKind::Session);
        let path = folder.path().join("x.safetensors");
        let header =
            Header { kind: "shard".into(), version: 1, provenance: Provenance::new("simulate", 0, &()), body: () };
        artifact::write(&path, &header, &Tensors::new()).unwrap();
        assert_eq!(FileKind::of(&path).unwrap(), FileKind::Artifact("shard".into()));
        assert!(FileKind::of(&folder.path().join("missing")).is_err());
    }
}
