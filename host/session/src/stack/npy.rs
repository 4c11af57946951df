//! NumPy .npy files: a short header, then the frames one after another in C order.

use super::layout::Shape;
use super::number::Number;
use crate::error::SessionError;
use npyz::{DType, Endianness, NpyHeader, Order, TypeChar};
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::Path;

const KIND: &str = ".npy";

/// An open .npy file.
#[derive(Debug)]
pub(super) struct NpySource {
    file: File,
    data_start: u64,
    frame_bytes: usize,
    number: Number,
    big_endian: bool,
    buffer: Vec<u8>,
}

impl NpySource {
    pub(super) fn open(path: &Path) -> Result<(Shape, Self), SessionError> {
        let mut file = File::open(path).map_err(|e| SessionError::io(path, e))?;
        let found = file.metadata().map_err(|e| SessionError::io(path, e))?.len();
        let (header, data_start) = read_header(&mut file).map_err(|e| SessionError::format(path, KIND, e))?;
        let (number, big_endian) = number(path, &header.dtype())?;
        let [len, rows, cols] = shape(path, &header)?;
        let frame_bytes = rows.checked_mul(cols).and_then(|n| n.checked_mul(number.bytes()));
        let expected = frame_bytes.and_then(|b| (b as u64).checked_mul(len as u64)?.checked_add(data_start));
        let (Some(frame_bytes), Some(expected)) = (frame_bytes, expected) else {
            return Err(SessionError::format(
                path,
                KIND,
                format!("its shape [{len}, {rows}, {cols}] overflows the file size"),
            ));
        };
        if found != expected {
            return Err(SessionError::Size { path: path.into(), expected, found });
        }
        let source = Self { file, data_start, frame_bytes, number, big_endian, buffer: Vec::new() };
        Ok((Shape { len, rows, cols, samples: number.samples() }, source))
    }

    pub(super) fn read(&mut self, path: &Path, i: usize) -> Result<Vec<f32>, SessionError> {
        self.buffer.resize(self.frame_bytes, 0);
        let start = self.data_start + i as u64 * self.frame_bytes as u64;
        self.file
            .seek(SeekFrom::Start(start))
            .and_then(|_| self.file.read_exact(&mut self.buffer))
            .map_err(|e| SessionError::io(path, e))?;
        Ok(self.number.decode(&self.buffer, self.big_endian))
    }
}

/// Longest header that is read, bytes. Headers of plain arrays have one or two hundred bytes.
const MOST_HEADER: usize = 4096;
/// Largest number of opening brackets in a header. A plain array has two.
const MOST_BRACKETS: usize = 4;

/// Reads the header; returns it with the offset of the data in the file, bytes.
///
/// The parser's time doubles with each nested bracket, so a hostile file could stall it: brackets are counted first.
fn read_header(file: &mut File) -> std::io::Result<(NpyHeader, u64)> {
    let refuse = |what: String| Err(std::io::Error::new(std::io::ErrorKind::InvalidData, what));
    let mut start = [0; 12];
    file.read_exact(&mut start)?;
    // Magic, version, then the length of the rest: two bytes in version 1, four after it.
    let length = match start[6] {
        1 => 10 + usize::from(u16::from_le_bytes([start[8], start[9]])),
        _ => (u32::from_le_bytes([start[8], start[9], start[10], start[11]]) as usize).saturating_add(12),
    };
    if length > MOST_HEADER {
        return refuse(format!("its header has {length} bytes; at most {MOST_HEADER} are read"));
    }
    let mut header = vec![0; length.max(start.len())];
    file.seek(SeekFrom::Start(0))?;
    file.read_exact(&mut header)?;
    let brackets = header.iter().filter(|b| b"([{".contains(b)).count();
    if brackets > MOST_BRACKETS {
        return refuse(format!("its header opens {brackets} brackets; a plain array has at most {MOST_BRACKETS}"));
    }
    Ok((NpyHeader::from_reader(header.as_slice())?, length as u64))
}

fn number(path: &Path, dtype: &DType) -> Result<(Number, bool), SessionError> {
    if let DType::Plain(t) = dtype {
        let number = match (t.type_char(), t.size_field()) {
            (TypeChar::Uint, 1) => Some(Number::U8),
            (TypeChar::Uint, 2) => Some(Number::U16),
            (TypeChar::Float, 4) => Some(Number::F32),
            _ => None,
        };
        if let Some(number) = number {
            return Ok((number, t.endianness() == Endianness::Big));
        }
    }
    Err(SessionError::SampleType { path: path.into(), expected: "uint8, uint16 or float32", found: dtype.descr() })
}

fn shape(path: &Path, header: &NpyHeader) -> Result<[usize; 3], SessionError> {
    let wrong = |found: String, remedy| SessionError::Shape {
        path: path.into(),
        expected: "[frames, rows, cols] in C order".into(),
        found,
        remedy,
    };
    if header.order() != Order::C {
        return Err(wrong("Fortran order".into(), "save `numpy.ascontiguousarray(a)`"));
    }
    let axes: Vec<usize> = header.shape().iter().filter_map(|&n| usize::try_from(n).ok()).collect();
    <[usize; 3]>::try_from(axes).map_err(|_| {
        wrong(format!("{:?}", header.shape()), "save an array of three axes; for a single frame save `a[None]`")
    })
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use std::io::Write;

    #[test]
    fn a_header_of_nested_brackets_is_refused_at_once() {
        let text = format!("{{'descr': '<u2', 'fortran_order': False, 'shape': {}1", "(".repeat(60));
        let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
        bytes.extend((text.len() as u16).to_le_bytes());
        bytes.extend(text.as_bytes());
        let mut file = tempfile::NamedTempFile::with_suffix(".npy").unwrap();
        file.write_all(&bytes).unwrap();
        let error = NpySource::open(file.path()).err().unwrap().to_string();
        assert!(error.contains("brackets"), "{error}");
    }
}
