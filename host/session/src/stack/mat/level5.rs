//! Level 5 of the .mat format: elements with a tag of type and length, each variable one element, compressed by zlib
//! or not. After "MAT-File Format", The MathWorks.

use super::variables::{self, Variable};
use super::{KIND, MAX_FRAME_BYTES, by_rows};
use crate::error::SessionError;
use crate::stack::layout::{SampleType, Shape};
use crate::stack::number::Number;
use flate2::read::ZlibDecoder;
use std::fs::File;
use std::io::{BufReader, Error, ErrorKind, Read, Result, Seek, SeekFrom, Take, copy, sink};
use std::path::Path;

/// Bytes of the file's header.
const HEADER: u64 = 128;
/// Most variables of a file, and most axes and bytes of the name of one.
const MOST_VARIABLES: usize = 4096;
const MOST_AXES: u64 = 32;
const MOST_NAME: u64 = 4096;
/// zlib makes at most this many bytes of one.
const MOST_INFLATION: u64 = 1032;

const COMPRESSED: u32 = 15;
const MATRIX: u32 = 14;
/// The class of objects, whose elements have another layout.
const OPAQUE: u32 = 17;
const COMPLEX: u32 = 1 << 11;
const CLASSES: [&str; 18] = [
    "unknown", "cell", "struct", "object", "char", "sparse", "double", "single", "int8", "uint8", "int16", "uint16",
    "int32", "uint32", "int64", "uint64", "function", "opaque",
];

/// An open array of a file of level 5.
#[derive(Debug)]
pub(in super::super) struct Level5Source {
    file: File,
    place: Place,
    stored: Number,
    big_endian: bool,
    rows: usize,
    cols: usize,
    /// What inflates the element, with the number of bytes that it has yielded.
    inflating: Option<(ZlibDecoder<Take<File>>, u64)>,
}

/// Where the numbers of a variable lie.
#[derive(Clone, Copy, Debug)]
struct Place {
    /// Start of the element's content in the file, and its length.
    start: u64,
    length: u64,
    compressed: bool,
    /// First number, from the start of the content, inflated if it is compressed.
    numbers: u64,
    /// Type of the stored numbers, and their bytes.
    kind: u32,
    bytes: u64,
}

impl Level5Source {
    pub fn open(path: &Path, variable: Option<&str>) -> std::result::Result<(Shape, Self), SessionError> {
        let io = |e| SessionError::io(path, e);
        let mut file = File::open(path).map_err(io)?;
        let size = file.metadata().map_err(io)?.len();
        let mut order = [0; 2];
        file.seek(SeekFrom::Start(HEADER - 2)).and_then(|_| file.read_exact(&mut order)).map_err(io)?;
        let big_endian = order == *b"MI";
        let (variables, places) = list(path, &mut file, size, big_endian)?;
        let chosen = variables::choose(path, &variables, variable)?;
        let (variable, place) = (&variables[chosen], places[chosen]);
        let [len, rows, cols] = variable.shape(path)?;
        let damaged = |detail: String| SessionError::format(path, KIND, format!("`{}`: {detail}", variable.name));
        let Some(stored) = stored(place.kind).filter(|_| supported(&variable.class)) else {
            let found = format!("`{}` of class {}", variable.name, variable.class);
            let expected = "uint8, uint16, int8, int16, single or double";
            return Err(SessionError::SampleType { path: path.into(), expected, found });
        };
        let frame = (rows as u64).checked_mul(cols as u64).and_then(|n| n.checked_mul(stored.bytes() as u64));
        let frame = frame.filter(|bytes| *bytes <= MAX_FRAME_BYTES);
        let frame = frame.ok_or_else(|| damaged(format!("a frame of {rows} x {cols} pixels is too large")))?;
        if frame.checked_mul(len as u64) != Some(place.bytes) {
            return Err(damaged(format!("{} bytes for {len} frames of {frame} bytes", place.bytes)));
        }
        let room = if place.compressed { place.length.saturating_mul(MOST_INFLATION) } else { place.length };
        if place.numbers.checked_add(place.bytes).is_none_or(|end| end > room) {
            return Err(damaged(format!("{} bytes of numbers do not fit into its element", place.bytes)));
        }
        let samples = match (variable.class.as_str(), stored) {
            ("uint8", Number::U8) => SampleType::U8,
            ("uint16", Number::U8 | Number::U16) => SampleType::U16,
            _ => SampleType::F32,
        };
        let source = Self { file, place, stored, big_endian, rows, cols, inflating: None };
        Ok((Shape { len, rows, cols, samples }, source))
    }

