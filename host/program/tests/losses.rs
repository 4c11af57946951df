//! What is lost of a recording, or put beside it, and what each verb says of it.
#![allow(clippy::unwrap_used)]

mod common;

use common::contents;
use common::miniscope::{COLS, ROWS, avi, frame, json, miniscope, ommatidia};
use ndarray::Array2;
use ommatidia_session::{FrameWriter, SampleType, Session, StackSpec};
use serde_json::Value;
use std::path::{Path, PathBuf};

/// A V4 folder of 3 files of 30 frames, whole, and an instrument for it: `camera`.
fn whole(at: &Path) -> PathBuf {
    let folder = at.join("Whole");
    std::fs::create_dir(&folder).unwrap();
    for file in 0..3 {
        std::fs::write(folder.join(format!("{file}.avi")), avi(&(30 * file..30 * file + 30).collect::<Vec<_>>()))
            .unwrap();
    }
    std::fs::write(folder.join("timeStamps.csv"), table("Frame Number,Time Stamp (ms),Buffer Index", 90)).unwrap();
    std::fs::write(folder.join("metaData.json"), r#"{"frameRate": 20, "framesPerFile": 30}"#).unwrap();
    json(at, "import Whole -o whole");
    json(at, "calibrate whole -o camera --gain 1 --read-noise 1");
    folder
}

fn table(head: &str, rows: usize) -> String {
    let rows = (0..rows).map(|i| format!("{i},{},0\n", 50 * i));
    std::iter::once(format!("{head}\n")).chain(rows).collect()
}

const WITH: &str = "--with camera --method central";

fn texts(list: &Value) -> Vec<String> {
    list.as_array().unwrap().iter().map(|text| text.as_str().unwrap().to_string()).collect()
}

/// The first file, the last file, and the end of the last: `reconstruct` and `check` say what `import` says.
#[test]
fn every_verb_names_the_same_losses() {
    let desk = tempfile::tempdir().unwrap();
    let recording = whole(desk.path());
    let keep = |name: &str| std::fs::read(recording.join(name)).unwrap();
    let files = ["0.avi", "1.avi", "2.avi"].map(keep);
    let short = avi(&(60..80).collect::<Vec<_>>());
    // The file that is lost or other, what is in it then, the number of lost frames, and how it is said.
    let cases = [
        ("first", 0, None, 30, "Whole: file 0 is missing"),
        ("last", 2, None, 30, "Whole: 30 frames are missing after the last"),
        ("end", 2, Some(&short[..]), 10, "Whole/2.avi: it is short: it has 20 whole frames, and should have 30"),
        ("middle", 1, Some(&b"no video"[..]), 30, "Whole: 30 frames are missing in 1 gap"),
    ];
    for (name, changed, content, lost, sentence) in cases {
        for (i, bytes) in files.iter().enumerate() {
            let path = recording.join(format!("{i}.avi"));
            match content {
                _ if i != changed => std::fs::write(path, bytes).unwrap(),
                Some(bytes) => std::fs::write(path, bytes).unwrap(),
                None => std::fs::remove_file(path).unwrap(),
            }
        }
        let imported = json(desk.path(), &format!("import Whole -o {name}"));
        let said = texts(&imported["warnings"]);
        assert!(said.iter().any(|text| text.starts_with(sentence)), "{name}: {said:#?}");
        assert!(said.iter().all(|text| text.matches("Whole").count() == 1), "{said:#?}");
        assert_eq!((&imported["lost"], &imported["recordings"][0]["lost"]), (&lost.into(), &lost.into()), "{name}");
        let folder = json(desk.path(), &format!("reconstruct Whole {WITH} -o {name}.npy"));
        let session = json(desk.path(), &format!("reconstruct {name} {WITH} -o {name}-session.npy"));
        for (verb, found) in [("folder", &folder), ("session", &session)] {
            assert_eq!(found["lost"], lost, "{name}, {verb}");
            // The paths of a session are relative to it.
            let again = texts(&found["warnings"]).into_iter().map(|text| text.replace(&format!("{name}/../"), ""));
            let again: Vec<String> = again.filter(|text| !text.contains("the output holds")).collect();
            assert_eq!(again, said, "{name}, {verb}");
        }
        let checked = json(desk.path(), &format!("check {name}"));
        let findings = checked["findings"].as_array().unwrap().iter().filter(|f| f["topic"] == "recording");
        assert_eq!(findings.count(), said.len(), "{checked:#}");
    }
}

#[test]
fn losses_are_warnings_and_strict_makes_them_an_exit_code() {
    let desk = tempfile::tempdir().unwrap();
    whole(desk.path());
    miniscope(desk.path());
    let (code, out, error) = ommatidia(desk.path(), "import Miniscope -o session");
    assert_eq!(code, 0);
    // 120 rows and the 7 frames that the recorder missed.
    assert!(out.lines().last().unwrap().contains("115 of 127 frames are used"), "{out}");
    assert!(error.contains("WARN Miniscope/3.avi: frame 29 is not whole, and is left out"), "{error}");
    assert!(error.contains("WARN Miniscope: 11 frames are missing in 3 gaps: 5 after frame 40"), "{error}");
    assert!(!out.contains("missing") && !out.contains("left out"), "{out}");
    let (code, out, error) = ommatidia(desk.path(), "import Miniscope -o strict --strict --json");
    let found: Value = serde_json::from_str(&out).unwrap();
    assert!(code == 3 && found["lost"] == 12 && !error.contains("error"), "{code} {error}");
    assert!(Session::open(desk.path().join("strict")).is_ok());
    let (code, out, _) = ommatidia(desk.path(), &format!("reconstruct Miniscope {WITH} -o strict.npy --strict"));
    assert!(
        code == 3 && out.contains("(115 of 127 frames,") && desk.path().join("strict.npy").is_file(),
        "{code} {out}"
    );
    // A whole recording, and an error, have their usual codes.
    let (code, out, error) = ommatidia(desk.path(), "import Whole -o again --strict");
    assert!(code == 0 && error.is_empty() && out.contains("(all 90 frames are used,"), "{code} {out} {error}");
    assert_eq!(ommatidia(desk.path(), &format!("reconstruct Whole {WITH} -o x.npy --strict")).0, 0);
    assert_eq!(ommatidia(desk.path(), "import Whole -o again --strict").0, 1);
    // `-q` leaves out warnings and notes, and keeps the result.
    let (_, out, error) = ommatidia(desk.path(), "import Miniscope -o quiet -q");
    assert!(error.is_empty() && !out.contains("note") && out.contains("115 of 127"), "{out} {error}");
    // Where the times are written, nobody needs to hear how.
    for (option, hint) in [("", true), (" --times t.csv", false)] {
        let command = format!("reconstruct Miniscope {WITH} -o t{hint}.npy{option}");
        let (_, _, error) = ommatidia(desk.path(), &command);
        assert!(error.contains("one after another") && error.contains("--times FILE") == hint, "{error}");
    }
}

/// An output among the files of a recording would count as a part of it from then on.
#[test]
fn no_output_lies_in_a_recording_that_is_read() {
    let desk = tempfile::tempdir().unwrap();
    let recording = whole(desk.path());
    let tifs = desk.path().join("tifs");
    std::fs::create_dir(&tifs).unwrap();
    for i in 0..2 {
        write(&tifs.join(format!("img_{i}.tif")), [1, ROWS, COLS], i as f32);
    }
    let before = contents(desk.path());
    for command in [
        format!("reconstruct Whole {WITH} -o Whole/3.avi"),
        format!("reconstruct Whole {WITH} -o Whole/objects.npy --shard 1/2"),
        format!("reconstruct Whole {WITH} -o x.npy --times Whole/times.csv"),
        format!("reconstruct whole {WITH} -o Whole/3.avi"),
        format!("reconstruct Whole/0.avi {WITH} -o Whole/objects.avi"),
        format!("reconstruct tifs {WITH} -o tifs/objects.tif"),
        "import Whole -o Whole/session".into(),
        "calibrate whole -o whole/../Whole/camera --force".into(),
    ] {
        let (code, _, error) = ommatidia(desk.path(), &command);
        assert!(code == 1 && error.contains("lies in the recording") && error.contains("another folder"), "{error}");
        assert!(contents(desk.path()) == before, "{command}");
    }
    // Beside the recording, and in the session that refers to it, an output harms nothing.
    json(desk.path(), &format!("reconstruct whole {WITH} -o whole/objects.tif"));
    json(desk.path(), &format!("reconstruct tifs/img_0.tif {WITH} -o object.tif"));
    assert!(recording.is_dir() && Session::open(desk.path().join("whole")).is_ok());
}

fn write(path: &Path, [frames, rows, cols]: [usize; 3], value: f32) {
    let spec = StackSpec { frames, rows, cols, samples: SampleType::U16, pixel_um: None };
    let mut writer = FrameWriter::create(path, spec).unwrap();
    (0..frames).for_each(|_| writer.push(Array2::from_elem((rows, cols), value).view()).unwrap());
    writer.finish().unwrap();
}

#[test]
fn a_number_that_two_files_have_is_an_error() {
    let desk = tempfile::tempdir().unwrap();
    let recording = whole(desk.path());
    std::fs::copy(recording.join("0.avi"), recording.join("00.avi")).unwrap();
    for command in ["import Whole -o new".into(), format!("reconstruct Whole {WITH} -o new.npy")] {
        let (code, _, error) = ommatidia(desk.path(), &command);
        assert!(code == 1 && error.contains("0.avi and 00.avi with the same number"), "{error}");
    }
}

/// A table of timestamps that cannot be read costs the times, and no frame; one with another usual name is understood.
#[test]
fn a_broken_table_of_timestamps_stops_nothing() {
    let desk = tempfile::tempdir().unwrap();
    let recording = whole(desk.path());
    let good = table("Frame Number,Time Stamp (ms),Buffer Index", 90);
    let cases = [
        ("", "found an empty table"),
        ("Frame Number,Clock,Buffer Index\n0,0,0\n", "column `Time Stamp (ms)`: expected"),
        (&good.replace("\n7,350,", "\n7,soon,"), "line 9, column `Time Stamp (ms)`"),
    ];
    for (i, (text, why)) in cases.into_iter().enumerate() {
        std::fs::write(recording.join("timeStamps.csv"), text).unwrap();
        let found = json(desk.path(), &format!("import Whole -o broken{i}"));
        assert_eq!((&found["frames"], &found["recordings"][0]["timestamps"]), (&90.into(), &Value::Null), "{found:#}");
        let made = json(desk.path(), &format!("reconstruct Whole {WITH} -o broken{i}.npy"));
        for warnings in [&found["warnings"], &made["warnings"]] {
            let said = texts(warnings);
            assert!(said.len() == 1 && said[0].contains("timeStamps.csv") && said[0].contains(why), "{said:?}");
        }
    }
    let names = ["Timestamp", "time_ms", "TIME STAMP [ms]", "timestamp (ms)", "Timestamps"];
    for (i, name) in names.into_iter().enumerate() {
        std::fs::write(recording.join("timeStamps.csv"), table(&format!("Frame Number,{name},Buffer Index"), 90))
            .unwrap();
        let found = json(desk.path(), &format!("import Whole -o named{i}"));
        assert_eq!((&found["recordings"][0]["rate_hz"], &found["warnings"]), (&20.0.into(), &serde_json::json!([])));
        let notes = found["recordings"][0]["notes"].to_string();
        assert_eq!(notes.contains("states no unit: milliseconds"), !name.contains("ms"), "{name}: {notes}");
    }
    let seconds: String = (0..90).map(|i| format!("{},0\n", i as f64 / 20.0)).collect();
    std::fs::write(recording.join("timeStamps.csv"), format!("Time,Buffer Index\n{seconds}")).unwrap();
    let rate = json(desk.path(), "import Whole -o seconds")["recordings"][0]["rate_hz"].as_f64().unwrap();
    assert!((rate - 20.0).abs() < 1e-9, "{rate}");
}

/// A folder of beads whose table is `positions`, in um.
fn beads(at: &Path, positions: &str) -> PathBuf {
    let folder = at.join("beads");
    std::fs::create_dir(&folder).unwrap();
    (0..3).for_each(|i| write(&folder.join(format!("b{i}.tif")), [1, 9, 9], 100.0 * i as f32));
    std::fs::write(folder.join("pos.csv"), positions).unwrap();
    folder
}

#[test]
fn a_failed_import_leaves_nothing_and_names_the_file_of_the_user() {
    let desk = tempfile::tempdir().unwrap();
    let folder = beads(desk.path(), "x_um,y_um\n0,0\n1,0\n200,0\n");
    let (code, _, error) = ommatidia(desk.path(), "import beads -o session --exposure-ms 5");
    assert!(
        code == 1 && error.contains("beads/pos.csv: column `x_um`, frame 2") && error.contains("--like"),
        "{error}"
    );
    assert!(!desk.path().join("session").exists());
    std::fs::write(folder.join("pos.csv"), "x_um,y_um\n0,0\n1,0\n2,0\n").unwrap();
    json(desk.path(), "import beads -o session --exposure-ms 5");
    // The same of positions in the names of the files.
    std::fs::remove_file(folder.join("pos.csv")).unwrap();
    for i in 0..3 {
        std::fs::rename(folder.join(format!("b{i}.tif")), folder.join(format!("b{i}_x{}_y0.tif", 2 * i))).unwrap();
    }
    let (code, _, error) = ommatidia(desk.path(), "import beads -o names --exposure-ms 5 --unit mm");
    assert!(code == 1 && error.contains("beads/b1_x2_y0.tif: position `x_um`") && error.contains("--unit"), "{error}");
    json(desk.path(), "import beads -o names --exposure-ms 5 --unit um");
}

#[test]
fn of_two_tables_of_positions_none_is_taken_silently() {
    let desk = tempfile::tempdir().unwrap();
    let positions = "x_um,y_um\n0,0\n1,0\n2,0\n";
    let folder = beads(desk.path(), positions);
    std::fs::write(folder.join("notes.csv"), positions).unwrap();
    let (code, _, error) = ommatidia(desk.path(), "import beads -o session --exposure-ms 5");
    assert!(code == 1 && error.contains("notes.csv and pos.csv") && error.contains("--positions"), "{error}");
    json(desk.path(), "import beads -o session --exposure-ms 5 --positions beads/pos.csv");
    // A table of something else is no second one.
    std::fs::write(folder.join("notes.csv"), "who,what\nme,beads\n").unwrap();
    let found = json(desk.path(), "import beads -o other --exposure-ms 5");
    assert_eq!(found["recordings"][0]["role"], "bead");
    assert!(found["recordings"][0]["notes"].to_string().contains("pos.csv"), "{found:#}");
}

/// Parts are gone on with where nothing changed, and only there.
#[test]
fn resume_mixes_no_recordings_and_remakes_damaged_parts() {
    let desk = tempfile::tempdir().unwrap();
    let recording = whole(desk.path());
    let with = format!("reconstruct Whole {WITH}");
    json(desk.path(), &format!("{with} -o whole.npy"));
    json(desk.path(), &format!("{with} -o x.npy --shard 1/2"));
    // A flipped bit in the values of a part that is otherwise whole.
    let part = desk.path().join("x.npy.parts/part-000000.npy");
    let mut bytes = std::fs::read(&part).unwrap();
    let at = bytes.len() - 6;
    bytes[at] ^= 1;
    std::fs::write(&part, bytes).unwrap();
    let made = json(desk.path(), &format!("{with} -o x.npy --resume"));
    assert_eq!(made["frames_made"], 64, "one part of 32, and that of the other share");
    let read = |name: &str| std::fs::read(desk.path().join(name)).unwrap();
    assert!(read("x.npy") == read("whole.npy"));
    // Another file of the same size in the midst of the recording: first and last frame are the same.
    json(desk.path(), &format!("{with} -o y.npy --shard 1/2"));
    std::fs::write(recording.join("1.avi"), avi(&(31..61).collect::<Vec<_>>())).unwrap();
    let (code, _, error) = ommatidia(desk.path(), &format!("{with} -o y.npy --resume"));
    assert!(code == 1 && error.contains("a file of frames that was changed"), "{error}");
    // What is refused before the first part leaves no folder of parts.
    let (code, _, _) = ommatidia(desk.path(), &format!("{with} -o z.mat --resume"));
    assert!(code == 1);
    let limited = format!("ulimit -f 8; exec {} {with} -o z.npy --resume", env!("CARGO_BIN_EXE_ommatidia"));
    let out = std::process::Command::new("sh").args(["-c", &limited]).current_dir(desk.path()).output().unwrap();
    let error = String::from_utf8_lossy(&out.stderr);
    assert!(out.status.code() == Some(1) && error.contains("ulimit -f") && error.contains("z.npy"), "{error}");
    let left: Vec<PathBuf> =
        contents(desk.path()).into_keys().filter(|path| path.to_string_lossy().contains("z.")).collect();
    assert!(left.is_empty(), "{left:?}");
}

/// Names decide what a file is read as, so that a wrong one is said; so is one that nothing is written as.
#[test]
fn wrong_names_of_files_are_said_with_the_names_that_are_right() {
    let desk = tempfile::tempdir().unwrap();
    let recording = whole(desk.path());
    write(&desk.path().join("x.tif"), [2, 9, 9], 1.0);
    for (from, to) in [("x.tif", "tif.avi"), ("x.tif", "tif"), ("x.tif", "x.h5")] {
        std::fs::copy(desk.path().join(from), desk.path().join(to)).unwrap();
    }
    std::fs::copy(recording.join("0.avi"), desk.path().join("avi.tif")).unwrap();
    std::fs::write(desk.path().join("y.h5"), b"\x89HDF\r\n\x1a\n").unwrap();
    std::fs::write(desk.path().join("y.mp4"), b"\0\0\0 ftypisom").unwrap();
    std::fs::write(desk.path().join("none.npy"), b"").unwrap();
    for (name, words) in [
        ("tif.avi", ["a TIFF named .avi", "ends in .tif"]),
        ("tif", ["a TIFF without a suffix", "ends in .tif"]),
        ("x.h5", ["a TIFF named .h5", "ends in .tif"]),
        ("avi.tif", ["an AVI named .tif", "ends in .avi"]),
        ("y.h5", ["found .h5", "convert the frames"]),
        ("y.mp4", ["found .mp4", "expected .npy, .tif, .tiff, .avi or .mat, or"]),
        ("none.npy", ["it ends too early", "copy it again"]),
    ] {
        let (code, _, error) = ommatidia(desk.path(), &format!("import {name} -o new --exposure-ms 5"));
        assert!(code == 1 && words.iter().all(|word| error.contains(word)), "{name}: {error}");
    }
    for name in ["z.png", "z.mat", "z"] {
        let (code, _, error) = ommatidia(desk.path(), &format!("reconstruct Whole {WITH} -o {name}"));
        let expected = "expected .npy, .tif, .tiff, .zarr, .avi or .mp4";
        assert!(code == 1 && error.contains(expected) && error.contains("choose a name"), "{error}");
    }
    let (code, _, error) = ommatidia(desk.path(), "import x.tif -o new --exposure-ms 5 --variable Y");
    assert!(code == 1 && error.contains("only .mat files"), "{error}");
    let (code, _, error) = ommatidia(desk.path(), "reconstruct Whole --with x.tif -o new.npy");
    assert!(code == 1 && error.contains("expected a checkpoint, a network file (blob) or an instrument"), "{error}");
    assert!(!error.contains("method"), "{error}");
    // A recording that was moved is missed by the session that names it.
    std::fs::rename(&recording, desk.path().join("Moved")).unwrap();
    let (code, _, error) = ommatidia(desk.path(), "check whole");
    assert!(code == 1 && error.contains("whole/session.toml: file of a scene stack: expected `../Whole`"), "{error}");
}

#[test]
fn raw_colours_are_said_to_be_colours() {
    let desk = tempfile::tempdir().unwrap();
    let mut bytes = avi(&[0, 1]);
    // As many bytes as grey, of a third of the columns.
    while let Some(at) = bytes.windows(4).position(|w| w == b"GREY") {
        bytes[at..at + 4].copy_from_slice(&[0; 4]);
    }
    let head = [(COLS as u32).to_le_bytes(), (ROWS as u32).to_le_bytes()].concat();
    let at = bytes.windows(8).position(|w| w == head).unwrap();
    bytes[at..at + 4].copy_from_slice(&(COLS as u32 / 4).to_le_bytes());
    bytes[at + 10] = 32;
    assert!(frame(0)[0] != frame(0)[1], "colours");
    std::fs::write(desk.path().join("colours.avi"), bytes).unwrap();
    let (code, _, error) = ommatidia(desk.path(), "import colours.avi -o new --exposure-ms 5");
    assert!(code == 1 && error.contains("levels of grey, found colours") && error.contains("ffmpeg -i"), "{error}");
    assert!(!error.contains("again"), "{error}");
}
