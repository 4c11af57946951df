//! Walks through the chunks of a RIFF file (AVI 1.0 and OpenDML 2.0) and notes where the frames lie.
//!
//! Lists are entered and not measured: a recorder that was killed leaves wrong lengths of lists, but right lengths of
//! frames. The index is not read, since such a file lacks it. Where the head of a frame is damaged and all frames have
//! one length, the next frame is searched for.

use std::fs::File;
use std::io::{BufReader, Error, ErrorKind, Read, Result, Seek, SeekFrom};

/// The place of a frame's data.
#[derive(Clone, Copy, Debug)]
pub(super) struct Chunk {
    /// Bytes from the start of the file.
    pub start: u64,
    /// Length that its header states, bytes.
    pub bytes: u32,
    /// Whether the file reaches to its end.
    pub whole: bool,
}

/// What the header says of the video stream.
#[derive(Debug)]
pub(super) struct Video {
    pub rows: usize,
    pub cols: usize,
    /// Whether the first row of the data is the lowest of the picture.
    pub upwards: bool,
    /// Bits of a pixel.
    pub bits: u16,
    /// Code of the compression, four letters; zeros for none.
    pub code: [u8; 4],
    /// Grey level of each colour of a palette; `None` without one, an error for a palette of colours.
    pub palette: Option<std::result::Result<Vec<u8>, String>>,
    pub interval_s: Option<f64>,
}

#[derive(Debug, Default)]
pub(super) struct Found {
    pub video: Option<Video>,
    pub chunks: Vec<Chunk>,
    pub damage: Option<String>,
}

/// Most bytes of a header of a stream.
const MOST_HEADER: u32 = 1 << 16;

/// Lists that hold frames or headers of streams; others are skipped.
const ENTERED: [&[u8; 4]; 4] = [b"hdrl", b"strl", b"movi", b"rec "];

/// Reads all headers of chunks.
///
/// # Errors
/// The file cannot be read, or does not begin as an AVI. What is damaged later is noted in the result.
pub(super) fn walk(file: File) -> Result<Found> {
    let size = file.metadata()?.len();
    let mut file = BufReader::new(file);
    let mut start = [0; 12];
    file.read_exact(&mut start).map_err(|_| invalid("it is shorter than a header"))?;
    if &start[..4] != b"RIFF" || &start[8..] != b"AVI " {
        return Err(invalid("it does not begin with RIFF and AVI"));
    }
    let mut found = Found::default();
    let (mut at, mut streams, mut ours, mut kind) = (12u64, 0u32, None, [0; 4]);
    let (mut rate, mut last_end) = (None, at);
    while at + 8 <= size {
        let here = file.stream_position()?;
        file.seek_relative(at as i64 - here as i64)?;
        let mut head = [0; 8];
        file.read_exact(&mut head)?;
        let id = [head[0], head[1], head[2], head[3]];
        let bytes = u32::from_le_bytes([head[4], head[5], head[6], head[7]]);
        let data = at + 8;
        if &id == b"RIFF" || &id == b"LIST" {
            let mut form = [0; 4];
            if file.read_exact(&mut form).is_err() {
                break;
            }
            if &id == b"RIFF" || ENTERED.contains(&&form) {
                if &form == b"strl" {
                    streams += 1;
                }
                at = data + 4;
                continue;
            }
        }
        let end = data + u64::from(bytes);
        match &id {
            b"strh" if ours.is_none() => {
                let header = part(&mut file, bytes)?;
                kind = word(&header, 0).unwrap_or_default();
                rate = number(&header, 20).zip(number(&header, 24));
            }
            b"strf" if ours.is_none() && &kind == b"vids" => {
                ours = Some(streams.saturating_sub(1));
                let interval_s = rate.filter(|(s, r)| *s > 0 && *r > 0).map(|(s, r)| f64::from(s) / f64::from(r));
                found.video = video(&part(&mut file, bytes)?, interval_s);
            }
            _ if is_frame(id, ours) => {
                let whole = end <= size;
                // Where frames are alike and the next one begins where it should, this length alone is wrong.
                if let Some(usual) = usual(&found.chunks).filter(|usual| *usual != bytes && bytes > 0) {
                    let next = data + u64::from(usual.next_multiple_of(2));
                    if !is_head(&mut file, end + u64::from(bytes % 2), size, ours)?
                        && is_head(&mut file, next, size, ours)?
                    {
                        found.chunks.push(Chunk { start: data, bytes, whole: false });
                        (last_end, at) = (next, next);
                        continue;
                    }
                }
                found.chunks.push(Chunk { start: data, bytes, whole });
                if !whole {
                    let (there, of) = (size - data, bytes);
                    found.damage = Some(format!("it ends within a frame, after {there} of its {of} bytes"));
                }
            }
            _ if !id.iter().all(|b| (b' '..=b'~').contains(b)) => {
                if let Some(usual) = usual(&found.chunks)
                    && let Some(next) = next_frame(&mut file, (at, size), usual, ours)?
                {
                    // So many frames were there, by their length.
                    let each = f64::from(usual.next_multiple_of(2)) + 8.0;
                    let lost = ((next - at) as f64 / each).round().max(1.0) as usize;
                    found.chunks.extend(std::iter::repeat_n(Chunk { start: at, bytes: usual, whole: false }, lost));
                    let (bytes, frames) = (next - at, if lost == 1 { "frame" } else { "frames" });
                    found.damage.get_or_insert_with(|| {
                        format!(
                            "{bytes} bytes from byte {at} on cannot be followed: {lost} {frames}; others come after"
                        )
                    });
                    (last_end, at) = (next, next);
                    continue;
                }
                let lost = size - at;
                found.damage = Some(match id {
                    [0, 0, 0, 0] => format!("the last {lost} bytes are no frames"),
                    _ => format!(
                        "from byte {at} on it cannot be followed: {lost} bytes are left out, with the frames in them; \
                         ffmpeg may find more by the index of the file (ffmpeg -i FILE -c copy NEW.avi)"
                    ),
                });
                break;
            }
            _ => {}
        }
        // Chunks begin at even places.
        (last_end, at) = (end, end + u64::from(bytes % 2));
    }
    // A byte that fills up the last chunk may be missing.
    if found.damage.is_none() && at != size && last_end != size {
        found.damage = Some("it ends within a chunk that is no frame".into());
    }
    Ok(found)
}