    pub fn read(&mut self, path: &Path, i: usize) -> std::result::Result<Vec<f32>, SessionError> {
        let bytes = (self.rows * self.cols * self.stored.bytes()) as u64;
        let from = self.place.numbers + i as u64 * bytes;
        let mut frame = Vec::new();
        if self.place.compressed {
            self.inflate(path, from, bytes, &mut frame).map_err(|e| {
                let detail = format!("its compressed data are damaged or end early, in frame {i}: {e}");
                SessionError::format(path, KIND, detail)
            })?;
        } else {
            let start = SeekFrom::Start(self.place.start + from);
            let read = self.file.seek(start).and_then(|_| whole(&mut self.file, bytes, &mut frame));
            read.map_err(|e| SessionError::io(path, e))?;
        }
        Ok(by_rows(&self.stored.decode(&frame, self.big_endian), self.rows, self.cols))
    }

    /// Inflates bytes at a place. Frames that are read in order are inflated once; a frame before the last one begins
    /// again.
    fn inflate(&mut self, path: &Path, from: u64, bytes: u64, frame: &mut Vec<u8>) -> Result<()> {
        let (mut decoder, at) = match self.inflating.take().filter(|(_, at)| *at <= from) {
            Some(inflating) => inflating,
            None => {
                let mut file = File::open(path)?;
                file.seek(SeekFrom::Start(self.place.start))?;
                (ZlibDecoder::new(file.take(self.place.length)), 0)
            }
        };
        if copy(&mut Read::by_ref(&mut decoder).take(from - at), &mut sink())? < from - at {
            return Err(ErrorKind::UnexpectedEof.into());
        }
        whole(&mut decoder, bytes, frame)?;
        self.inflating = Some((decoder, from + bytes));
        Ok(())
    }
}

/// Reads so many bytes. No more memory is taken than there are bytes.
fn whole(reader: &mut impl Read, bytes: u64, out: &mut Vec<u8>) -> Result<()> {
    reader.take(bytes).read_to_end(out)?;
    if (out.len() as u64) < bytes { Err(ErrorKind::UnexpectedEof.into()) } else { Ok(()) }
}

fn supported(class: &str) -> bool {
    ["double", "single", "int8", "uint8", "int16", "uint16"].contains(&class)
}

/// The number of a type in a tag. MATLAB stores numbers of any class in the smallest type that holds all of them.
fn stored(kind: u32) -> Option<Number> {
    Some(match kind {
        1 => Number::I8,
        2 => Number::U8,
        3 => Number::I16,
        4 => Number::U16,
        5 => Number::I32,
        6 => Number::U32,
        7 => Number::F32,
        9 => Number::F64,
        _ => return None,
    })
}

/// All variables of a file, with their places.
fn list(
    path: &Path,
    file: &mut File,
    size: u64,
    big_endian: bool,
) -> std::result::Result<(Vec<Variable>, Vec<Place>), SessionError> {
    let io = |e| SessionError::io(path, e);
    let (mut variables, mut places) = (Vec::new(), Vec::new());
    let mut at = HEADER;
    while at < size {
        file.seek(SeekFrom::Start(at)).map_err(io)?;
        let cut = |expected: u64| SessionError::Size { path: path.into(), expected, found: size };
        let mut tag = [0; 8];
        file.read_exact(&mut tag).map_err(|_| cut(at + 8))?;
        let [kind, length] = words(tag, big_endian);
        let (start, length) = (at + 8, u64::from(length));
        at = start + length;
        if at > size {
            return Err(cut(at));
        }
        let mut content = BufReader::new(Read::by_ref(file).take(length));
        let (compressed, found) = match kind {
            COMPRESSED => {
                let mut inflated = ZlibDecoder::new(content);
                let mut inner = [0; 8];
                let found = inflated.read_exact(&mut inner).and_then(|()| match words(inner, big_endian)[0] {
                    MATRIX => Elements { from: &mut inflated, at: 8, big_endian }.variable(),
                    _ => Ok(None),
                });
                (true, found)
            }
            MATRIX if length > 0 => (false, Elements { from: &mut content, at: 0, big_endian }.variable()),
            _ => (false, Ok(None)),
        };
        let damaged = |e: Error| SessionError::format(path, KIND, format!("variable {}: {e}", variables.len() + 1));
        if let Some((variable, numbers, kind, bytes)) = found.map_err(damaged)? {
            variables.push(variable);
            places.push(Place { start, length, compressed, numbers, kind, bytes });
        }
        if variables.len() > MOST_VARIABLES {
            return Err(SessionError::format(path, KIND, format!("it has more than {MOST_VARIABLES} variables")));
        }
    }
    Ok((variables, places))
}

