//! Imports of recordings as laboratories have them: names, tables and metadata that are not as they should be.

#![allow(clippy::unwrap_used)]

use super::*;
use crate::files::{Content, Files};
use crate::stack;
use ndarray::Array3;
use std::fs;

fn chunk(id: &[u8; 4], data: &[u8]) -> Vec<u8> {
    let mut out = [&id[..], &(data.len() as u32).to_le_bytes(), data].concat();
    out.resize(out.len().next_multiple_of(2), 0);
    out
}

/// A grey AVI of 4 x 6 pixels at 20 Hz.
fn avi(frames: usize) -> Vec<u8> {
    let mut strh = [&b"vidsGREY"[..], &[0; 48]].concat();
    (strh[20], strh[24]) = (1, 20);
    let mut strf = [40u32, 6, 4].iter().flat_map(|n| n.to_le_bytes()).collect::<Vec<u8>>();
    strf.extend([1, 0, 8, 0]);
    strf.extend(b"GREY");
    strf.resize(40, 0);
    let list = |kind: &[u8; 4], form: &[u8], inner: &[u8]| chunk(kind, &[form, inner].concat());
    let strl = list(b"LIST", b"strl", &[chunk(b"strh", &strh), chunk(b"strf", &strf)].concat());
    let hdrl = list(b"LIST", b"hdrl", &[chunk(b"avih", &[0; 56]), strl].concat());
    // Rows of 6 bytes are filled up to 8.
    let data: Vec<u8> = (0..frames).flat_map(|i| chunk(b"00db", &[i as u8 + 1; 32])).collect();
    let body = [hdrl, list(b"LIST", b"movi", &data), chunk(b"idx1", &[0; 32])].concat();
    list(b"RIFF", b"AVI ", &body)
}

/// A folder with these files.
fn folder(at: &Path, name: &str, files: &[(&str, &[u8])]) -> PathBuf {
    let folder = at.join(name);
    fs::create_dir(&folder).unwrap();
    files.iter().for_each(|(file, bytes)| fs::write(folder.join(file), bytes).unwrap());
    folder
}

/// A folder of TIFFs of 9 x 9 pixels and `pages` frames.
fn tiffs(at: &Path, name: &str, files: &[&str], pages: usize) -> PathBuf {
    let folder = folder(at, name, &[]);
    let frames = Array3::from_elem((pages, 9, 9), 7.0);
    files.iter().for_each(|file| stack::write(&folder.join(file), frames.view()).unwrap());
    folder
}

/// Imports a recording into the folder beside it that ends in `-session`.
fn imported(path: &Path, role: Option<Role>) -> Result<(Found, crate::Session), String> {
    let output = session_of(path);
    let request = ImportRequest {
        sources: &[Source { role, path: path.into() }],
        output: &output,
        like: None,
        pixel_um: None,
        exposure_ms: Some(5.0),
        bit_depth: None,
        positions: None,
        variable: None,
        unit: None,
        copy: false,
        replace: true,
    };
    let found = import(&request, || ()).map_err(|e| e.to_string())?;
    Ok((found[0].clone(), crate::Session::open(&output).unwrap()))
}

fn session_of(path: &Path) -> PathBuf {
    path.with_file_name(format!("{}-session", path.file_name().unwrap().to_string_lossy()))
}

/// Rows of a table of timestamps at 20 Hz.
fn rows(numbers: impl IntoIterator<Item = usize>) -> String {
    let row = |i: usize| format!("{i},{},1\n", 50 * i);
    format!("Frame Number,Time Stamp (ms),Buffer Index\n{}", numbers.into_iter().map(row).collect::<String>())
}

/// The times of the frames of one AVI of 20 frames, and what was found.
fn timed(table: &str) -> (Found, Vec<f64>) {
    let desk = tempfile::tempdir().unwrap();
    let path = folder(desk.path(), "rec", &[("0.avi", &avi(20)), ("TimeStamps.csv", table.as_bytes())]);
    let (found, session) = imported(&path, None).unwrap();
    let times = session.stacks()[0].info().iter().map(|info| info.time_s).collect();
    (found, times)
}

