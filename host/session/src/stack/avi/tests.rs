//! AVI files as recorders write them, and as they leave them.
#![allow(clippy::unwrap_used)]

use crate::{FrameReader, SampleType};
use std::path::{Path, PathBuf};

/// A chunk with its header, filled up to an even length.
fn chunk(id: &[u8; 4], data: &[u8]) -> Vec<u8> {
    let mut out = id.to_vec();
    out.extend((data.len() as u32).to_le_bytes());
    out.extend(data);
    out.resize(out.len().next_multiple_of(2), 0);
    out
}

fn list(kind: &[u8; 4], form: &[u8; 4], parts: &[Vec<u8>]) -> Vec<u8> {
    chunk(kind, &[&form[..], &parts.concat()].concat())
}

/// The header of a movie of one stream.
fn header(rows: i32, cols: i32, bits: u16, code: &[u8; 4], palette: &[u8]) -> Vec<u8> {
    let mut strh = [&b"vids"[..], code, &[0; 48]].concat();
    strh[20..24].copy_from_slice(&1u32.to_le_bytes());
    strh[24..28].copy_from_slice(&20u32.to_le_bytes());
    let mut strf = 40u32.to_le_bytes().to_vec();
    strf.extend(cols.to_le_bytes());
    strf.extend(rows.to_le_bytes());
    strf.extend(1u16.to_le_bytes());
    strf.extend(bits.to_le_bytes());
    strf.extend(code);
    strf.resize(40, 0);
    strf.extend(palette);
    let stream = list(b"LIST", b"strl", &[chunk(b"strh", &strh), chunk(b"strf", &strf)]);
    list(b"LIST", b"hdrl", &[chunk(b"avih", &[0; 56]), stream])
}

fn frame(i: u8) -> Vec<u8> {
    (0..12).map(|p| 10 * i + p).collect()
}

fn write(folder: &Path, name: &str, bytes: &[u8]) -> PathBuf {
    let path = folder.join(name);
    std::fs::write(&path, bytes).unwrap();
    path
}

fn grey(frames: &[Vec<u8>]) -> Vec<u8> {
    let frames: Vec<Vec<u8>> = frames.iter().map(|f| chunk(b"00db", f)).collect();
    let index = chunk(b"idx1", &[0; 16]);
    list(b"RIFF", b"AVI ", &[header(3, 4, 8, b"GREY", &[]), list(b"LIST", b"movi", &frames), index])
}

#[test]
fn grey_frames_are_read_in_any_order() {
    let folder = tempfile::tempdir().unwrap();
    let path = write(folder.path(), "a.avi", &grey(&[frame(0), frame(1), frame(2)]));
    let mut reader = FrameReader::open(&path).unwrap();
    assert_eq!((reader.len(), reader.rows(), reader.cols(), reader.samples()), (3, 3, 4, SampleType::U8));
    assert_eq!(reader.scale().interval_s, Some(0.05));
    for i in [2, 0, 1] {
        let expected: Vec<f32> = frame(i as u8).into_iter().map(f32::from).collect();
        assert_eq!(reader.read(i).unwrap().into_raw_vec_and_offset().0, expected);
    }
    assert_eq!(reader.parts()[0].damage, None);
}

#[test]
fn a_file_cut_at_any_byte_keeps_its_whole_frames_and_names_its_damage() {
    let folder = tempfile::tempdir().unwrap();
    let whole = grey(&[frame(0), frame(1), frame(2)]);
    let first = whole.windows(4).position(|w| w == b"00db").unwrap();
    for length in 0..whole.len() {
        let path = write(folder.path(), "a.avi", &whole[..length]);
        let reader = FrameReader::open(&path);
        let there = (length.saturating_sub(first) / 20).min(3);
        if there == 0 {
            assert!(reader.is_err(), "{length}");
            continue;
        }
        let reader = reader.unwrap();
        assert_eq!(reader.len(), there, "{length}");
        let part = &reader.parts()[0];
        let in_frame = there < 3 && length - first - 20 * there >= 8;
        assert_eq!(part.torn, if in_frame { vec![there] } else { vec![] }, "{length}");
        // A cut between two frames shows in no chunk.
        let between = (length - first).is_multiple_of(20) && length <= first + 60;
        assert_eq!(part.damage.is_none(), between || length == whole.len(), "{length}");
    }
}

#[test]
fn a_recorder_that_was_killed_leaves_wrong_lengths_of_lists_and_zeros() {
    let folder = tempfile::tempdir().unwrap();
    let mut bytes = grey(&[frame(0), frame(1)]);
    bytes.truncate(bytes.len() - 24);
    let movi = bytes.windows(4).position(|w| w == b"movi").unwrap();
    for at in [4, movi - 4] {
        bytes[at..at + 4].fill(0);
    }
    bytes.extend([0; 100]);
    let reader = FrameReader::open(&write(folder.path(), "a.avi", &bytes)).unwrap();
    assert_eq!(reader.len(), 2);
    assert!(reader.parts()[0].damage.as_ref().unwrap().contains("the last 100 bytes are no frames"));
}

