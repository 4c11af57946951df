//! Recordings as laboratories have them: a Miniscope folder with gaps, a torn frame and a short file, and numbered
//! TIFFs.
#![allow(clippy::unwrap_used)]

mod common;

use common::miniscope::{COLS, ROWS, avi, frame, json, miniscope, ommatidia};
use ndarray::Array2;
use ommatidia_session::{FrameWriter, Role, SampleType, Session, StackSpec, stack};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::Command;

#[test]
fn a_miniscope_folder_is_imported_with_all_that_is_wrong_in_it() {
    let desk = tempfile::tempdir().unwrap();
    miniscope(desk.path());
    let found = &json(desk.path(), "import Miniscope -o session")["recordings"][0];
    // 120 timestamps; 4 frames of 1.avi and the torn one are missing.
    assert_eq!((found["frames"].as_u64(), found["timestamps"].as_u64()), (Some(115), Some(120)), "{found:#}");
    assert_eq!(found["timestamps_unused"], 5);
    assert_eq!(found["torn"], serde_json::json!([{ "file": "3.avi", "frame": 29, "empty": false }]));
    assert_eq!(found["short"], serde_json::json!([["1.avi", 26, 30]]));
    assert_eq!(found["repeated"], serde_json::json!([10]));
    assert!(found["damaged"][0].as_str().unwrap().starts_with("3.avi: it ends within a frame"), "{found:#}");
    let gaps: Vec<[u64; 2]> = found["gaps"]
        .as_array()
        .unwrap()
        .iter()
        .map(|g| [g["after_frame"].as_u64().unwrap(), g["missing"].as_u64().unwrap()])
        .collect();
    // Frame 55 is the last of the short file; the frames behind it are four less than their rows.
    assert_eq!(gaps, [[40, 5], [55, 4], [66, 2]]);
    let rate = found["rate_hz"].as_f64().unwrap();
    assert!((rate - 1000.0 / 50.5).abs() < 0.05 && found["configured_rate_hz"] == 20.0, "{rate}");
    assert_eq!(found["device"], "Miniscope_V4_BNO");
    assert_eq!(found["missing_files"], serde_json::json!([]));
    assert!(!found["notes"].to_string().contains("table of timestamps"), "the table is whole: {found:#}");
    let session = Session::open(desk.path().join("session")).unwrap();
    let stack = session.need(Role::Scene).unwrap()[0];
    assert_eq!(stack.entry().file, "../Miniscope");
    assert_eq!((stack.len(), stack.info()[0].time_s, stack.info()[1].time_s), (115, -0.003, 0.047));
    let mut frames = stack.frames().unwrap();
    let values = |i: usize| frame(i).into_iter().map(f32::from).collect::<Vec<_>>();
    for (i, number) in [(0, 0), (55, 55), (56, 60), (114, 118)] {
        assert_eq!(frames.read(i).unwrap().into_raw_vec_and_offset().0, values(number), "{i}");
    }
    // A copy has the same frames, and needs the folder no longer.
    json(desk.path(), "import Miniscope -o copy --copy");
    std::fs::rename(desk.path().join("Miniscope"), desk.path().join("gone")).unwrap();
    let copied = stack::read(&desk.path().join("copy/scene.npy")).unwrap();
    assert_eq!(copied.dim(), (115, ROWS, COLS));
    let (code, _, text) = ommatidia(desk.path(), "inspect session");
    assert!(code == 1 && text.contains("Miniscope"), "{text}");
    assert!(desk.path().join("copy/scene.metaData.json").is_file() && desk.path().join("copy/import.json").is_file());
}

