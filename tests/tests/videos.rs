//! Videos that ffmpeg writes are read, and what is written for it plays.
#![allow(clippy::unwrap_used)]

use ommatidia_session::{FrameReader, FrameWriter, SampleType, StackSpec};
use ommatidia_tests::skip;
use std::process::Command;

const ROWS: usize = 24;
const COLS: usize = 32;

/// Frame `i` of a recording: a pattern that tells the number.
fn frame(i: usize) -> Vec<u8> {
    (0..ROWS * COLS).map(|p| (40 + (7 * i + p) % 97) as u8).collect()
}

#[test]
fn compressed_videos_are_read_and_written_by_ffmpeg() {
    let desk = tempfile::tempdir().unwrap();
    // Grey frames, as a raw stream.
    let raw: Vec<u8> = (0..5).flat_map(frame).collect();
    std::fs::write(desk.path().join("raw"), raw).unwrap();
    let encode = |codec: &str, pixels: &str, name: &str| {
        let mut command = Command::new("ffmpeg");
        command.args([
            "-v",
            "error",
            "-f",
            "rawvideo",
            "-pix_fmt",
            "gray",
            "-s",
            &format!("{COLS}x{ROWS}"),
            "-i",
            "raw",
        ]);
        command.args(["-c:v", codec, "-pix_fmt", pixels, name]).current_dir(desk.path());
        command.status()
    };
    match encode("ffv1", "gray", "ffv1.avi") {
        Ok(status) => assert!(status.success()),
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => {
            skip("compressed_videos_are_read_and_written_by_ffmpeg", "ffmpeg is not installed");
            return;
        }
        Err(e) => panic!("{e}"),
    }
    let read = |name: &str| {
        let mut reader = FrameReader::open(&desk.path().join(name)).unwrap();
        assert_eq!(reader.len(), 5, "{name}");
        // Backwards, too: the decoder starts again.
        let last = reader.read(4).unwrap();
        (reader.read(1).unwrap().into_raw_vec_and_offset().0, last)
    };
    let values: Vec<f32> = frame(1).into_iter().map(f32::from).collect();
    assert!(encode("rawvideo", "gray", "grey.avi").unwrap().success());
    assert_eq!(read("grey.avi").0, values);
    assert_eq!(read("ffv1.avi").0, values, "FFV1 has no loss");
    assert!(encode("ffv1", "gray16le", "deep.avi").unwrap().success());
    let deep = FrameReader::open(&desk.path().join("deep.avi")).unwrap();
    assert_eq!((deep.samples(), read("deep.avi").0[0]), (SampleType::U16, values[0] * 257.0));
    assert!(encode("mjpeg", "yuvj420p", "mjpeg.avi").unwrap().success());
    let (mjpeg, _) = read("mjpeg.avi");
    let off = mjpeg.iter().zip(&values).map(|(a, b)| (a - b).abs()).sum::<f32>() / values.len() as f32;
    assert!(off < 12.0, "{off}");
    // Written and read again: AVI to the code, MP4 by its length.
    let objects = ndarray::Array3::from_shape_fn((3, 33, 31), |(f, r, c)| (f * 85 * 85 + r + c) as f32);
    let (frames, rows, cols) = objects.dim();
    for name in ["x.avi", "x.mp4"] {
        let spec = StackSpec { frames, rows, cols, samples: SampleType::F32, pixel_um: None };
        let mut writer = FrameWriter::create(&desk.path().join(name), spec).unwrap().with_interval(Some(0.05));
        objects.outer_iter().for_each(|object| writer.push(object).unwrap());
        writer.finish().unwrap();
    }
    let mut reader = FrameReader::open(&desk.path().join("x.avi")).unwrap();
    let largest = objects.fold(0.0f32, |m, v| m.max(*v));
    assert_eq!((reader.len(), reader.read(2).unwrap()[(32, 30)]), (3, 255.0));
    assert_eq!(reader.read(1).unwrap()[(0, 0)], (objects[(1, 0, 0)] * (255.0 / largest)).round());
    let mut probe = Command::new("ffprobe");
    probe.args(["-v", "error", "-count_frames", "-show_entries", "stream=nb_read_frames,width,height,r_frame_rate"]);
    let out = probe.args(["-of", "csv=p=0", "x.mp4"]).current_dir(desk.path()).output().unwrap();
    assert_eq!(String::from_utf8_lossy(&out.stdout).trim(), "32,34,20/1,3");
}

