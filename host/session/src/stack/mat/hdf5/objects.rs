//! Objects of an HDF5 file and the links to them: superblock 0 or 1, object headers of version 1, groups with a symbol
//! table. After the "HDF5 File Format Specification", The HDF Group.

use super::bytes::{Fields, Source, damaged, unsupported};
use std::fs::File;
use std::io::{Read, Result, Seek, SeekFrom};

/// The first bytes of a superblock.
pub(in super::super) const SIGNATURE: &[u8] = b"\x89HDF\r\n\x1a\n";
/// MATLAB puts its own header in front.
const MOST_USER_BLOCK: u64 = 1 << 16;
/// Most blocks and messages of one object header, most links of a group, and most nodes of its tree.
const MOST_BLOCKS: usize = 64;
const MOST_MESSAGES: usize = 4096;
const MOST_LINKS: usize = 4096;
/// Deepest tree.
pub(super) const MOST_LEVELS: u8 = 16;

const CONTINUATION: u16 = 0x10;
const SYMBOL_TABLE: u16 = 0x11;

/// A message of an object header.
#[derive(Debug)]
pub(super) struct Message {
    pub kind: u16,
    /// Whether it stands elsewhere, and this is only a reference to it.
    pub shared: bool,
    pub data: Vec<u8>,
}

/// Opens a file; gives it with the address of the root group.
pub(super) fn open(mut file: File) -> Result<(Source, u64)> {
    let size = file.metadata()?.len();
    let mut base = 0;
    loop {
        let mut start = [0; 8];
        file.seek(SeekFrom::Start(base))?;
        if file.read_exact(&mut start).is_ok() && start == *SIGNATURE {
            break;
        }
        base = if base == 0 { 512 } else { 2 * base };
        if base > MOST_USER_BLOCK {
            return Err(damaged("no HDF5 superblock"));
        }
    }
    let mut source = Source { file, base, size };
    let block = source.metadata(0, 100.min(size - base))?;
    let mut fields = Fields(&block);
    fields.expect(SIGNATURE, "superblock")?;
    let version = fields.number(1)?;
    if version > 1 {
        return Err(unsupported(format!("superblock {version}, of `libver='latest'`")));
    }
    fields.take(4)?;
    if (fields.number(1)?, fields.number(1)?) != (8, 8) {
        return Err(unsupported("addresses of other than eight bytes"));
    }
    fields.take(if version == 0 { 9 } else { 13 })?;
    // The addresses of the base, of free space, of the end and of a driver; then the root's link: name and header.
    let stated = fields.number(8)?;
    if stated != base && stated != 0 {
        return Err(damaged(format!("it states that it begins at {stated}, and begins at {base}")));
    }
    source.base = stated;
    fields.take(8)?;
    let end = fields.number(8)?;
    if end > size {
        return Err(damaged(format!("it states {end} bytes and has {size}: it was cut short")));
    }
    fields.take(8 + 8)?;
    let root = fields.number(8)?;
    Ok((source, root))
}

/// The messages of an object.
pub(super) fn messages(source: &mut Source, address: u64) -> Result<Vec<Message>> {
    let header = source.metadata(address, 16)?;
    let mut fields = Fields(&header);
    if fields.number(1)? != 1 {
        return Err(unsupported("object headers of another version than 1"));
    }
    fields.take(1)?;
    let count = fields.number(2)? as usize;
    fields.take(4)?;
    let mut blocks = vec![(address.saturating_add(16), fields.number(4)?)];
    let mut messages = Vec::new();
    let mut next = 0;
    while let Some((address, length)) = blocks.get(next).copied() {
        next += 1;
        let block = source.metadata(address, length)?;
        let mut fields = Fields(&block);
        while fields.0.len() >= 8 && messages.len() < count.min(MOST_MESSAGES) {
            let (kind, length) = (fields.number(2)? as u16, fields.number(2)? as usize);
            let shared = fields.number(1)? & 2 != 0;
            fields.take(3)?;
            let data = fields.take(length)?.to_vec();
            if kind == CONTINUATION && blocks.len() < MOST_BLOCKS {
                let mut place = Fields(&data);
                blocks.push((place.number(8)?, place.number(8)?));
            }
            messages.push(Message { kind, shared, data });
        }
    }
    Ok(messages)
}