/// A crash of the recorder cuts the last line of its table, or leaves a block that was never written.
#[test]
fn a_table_that_ends_within_a_line_is_read_up_to_it() {
    let desk = tempfile::tempdir().unwrap();
    let table = miniscope(desk.path()).join("timeStamps.csv");
    let whole = std::fs::read(&table).unwrap();
    for (i, cut) in
        [whole[..whole.len() - 5].to_vec(), [&whole[..whole.len() - 3], &[0; 300]].concat()].iter().enumerate()
    {
        std::fs::write(&table, cut).unwrap();
        let found = &json(desk.path(), &format!("import Miniscope -o session{i}"))["recordings"][0];
        // The last row belongs to the torn frame.
        assert_eq!(
            (found["timestamps"].as_u64(), found["timestamps_unused"].as_u64()),
            (Some(119), Some(4)),
            "{found:#}"
        );
        let note = "ends within a line, which is left out: line 121";
        assert!(found["notes"].to_string().contains(note), "{found:#}");
    }
    // With a line within it that lacks a value the table cannot be read: the frames are, without their times.
    let text = String::from_utf8(whole).unwrap().replace("\r\n7,", "\r\n7\r\n7,");
    std::fs::write(&table, text).unwrap();
    let found = &json(desk.path(), "import Miniscope -o broken")["recordings"][0];
    assert!(found["warnings"].to_string().contains("line 9") && found["timestamps"].is_null(), "{found:#}");
}

/// Without its first file, each frame keeps its own time, and the file is named.
#[test]
fn a_missing_first_file_moves_no_times() {
    let desk = tempfile::tempdir().unwrap();
    let folder = miniscope(desk.path());
    let times = |session: &str| {
        json(desk.path(), &format!("import Miniscope -o {session}"));
        let session = Session::open(desk.path().join(session)).unwrap();
        session.need(Role::Scene).unwrap()[0].info().iter().map(|info| info.time_s).collect::<Vec<_>>()
    };
    let all = times("all");
    std::fs::remove_file(folder.join("0.avi")).unwrap();
    assert_eq!(times("without"), all[30..]);
    let found = &json(desk.path(), "import Miniscope -o again")["recordings"][0];
    assert_eq!(found["missing_files"], serde_json::json!([0]), "{found:#}");
    // The table of the session names the recorder's file and frame of each.
    let table = std::fs::read_to_string(desk.path().join("again/scene.csv")).unwrap();
    let column = |line: &str, name: &str| {
        let at = table.lines().next().unwrap().split(',').position(|n| n == name).unwrap();
        line.split(',').nth(at).unwrap().to_string()
    };
    let row = table.lines().nth(1 + 26).unwrap();
    assert_eq!([column(row, "recorded_in"), column(row, "recorded_frame")], ["2.avi", "0"]);
    // Files that another program counts from 1, with a row for each frame: nothing is missing.
    for (from, to) in [(1, 11), (2, 12), (3, 13)] {
        std::fs::rename(folder.join(format!("{from}.avi")), folder.join(format!("{to}.avi"))).unwrap();
    }
    for (from, to) in [(11, 1), (12, 2), (13, 3)] {
        std::fs::write(
            folder.join(format!("{to}.avi")),
            avi(&(30 * (from - 11)..30 * (from - 10)).collect::<Vec<_>>()),
        )
        .unwrap();
        std::fs::remove_file(folder.join(format!("{from}.avi"))).unwrap();
    }
    let rows: Vec<String> =
        std::fs::read_to_string(folder.join("timeStamps.csv")).unwrap().lines().map(Into::into).collect();
    std::fs::write(folder.join("timeStamps.csv"), rows[..91].join("\n")).unwrap();
    let found = &json(desk.path(), "import Miniscope -o from-one")["recordings"][0];
    assert_eq!((&found["missing_files"], &found["frames"]), (&serde_json::json!([]), &90.into()), "{found:#}");
}

