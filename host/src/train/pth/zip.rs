//! The files of a zip archive that are stored as they are: all that PyTorch writes.

use super::PthError;
use std::collections::BTreeMap;
use std::ops::Range;

const END: u32 = 0x0605_4b50;
const ENTRY: u32 = 0x0201_4b50;
const LOCAL: u32 = 0x0403_4b50;
/// The end record is this long, and a comment behind it at most that.
const END_LEN: usize = 22;
const COMMENT: usize = 1 << 16;

/// Where each file of an archive lies, by name.
///
/// # Errors
/// It is no zip archive, is cut short, is larger than 4 GiB, or holds a compressed file.
pub fn entries(bytes: &[u8]) -> Result<BTreeMap<String, Range<usize>>, PthError> {
    let first = bytes.len().saturating_sub(END_LEN + COMMENT);
    let end = (first..=bytes.len().saturating_sub(END_LEN)).rev().find(|&at| u32_at(bytes, at).ok() == Some(END));
    let end =
        end.ok_or(PthError::Zip("no end record; PyTorch before 1.6 wrote another format: load and save it anew"))?;
    let (count, mut at) = (u16_at(bytes, end + 10)?, u32_at(bytes, end + 16)? as usize);
    let mut found = BTreeMap::new();
    for _ in 0..count {
        if u32_at(bytes, at)? != ENTRY {
            return Err(PthError::Zip("a damaged directory, or more than 4 GiB"));
        }
        if u16_at(bytes, at + 10)? != 0 {
            return Err(PthError::Zip("a compressed file; PyTorch compresses none"));
        }
        let size = u32_at(bytes, at + 24)? as usize;
        let [name, extra, comment] = [28, 30, 32].map(|o| u16_at(bytes, at + o).map(usize::from));
        let (name, extra, comment) = (name?, extra?, comment?);
        let local = u32_at(bytes, at + 42)? as usize;
        let text = String::from_utf8_lossy(part(bytes, at + 46, name)?).into_owned();
        if u32_at(bytes, local)? != LOCAL {
            return Err(PthError::Zip("a file that is not where the directory says"));
        }
        let start = local + 30 + usize::from(u16_at(bytes, local + 26)?) + usize::from(u16_at(bytes, local + 28)?);
        part(bytes, start, size)?;
        found.insert(text, start..start + size);
        at += 46 + name + extra + comment;
    }
    Ok(found)
}

fn part(bytes: &[u8], at: usize, len: usize) -> Result<&[u8], PthError> {
    at.checked_add(len).and_then(|end| bytes.get(at..end)).ok_or(PthError::Zip("less than its directory says"))
}

fn u16_at(bytes: &[u8], at: usize) -> Result<u16, PthError> {
    part(bytes, at, 2).map(|b| u16::from_le_bytes([b[0], b[1]]))
}

fn u32_at(bytes: &[u8], at: usize) -> Result<u32, PthError> {
    part(bytes, at, 4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]))
}
