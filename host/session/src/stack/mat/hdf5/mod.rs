//! Version 7.3 of the .mat format: HDF5 as MATLAB writes it, arrays in one piece or in chunks with deflate, shuffle and
//! checksums.

mod bytes;
mod dataset;
mod objects;
mod pieces;

pub(super) use objects::SIGNATURE;

use super::variables::{self, Variable};
use super::{KIND, MAX_FRAME_BYTES, by_rows};
use crate::error::SessionError;
use crate::stack::chunks::Chunks;
use crate::stack::layout::Shape;
use crate::stack::number::Number;
use bytes::{Source, damaged};
use dataset::{Dataset, Filter, Layout};
use pieces::Piece;
use std::collections::HashMap;
use std::fs::File;
use std::io::{Error, ErrorKind};
use std::path::Path;

/// What is found of an array in one piece that has no place in the file.
const NEVER_WRITTEN: &str = "none: it was created, and nothing was written into it";

/// An open array of a file of version 7.3.
#[derive(Debug)]
pub(in super::super) struct Hdf5Source {
    source: Source,
    numbers: Numbers,
    number: Number,
    big_endian: bool,
    rows: usize,
    cols: usize,
}

/// The numbers of an array.
#[derive(Debug)]
enum Numbers {
    Compact(Vec<u8>),
    Contiguous(u64),
    Chunked {
        chunks: Box<Chunks>,
        pieces: HashMap<Vec<usize>, Piece>,
        filters: Vec<Filter>,
        axes: usize,
        /// The number that stands where no chunk has been written.
        fill: Vec<u8>,
    },
}

impl Hdf5Source {
    pub fn open(path: &Path, variable: Option<&str>) -> Result<(Shape, Self), SessionError> {
        let file = File::open(path).map_err(|e| SessionError::io(path, e))?;
        let (mut source, root) = objects::open(file).map_err(|e| error(path, e))?;
        let (variables, objects) = list(&mut source, root).map_err(|e| error(path, e))?;
        let chosen = variables::choose(path, &variables, variable)?;
        let shape = variables[chosen].shape(path)?;
        let opened = Self::of(source, &variables[chosen], objects[chosen], shape).map_err(|e| error(path, e))?;
        let Some(opened) = opened else {
            let found = format!("`{}` of class {}", variables[chosen].name, variables[chosen].class);
            let expected = "uint8, uint16, int8, int16, single or double";
            return Err(SessionError::SampleType { path: path.into(), expected, found });
        };
        let [len, rows, cols] = shape;
        Ok((Shape { len, rows, cols, samples: opened.number.samples() }, opened))
    }

    /// The array at an address; `None` if its numbers are of a type that is not read.
    fn of(
        mut source: Source,
        variable: &Variable,
        address: u64,
        [len, rows, cols]: [usize; 3],
    ) -> std::io::Result<Option<Self>> {
        let messages = objects::messages(&mut source, address)?;
        let number = Dataset::of(&messages)?.and_then(|dataset| dataset.number.ok());
        let Some((number, big_endian)) = number.filter(|(n, _)| !matches!(n, Number::U32 | Number::I32)) else {
            return Ok(None);
        };
        let frame = (rows as u64).checked_mul(cols as u64).and_then(|n| n.checked_mul(number.bytes() as u64));
        let frame = frame.filter(|bytes| *bytes <= MAX_FRAME_BYTES);
        let frame = frame.ok_or_else(|| damaged(format!("a frame of {rows} x {cols} pixels is too large")))?;
        let inside = |start: u64, end: u64| {
            let needed = frame.checked_mul(len as u64).and_then(|bytes| bytes.checked_add(start));
            match needed.is_some_and(|needed| needed <= end) {
                true => Ok(()),
                false => Err(damaged(format!("{len} frames of {frame} bytes do not lie inside the file"))),
            }
        };
        let numbers = match dataset::layout(&messages)? {
            Layout::Compact(bytes) => {
                inside(0, bytes.len() as u64)?;
                Numbers::Compact(bytes)
            }
            Layout::Contiguous(u64::MAX) => return Err(Error::new(ErrorKind::NotFound, NEVER_WRITTEN)),
            Layout::Contiguous(address) => {
                inside(address.saturating_add(source.base), source.size)?;
                Numbers::Contiguous(address)
            }
            Layout::Chunked(tree, chunk) => {
                let size: Vec<u64> = variable.size.iter().rev().copied().collect();
                if chunk.len() != size.len() || chunk.contains(&0) {
                    return Err(damaged(format!("chunks of {chunk:?} of an array of {size:?}")));
                }
                // The frames lie column by column; a matrix is one frame.
                let mut sides: Vec<usize> = chunk.iter().map(|n| *n as usize).collect();
                sides.splice(0..0, std::iter::repeat_n(1, 3 - sides.len().min(3)));
                let chunks = Chunks::new([len, cols, rows], [sides[0], sides[1], sides[2]], number)?;
                let pieces = pieces::pieces(&mut source, tree, &size, &chunk)?;
                let filters = dataset::filters(&messages)?;
                let fill = dataset::fill(&messages, number.bytes())?;
                Numbers::Chunked { chunks: Box::new(chunks), pieces, filters, axes: size.len(), fill }
            }
        };
        Ok(Some(Self { source, numbers, number, big_endian, rows, cols }))
    }