/// A table tells of files that are missing at the end, of a last file that is short, and by the numbers of its rows of
/// rows that are missing.
#[test]
fn a_table_tells_what_is_missing_at_the_end_and_within_it() {
    let desk = tempfile::tempdir().unwrap();
    let folder = miniscope(desk.path());
    let table = folder.join("timeStamps.csv");
    let text = std::fs::read_to_string(&table).unwrap();
    let import = |name: &str| json(desk.path(), &format!("import Miniscope -o {name}"))["recordings"][0].clone();
    let times = |name: &str| {
        let session = Session::open(desk.path().join(name)).unwrap();
        session.need(Role::Scene).unwrap()[0].info().iter().map(|info| info.time_s).collect::<Vec<_>>()
    };
    import("whole");
    // Rows 10 to 14 are lost: the frames keep their times but for these.
    let rows: Vec<&str> = text.lines().collect();
    std::fs::write(&table, [&rows[..11], &rows[16..], &[""]].concat().join("\r\n")).unwrap();
    let found = import("fewer");
    assert_eq!((&found["times_interpolated"], &found["timestamps"]), (&5.into(), &115.into()), "{found:#}");
    let (whole, fewer) = (times("whole"), times("fewer"));
    for (i, (a, b)) in whole.iter().zip(&fewer).enumerate() {
        assert!((a - b).abs() < if (10..15).contains(&i) { 2e-3 } else { 1e-9 }, "{i}: {a} {b}");
    }
    let marked = std::fs::read_to_string(desk.path().join("fewer/scene.csv")).unwrap();
    assert_eq!(marked.matches("estimated").count(), 5);
    // The last file is gone, and the one before lacks its end.
    std::fs::write(&table, &text).unwrap();
    std::fs::remove_file(folder.join("3.avi")).unwrap();
    let found = import("shorter");
    assert_eq!(found["missing_files"], serde_json::json!([3]), "{found:#}");
    std::fs::write(&table, rows[..91].join("\n")).unwrap();
    std::fs::write(folder.join("2.avi"), avi(&(60..80).collect::<Vec<_>>())).unwrap();
    let found = import("short");
    assert_eq!(
        (&found["missing_files"], &found["short"][1]),
        (&serde_json::json!([]), &serde_json::json!(["2.avi", 20, 30]))
    );
    // Without timestamps the table of the session has the recorder's numbers, and times by the rate that was set.
    std::fs::remove_file(&table).unwrap();
    import("without");
    let session = std::fs::read_to_string(desk.path().join("without/scene.csv")).unwrap();
    assert!(session.contains("recorded_in") && session.matches("estimated").count() == 76, "{session}");
    assert_eq!(times("without")[30], 1.5);
}

/// What the recorder says beside the frames may be cut or strange: the frames are read all the same.
#[test]
fn broken_metadata_and_the_turns_of_a_head_stop_nothing() {
    let desk = tempfile::tempdir().unwrap();
    let folder = miniscope(desk.path());
    std::fs::write(folder.join("metaData.json"), "{\"frameRate\": 20, ").unwrap();
    let found = &json(desk.path(), "import Miniscope -o session")["recordings"][0];
    assert!(found["notes"].to_string().contains("metaData.json: is no JSON"), "{found:#}");
    // A table of how the head is turned holds no positions of beads.
    std::fs::remove_file(folder.join("timeStamps.csv")).unwrap();
    std::fs::write(folder.join("headOrientation.csv"), "Time Stamp (ms),qw,qx,qy,qz\n3,1,0,0,0\n").unwrap();
    let found = &json(desk.path(), "import Miniscope -o turned --exposure-ms 50")["recordings"][0];
    assert_eq!(found["role"], "scene", "{found:#}");
}

/// Recorders write 60 frames a second into the heads of their files, whatever was set.
#[test]
fn without_timestamps_the_rate_that_was_set_counts() {
    let desk = tempfile::tempdir().unwrap();
    let folder = miniscope(desk.path());
    std::fs::remove_file(folder.join("timeStamps.csv")).unwrap();
    for file in 0..4 {
        let path = folder.join(format!("{file}.avi"));
        let mut bytes = std::fs::read(&path).unwrap();
        let strh = bytes.windows(8).position(|w| w == b"vidsGREY").unwrap();
        bytes[strh + 24] = 60;
        std::fs::write(path, bytes).unwrap();
    }
    json(desk.path(), "import Miniscope -o session");
    let session = Session::open(desk.path().join("session")).unwrap();
    assert_eq!(session.need(Role::Scene).unwrap()[0].entry().exposure_ms, 50.0);
}