/// Where the data of each frame lie in an AVI of one video.
fn frames_in(avi: &[u8]) -> Vec<std::ops::Range<usize>> {
    let movi = avi.windows(4).position(|w| w == b"movi").unwrap() + 4;
    let mut at = movi;
    let mut found = Vec::new();
    while avi[at..].starts_with(b"00dc") {
        let bytes = u32::from_le_bytes(avi[at + 4..at + 8].try_into().unwrap()) as usize;
        found.push(at + 8..at + 8 + bytes);
        at += 8 + bytes + bytes % 2;
    }
    found
}

/// ffmpeg goes on where a frame is damaged, with pixels that it invents or without the frame: either is named, and the
/// other frames stay in their places.
#[test]
fn damaged_frames_are_named_and_move_no_other() {
    let desk = tempfile::tempdir().unwrap();
    let count = 20;
    std::fs::write(desk.path().join("raw"), (0..count).flat_map(frame).collect::<Vec<u8>>()).unwrap();
    let size = format!("{COLS}x{ROWS}");
    let input = ["-v", "error", "-f", "rawvideo", "-pix_fmt", "gray", "-s", &size, "-r", "60", "-i", "raw"];
    // As recorders write it: each frame for itself, with checksums.
    let coding = ["-c:v", "ffv1", "-level", "3", "-slices", "4", "-slicecrc", "1", "-g", "1", "whole.avi"];
    match Command::new("ffmpeg").args(input).args(coding).current_dir(desk.path()).status() {
        Ok(status) => assert!(status.success()),
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => {
            skip("damaged_frames_are_named_and_move_no_other", "ffmpeg is not installed");
            return;
        }
        Err(e) => panic!("{e}"),
    }
    let whole = std::fs::read(desk.path().join("whole.avi")).unwrap();
    let places = frames_in(&whole);
    assert_eq!(places.len(), count);
    // Frames 0, 5 and 6, and the last cannot be decoded; one slice of frame 12 is damaged.
    let mut bytes = whole.clone();
    for i in [0, 5, 6, count - 1] {
        bytes[places[i].clone()].fill(0xff);
    }
    bytes[places[12].end - 12] ^= 0x55;
    let path = desk.path().join("damaged.avi");
    std::fs::write(&path, bytes).unwrap();
    let mut reader = FrameReader::open(&path).unwrap();
    assert!(reader.parts()[0].damaged.is_empty(), "nothing is decoded yet");
    let values = |i: usize| frame(i).into_iter().map(f32::from).collect::<Vec<_>>();
    for i in 0..count {
        let read = reader.read(i).unwrap().into_raw_vec_and_offset().0;
        match i {
            // What stands in the place of frames that are not there.
            0 => assert_eq!(read, values(1)),
            5 | 6 => assert_eq!(read, values(4)),
            19 => assert_eq!(read, values(18)),
            12 => assert!(read != values(12), "a slice of it is damaged"),
            _ => assert_eq!(read, values(i), "{i}"),
        }
    }
    let damaged = &reader.parts()[0].damaged;
    assert_eq!(damaged.iter().map(|(i, _)| *i).collect::<Vec<_>>(), [0, 5, 6, 12, 19], "{damaged:?}");
    assert!(damaged[1].1.contains("cannot be decoded") && damaged[1].1.contains("frame before"), "{damaged:?}");
    assert!(damaged[3].1.contains("ffmpeg: slice CRC mismatch"), "{damaged:?}");
    // Read again and out of order, nothing is named twice.
    reader.read(12).unwrap();
    reader.read(5).unwrap();
    assert_eq!(reader.parts()[0].damaged.len(), 5);
    let mut reader = FrameReader::open(&desk.path().join("whole.avi")).unwrap();
    (0..count).for_each(|i| assert_eq!(reader.read(i).unwrap().into_raw_vec_and_offset().0, values(i)));
    assert!(reader.parts()[0].damaged.is_empty());
    // Frames that are decoded from a damaged one may be wrong, too, up to the next frame that is coded for itself.
    let coding = ["-c:v", "ffv1", "-level", "3", "-slices", "4", "-slicecrc", "1", "-g", "8", "groups.avi"];
    assert!(Command::new("ffmpeg").args(input).args(coding).current_dir(desk.path()).status().unwrap().success());
    let mut bytes = std::fs::read(desk.path().join("groups.avi")).unwrap();
    let place = frames_in(&bytes)[10].clone();
    bytes[place.end - 12] ^= 0x55;
    std::fs::write(desk.path().join("groups.avi"), bytes).unwrap();
    let mut reader = FrameReader::open(&desk.path().join("groups.avi")).unwrap();
    let wrong: Vec<usize> =
        (0..count).filter(|i| reader.read(*i).unwrap().into_raw_vec_and_offset().0 != values(*i)).collect();
    let damaged: Vec<usize> = reader.parts()[0].damaged.iter().map(|(i, _)| *i).collect();
    assert_eq!(damaged, (10..16).collect::<Vec<_>>());
    assert!(wrong.contains(&10) && wrong.iter().all(|i| damaged.contains(i)), "{wrong:?}");
}

