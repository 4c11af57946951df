//! The header of a NumPy .npy file: a Python dictionary of three keys behind a magic number and its length.
//!
//! Source: NumPy Enhancement Proposal 1 and `numpy.lib.format`, versions 1 to 3 of the format.

use std::io::{Error, ErrorKind, Read, Result};

/// What a header says.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct NpyHeader {
    /// Type of the numbers as it is written: `'<u2'` with its quotes, or the list of a record's fields.
    pub(super) descr: String,
    /// Whether the first axis, not the last, is the one whose values lie side by side.
    pub(super) fortran_order: bool,
    /// Sizes of the axes.
    pub(super) shape: Vec<u64>,
}

const MAGIC: &[u8] = b"\x93NUMPY";
/// Longest header that is read, bytes. Headers of plain arrays have one or two hundred bytes.
const MOST_BYTES: usize = 4096;

impl NpyHeader {
    /// Reads a header; returns it with the offset of the data in the file, bytes.
    pub(super) fn read(file: &mut impl Read) -> Result<(Self, u64)> {
        let mut start = [0; 10];
        file.read_exact(&mut start)?;
        if !start.starts_with(MAGIC) {
            return Err(refuse("it does not begin with the magic number of the format"));
        }
        // The length of the dictionary: two bytes in version 1, four after it.
        let mut length = [start[8], start[9], 0, 0];
        match start[6] {
            1 => {}
            2 | 3 => file.read_exact(&mut length[2..])?,
            v => return Err(refuse(format!("versions 1 to 3 of the format are read, this is version {v}"))),
        }
        let before = if start[6] == 1 { 10 } else { 12 };
        let length = u32::from_le_bytes(length) as usize;
        if length > MOST_BYTES {
            return Err(refuse(format!("its header has {length} bytes; at most {MOST_BYTES} are read")));
        }
        let mut text = vec![0; length];
        file.read_exact(&mut text)?;
        let text = String::from_utf8(text).map_err(|_| refuse("its header is no text"))?;
        let header = Self::parse(&text).ok_or_else(|| {
            refuse(format!("its header is no dictionary of descr, fortran_order and shape: {text:?}"))
        })?;
        Ok((header, (before + length) as u64))
    }

    /// The dictionary, whose keys may come in any order; each is there once, and no other.
    fn parse(text: &str) -> Option<Self> {
        let inside = text.trim().strip_prefix('{')?.strip_suffix('}')?;
        let (mut descr, mut fortran_order, mut shape) = (None, None, None);
        for entry in parts(inside)? {
            let (key, value) = entry.split_once(':')?;
            let value = value.trim();
            let again = match unquoted(key.trim())? {
                "descr" => descr.replace(value.to_string()).is_some(),
                "fortran_order" => fortran_order.replace(truth(value)?).is_some(),
                "shape" => shape.replace(sizes(value)?).is_some(),
                _ => return None,
            };
            if again {
                return None;
            }
        }
        Some(Self { descr: descr?, fortran_order: fortran_order?, shape: shape? })
    }

    /// The bytes before the data of an array in C order: a multiple of 64, as NumPy writes them.
    pub(super) fn bytes(type_name: &str, shape: [usize; 3]) -> Vec<u8> {
        let [a, b, c] = shape;
        let text = format!("{{'descr': '{type_name}', 'fortran_order': False, 'shape': ({a}, {b}, {c}, ), }}");
        // Three sizes of at most 20 digits: far below the 65,535 bytes of version 1.
        let length = (10 + text.len() + 1).next_multiple_of(64) - 10;
        let mut bytes = MAGIC.to_vec();
        bytes.extend([1, 0]);
        bytes.extend((length as u16).to_le_bytes());
        bytes.extend(format!("{text:<width$}\n", width = length - 1).bytes());
        bytes
    }
}

fn refuse(what: impl Into<String>) -> Error {
    Error::new(ErrorKind::InvalidData, what.into())
}

/// The parts between commas outside quotes and brackets; a comma at the end begins no part. None if a bracket or a
/// quote is not closed.
fn parts(text: &str) -> Option<Vec<&str>> {
    let (mut parts, mut start, mut depth, mut quote) = (Vec::new(), 0, 0usize, None);
    for (i, c) in text.char_indices() {
        match (quote, c) {
            (Some(q), _) => quote = (c != q).then_some(q),
            (None, '\'' | '"') => quote = Some(c),
            (None, '(' | '[' | '{') => depth += 1,
            (None, ')' | ']' | '}') => depth = depth.checked_sub(1)?,
            (None, ',') if depth == 0 => {
                parts.push(&text[start..i]);
                start = i + 1;
            }
            _ => {}
        }
    }
    if !text[start..].trim().is_empty() {
        parts.push(&text[start..]);
    }
    (depth == 0 && quote.is_none()).then_some(parts)
}

fn unquoted(text: &str) -> Option<&str> {
    ['\'', '"'].iter().find_map(|&q| text.strip_prefix(q)?.strip_suffix(q))
}

fn truth(text: &str) -> Option<bool> {
    match text {
        "True" => Some(true),
        "False" => Some(false),
        _ => None,
    }
}