#[test]
fn a_folder_is_reconstructed_directly_in_one_run_in_parts_and_in_shares() {
    let desk = tempfile::tempdir().unwrap();
    miniscope(desk.path());
    json(desk.path(), "import Miniscope -o session");
    // Without beads the optics are the identity: `central` gives the frame above black.
    json(desk.path(), "calibrate session -o camera.instrument --gain 1 --read-noise 1");
    let with = "reconstruct Miniscope --with camera.instrument --method central";
    let whole = json(desk.path(), &format!("{with} -o whole.tif --times times.csv"));
    assert_eq!((whole["frames"].as_u64(), whole["gaps"].as_u64()), (Some(115), Some(3)));
    let warnings = whole["warnings"].to_string();
    assert!(warnings.contains("frame 29 is not whole") && warnings.contains("11 frames are missing in 3 gaps"));
    let times = std::fs::read_to_string(desk.path().join("times.csv")).unwrap();
    assert!(times.starts_with("frame,time_s\n0,-0.003\n1,0.047\n") && times.lines().count() == 116, "{times}");
    // Frames that are not evenly spaced state no interval.
    assert_eq!(whole["interval_s"], Value::Null);
    // In three shares, one of which is lost and one damaged, and then together.
    // Four parts: the first share has two of them.
    for (share, left) in [("1/3", 2), ("2/3", 1), ("3/3", 0)] {
        let made = json(desk.path(), &format!("{with} -o shared.tif --shard {share}"));
        assert_eq!(made["parts_missing"], serde_json::json!(left), "{made}");
    }
    let part = |k: usize| desk.path().join(format!("shared.tif.parts/part-{k:06}.npy"));
    std::fs::remove_file(part(0)).unwrap();
    std::fs::write(part(2), b"not whole").unwrap();
    let joined = json(desk.path(), &format!("{with} -o shared.tif --resume"));
    assert_eq!(joined["frames_made"], 64, "{joined}");
    let bytes = |name: &str| std::fs::read(desk.path().join(name)).unwrap();
    assert!(bytes("shared.tif") == bytes("whole.tif") && !desk.path().join("shared.tif.parts").exists());
    // Parts of another method are not mixed in.
    json(desk.path(), &format!("{with} -o other.npy --shard 1/2"));
    let other = "reconstruct Miniscope --with camera.instrument --method wiener -o other.npy --resume";
    let (code, _, text) = ommatidia(desk.path(), other);
    assert!(code == 1 && text.contains("another reconstruction"), "{text}");
    // The session that refers to the folder gives the same.
    json(desk.path(), "reconstruct session --with camera.instrument --method central -o session.npy");
    json(desk.path(), &format!("{with} -o whole.npy"));
    assert_eq!(bytes("session.npy"), bytes("whole.npy"));
    // No scheduler: `auto` says what it looked for.
    let (code, _, text) = ommatidia(desk.path(), &format!("{with} -o auto.npy --shard auto"));
    assert!(code == 2 && text.contains("SLURM_ARRAY_TASK_ID"), "{text}");
}

#[test]
fn zarr_holds_the_reconstruction() {
    let desk = tempfile::tempdir().unwrap();
    miniscope(desk.path());
    json(desk.path(), "import Miniscope -o session --pixel-um 2");
    json(desk.path(), "calibrate session -o camera.instrument --gain 1 --read-noise 1");
    let with = "reconstruct Miniscope --with camera.instrument --method central";
    json(desk.path(), &format!("{with} -o x.npy"));
    json(desk.path(), &format!("{with} -o x.zarr"));
    let npy = stack::read(&desk.path().join("x.npy")).unwrap();
    let values: Vec<u8> = npy.iter().take(64 * ROWS * COLS).flat_map(|v| v.to_le_bytes()).collect();
    assert!(std::fs::read(desk.path().join("x.zarr/0/c/0/0/0/0")).unwrap() == values);
    let group: Value =
        serde_json::from_str(&std::fs::read_to_string(desk.path().join("x.zarr/zarr.json")).unwrap()).unwrap();
    let image = &group["attributes"]["ome"]["multiscales"][0];
    assert_eq!(image["axes"][2], serde_json::json!({ "name": "y", "type": "space", "unit": "micrometer" }));
    assert_eq!(image["datasets"][0]["coordinateTransformations"][0]["scale"], serde_json::json!([1.0, 1.0, 2.0, 2.0]));
    assert!(stack::read(&desk.path().join("x.zarr")).unwrap() == npy);
    // A folder of something else is never replaced.
    std::fs::create_dir(desk.path().join("mine.zarr")).unwrap();
    std::fs::write(desk.path().join("mine.zarr/notes.txt"), "mine").unwrap();
    let (code, _, text) = ommatidia(desk.path(), &format!("{with} -o mine.zarr --force"));
    assert!(code == 1 && text.contains("never replaced"), "{text}");
}

