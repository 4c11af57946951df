//! What an object header says of an array: size, type of its numbers, and where they lie.

use super::bytes::{Fields, damaged, unsupported};
use super::objects::Message;
use crate::stack::number::Number;
use std::io::Result;

const DATASPACE: u16 = 1;
const DATATYPE: u16 = 3;
const OLD_FILL: u16 = 4;
const FILL: u16 = 5;
const LAYOUT: u16 = 8;
const FILTERS: u16 = 0xb;
const MOST_AXES: u64 = 32;
const MOST_FILTERS: u64 = 16;

/// An array of the file.
#[derive(Debug)]
pub(super) struct Dataset {
    /// Size as HDF5 has it: that of MATLAB, last axis first.
    pub size: Vec<u64>,
    /// Type of its numbers, with the byte order; or the name of a type that is not read.
    pub number: std::result::Result<(Number, bool), &'static str>,
}

/// Where the numbers of an array lie.
#[derive(Clone, Debug)]
pub(super) enum Layout {
    /// In the header.
    Compact(Vec<u8>),
    /// In one piece, at this address.
    Contiguous(u64),
    /// In chunks of the given size; the address is that of their tree.
    Chunked(u64, Vec<u64>),
}

/// What was done to a chunk before it was written.
#[derive(Clone, Debug)]
pub(super) struct Filter {
    pub id: u64,
    pub values: Vec<u64>,
}

impl Dataset {
    /// The array of an object; `None` if the object is none.
    pub fn of(messages: &[Message]) -> Result<Option<Self>> {
        let find = |kind| messages.iter().find(|m| m.kind == kind);
        let (Some(space), Some(kind)) = (find(DATASPACE), find(DATATYPE)) else { return Ok(None) };
        let number = if kind.shared { Err("a named type") } else { number(&kind.data)? };
        Ok(Some(Self { size: size(&space.data)?, number }))
    }
}

fn size(message: &[u8]) -> Result<Vec<u64>> {
    let mut fields = Fields(message);
    let (version, axes) = (fields.number(1)?, fields.number(1)?);
    if axes > MOST_AXES {
        return Err(damaged(format!("an array of {axes} axes")));
    }
    fields.take(if version == 1 { 6 } else { 2 })?;
    (0..axes).map(|_| fields.number(8)).collect()
}

fn number(message: &[u8]) -> Result<std::result::Result<(Number, bool), &'static str>> {
    let mut fields = Fields(message);
    let (class, bits) = (fields.number(1)? & 15, fields.number(3)?);
    let (big_endian, signed) = (bits & 1 == 1, bits & 8 != 0);
    let number = match (class, fields.number(4)?, signed) {
        (0, 1, false) => Number::U8,
        (0, 1, true) => Number::I8,
        (0, 2, false) => Number::U16,
        (0, 2, true) => Number::I16,
        (0, 4, false) => Number::U32,
        (0, 4, true) => Number::I32,
        (1, 4, _) => Number::F32,
        (1, 8, _) => Number::F64,
        (0, _, _) => return Ok(Err("int64")),
        (1, 2, _) => return Ok(Err("float16")),
        (3, _, _) => return Ok(Err("text")),
        (6, _, _) => return Ok(Err("complex, or a compound")),
        (7, _, _) => return Ok(Err("cell")),
        (8, _, _) => return Ok(Err("logical, or an enumeration")),
        _ => return Ok(Err("no number")),
    };
    Ok(Ok((number, big_endian)))
}

/// Where the numbers of an array lie.
pub(super) fn layout(messages: &[Message]) -> Result<Layout> {
    let message = messages.iter().find(|m| m.kind == LAYOUT).ok_or_else(|| damaged("an array without numbers"))?;
    let mut fields = Fields(&message.data);
    let version = fields.number(1)?;
    let sizes = |fields: &mut Fields<'_>, axes: u64| -> Result<Vec<u64>> {
        (0..axes.min(MOST_AXES)).map(|_| fields.number(4)).collect()
    };
    // Before version 3 the axes come first, and the sizes of an array in one piece are stated, too.
    let (mut axes, class) = match version {
        1 | 2 => (fields.number(1)?, fields.number(1)?),
        3 => (0, fields.number(1)?),
        _ => return Err(unsupported(format!("data layout {version}"))),
    };
    if version < 3 {
        fields.take(5)?;
    } else if class == 2 {
        axes = fields.number(1)?;
    }
    Ok(match class {
        0 => {
            if version < 3 {
                sizes(&mut fields, axes)?;
            }
            let length = fields.number(if version < 3 { 4 } else { 2 })? as usize;
            Layout::Compact(fields.take(length)?.to_vec())
        }
        1 => Layout::Contiguous(fields.number(8)?),
        // The last of the sizes is that of a number.
        2 => Layout::Chunked(fields.number(8)?, sizes(&mut fields, axes.saturating_sub(1))?),
        _ => return Err(unsupported(format!("data layout of class {class}"))),
    })
}