/// The numbers of a tuple. Files of Python 2 have an `L` behind each.
fn sizes(text: &str) -> Option<Vec<u64>> {
    let inside = text.strip_prefix('(')?.strip_suffix(')')?;
    parts(inside)?.into_iter().map(|n| n.trim().trim_end_matches('L').parse().ok()).collect()
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use rand::RngExt as _;

    /// The file of a header text in the given version.
    fn file(version: u8, text: &str) -> Vec<u8> {
        let mut bytes = MAGIC.to_vec();
        bytes.extend([version, 0]);
        match version {
            1 => bytes.extend((text.len() as u16).to_le_bytes()),
            _ => bytes.extend((text.len() as u32).to_le_bytes()),
        }
        bytes.extend(text.bytes());
        bytes
    }

    #[test]
    fn headers_of_numpy_are_read_in_each_version_and_order_of_keys() {
        let texts = [
            "{'descr': '<u2', 'fortran_order': False, 'shape': (3, 4, 5), }          \n",
            "{\"shape\":(3L,4L,5L),\"descr\":'<u2',\"fortran_order\":False}",
        ];
        for (text, version) in texts.into_iter().zip([1, 2]).chain([(texts[0], 3)]) {
            let bytes = file(version, text);
            let (header, start) = NpyHeader::read(&mut bytes.as_slice()).unwrap();
            let expected = NpyHeader { descr: "'<u2'".into(), fortran_order: false, shape: vec![3, 4, 5] };
            assert_eq!((header, start as usize), (expected, bytes.len()));
        }
        let of =
            |shape: &str| NpyHeader::parse(&format!("{{'descr': '|u1', 'fortran_order': True, 'shape': {shape}}}"));
        assert_eq!(of("()").unwrap().shape, [0u64; 0]);
        assert_eq!(of("(7,)").unwrap().shape, [7]);
        // A record: its commas and colons are its own.
        let record = "{'descr': [('x', '<f4'), ('a:b,', '<i2', (2,))], 'fortran_order': False, 'shape': (2,)}";
        assert_eq!(NpyHeader::parse(record).unwrap().descr, "[('x', '<f4'), ('a:b,', '<i2', (2,))]");
    }

    #[test]
    fn what_is_written_is_read_and_aligned() {
        for shape in [[1, 1, 1], [2, 214, 214], [usize::MAX; 3]] {
            let bytes = NpyHeader::bytes("<f4", shape);
            let (header, start) = NpyHeader::read(&mut bytes.as_slice()).unwrap();
            assert_eq!((start as usize, start % 64, bytes.last()), (bytes.len(), 0, Some(&b'\n')));
            assert_eq!(header.shape, shape.map(|n| n as u64));
        }
    }

    #[test]
    fn what_is_no_header_is_refused() {
        let whole = |entries: &str| NpyHeader::parse(&format!("{{{entries}}}"));
        let good = "'descr': '<u2', 'fortran_order': False, 'shape': (1, 2, 3)";
        assert!(whole(good).is_some());
        for bad in [
            "",
            "'descr': '<u2', 'fortran_order': False",
            "'descr': '<u2', 'fortran_order': False, 'shape': (1, 2, 3), 'shape': (1, 2, 3)",
            "'descr': '<u2', 'fortran_order': False, 'shape': (1, 2, 3), 'more': 1",
            "'descr': '<u2', 'fortran_order': 0, 'shape': (1, 2, 3)",
            "'descr': '<u2', 'fortran_order': False, 'shape': (1, -2, 3)",
            "'descr': '<u2', 'fortran_order': False, 'shape': (1, (2, 3))",
            "'descr': '<u2', 'fortran_order': False, 'shape': (1, 2, 99999999999999999999)",
            "'descr': '<u2, 'fortran_order': False, 'shape': (1, 2, 3)",
            "'descr': '<u2', 'fortran_order': False, 'shape': (1, 2, 3",
            "'descr': '<u2', 'fortran_order': False,, 'shape': (1, 2, 3)",
        ] {
            assert!(whole(bad).is_none(), "{bad}");
        }
        let error = |bytes: &[u8]| NpyHeader::read(&mut &bytes[..]).unwrap_err().to_string();
        assert!(error(&file(1, "{}")).contains("dictionary"));
        assert!(error(&file(4, good)).contains("version 4"));
        assert!(error(b"II*\0 a TIFF file").contains("magic"));
        assert!(error(&[&file(2, "")[..8], &[255; 4]].concat()).contains("4294967295 bytes"));
    }

    /// Random changes of a good file, and every cut of it, give a header or an error, at once and without a panic.
    #[test]
    fn hostile_bytes_never_panic() {
        let mut rng = crate::rng::stream(1, "npy header", 0);
        let good = NpyHeader::bytes("<u2", [3, 4, 5]);
        for n in 0..good.len() {
            assert!(NpyHeader::read(&mut &good[..n]).is_err());
        }
        for _ in 0..20_000 {
            let mut bytes = good.clone();
            for _ in 0..rng.random_range(1..6) {
                let i = rng.random_range(0..bytes.len());
                bytes[i] = b"([{}])'\",:0 9L\xff\xc3\n"[rng.random_range(0..17)];
            }
            let _ = NpyHeader::read(&mut bytes.as_slice());
        }
        let nested = format!("{{'descr': {}, 'fortran_order': False, 'shape': (1,)}}", "(".repeat(4000));
        assert!(NpyHeader::parse(&nested).is_none());
    }
}