fn words(tag: [u8; 8], big_endian: bool) -> [u32; 2] {
    let word = |b: [u8; 4]| if big_endian { u32::from_be_bytes(b) } else { u32::from_le_bytes(b) };
    [word([tag[0], tag[1], tag[2], tag[3]]), word([tag[4], tag[5], tag[6], tag[7]])]
}

/// Reads the elements within a variable's, in their order.
struct Elements<R> {
    from: R,
    /// Bytes that were read.
    at: u64,
    big_endian: bool,
}

/// The tag of an element; a short one holds its data.
struct Tag {
    kind: u32,
    bytes: u64,
    short: Option<[u8; 4]>,
}

impl<R: Read> Elements<R> {
    /// What a variable is, the place of its numbers, and their type and bytes; `None` for an object.
    fn variable(&mut self) -> Result<Option<(Variable, u64, u32, u64)>> {
        let flags = self.element(8)?;
        let [flags, _] = words(flags.try_into().map_err(|_| refused("array flags"))?, self.big_endian);
        let class = flags & 0xff;
        if class == OPAQUE {
            return Ok(None);
        }
        let sizes = self.element(4 * MOST_AXES)?;
        let word = |b: &[u8; 4]| if self.big_endian { u32::from_be_bytes(*b) } else { u32::from_le_bytes(*b) };
        let size: Vec<u64> = sizes.as_chunks::<4>().0.iter().map(|b| u64::from(word(b))).collect();
        let name = String::from_utf8_lossy(&self.element(MOST_NAME)?).into_owned();
        let mut named = CLASSES.get(class as usize).unwrap_or(&CLASSES[0]).to_string();
        let numeric = (6..=15).contains(&class);
        if !numeric {
            return Ok(Some((Variable { name, class: named, size, numeric }, 0, 0, 0)));
        }
        if flags & COMPLEX != 0 {
            named = format!("complex {named}");
        }
        // An array without elements may end here.
        let Tag { kind, bytes, short } = self.tag().unwrap_or(Tag { kind: 0, bytes: 0, short: None });
        let numbers = if short.is_some() { self.at - 4 } else { self.at };
        Ok(Some((Variable { name, class: named, size, numeric }, numbers, kind, bytes)))
    }

    fn tag(&mut self) -> Result<Tag> {
        let mut tag = [0; 8];
        self.from.read_exact(&mut tag)?;
        self.at += 8;
        let [kind, bytes] = words(tag, self.big_endian);
        Ok(match kind >> 16 {
            0 => Tag { kind, bytes: u64::from(bytes), short: None },
            bytes @ 1..=4 => {
                let data = [tag[4], tag[5], tag[6], tag[7]];
                Tag { kind: kind & 0xffff, bytes: u64::from(bytes), short: Some(data) }
            }
            _ => return Err(refused("the length of a short element")),
        })
    }

    /// The data of the next element, of at most so many bytes.
    fn element(&mut self, most: u64) -> Result<Vec<u8>> {
        let Tag { bytes, short, .. } = self.tag()?;
        if let Some(data) = short {
            return Ok(data[..bytes as usize].to_vec());
        }
        if bytes > most {
            return Err(refused("the length of an element"));
        }
        // Elements begin at multiples of eight bytes.
        let padded = bytes.next_multiple_of(8);
        let mut data = vec![0; padded as usize];
        self.from.read_exact(&mut data)?;
        self.at += padded;
        data.truncate(bytes as usize);
        Ok(data)
    }
}

fn refused(what: &str) -> Error {
    Error::new(ErrorKind::InvalidData, format!("{what}: not as the format has it"))
}