/// The length of all frames so far, if they have one: that of uncompressed frames.
fn usual(chunks: &[Chunk]) -> Option<u32> {
    let mut whole = chunks.iter().filter(|c| c.whole && c.bytes > 0).map(|c| c.bytes);
    let first = whole.next()?;
    // Compressed frames differ in length.
    (whole.next()? == first && whole.take(MOST_COMPARED).all(|bytes| bytes == first)).then_some(first)
}

/// Number of frames whose lengths are compared.
const MOST_COMPARED: usize = 16;

/// Whether a frame or another chunk begins at a place; the end of the file counts.
fn is_head(file: &mut BufReader<File>, at: u64, size: u64, ours: Option<u32>) -> Result<bool> {
    if at + 8 > size {
        return Ok(at == size);
    }
    let mut id = [0; 4];
    file.seek(SeekFrom::Start(at))?;
    file.read_exact(&mut id)?;
    Ok(is_frame(id, ours) || [b"idx1", b"RIFF", b"LIST", b"JUNK"].contains(&&id) || id.starts_with(b"ix"))
}

/// Bytes that are searched at once.
const SEARCHED: u64 = 1 << 20;

/// The first place behind `at` where a frame of the usual length begins, with another chunk behind it.
fn next_frame(
    file: &mut BufReader<File>,
    (at, size): (u64, u64),
    usual: u32,
    ours: Option<u32>,
) -> Result<Option<u64>> {
    let mut from = at + 1;
    while from + 8 <= size {
        file.seek(SeekFrom::Start(from))?;
        let mut bytes = Vec::new();
        // The head of a frame may lie across two searches.
        file.take(SEARCHED + 7).read_to_end(&mut bytes)?;
        for (i, head) in bytes.windows(8).enumerate() {
            let [a, b, c, d, ..] = *head else { continue };
            let start = from + i as u64;
            let end = start + 8 + u64::from(usual.next_multiple_of(2));
            if head[4..] == usual.to_le_bytes() && is_frame([a, b, c, d], ours) && is_head(file, end, size, ours)? {
                return Ok(Some(start));
            }
        }
        from += SEARCHED;
    }
    Ok(None)
}

/// Whether a chunk is a frame of the video stream: its number in two digits, then `db` or `dc`.
fn is_frame(id: [u8; 4], ours: Option<u32>) -> bool {
    let digit = |b: u8| char::from(b).to_digit(10);
    let stream = digit(id[0]).zip(digit(id[1])).map(|(tens, ones)| 10 * tens + ones);
    ours.is_some() && stream == ours && matches!(&id[2..], b"db" | b"dc")
}

/// A header of a stream.
fn part(file: &mut impl Read, bytes: u32) -> Result<Vec<u8>> {
    let mut header = Vec::new();
    file.take(u64::from(bytes.min(MOST_HEADER))).read_to_end(&mut header)?;
    Ok(header)
}

fn word(bytes: &[u8], at: usize) -> Option<[u8; 4]> {
    bytes.get(at..at + 4)?.try_into().ok()
}

fn number(bytes: &[u8], at: usize) -> Option<u32> {
    word(bytes, at).map(u32::from_le_bytes)
}

/// A `BITMAPINFOHEADER` with its palette.
fn video(header: &[u8], interval_s: Option<f64>) -> Option<Video> {
    let rows = number(header, 8)? as i32;
    let bits = (number(header, 12)? >> 16) as u16;
    let code = word(header, 16)?;
    let length = (number(header, 0)? as usize).clamp(40, header.len().max(40));
    let palette: Vec<&[u8]> = header.get(length..).unwrap_or_default().chunks_exact(4).collect();
    let palette = (!palette.is_empty()).then(|| {
        let grey = |c: &&[u8]| c[0] == c[1] && c[1] == c[2];
        match palette.iter().all(grey) {
            true => Ok(palette.iter().map(|c| c[0]).collect()),
            false => Err("its palette has colours; one channel of grey levels is expected".to_string()),
        }
    });
    Some(Video {
        rows: rows.unsigned_abs() as usize,
        cols: (number(header, 4)? as i32).unsigned_abs() as usize,
        upwards: code == [0; 4] && rows > 0,
        bits,
        code,
        palette,
        interval_s,
    })
}

fn invalid(text: &str) -> Error {
    Error::new(ErrorKind::InvalidData, text)
}