/// What ffmpeg says of a file that it cannot read is one line, the same each time.
#[test]
fn a_video_that_ffmpeg_cannot_read_has_one_reason() {
    let desk = tempfile::tempdir().unwrap();
    std::fs::write(desk.path().join("raw"), (0..3).flat_map(frame).collect::<Vec<u8>>()).unwrap();
    let size = format!("{COLS}x{ROWS}");
    let input = ["-v", "error", "-f", "rawvideo", "-pix_fmt", "gray", "-s", &size, "-i", "raw"];
    let coding = ["-c:v", "ffv1", "-level", "3", "-slicecrc", "1", "whole.avi"];
    match Command::new("ffmpeg").args(input).args(coding).current_dir(desk.path()).status() {
        Ok(status) => assert!(status.success()),
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => {
            skip("a_video_that_ffmpeg_cannot_read_has_one_reason", "ffmpeg is not installed");
            return;
        }
        Err(e) => panic!("{e}"),
    }
    let whole = std::fs::read(desk.path().join("whole.avi")).unwrap();
    let read = |name: &str, bytes: &[u8]| {
        let path = desk.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        FrameReader::open(&path).unwrap_err().to_string()
    };
    let coded = |with: &[u8]| {
        let mut bytes = whole.clone();
        while let Some(at) = bytes.windows(4).position(|w| w == b"FFV1") {
            bytes[at..at + 4].copy_from_slice(with);
        }
        bytes
    };
    let unknown = read("unknown.avi", &coded(b"XYZW"));
    assert!(unknown.contains("ffmpeg does not know its coding, `XYZW`"), "{unknown}");
    // The header of the coding lies behind the 40 bytes that describe the frames.
    let mut bytes = whole.clone();
    let at = bytes.windows(4).position(|w| w == b"strf").unwrap() + 8 + 40;
    bytes[at..at + 16].fill(0xff);
    let [first, second] = [(); 2].map(|()| read("header.avi", &bytes));
    assert_eq!(first, second);
    assert!(
        !first.contains("0x") && !first.contains('\n') && !first.contains("()") && !first.contains(": )"),
        "{first}"
    );
    assert_eq!(first.matches("header.avi").count(), 1, "{first}");
}
