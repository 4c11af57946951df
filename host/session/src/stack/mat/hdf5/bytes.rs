//! Bytes of an HDF5 file by their address, and numbers in them, little-endian.

use std::fs::File;
use std::io::{Error, ErrorKind, Read, Result, Seek, SeekFrom};

/// Most bytes of one piece of metadata.
const MOST_METADATA: u64 = 1 << 22;

/// The file; its addresses count from where its superblock lies.
#[derive(Debug)]
pub(super) struct Source {
    pub file: File,
    pub base: u64,
    pub size: u64,
}

impl Source {
    /// A piece of metadata.
    pub fn metadata(&mut self, address: u64, length: u64) -> Result<Vec<u8>> {
        if length > MOST_METADATA {
            return Err(damaged(format!("{length} bytes of metadata at {address}")));
        }
        self.read(address, length)
    }

    /// Bytes that must lie inside the file.
    pub fn read(&mut self, address: u64, length: u64) -> Result<Vec<u8>> {
        let start = self.base.checked_add(address);
        let start = start.filter(|s| s.checked_add(length).is_some_and(|end| end <= self.size));
        let Some(start) = start else {
            return Err(damaged(format!(
                "{length} bytes at {address} lie beyond the end of the file, which was cut short or damaged"
            )));
        };
        let mut bytes = vec![0; length as usize];
        self.file.seek(SeekFrom::Start(start))?;
        self.file.read_exact(&mut bytes)?;
        Ok(bytes)
    }
}

/// Takes numbers from the front of some bytes.
pub(super) struct Fields<'a>(pub &'a [u8]);

impl<'a> Fields<'a> {
    pub fn take(&mut self, length: usize) -> Result<&'a [u8]> {
        let (taken, rest) = self.0.split_at_checked(length).ok_or_else(|| damaged("metadata end early"))?;
        self.0 = rest;
        Ok(taken)
    }

    /// A number of up to eight bytes.
    pub fn number(&mut self, bytes: usize) -> Result<u64> {
        Ok(self.take(bytes)?.iter().rev().fold(0, |n, byte| n << 8 | u64::from(*byte)))
    }

    /// Checks that the next bytes are these.
    pub fn expect(&mut self, bytes: &[u8], what: &str) -> Result<()> {
        match self.take(bytes.len())? == bytes {
            true => Ok(()),
            false => Err(damaged(format!("no {what} where one should be"))),
        }
    }
}

pub(super) fn damaged(detail: impl Into<String>) -> Error {
    Error::new(ErrorKind::InvalidData, detail.into())
}

/// A part of HDF5 that MATLAB does not write, and that is not read.
pub(super) fn unsupported(what: impl Into<String>) -> Error {
    Error::new(ErrorKind::Unsupported, what.into())
}