#[test]
fn frames_behind_a_damaged_head_are_found_and_keep_their_places() {
    let folder = tempfile::tempdir().unwrap();
    let whole = grey(&(0..9).map(frame).collect::<Vec<_>>());
    let first = whole.windows(4).position(|w| w == b"00db").unwrap();
    // Head and data of frames 3 and 4, the head of frame 3 alone, its length alone: too long, and past the end.
    let damages: [(usize, usize, &[u8], &[usize]); 5] = [
        (0, 40, &[0], &[3, 4]),
        (0, 8, &[0xff], &[3]),
        (0, 8, &[0], &[3]),
        (4, 8, &[13, 1, 0, 0], &[3]),
        (4, 8, &[0xff, 0xff, 0xff, 0x7f], &[3]),
    ];
    for (from, to, with, lost) in damages {
        let mut bytes = whole.clone();
        for (i, b) in bytes[first + 60 + from..first + 60 + to].iter_mut().enumerate() {
            *b = with[i % with.len()];
        }
        let mut reader = FrameReader::open(&write(folder.path(), "a.avi", &bytes)).unwrap();
        let part = reader.parts()[0].clone();
        assert_eq!((part.torn.as_slice(), part.listed), (lost, 9), "{with:?}: {part:?}");
        let kept: Vec<usize> = (0..9).filter(|i| !lost.contains(i)).collect();
        assert_eq!(part.places().collect::<Vec<_>>(), kept);
        for (i, place) in kept.into_iter().enumerate() {
            let expected: Vec<f32> = frame(place as u8).into_iter().map(f32::from).collect();
            assert_eq!(reader.read(i).unwrap().into_raw_vec_and_offset().0, expected, "{with:?}");
        }
        if from == 0 {
            assert!(part.damage.is_some_and(|d| d.contains("cannot be followed")));
        }
    }
    // Nothing is behind it.
    let mut bytes = whole;
    bytes.truncate(first + 80);
    bytes[first + 60..].fill(0xff);
    let reader = FrameReader::open(&write(folder.path(), "a.avi", &bytes)).unwrap();
    assert_eq!(reader.len(), 3);
    assert!(reader.parts()[0].damage.as_ref().unwrap().contains("ffmpeg may find more"));
}

#[test]
fn the_second_segment_of_a_large_file_is_read_and_short_and_empty_frames_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let mut bytes = grey(&[frame(0), vec![], frame(1), vec![1; 5]]);
    let more =
        [chunk(b"00db", &frame(2)), chunk(b"01wb", &[7; 3]), list(b"LIST", b"rec ", &[chunk(b"00db", &frame(3))])];
    bytes.extend(list(b"RIFF", b"AVIX", &[list(b"LIST", b"movi", &more)]));
    let mut reader = FrameReader::open(&write(folder.path(), "a.avi", &bytes)).unwrap();
    let part = reader.parts()[0].clone();
    assert_eq!((reader.len(), part.listed, &part.empty, &part.torn), (4, 6, &vec![1], &vec![3]));
    assert_eq!(part.places().collect::<Vec<_>>(), [0, 2, 4, 5]);
    assert_eq!((0..4).map(|i| reader.read(i).unwrap()[(0, 0)]).collect::<Vec<_>>(), [0.0, 10.0, 20.0, 30.0]);
}

#[test]
fn rows_from_below_padding_and_palettes_are_understood() {
    let folder = tempfile::tempdir().unwrap();
    // Two rows of three pixels, the lower row first, filled up to four bytes; the palette is inverted.
    let palette: Vec<u8> = (0..=255u8).flat_map(|i| [255 - i, 255 - i, 255 - i, 0]).collect();
    let movie = |palette: &[u8]| {
        let frames = chunk(b"00db", &[4, 5, 6, 0, 1, 2, 3, 0]);
        list(b"RIFF", b"AVI ", &[header(2, 3, 8, &[0; 4], palette), list(b"LIST", b"movi", &[frames])])
    };
    let read = |bytes: &[u8]| FrameReader::open(&write(folder.path(), "a.avi", bytes)).unwrap().read(0).unwrap();
    assert_eq!(read(&movie(&[])).into_raw_vec_and_offset().0, [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]);
    assert_eq!(read(&movie(&palette)).into_raw_vec_and_offset().0, [254.0, 253.0, 252.0, 251.0, 250.0, 249.0]);
    let colours = movie(&[1, 2, 3, 0]);
    let error = FrameReader::open(&write(folder.path(), "a.avi", &colours)).unwrap_err().to_string();
    assert!(error.contains("colours"), "{error}");
}

#[test]
fn any_bytes_are_refused_without_a_panic() {
    let folder = tempfile::tempdir().unwrap();
    let whole = grey(&[frame(0), frame(1)]);
    for at in 0..whole.len() {
        for value in [0, 0xff, 0x7f] {
            let mut bytes = whole.clone();
            bytes[at] = value;
            if let Ok(mut reader) = FrameReader::open(&write(folder.path(), "a.avi", &bytes)) {
                // An error is an answer; a panic would not be.
                let _ = reader.read(0);
            }
        }
    }
}