/// The number, of so many bytes as they lie in the file, that stands where nothing has been written; zero where none is
/// stated.
pub(super) fn fill(messages: &[Message], bytes: usize) -> Result<Vec<u8>> {
    let find = |kind| messages.iter().find(|m| m.kind == kind);
    let Some(message) = find(FILL).or_else(|| find(OLD_FILL)) else { return Ok(vec![0; bytes]) };
    if message.shared {
        return Err(unsupported("a fill value that several arrays share"));
    }
    let mut fields = Fields(&message.data);
    let stated = match (message.kind, if message.kind == FILL { fields.number(1)? } else { 0 }) {
        (OLD_FILL, _) => true,
        (_, version @ (1 | 2)) => {
            // When space is taken, when the number is written, and whether there is one.
            fields.take(2)?;
            fields.number(1)? != 0 || version == 1
        }
        (_, 3) => fields.number(1)? & 0x20 != 0,
        (_, version) => return Err(unsupported(format!("fill value message {version}"))),
    };
    // A size that is not positive: there is none.
    let size = if stated { fields.number(4)? as u32 as i32 } else { 0 };
    match usize::try_from(size) {
        Ok(size) if size == bytes => Ok(fields.take(size)?.to_vec()),
        Ok(0) | Err(_) => Ok(vec![0; bytes]),
        Ok(size) => Err(damaged(format!("a fill value of {size} bytes for numbers of {bytes}"))),
    }
}

/// What was done to the chunks of an array, in the order in which it was done.
pub(super) fn filters(messages: &[Message]) -> Result<Vec<Filter>> {
    let Some(message) = messages.iter().find(|m| m.kind == FILTERS) else { return Ok(Vec::new()) };
    let mut fields = Fields(&message.data);
    let (version, count) = (fields.number(1)?, fields.number(1)?);
    if count > MOST_FILTERS {
        return Err(damaged(format!("{count} filters")));
    }
    fields.take(if version == 1 { 6 } else { 0 })?;
    let mut filters = Vec::new();
    for _ in 0..count {
        let id = fields.number(2)?;
        let named = version == 1 || id >= 256;
        let name = if named { fields.number(2)? as usize } else { 0 };
        fields.take(2)?;
        let values = fields.number(2)? as usize;
        fields.take(if version == 1 { name.next_multiple_of(8) } else { name })?;
        let values = (0..values).map(|_| fields.number(4)).collect::<Result<Vec<u64>>>()?;
        if version == 1 && values.len() % 2 == 1 {
            fields.take(4)?;
        }
        filters.push(Filter { id, values });
    }
    Ok(filters)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn fill_values_of_each_version_are_read() {
        let of = |kind, data: &[u8]| fill(&[Message { kind, shared: false, data: data.to_vec() }], 2);
        for (kind, data, expected) in [
            (OLD_FILL, &[2, 0, 0, 0, 7, 1][..], [7, 1]),
            (FILL, &[1, 2, 2, 1, 2, 0, 0, 0, 7, 1], [7, 1]),
            (FILL, &[1, 2, 2, 0, 0, 0, 0, 0], [0, 0]),
            (FILL, &[1, 2, 2, 0, 0xff, 0xff, 0xff, 0xff], [0, 0]),
            (FILL, &[2, 3, 2, 1, 2, 0, 0, 0, 7, 1], [7, 1]),
            (FILL, &[2, 3, 2, 0], [0, 0]),
            (FILL, &[3, 0x2a, 2, 0, 0, 0, 7, 1], [7, 1]),
            (FILL, &[3, 0x0a], [0, 0]),
            (LAYOUT, &[], [0, 0]),
        ] {
            assert_eq!(of(kind, data).unwrap(), expected, "{kind}: {data:?}");
        }
        assert!(of(FILL, &[3, 0x2a, 4, 0, 0, 0, 7, 1, 0, 0]).unwrap_err().to_string().contains("4 bytes"));
        assert!(of(FILL, &[3, 0x2a, 2, 0, 0, 0, 7]).is_err() && of(FILL, &[9]).is_err() && of(FILL, &[]).is_err());
    }
}
