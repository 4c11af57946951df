//! TIFFs as other programs write them: bytes laid down by hand.
#![allow(clippy::unwrap_used)]

use crate::{FrameReader, SampleType};
use ndarray::Array2;
use std::collections::HashMap;
use std::path::{Path, PathBuf};

/// What a file of frames of 2 x 3 pixels states.
struct Stated<'a> {
    /// Pages that are listed; the numbers of others lie behind them.
    listed: usize,
    photometric: u16,
    compression: u16,
    bits: u16,
    /// 1 for integers, 3 for floats.
    format: u16,
    description: &'a [u8],
}

const PLAIN: Stated<'_> =
    Stated { listed: 1, photometric: 1, compression: 1, bits: 16, format: 1, description: b"ImageJ=1.53t\nimages=3\n" };

/// Three frames, number p + 10 f at pixel p of frame f; the pages come first, and then the numbers.
fn tiff(stated: &Stated<'_>) -> Vec<u8> {
    let bytes = usize::from(stated.bits) / 8;
    let page_bytes = 2 + 12 * 10 + 4;
    let text = 8 + stated.listed * page_bytes;
    let numbers = text + stated.description.len().next_multiple_of(2);
    let mut out = b"II*\0\x08\0\0\0".to_vec();
    for page in 0..stated.listed {
        out.extend(10u16.to_le_bytes());
        let length = stated.description.len() as u32;
        for (tag, kind, count, value) in [
            (256u16, 4u16, 1u32, 3),
            (257, 4, 1, 2),
            (258, 3, 1, u32::from(stated.bits)),
            (259, 3, 1, u32::from(stated.compression)),
            (262, 3, 1, u32::from(stated.photometric)),
            (270, 2, length, text as u32),
            (273, 4, 1, (numbers + 6 * bytes * page) as u32),
            (278, 4, 1, 2),
            (279, 4, 1, 6 * bytes as u32),
            (339, 3, 1, u32::from(stated.format)),
        ] {
            out.extend([tag.to_le_bytes(), kind.to_le_bytes()].concat());
            out.extend([count.to_le_bytes(), value.to_le_bytes()].concat());
        }
        let next = if page + 1 < stated.listed { out.len() + 4 } else { 0 };
        out.extend((next as u32).to_le_bytes());
    }
    out.extend(stated.description);
    out.resize(numbers, 0);
    for number in (0..3u8).flat_map(|f| (0..6).map(move |p| p + 10 * f)) {
        match (stated.bits, stated.format) {
            (8, _) => out.push(number),
            (16, _) => out.extend(u16::from(number).to_le_bytes()),
            _ => out.extend(f32::from(number).to_le_bytes()),
        }
    }
    out
}

fn write(folder: &Path, bytes: &[u8]) -> PathBuf {
    let path = folder.join("a.tif");
    std::fs::write(&path, bytes).unwrap();
    path
}

fn refused(stated: &Stated<'_>, parts: &[&str]) {
    let folder = tempfile::tempdir().unwrap();
    let error = FrameReader::open(&write(folder.path(), &tiff(stated))).unwrap_err().to_string();
    assert!(parts.iter().all(|part| error.contains(part)), "{parts:?} in {error}");
    assert!(error.contains("a.tif") && !error.contains("copy it again from there"), "{error}");
}

fn holds_the_frames(stated: &Stated<'_>) -> FrameReader {
    let folder = tempfile::tempdir().unwrap();
    let mut reader = FrameReader::open(&write(folder.path(), &tiff(stated))).unwrap();
    assert_eq!((reader.len(), reader.rows(), reader.cols()), (3, 2, 3));
    for f in [2, 0, 1] {
        let expected: Vec<f32> = (0..6).map(|p| (p + 10 * f) as f32).collect();
        assert_eq!(reader.read(f).unwrap().into_raw_vec_and_offset().0, expected, "frame {f}");
    }
    reader
}

#[test]
fn frames_behind_the_only_page_are_read() {
    holds_the_frames(&PLAIN);
    let description = br#"{"shape": [3, 2, 3], "truncated": true}"#;
    assert_eq!(holds_the_frames(&Stated { description, bits: 32, format: 3, ..PLAIN }).samples(), SampleType::F32);
    assert_eq!(holds_the_frames(&Stated { bits: 8, ..PLAIN }).samples(), SampleType::U8);
    // A description may announce fewer than there are: that of a recording that was killed.
    holds_the_frames(&Stated { listed: 3, description: b"ImageJ=1.53t\nimages=1\n", ..PLAIN });
}

#[test]
fn frames_that_are_announced_and_not_there_are_an_error() {
    let lost = |description: &'static [u8], listed: usize, expected: &str, found: &str| {
        refused(
            &Stated { description, listed, ..PLAIN },
            &["frames: expected", expected, found, "copy the file again"],
        );
    };
    lost(b"ImageJ=1.53t\nimages=4\n", 1, "expected 4, as", "found 1");
    lost(b"<OME><Image><Pixels SizeC='1' SizeZ='1' SizeT='500'/></Image></OME>", 3, "expected 500", "found 3");
    lost(br#"{"shape": [18446744073709551615, 2, 3]}"#, 1, "expected 18446744073709551615", "found 1");
    // Compressed frames do not lie where they are computed to lie.
    let folder = tempfile::tempdir().unwrap();
    let path = write(folder.path(), &tiff(&Stated { compression: 8, ..PLAIN }));
    assert!(FrameReader::open(&path).unwrap_err().to_string().contains("expected 3, as"));
}