/// The links of a group: names, and addresses of objects.
pub(super) fn links(source: &mut Source, group: u64) -> Result<Vec<(String, u64)>> {
    let messages = messages(source, group)?;
    let table = messages.iter().find(|m| m.kind == SYMBOL_TABLE);
    let table = table.ok_or_else(|| unsupported("groups without a symbol table"))?;
    let mut fields = Fields(&table.data);
    let (tree, heap) = (fields.number(8)?, fields.number(8)?);
    let names = heap_data(source, heap)?;
    let mut links = Vec::new();
    let mut nodes = vec![(tree, None)];
    let mut visited = 0;
    while let Some((address, level)) = nodes.pop() {
        visited += 1;
        if visited > MOST_LINKS || links.len() > MOST_LINKS {
            return Err(damaged(format!("a group of more than {MOST_LINKS} links")));
        }
        if level == Some(0) {
            symbols(source, address, &names, &mut links)?;
            continue;
        }
        // Between the keys, which are places of names, the children; those of the lowest level are lists of links.
        let (found, entries) = tree_node(source, address, 0, 8, level.map(|level| level - 1))?;
        let children = entries.chunks_exact(16).map(|entry| Fields(&entry[8..]).number(8));
        for child in children.collect::<Result<Vec<u64>>>()?.into_iter().rev() {
            nodes.push((child, Some(found)));
        }
    }
    Ok(links)
}

/// A node of a tree of the given kind: its level, and its entries, each a key and the address of a child. `expected`
/// is the level that it must have.
pub(super) fn tree_node(
    source: &mut Source,
    address: u64,
    kind: u64,
    key: usize,
    expected: Option<u8>,
) -> Result<(u8, Vec<u8>)> {
    let header = source.metadata(address, 24)?;
    let mut fields = Fields(&header);
    fields.expect(b"TREE", "tree")?;
    let (found, level, count) = (fields.number(1)?, fields.number(1)? as u8, fields.number(2)?);
    if found != kind || level > MOST_LEVELS || expected.is_some_and(|expected| expected != level) {
        return Err(damaged(format!("a tree of kind {found} with a node of level {level}")));
    }
    let entries = source.metadata(address.saturating_add(24), count * (key as u64 + 8))?;
    Ok((level, entries))
}

fn heap_data(source: &mut Source, address: u64) -> Result<Vec<u8>> {
    let header = source.metadata(address, 32)?;
    let mut fields = Fields(&header);
    fields.expect(b"HEAP", "heap")?;
    fields.take(4)?;
    let length = fields.number(8)?;
    fields.take(8)?;
    let data = fields.number(8)?;
    source.metadata(data, length)
}

fn symbols(source: &mut Source, address: u64, names: &[u8], links: &mut Vec<(String, u64)>) -> Result<()> {
    let header = source.metadata(address, 8)?;
    let mut fields = Fields(&header);
    fields.expect(b"SNOD", "list of links")?;
    fields.take(2)?;
    let count = fields.number(2)?;
    let entries = source.metadata(address.saturating_add(8), 40 * count)?;
    for entry in entries.chunks_exact(40) {
        let mut fields = Fields(entry);
        let (name, object) = (fields.number(8)? as usize, fields.number(8)?);
        // A link to a name, which may lead nowhere, has no object of its own.
        if object == u64::MAX {
            continue;
        }
        let name = names.get(name..).ok_or_else(|| damaged("a name lies outside its heap"))?;
        let name = name.split(|byte| *byte == 0).next().unwrap_or_default();
        links.push((String::from_utf8_lossy(name).into_owned(), object));
    }
    Ok(())
}