    pub fn read(&mut self, path: &Path, i: usize) -> Result<Vec<f32>, SessionError> {
        let frame = self.frame(i).map_err(|e| error(path, e))?;
        Ok(by_rows(&self.number.decode(&frame, self.big_endian), self.rows, self.cols))
    }

    fn frame(&mut self, i: usize) -> std::io::Result<Vec<u8>> {
        let bytes = self.rows * self.cols * self.number.bytes();
        let source = &mut self.source;
        match &mut self.numbers {
            Numbers::Compact(all) => Ok(all[i * bytes..(i + 1) * bytes].to_vec()),
            Numbers::Contiguous(address) => source.read(*address + i as u64 * bytes as u64, bytes as u64),
            Numbers::Chunked { chunks, pieces, filters, axes, fill } => {
                let most = chunks.chunk_bytes();
                let fetch = |at: [usize; 3]| {
                    pieces.get(&at[3 - *axes..]).map(|piece| piece.read(source, filters, most)).transpose()
                };
                Ok(chunks.frame(i, fill, fetch)?.to_vec())
            }
        }
    }
}

/// All variables of a file, with the addresses of their objects.
fn list(source: &mut Source, root: u64) -> std::io::Result<(Vec<Variable>, Vec<u64>)> {
    let (mut variables, mut objects) = (Vec::new(), Vec::new());
    for (name, address) in objects::links(source, root)? {
        // What MATLAB keeps for itself.
        if name.starts_with('#') {
            continue;
        }
        let dataset = Dataset::of(&objects::messages(source, address)?)?;
        let variable = match dataset {
            Some(Dataset { size, number }) => {
                let class = match number {
                    Ok((number, _)) => class(number),
                    Err(name) => name,
                };
                let numeric = number.is_ok() || class == "int64" || class.starts_with("complex");
                Variable { name, class: class.into(), size: size.into_iter().rev().collect(), numeric }
            }
            None => Variable { name, class: "struct, or a sparse array".into(), size: Vec::new(), numeric: false },
        };
        variables.push(variable);
        objects.push(address);
    }
    Ok((variables, objects))
}

/// MATLAB's name of a type.
fn class(number: Number) -> &'static str {
    match number {
        Number::U8 => "uint8",
        Number::I8 => "int8",
        Number::U16 => "uint16",
        Number::I16 => "int16",
        Number::U32 => "uint32",
        Number::I32 => "int32",
        Number::F32 => "single",
        Number::F64 => "double",
    }
}

fn error(path: &Path, e: Error) -> SessionError {
    match e.kind() {
        ErrorKind::Unsupported if e.raw_os_error().is_none() => SessionError::value(
            path,
            "HDF5",
            "what MATLAB writes",
            e,
            "save the array as .npy, in Python: numpy.save(\"frames.npy\", \
             h5py.File(\"FILE.mat\")[\"NAME\"][()].swapaxes(1, 2))",
        ),
        ErrorKind::NotFound if e.raw_os_error().is_none() => {
            let remedy =
                "let the program that records write the frames, or choose another array with `--variable NAME`";
            SessionError::value(path, "frames of the array", "numbers", e, remedy)
        }
        _ if e.raw_os_error().is_some() => SessionError::io(path, e),
        _ => SessionError::format(path, KIND, e),
    }
}