#[test]
fn numbers_are_those_of_the_file_where_zero_is_white() {
    for bits in [8, 16] {
        holds_the_frames(&Stated { listed: 3, photometric: 0, bits, ..PLAIN });
        holds_the_frames(&Stated { photometric: 0, bits, ..PLAIN });
    }
    let float = Stated { listed: 3, photometric: 0, bits: 32, format: 3, ..PLAIN };
    refused(&float, &["zero as black", "float32 with zero as white"]);
}

#[test]
fn a_description_of_another_encoding_is_read() {
    let description = b"ImageJ=1.53t\nimages=3\nfinterval=50\ntunit=\xb5s\n";
    let reader = holds_the_frames(&Stated { description, ..PLAIN });
    assert!(reader.scale().interval_s.is_some_and(|s| (s - 5e-5).abs() < 1e-12));
    holds_the_frames(&Stated { listed: 3, description: b"Gr\xf6\xdfe 2 \xb5m", ..PLAIN });
}

#[test]
fn what_is_not_read_is_told_from_damage() {
    refused(
        &Stated { compression: 34925, ..PLAIN },
        &["found compression 34925 (LZMA)", "without compression or with"],
    );
    refused(&Stated { photometric: 3, bits: 8, ..PLAIN }, &["pages: expected pages of grey", "RGBPalette"]);
}

#[test]
fn a_page_is_measured_as_it_lies_in_memory() {
    let folder = tempfile::tempdir().unwrap();
    let mut bytes = tiff(&Stated { description: b"no frames announced", compression: 5, bits: 8, ..PLAIN });
    // Columns, rows and rows of a strip: 0.4 GB of uint8, four times as much as float32.
    [18, 30, 102].iter().for_each(|at| bytes[*at..at + 4].copy_from_slice(&20_000u32.to_le_bytes()));
    let error = FrameReader::open(&write(folder.path(), &bytes)).unwrap_err().to_string();
    assert!(error.contains("a page of 20000 x 20000 pixels is too large"), "{error}");
}

#[test]
fn any_bytes_are_refused_without_a_panic() {
    let folder = tempfile::tempdir().unwrap();
    let shaped = Stated { description: br#"{"shape": [3, 2, 3], "axes": "TYX"}"#, ..PLAIN };
    for whole in [tiff(&PLAIN), tiff(&Stated { listed: 3, photometric: 0, ..PLAIN }), tiff(&shaped)] {
        for at in 0..whole.len() {
            for value in [0, 1, 0xff, 0x7f] {
                let mut bytes = whole.clone();
                bytes[at] = value;
                if let Ok(mut reader) = FrameReader::open(&write(folder.path(), &bytes)) {
                    // An error is an answer; a panic would not be.
                    let _ = reader.read(0);
                    let _ = reader.read(reader.len() - 1);
                }
            }
        }
    }
}

/// LZW as section 13 of the specification TIFF 6.0 has it.
fn lzw(data: &[u8]) -> Vec<u8> {
    let mut known: HashMap<Vec<u8>, usize> = (0..=255u8).map(|b| (vec![b], usize::from(b))).collect();
    let (mut bits, mut width) = (vec![], 9);
    let mut put = |code: usize, width: usize| bits.extend((0..width).rev().map(|b| (code >> b & 1) as u8));
    put(256, width);
    let mut run = Vec::new();
    for byte in data {
        let longer = [&run[..], &[*byte]].concat();
        if known.contains_key(&longer) {
            run = longer;
            continue;
        }
        put(known[&run], width);
        let next = known.len() + 2;
        known.insert(longer, next);
        // Before code 511 is used.
        width = if next >= 511 { 10 } else { 9 };
        run = vec![*byte];
    }
    put(known[&run], width);
    put(257, width);
    bits.chunks(8).map(|byte| byte.iter().enumerate().fold(0, |n, (i, bit)| n | bit << (7 - i))).collect()
}

#[test]
fn tiles_with_lzw_that_reach_over_the_edge_are_read() {
    // One tile of 16 x 16, of which the page has 8 columns.
    let value = |r: usize, c: usize| if c < 8 { ((16 * r + c) * 37 % 251) as u8 } else { 0 };
    let tile: Vec<u8> = (0..16).flat_map(|r| (0..16).map(move |c| value(r, c))).collect();
    let coded = lzw(&tile);
    let entries = 10u16;
    let mut bytes = b"II*\0\x08\0\0\0".to_vec();
    bytes.extend(entries.to_le_bytes());
    let start = 8 + 2 + 12 * u32::from(entries) + 4;
    for (tag, kind, value) in [
        (256u16, 4u16, 8u32),
        (257, 4, 16),
        (258, 3, 8),
        (259, 3, 5),
        (262, 3, 1),
        (322, 4, 16),
        (323, 4, 16),
        (324, 4, start),
        (325, 4, coded.len() as u32),
        (339, 3, 1),
    ] {
        bytes.extend([tag.to_le_bytes(), kind.to_le_bytes()].concat());
        bytes.extend([1u32.to_le_bytes(), value.to_le_bytes()].concat());
    }
    bytes.extend([0; 4]);
    bytes.extend(&coded);
    let folder = tempfile::tempdir().unwrap();
    let frame = FrameReader::open(&write(folder.path(), &bytes)).unwrap().read(0).unwrap();
    assert_eq!(frame, Array2::from_shape_fn((16, 8), |(r, c)| f32::from(value(r, c))));
    // Damage stays an error.
    let at = bytes.len() - coded.len() / 2;
    bytes[at..].fill(0xff);
    assert!(FrameReader::open(&write(folder.path(), &bytes)).unwrap().read(0).is_err());
}