#[test]
fn rows_belong_to_the_frames_of_their_numbers() {
    let expected: Vec<f64> = (0..20).map(|i| f64::from(i) / 20.0).collect();
    let repeated = rows(0..20).replace("\n7,350,1\n", "\n7,350,1\n7,350,1\n");
    for (table, estimated, interpolated) in [
        (rows(0..20), 0, 0),
        (rows(5..20), 0, 5),
        (rows(1..20), 0, 1),
        (rows((0..17).filter(|i| *i != 9)), 3, 1),
        (repeated, 0, 0),
    ] {
        let (found, times) = timed(&table);
        assert_eq!(times, expected, "{table}");
        assert_eq!((found.times_estimated, found.times_interpolated), (estimated, interpolated), "{table}");
        assert_eq!((found.losses.lost, found.losses.any()), (0, false), "{table}");
    }
    // Counted from 1: the last is the number of frames.
    let (_, times) = timed(&rows(1..21));
    assert_eq!(times[0], 0.05);
    let (_, times) = timed(&rows((1..21).filter(|i| *i != 5)));
    assert_eq!((times[3], times[5], times[19]), (0.2, 0.3, 1.0));
}

#[test]
fn numbers_of_version_3_count_from_1() {
    let desk = tempfile::tempdir().unwrap();
    let row = |i: usize| format!("1\t{}\t{}\t1\n", i + 1, 50 * i);
    // The rows of frames 4 and 19 are missing.
    let table: String = (0..19).filter(|i| *i != 4).map(row).collect();
    let table = format!("camNum\tframeNum\tsysClock\tbuffer\n{table}");
    let files: [(&str, &[u8]); 2] = [("msCam1.avi", &avi(20)), ("timestamp.dat", table.as_bytes())];
    let (found, session) = imported(&folder(desk.path(), "V3", &files), None).unwrap();
    let times: Vec<f64> = session.stacks()[0].info().iter().map(|info| info.time_s).collect();
    assert_eq!(times, (0..20).map(|i| f64::from(i) / 20.0).collect::<Vec<_>>());
    assert_eq!((found.times_estimated, found.times_interpolated), (1, 1));
}

#[test]
fn a_table_of_few_rows_or_of_damaged_ones_gives_no_wrong_times() {
    let (found, _) = timed("Frame Number,Time Stamp (ms),Buffer Index\n");
    assert!(found.timestamps.is_none() && found.warnings[0].contains("only its header"), "{found:?}");
    let (found, times) = timed(&rows(0..1));
    assert_eq!((found.times_estimated, times[19]), (19, 0.95));
    assert!(found.text().contains("none by the timestamps") || found.configured_rate_hz.is_none());
    let (found, _) = timed(&rows(0..20).replace(",350,", ",1e300,"));
    assert!(found.timestamps.is_none() && found.warnings[0].contains("1e300"), "{found:?}");
    let (found, _) = timed(&rows(0..20).replace(",950,", ",1e19,"));
    assert_eq!(found.losses.gaps[0].missing, u32::MAX as usize - 1);
    let back: String = (0..20).map(|i| format!("{i},{}\n", if i < 10 { 50 * i } else { 50 * i - 5000 })).collect();
    let (found, _) = timed(&format!("Frame Number,Time Stamp (ms)\n{back}"));
    assert!((found.rate_hz.unwrap() - 20.0).abs() < 1e-9 && found.losses.backwards == [10], "{found:?}");
}

#[test]
fn the_unit_that_gives_the_rate_of_the_recorder_is_taken() {
    for (unit, factor, doubt) in [
        ("seconds", 0.05, false),
        ("milliseconds", 50.0, false),
        ("microseconds", 5e4, true),
        ("nanoseconds", 5e7, true),
        // Not nearly the rate that was set.
        ("milliseconds", 400.0, true),
    ] {
        let table: String = (0..20).map(|i| format!("{i},{}\n", f64::from(i) * factor)).collect();
        let (found, _) = timed(&format!("Frame Number,Timestamp\n{table}"));
        let said = if doubt { &found.warnings } else { &found.notes };
        assert!(said.iter().any(|text| text.contains(&format!("no unit: {unit} are taken"))), "{found:?}");
        assert_eq!(found.warnings.is_empty(), !doubt, "{found:?}");
    }
}

