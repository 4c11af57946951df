//! Kinds of files, and the bytes at the head of a file by which most of them are recognised.

use ommatidia_shared::blob;
use std::fmt;
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
    /// The manifest of a session, by its name.
    Manifest,
    /// A folder without a session.toml.
    Folder,
    /// JSON: the output of a verb with `--json`, or any other.
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
            Self::Manifest => f.write_str("the manifest of a session"),
            Self::Folder => f.write_str("a folder without a session.toml"),
            Self::Json => f.write_str("JSON"),
            Self::Stack => f.write_str("a stack of frames"),
            Self::Page => f.write_str("an HTML page"),
            Self::Picture => f.write_str("a PNG picture"),
            Self::Tensors => f.write_str("a safetensors file of another program"),
            Self::Unknown => f.write_str("an unknown file"),
        }
    }
}

impl FileKind {
    /// What to do where a file of this kind is named in the place of another, in words that follow the kind; may be
    /// empty.
    pub fn advice(&self) -> &'static str {
        if *self == Self::Manifest { "; name its folder" } else { "" }
    }

    /// The kind of a folder; None: the path is none.
    pub(crate) fn of_folder(path: &Path) -> Option<Self> {
        let kind = if path.join(crate::MANIFEST).exists() { Self::Session } else { Self::Folder };
        path.is_dir().then_some(kind)
    }

    /// The kind of a file by its first bytes (16, or fewer in a shorter file). None: they may be those of an artifact,
    /// or of anything.
    pub(crate) fn by_start(start: &[u8]) -> Option<Self> {
        match start {
            s if s.starts_with(&blob::MAGIC) => Some(Self::Blob),
            s if s.starts_with(b"MATLAB 5.0 MAT") || s.starts_with(b"MATLAB 7.3 MAT") => Some(Self::Stack),
            s if s.starts_with(b"\x93NUMPY") || s.starts_with(b"II") || s.starts_with(b"MM") => Some(Self::Stack),
            [_, _, _, _, b'f', b't', b'y', b'p', ..] => Some(Self::Stack),
            [b'R', b'I', b'F', b'F', _, _, _, _, b'A', b'V', b'I', b' ', ..] => Some(Self::Stack),
            s if is_tensors(s) => None,
            s if is_json(s) => Some(Self::Json),
            s if s.starts_with(b"\x89PNG") => Some(Self::Picture),
            s if s.to_ascii_lowercase().starts_with(b"<!doctype html") => Some(Self::Page),
            _ => None,
        }
    }
}

/// Whether the first bytes may be those of a safetensors file: the length of its header, less than 4 GiB, and the
/// header, which is JSON. No text has a zero byte.
pub(crate) fn is_tensors(start: &[u8]) -> bool {
    matches!(start, [_, _, _, _, 0, 0, 0, 0, b'{', ..])
}

/// Whether the first bytes are those of a JSON object, or of a JSON array. The first line of a TOML file may be
/// `[table]` or `[[list]]`.
fn is_json(start: &[u8]) -> bool {
    let text = start.trim_ascii_start();
    let inside = text.iter().find(|byte| !(byte.is_ascii_whitespace() || **byte == b'['));
    match text.first() {
        Some(b'{') => true,
        Some(b'[') => matches!(inside, Some(b'{' | b'"' | b']' | b'-' | b'0'..=b'9')),
        _ => false,
    }
}
