//! Recordings as Miniscope V4 writes them, with what goes wrong in laboratories.

use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Rows of a frame.
pub const ROWS: usize = 24;
/// Columns of a frame.
pub const COLS: usize = 32;

/// Runs the program in a folder; gives its exit code, standard output and standard error.
pub fn ommatidia(folder: &Path, words: &str) -> (i32, String, String) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_ommatidia"));
    command.args(words.split_whitespace()).current_dir(folder).env("NO_COLOR", "1").env_remove("RUST_LOG");
    // A test may itself run under a scheduler.
    for name in ["SLURM_ARRAY_TASK_ID", "SGE_TASK_ID", "PBS_ARRAY_INDEX", "JOB_COMPLETION_INDEX", "HQ_TASK_ID"] {
        command.env_remove(name);
    }
    let out = command.output().unwrap();
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    (out.status.code().unwrap(), text(&out.stdout), text(&out.stderr))
}

/// The JSON that the program prints, which must succeed.
pub fn json(folder: &Path, words: &str) -> Value {
    let (code, out, error) = ommatidia(folder, &format!("{words} --json"));
    assert_eq!(code, 0, "{words}: {error}");
    serde_json::from_str(&out).unwrap()
}

/// Frame `i` of a recording: a pattern that shows the number.
pub fn frame(i: usize) -> Vec<u8> {
    (0..ROWS * COLS).map(|p| (40 + (7 * i + p) % 97) as u8).collect()
}

fn chunk(id: &[u8; 4], data: &[u8]) -> Vec<u8> {
    let mut out = [&id[..], &(data.len() as u32).to_le_bytes(), data].concat();
    out.resize(out.len().next_multiple_of(2), 0);
    out
}

/// A grey AVI as Miniscope V4 writes it.
pub fn avi(frames: &[usize]) -> Vec<u8> {
    let mut strh = [&b"vidsGREY"[..], &[0; 48]].concat();
    strh[20] = 1;
    strh[24] = 20;
    let mut strf = [&40u32.to_le_bytes()[..], &(COLS as u32).to_le_bytes(), &(ROWS as u32).to_le_bytes()].concat();
    strf.extend([1, 0, 8, 0]);
    strf.extend(b"GREY");
    strf.resize(40, 0);
    let list = |kind: &[u8; 4], form: &[u8], inner: &[u8]| chunk(kind, &[form, inner].concat());
    let strl = list(b"LIST", b"strl", &[chunk(b"strh", &strh), chunk(b"strf", &strf)].concat());
    let hdrl = list(b"LIST", b"hdrl", &[chunk(b"avih", &[0; 56]), strl].concat());
    let data: Vec<u8> = frames.iter().flat_map(|i| chunk(b"00db", &frame(*i))).collect();
    let body = [hdrl, list(b"LIST", b"movi", &data), chunk(b"idx1", &[0; 32])].concat();
    list(b"RIFF", b"AVI ", &body)
}

/// A V4 folder of 4 files of 30 frames: 1.avi lacks its last 4 frames, 3.avi is torn in its last frame; the recorder
/// missed 5 frames after number 40 and 2 after number 70; frame 10 repeats frame 9. Gives the folder.
pub fn miniscope(at: &Path) -> PathBuf {
    let folder = at.join("Miniscope");
    std::fs::create_dir_all(&folder).unwrap();
    let shown = |i: usize| if i == 10 { 9 } else { i };
    for file in 0..4 {
        let last = if file == 1 { 56 } else { 30 * file + 30 };
        let mut bytes = avi(&(30 * file..last).map(shown).collect::<Vec<_>>());
        if file == 3 {
            // Cut in the middle of the last frame, as by a crash.
            let cut = bytes.len() - 40 - ROWS * COLS / 2;
            bytes.truncate(cut);
        }
        std::fs::write(folder.join(format!("{file}.avi")), bytes).unwrap();
    }
    let mut table = String::from("Frame Number,Time Stamp (ms),Buffer Index\r\n");
    let mut ms = -3;
    for i in 0..120 {
        table += &format!("{i},{ms},0\r\n");
        ms += 50 + i % 2 + if i == 40 { 5 * 50 } else { 0 } + if i == 70 { 2 * 50 } else { 0 };
    }
    std::fs::write(folder.join("timeStamps.csv"), table).unwrap();
    let metadata = r#"{"ROI": {"height": 24, "leftEdge": 0, "topEdge": 0, "width": 32}, "compression": "GREY",
        "deviceName": "Miniscope", "deviceType": "Miniscope_V4_BNO", "frameRate": "20FPS", "framesPerFile": 30,
        "gain": "Low", "led0": 15}"#;
    std::fs::write(folder.join("metaData.json"), metadata).unwrap();
    folder
}