#[test]
fn files_that_are_missing_are_those_of_a_recorder_that_counts() {
    let desk = tempfile::tempdir().unwrap();
    let v4: (&str, &[u8]) = ("metaData.json", b"{\"framesPerFile\": 10.0}");
    let (full, last) = (avi(10), avi(7));
    for (i, (files, missing)) in [
        (&[("1.avi", &full[..]), ("2.avi", &last), v4][..], &[0][..]),
        (&[("1.avi", &full), ("2.avi", &last)], &[]),
        (&[("mouse3_day5.avi", &last)], &[]),
        (&[("20261120.avi", &full), ("20261123.avi", &last)], &[]),
        (&[("18446744073709551615.avi", &full)], &[]),
        (&[("0.avi", &full), ("2.avi", &last)], &[1]),
    ]
    .into_iter()
    .enumerate()
    {
        let (found, _) = imported(&folder(desk.path(), &i.to_string(), files), None).unwrap();
        assert_eq!(found.losses.missing_files, missing, "{files:?}");
        assert_eq!(found.losses.lost, 10 * missing.len());
    }
}

#[test]
fn metadata_are_read_in_any_encoding_and_what_is_not_used_is_said() {
    let wide = |text: &str| [0xff, 0xfe].into_iter().chain(text.encode_utf16().flat_map(u16::to_le_bytes)).collect();
    let desk = tempfile::tempdir().unwrap();
    for (i, (bytes, rate, said)) in [
        (b"{\"deviceName\": \"M\xfcller\", \"frameRate\": \"FPS30\"}".to_vec(), Some(30.0), ""),
        (wide("{\"frameRate\": \"30 Hz\"}"), Some(30.0), ""),
        (b"\xef\xbb\xbf{\"frameRate\": 30.0}".to_vec(), Some(30.0), ""),
        (b"{\"frameRate\": \"fast\"}".to_vec(), None, "frameRate \"fast\""),
        (b"{\"framesPerFile\": 10.5}".to_vec(), None, "framesPerFile 10.5"),
    ]
    .into_iter()
    .enumerate()
    {
        let path = folder(desk.path(), &i.to_string(), &[("0.avi", &avi(3)), ("metaData.json", &bytes)]);
        let (found, _) = imported(&path, None).unwrap();
        assert_eq!(found.configured_rate_hz, rate, "{found:?}");
        assert!(found.warnings.join("|").contains(said), "{found:?}");
        assert_eq!(found.warnings.is_empty(), said.is_empty(), "{found:?}");
    }
}

