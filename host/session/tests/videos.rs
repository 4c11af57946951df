//! AVIs that ffmpeg writes: codes of any number of bits, luma in turns with colour, and a header that is wrong.
#![allow(clippy::unwrap_used)]

use ommatidia_session::{FrameReader, SampleType};
use std::io::{ErrorKind, Write};
use std::path::Path;
use std::process::Command;

const ROWS: usize = 24;
const COLS: usize = 32;
const FRAMES: usize = 4;

/// Code `p` of frame `f`, of 10 bits.
fn code(f: usize, p: usize) -> u16 {
    (64 + 200 * f + (7 * f + p) % 97) as u16
}

/// Writes frames that lie in the file `raw` of the folder; `false` where there is no ffmpeg.
fn encode(folder: &Path, given: &str, codec: &str, stored: &str, name: &str) -> bool {
    let mut command = Command::new("ffmpeg");
    command.args(["-v", "error", "-f", "rawvideo", "-pix_fmt", given, "-s", &format!("{COLS}x{ROWS}"), "-i", "raw"]);
    match command.args(["-c:v", codec, "-pix_fmt", stored, name]).current_dir(folder).status() {
        Ok(status) => {
            assert!(status.success(), "{name}");
            true
        }
        Err(e) if e.kind() == ErrorKind::NotFound => false,
        Err(e) => panic!("{e}"),
    }
}

/// Says that a test was not done, where `cargo verify` counts it.
fn skip(test: &str) {
    eprintln!("skipped {test}: ffmpeg is not installed");
    let Some(path) = std::env::var_os("OMMATIDIA_SKIPPED") else { return };
    let mut file = std::fs::OpenOptions::new().create(true).append(true).open(path).unwrap();
    writeln!(file, "{test}: ffmpeg is not installed").unwrap();
}

#[test]
fn codes_of_10_and_12_bits_are_not_scaled() {
    let desk = tempfile::tempdir().unwrap();
    let codes = (0..FRAMES).flat_map(|f| (0..ROWS * COLS).map(move |p| code(f, p)));
    std::fs::write(desk.path().join("raw"), codes.flat_map(u16::to_le_bytes).collect::<Vec<u8>>()).unwrap();
    for format in ["gray10le", "gray12le", "gray16le"] {
        if !encode(desk.path(), format, "ffv1", format, &format!("{format}.avi")) {
            return skip("codes_of_10_and_12_bits_are_not_scaled");
        }
        let mut reader = FrameReader::open(&desk.path().join(format!("{format}.avi"))).unwrap();
        assert_eq!((reader.len(), reader.samples()), (FRAMES, SampleType::U16), "{format}");
        let expected: Vec<f32> = (0..ROWS * COLS).map(|p| f32::from(code(2, p))).collect();
        assert_eq!(reader.read(2).unwrap().into_raw_vec_and_offset().0, expected, "{format}");
    }
}

#[test]
fn luma_in_turns_with_colour_is_read_as_it_is_stored() {
    let desk = tempfile::tempdir().unwrap();
    // Luma counts, colour is constant.
    let bytes = |luma_first: bool| -> Vec<u8> {
        let pair = |i: usize| if luma_first { [(i % 251) as u8, 128] } else { [128, (i % 251) as u8] };
        (0..FRAMES * ROWS * COLS).flat_map(pair).collect()
    };
    for (format, luma_first) in [("yuyv422", true), ("uyvy422", false)] {
        std::fs::write(desk.path().join("raw"), bytes(luma_first)).unwrap();
        if !encode(desk.path(), format, "rawvideo", format, &format!("{format}.avi")) {
            return skip("luma_in_turns_with_colour_is_read_as_it_is_stored");
        }
        let mut reader = FrameReader::open(&desk.path().join(format!("{format}.avi"))).unwrap();
        assert_eq!(reader.parts()[0].taken_of_colours, Some("luma"));
        let expected: Vec<f32> = (ROWS * COLS..2 * ROWS * COLS).map(|i| (i % 251) as f32).collect();
        assert_eq!(reader.read(1).unwrap().into_raw_vec_and_offset().0, expected, "{format}");
    }
}

#[test]
fn the_size_is_that_of_the_coding_and_not_of_a_wrong_header() {
    let desk = tempfile::tempdir().unwrap();
    let grey: Vec<u8> = (0..FRAMES).flat_map(|f| vec![40 * f as u8 + 20; ROWS * COLS]).collect();
    std::fs::write(desk.path().join("raw"), grey).unwrap();
    if !encode(desk.path(), "gray", "mjpeg", "yuvj420p", "a.avi") {
        return skip("the_size_is_that_of_the_coding_and_not_of_a_wrong_header");
    }
    let path = desk.path().join("a.avi");
    let mut bytes = std::fs::read(&path).unwrap();
    let at = bytes.windows(4).position(|w| w == b"strf").unwrap() + 8;
    bytes[at + 4..at + 8].copy_from_slice(&16u32.to_le_bytes());
    bytes[at + 8..at + 12].copy_from_slice(&8u32.to_le_bytes());
    std::fs::write(&path, bytes).unwrap();
    let mut reader = FrameReader::open(&path).unwrap();
    assert_eq!((reader.len(), reader.rows(), reader.cols()), (FRAMES, ROWS, COLS));
    assert!(reader.read(3).unwrap().iter().all(|v| (v - 140.0).abs() < 4.0));
}