#[test]
fn numbered_tiffs_with_positions_are_a_bead_scan() {
    let desk = tempfile::tempdir().unwrap();
    let folder = desk.path().join("beads");
    std::fs::create_dir(&folder).unwrap();
    let spec = StackSpec { frames: 1, rows: 9, cols: 9, samples: SampleType::U16, pixel_um: None };
    let write = |name: String, value: f32| {
        let mut writer = FrameWriter::create(&folder.join(name), spec).unwrap();
        writer.push(Array2::from_elem((9, 9), value).view()).unwrap();
        writer.finish().unwrap();
    };
    for i in 0..12 {
        write(format!("bead{i}_x{}um_y-2um.tif", i as f64 / 2.0 - 3.0), 100.0 * i as f32);
    }
    let found = json(desk.path(), "import beads -o session --exposure-ms 5");
    assert_eq!((&found["recordings"][0]["role"], &found["bit_depth"]), (&"bead".into(), &12.into()));
    let session = Session::open(desk.path().join("session")).unwrap();
    let stack = session.need(Role::Bead).unwrap()[0];
    // In the order of the numbers: bead2 before bead10.
    assert_eq!((stack.info()[10].x_um, stack.info()[10].y_um), (2.0, -2.0));
    assert_eq!(stack.frames().unwrap().read(10).unwrap()[(0, 0)], 1000.0);
    let (code, _, text) = ommatidia(desk.path(), "import beads -o other");
    assert!(code == 1 && text.contains("--exposure-ms"), "{text}");
    let (code, _, text) = ommatidia(desk.path(), "import dark=beads bead=Missing -o other --exposure-ms 5");
    assert!(code == 1 && text.contains("Missing") && !desk.path().join("other").exists(), "{text}");
}

#[test]
fn a_compressed_video_names_ffmpeg_where_it_is_missing() {
    let desk = tempfile::tempdir().unwrap();
    let mut bytes = avi(&[0, 1]);
    while let Some(at) = bytes.windows(4).position(|w| w == b"GREY") {
        bytes[at..at + 4].copy_from_slice(b"FFV1");
    }
    std::fs::write(desk.path().join("ffv1.avi"), bytes).unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_ommatidia"));
    let out = command.args(["inspect", "ffv1.avi"]).current_dir(desk.path()).env("PATH", "").output().unwrap();
    let text = String::from_utf8_lossy(&out.stderr);
    assert!(!out.status.success() && text.contains("install ffmpeg"), "{text}");
}

#[test]
fn mat_files_and_ome_zarr_become_sessions_by_reference_and_by_copy() {
    let desk = tempfile::tempdir().unwrap();
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("../session/tests/recordings");
    std::fs::copy(data.join("level5-compressed.mat"), desk.path().join("x.mat")).unwrap();
    let frame = |f: usize| Array2::from_shape_fn((24, 32), |(r, c)| (1000 * f + 37 * r + c) as f32);
    let (code, _, text) = ommatidia(desk.path(), "import x.mat -o session --exposure-ms 5");
    assert!(code == 1 && text.contains("Y (24 x 32 x 5, double), dark") && text.contains("--variable"), "{text}");
    let frames = |session: &str| Session::open(desk.path().join(session)).unwrap().stacks()[0].frames().unwrap();
    // Two arrays of one file: what names the array is kept in the session, and a copy needs none.
    for (name, copy) in [("session", ""), ("copied", "--copy")] {
        let found = json(desk.path(), &format!("import scene=x.mat -o {name} --variable Y --exposure-ms 5 {copy}"));
        assert_eq!((&found["recordings"][0]["frames"], &found["bit_depth"]), (&5.into(), &14.into()), "{found:#}");
        assert_eq!(frames(name).read(4).unwrap(), frame(4));
        assert_eq!(
            Session::open(desk.path().join(name)).unwrap().manifest().stacks[0].variable.is_some(),
            copy.is_empty()
        );
    }
    json(desk.path(), "import dark=x.mat -o dark --variable dark --exposure-ms 5");
    assert_eq!(frames("dark").read(1).unwrap(), frame(1).mapv(|v| v % 251.0));
    // The scales of an OME-Zarr are those of the session: 20 Hz, 2 um.
    let zarr = data.join("image-0.4.zarr");
    let found = json(desk.path(), &format!("import {} -o zarr", zarr.display()));
    assert_eq!(found["recordings"][0]["frames"], 5, "{found:#}");
    let session = Session::open(desk.path().join("zarr")).unwrap();
    assert_eq!((session.manifest().object.pixel_um, session.stacks()[0].info()[0].exposure_ms), (2.0, 50.0));
    assert_eq!(frames("zarr").read(3).unwrap(), frame(3));
    assert_eq!(json(desk.path(), &format!("inspect {}", zarr.display()))["frames"], 5);
    let (code, _, text) = ommatidia(desk.path(), "import zarr -o other --exposure-ms 5");
    assert!(code == 1 && !text.contains("panicked"), "{text}");
}