#[test]
fn rows_of_positions_belong_to_the_files_that_they_name() {
    let desk = tempfile::tempdir().unwrap();
    let names: Vec<String> = (0..4).map(|i| format!("bead_{i}.tif")).collect();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    for (i, (column, of)) in [
        ("File Name", "bead_{}.tif"),
        ("image_name", "bead_{}"),
        ("path", "scans/day 1/bead_{}.tif"),
        ("file", "C:\\data\\BEAD_{}.TIF"),
        ("what I saved", "bead_{}.tif"),
    ]
    .into_iter()
    .enumerate()
    {
        let path = tiffs(desk.path(), &i.to_string(), &names, 1);
        let row = |bead: usize| format!("{},{},0,um\n", of.replace("{}", &bead.to_string()), bead as f64 - 2.0);
        let table = format!("{column},x_um,y_um,unit\n{}", [3, 1, 0, 2].map(row).concat());
        fs::write(path.join("table.csv"), table).unwrap();
        let (found, session) = imported(&path, None).unwrap();
        let x: Vec<f64> = session.stacks()[0].info().iter().map(|info| info.x_um).collect();
        assert_eq!(x, [-2.0, -1.0, 0.0, 1.0], "{column}: a column `unit` of the user is no mark of pixels");
        assert!(found.notes.iter().any(|note| note.contains(&format!("column `{column}` says which file"))));
        assert!(session.stacks()[0].info().iter().all(|info| info.exposure_ms == 5.0), "as it is stated");
    }
    // Numbers alone may count anything; a file that is not there is an error.
    let path = tiffs(desk.path(), "numbers", &["0.tif", "1.tif"], 1);
    fs::write(path.join("table.csv"), "order,x_um,y_um\n1,-1,0\n0,1,0\n").unwrap();
    assert_eq!(imported(&path, None).unwrap().1.stacks()[0].info()[0].x_um, -1.0);
    fs::write(path.join("table.csv"), "file,x_um,y_um\n1.tif,-1,0\n7.tif,1,0\n").unwrap();
    assert!(imported(&path, None).unwrap_err().contains("7.tif"));
    // Two frames a file.
    let path = tiffs(desk.path(), "pages", &["b0.tif", "b1.tif"], 2);
    fs::write(path.join("table.csv"), "file,x_um,y_um\nb1,-1,0\nb0,1,0\nb1,2,0\nb0,-2,0\n").unwrap();
    let x: Vec<f64> = imported(&path, None).unwrap().1.stacks()[0].info().iter().map(|info| info.x_um).collect();
    assert_eq!(x, [1.0, -2.0, -1.0, 2.0]);
}

#[test]
fn positions_that_are_not_taken_are_said() {
    let desk = tempfile::tempdir().unwrap();
    let path = tiffs(desk.path(), "pages", &["x1um_y2um_1.tif", "x2um_y2um_2.tif"], 3);
    let (found, _) = imported(&path, None).unwrap();
    assert!(found.role == "scene" && found.warnings[0].contains("look like positions"), "{found:?}");
    assert!(imported(&path, Some(Role::Bead)).unwrap_err().contains("files of several frames"));
    // A table of something else beside scenes.
    let path = folder(desk.path(), "scenes", &[("0.avi", &avi(3)), ("notes.csv", b"frame,drug\n0,a\n1,a\n2,b\n")]);
    assert!(imported(&path, None).unwrap_err().contains("scene="));
    assert_eq!(imported(&path, Some(Role::Scene)).unwrap().0.frames, 3);
}

#[test]
fn only_what_an_import_wrote_is_replaced() {
    let desk = tempfile::tempdir().unwrap();
    let table = rows(0..3);
    let files: [(&str, &[u8]); 3] =
        [("0.avi", &avi(3)), ("timeStamps.csv", table.as_bytes()), ("metaData.json", b"{\"frameRate\": 20}")];
    let path = folder(desk.path(), "rec", &files);
    let session = session_of(&path);
    let (found, _) = imported(&path, None).unwrap();
    let written: Vec<&str> = found.written.iter().map(|file| file.name.as_str()).collect();
    assert_eq!(written, ["scene.csv", "scene.metaData.json", "session.toml"]);
    let held = || Files::default().writing([&session], Content::Imported).hold(true).map(drop);
    let refused = |found: &str| {
        let error = held().unwrap_err().to_string();
        assert!(error.contains(found) && error.contains("never replaced"), "{error}");
    };
    held().unwrap();
    for name in ["scene_mine.npy", "bead.csv"] {
        fs::write(session.join(name), "mine").unwrap();
        refused(name);
        fs::remove_file(session.join(name)).unwrap();
    }
    for name in ["session.toml", "scene.csv"] {
        let bytes = fs::read(session.join(name)).unwrap();
        fs::write(session.join(name), [&bytes[..], b"\n"].concat()).unwrap();
        refused(&format!("{name} (changed since)"));
        fs::write(session.join(name), bytes).unwrap();
    }
    held().unwrap();
    // As an earlier version wrote it.
    fs::write(session.join(REPORT), r#"[{"file": "../rec", "frames": 3}]"#).unwrap();
    refused("does not list");
    fs::remove_file(session.join(REPORT)).unwrap();
    refused("scene.csv, ");
}
