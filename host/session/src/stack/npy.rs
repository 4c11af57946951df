//! NumPy .npy files: a short header, then the frames one after another in C order.

use super::layout::Shape;
use super::npy_header::NpyHeader;
use super::number::Number;
use crate::error::SessionError;
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
        let (header, data_start) = NpyHeader::read(&mut file).map_err(|e| SessionError::format(path, KIND, e))?;
        let (number, big_endian) = number(path, &header.descr)?;
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

/// The numbers, and whether the first byte of each is the highest.
fn number(path: &Path, descr: &str) -> Result<(Number, bool), SessionError> {
    match descr.trim_matches(['\'', '"']) {
        "|u1" | "<u1" | ">u1" => Ok((Number::U8, false)),
        "<u2" => Ok((Number::U16, false)),
        ">u2" => Ok((Number::U16, true)),
        "<f4" => Ok((Number::F32, false)),
        ">f4" => Ok((Number::F32, true)),
        _ => Err(SessionError::SampleType {
            path: path.into(),
            expected: "uint8, uint16 or float32",
            found: descr.to_string(),
        }),
    }
}

fn shape(path: &Path, header: &NpyHeader) -> Result<[usize; 3], SessionError> {
    let wrong = |found: String, remedy| SessionError::Shape {
        path: path.into(),
        expected: "[frames, rows, cols] in C order".into(),
        found,
        remedy,
    };
    if header.fortran_order {
        return Err(wrong("Fortran order".into(), "save `numpy.ascontiguousarray(a)`"));
    }
    let axes: Vec<usize> = header.shape.iter().filter_map(|&n| usize::try_from(n).ok()).collect();
    <[usize; 3]>::try_from(axes).map_err(|_| {
        wrong(format!("{:?}", header.shape), "save an array of three axes; for a single frame save `a[None]`")
    })
}
