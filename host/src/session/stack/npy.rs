//! NumPy .npy: a short header, then the frames one after another in C order.

use super::{SampleType, reader::Shape};
use crate::session::SessionError;
use npyz::{DType, Endianness, NpyHeader, Order, TypeChar};
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::Path;

const KIND: &str = ".npy";

/// An open .npy file.
#[derive(Debug)]
pub(super) struct NpySource {
    file: File,
    data_start: u64,
    frame_bytes: usize,
    samples: SampleType,
    endianness: Endianness,
    buffer: Vec<u8>,
}

impl NpySource {
    pub(super) fn open(path: &Path) -> Result<(Shape, Self), SessionError> {
        let mut file = File::open(path).map_err(|e| SessionError::io(path, e))?;
        let found = file.metadata().map_err(|e| SessionError::io(path, e))?.len();
        let (header, data_start) = read_header(&mut file).map_err(|e| SessionError::format(path, KIND, e))?;
        let (samples, endianness) = sample_type(path, &header.dtype())?;
        let [len, rows, cols] = shape(path, &header)?;
        let frame_bytes = rows.checked_mul(cols).and_then(|n| n.checked_mul(samples.bytes()));
        let expected = frame_bytes.and_then(|b| (b as u64).checked_mul(len as u64)?.checked_add(data_start));
        let (Some(frame_bytes), Some(expected)) = (frame_bytes, expected) else {
            return Err(SessionError::format(path, KIND, format!("its shape [{len}, {rows}, {cols}] overflows")));
        };
        if found != expected {
            return Err(SessionError::Size { path: path.into(), expected, found });
        }
        let source = Self { file, data_start, frame_bytes, samples, endianness, buffer: Vec::new() };
        Ok((Shape { len, rows, cols, samples }, source))
    }

    pub(super) fn read(&mut self, path: &Path, i: usize) -> Result<Vec<f32>, SessionError> {
        self.buffer.resize(self.frame_bytes, 0);
        let start = self.data_start + i as u64 * self.frame_bytes as u64;
        self.file
            .seek(SeekFrom::Start(start))
            .and_then(|_| self.file.read_exact(&mut self.buffer))
            .map_err(|e| SessionError::io(path, e))?;
        Ok(decode(&self.buffer, self.samples, self.endianness))
    }
}

/// The header, and where the data begin.
fn read_header(file: &mut File) -> std::io::Result<(NpyHeader, u64)> {
    let mut buffered = BufReader::new(file);
    let header = NpyHeader::from_reader(&mut buffered)?;
    let start = buffered.stream_position()?;
    Ok((header, start))
}

fn sample_type(path: &Path, dtype: &DType) -> Result<(SampleType, Endianness), SessionError> {
    if let DType::Plain(t) = dtype {
        let samples = match (t.type_char(), t.size_field()) {
            (TypeChar::Uint, 1) => Some(SampleType::U8),
            (TypeChar::Uint, 2) => Some(SampleType::U16),
            (TypeChar::Float, 4) => Some(SampleType::F32),
            _ => None,
        };
        if let Some(samples) = samples {
            return Ok((samples, t.endianness()));
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
        return Err(wrong("Fortran order".into(), "store `numpy.ascontiguousarray(a)`"));
    }
    let axes: Vec<usize> = header.shape().iter().filter_map(|&n| usize::try_from(n).ok()).collect();
    <[usize; 3]>::try_from(axes)
        .map_err(|_| wrong(format!("{:?}", header.shape()), "store three axes; a single frame is `a[None]`"))
}

fn decode(bytes: &[u8], samples: SampleType, endianness: Endianness) -> Vec<f32> {
    let big = endianness == Endianness::Big;
    match samples {
        SampleType::U8 => bytes.iter().map(|&b| f32::from(b)).collect(),
        SampleType::U16 => bytes
            .chunks_exact(2)
            .map(|b| f32::from(if big { u16::from_be_bytes([b[0], b[1]]) } else { u16::from_le_bytes([b[0], b[1]]) }))
            .collect(),
        SampleType::F32 => bytes
            .chunks_exact(4)
            .map(|b| [b[0], b[1], b[2], b[3]])
            .map(|b| if big { f32::from_be_bytes(b) } else { f32::from_le_bytes(b) })
            .collect(),
    }
}