/// A V3 folder: two videos of the miniscope, one of the camera over the arena, and one table of timestamps for both.
/// `miniscope` is the number of the miniscope's camera in it; the arena's camera has three frames more.
fn miniscope_v3(at: &Path, miniscope: usize) -> PathBuf {
    let folder = at.join("V3");
    std::fs::create_dir_all(&folder).unwrap();
    std::fs::write(folder.join("msCam1.avi"), avi(&(0..10).collect::<Vec<_>>())).unwrap();
    std::fs::write(folder.join("msCam2.avi"), avi(&(10..16).collect::<Vec<_>>())).unwrap();
    std::fs::write(folder.join("behavCam1.avi"), avi(&(100..119).collect::<Vec<_>>())).unwrap();
    let mut table = String::from("camNum\tframeNum\tsysClock\tbuffer\r\n");
    for i in 0..19 {
        table += &format!("{}\t{}\t{}\t1\r\n", 1 - miniscope, i + 1, 40 * i);
        // The time of the first frame is that of an earlier recording.
        let ms = if i == 0 { 5_021_334 } else { 33 + 50 * i };
        if i < 16 {
            table += &format!("{miniscope}\t{}\t{ms}\t1\r\n", i + 1);
        }
    }
    std::fs::write(folder.join("timestamp.dat"), table).unwrap();
    folder
}

#[test]
fn of_a_v3_folder_the_miniscope_is_read_whichever_number_its_camera_has() {
    for camera in [0, 1] {
        let desk = tempfile::tempdir().unwrap();
        let folder = miniscope_v3(desk.path(), camera);
        let found = &json(desk.path(), "import V3 -o session")["recordings"][0];
        assert_eq!((found["frames"].as_u64(), found["timestamps"].as_u64()), (Some(16), Some(16)), "{found:#}");
        let notes = found["notes"].to_string();
        assert!(notes.contains("behavCam1.avi is a video of another camera and left out"), "{notes}");
        assert!(notes.contains(&format!("cameras 0 ({} rows)", if camera == 0 { 16 } else { 19 })), "{notes}");
        assert!(notes.contains(&format!("camera {camera} is taken: it alone has as many rows")), "{notes}");
        let session = Session::open(desk.path().join("session")).unwrap();
        let scenes = session.stacks_of(Role::Scene).next().unwrap();
        let times: Vec<f64> = scenes.info().iter().map(|info| info.time_s).collect();
        assert!(times.windows(2).all(|t| (t[1] - t[0] - 0.05).abs() < 1e-9), "{times:?}");
        let mut frames = scenes.frames().unwrap();
        let (last, expected) = (frames.read(15).unwrap(), frame(15));
        assert!(last.iter().zip(expected).all(|(v, e)| *v == f32::from(e)));
        // Where no camera has a row for each frame, that with the nearest number is taken, and is to be checked.
        std::fs::write(folder.join("msCam2.avi"), avi(&(10..15).collect::<Vec<_>>())).unwrap();
        let found = &json(desk.path(), "import V3 -o again")["recordings"][0];
        let notes = found["notes"].to_string();
        assert!(notes.contains(&format!("camera {camera} is taken: its 16 rows are nearest to the 15")), "{notes}");
        // Another recording in the folder is no video of the arena.
        std::fs::copy(folder.join("msCam1.avi"), folder.join("other1.avi")).unwrap();
        let (code, _, error) = ommatidia(desk.path(), "import V3 -o third");
        assert!(code != 0 && error.contains("put each recording into a folder of its own"), "{error}");
    }
}
