//! Sessions on disk: written, read back, and damaged in every way that the session format names.

#![allow(clippy::unwrap_used)]

use super::stack::{self, FrameReader, FrameWriter, SampleType, StackSpec};
use super::*;
use ndarray::{Array2, Array3, array};
use std::path::Path;

fn manifest() -> Manifest {
    Manifest {
        format: 1,
        name: "test".into(),
        sensor: SensorSpec { rows: 4, cols: 5, pixel_pitch_um: 2.0, bit_depth: 12 },
        array: ArrayGeometry::grid(1, 1, 0.0),
        optics: Optics { magnification: 0.5, psf_window_px: 3, wavelength_um: None },
        object: ObjectGrid { rows: 3, cols: 2, pixel_um: 4.0 },
        stacks: Vec::new(),
    }
}

fn entry(role: Role, file: &str) -> StackEntry {
    StackEntry::plain(role, file, 10.0)
}

fn ramp(frames: usize, rows: usize, cols: usize) -> Array3<f32> {
    Array3::from_shape_fn((frames, rows, cols), |(f, r, c)| (f * 1000 + r * 10 + c) as f32)
}

/// A session with a bead scan and a scene with truth.
fn write_session(dir: &Path) {
    let mut writer = SessionWriter::create(dir, &manifest(), Existing::Keep).unwrap();
    for (name, samples) in [("bead.npy", SampleType::U16), ("scene.tif", SampleType::F32)] {
        let spec = StackSpec { frames: 2, rows: 4, cols: 5, samples, pixel_um: Some(2.0) };
        let mut frames = writer.frames(name, spec).unwrap();
        ramp(2, 4, 5).outer_iter().for_each(|f| frames.push(f).unwrap());
        frames.finish().unwrap();
    }
    let spec = StackSpec { frames: 2, rows: 3, cols: 2, samples: SampleType::F32, pixel_um: None };
    let mut truth = writer.frames("truth.npy", spec).unwrap();
    ramp(2, 3, 2).outer_iter().for_each(|f| truth.push(f).unwrap());
    truth.finish().unwrap();
    let mut rows: Vec<FrameInfo> = (0..2).map(|i| FrameInfo::plain(i, 10.0)).collect();
    rows[1].x_um = -2.0;
    rows[1].other.insert("operator".into(), "kl".into());
    rows[0].other.insert("operator".into(), "mn".into());
    writer.table("bead.csv", &rows).unwrap();
    writer.add(StackEntry { table: Some("bead.csv".into()), ..entry(Role::Bead, "bead.npy") });
    writer.add(StackEntry { truth: Some("truth.npy".into()), ..entry(Role::Scene, "scene.tif") });
    writer.finish().unwrap();
}

/// Bytes of a .npy version 1.0 as the format's specification lays them down, written here by hand.
fn npy(descr: &str, order: &str, shape: &str, data: &[u8]) -> Vec<u8> {
    let mut header = format!("{{'descr': '{descr}', 'fortran_order': {order}, 'shape': {shape}, }}");
    header.push_str(&" ".repeat(63 - (10 + header.len()) % 64));
    header.push('\n');
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.bytes());
    bytes.extend(data);
    bytes
}

fn damaged(change: impl Fn(&Path)) -> String {
    let dir = tempfile::tempdir().unwrap();
    let session = dir.path().join("s");
    write_session(&session);
    change(&session);
    Session::open(&session).unwrap_err().to_string()
}

fn edit(path: &Path, from: &str, to: &str) {
    let text = std::fs::read_to_string(path).unwrap();
    assert!(text.contains(from), "{text}");
    std::fs::write(path, text.replace(from, to)).unwrap();
}

#[track_caller]
fn mentions(error: &str, parts: &[&str]) {
    for part in parts {
        assert!(error.contains(part), "`{part}` is missing in: {error}");
    }
}

#[test]
fn a_session_comes_back_as_it_was_written() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("s");
    write_session(&path);
    let session = Session::open(&path).unwrap();
    let bead = session.need(Role::Bead).unwrap()[0];
    assert_eq!(bead.info()[1].x_um, -2.0);
    assert_eq!(bead.info()[1].other["operator"], "kl");
    let scene = session.need(Role::Scene).unwrap()[0];
    for stack in [bead, scene] {
        let mut frames = stack.frames().unwrap();
        for (i, expected) in ramp(2, 4, 5).outer_iter().enumerate().rev() {
            assert_eq!(frames.read(i).unwrap(), expected);
        }
    }
    assert_eq!(scene.truth().unwrap().unwrap().read(1).unwrap(), ramp(2, 3, 2).index_axis(ndarray::Axis(0), 1));
    assert!(session.need(Role::Dark).unwrap_err().to_string().contains("role = \"dark\""));
    let leftovers: Vec<_> = std::fs::read_dir(dir.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
    assert_eq!(leftovers, ["s"], "temporary folders are gone");
}

#[test]
fn npy_of_each_type_and_byte_order_is_read() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.npy");
    let cases: [(&str, Vec<u8>); 5] = [
        ("|u1", vec![1, 200]),
        ("<u2", vec![1, 0, 200, 0]),
        (">u2", vec![0, 1, 0, 200]),
        ("<f4", [1.0f32, 200.0].iter().flat_map(|v| v.to_le_bytes()).collect()),
        (">f4", [1.0f32, 200.0].iter().flat_map(|v| v.to_be_bytes()).collect()),
    ];
    for (descr, data) in cases {
        std::fs::write(&path, npy(descr, "False", "(1, 1, 2)", &data)).unwrap();
        assert_eq!(FrameReader::open(&path).unwrap().read(0).unwrap(), array![[1.0f32, 200.0]], "{descr}");
    }
}

#[test]
fn damaged_npy_files_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.npy");
    let data = [0u8; 16];
    let cases = [
        (npy("<f8", "False", "(1, 1, 2)", &data), "sample type: expected uint8, uint16 or float32, found '<f8'"),
        (npy("<i2", "False", "(1, 4, 2)", &data), "sample type"),
        (npy("<u2", "True", "(1, 4, 2)", &data), "Fortran order"),
        (npy("<u2", "False", "(4, 2)", &data), "three axes"),
        (npy("<u2", "False", "(1, 4, 2)", &data[..15]), "expected 144 bytes, found 143"),
        (npy("<u2", "False", "(0, 4, 2)", &[]), "at least one frame"),
        (npy("<u2", "False", "(4294967296, 4294967296, 4294967296)", &data), "overflows"),
        (b"\x93NUMPY".to_vec(), "not a readable .npy"),
        (Vec::new(), "not a readable .npy"),
    ];
    for (bytes, message) in cases {
        std::fs::write(&path, bytes).unwrap();
        mentions(&FrameReader::open(&path).unwrap_err().to_string(), &["a.npy", message]);
    }
}

/// The XML of a written stack, taken apart by a parser that is not ours: pixel size and interval stand there once.
#[test]
fn the_ome_xml_of_a_stack_says_pixel_size_and_interval_once() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.tif");
    for (pixel_um, interval_s) in [(Some(2.8), Some(0.02)), (None, Some(0.5)), (Some(1.85), None), (None, None)] {
        let spec = StackSpec { frames: 3, rows: 2, cols: 4, samples: SampleType::F32, pixel_um };
        let mut writer = FrameWriter::create(&path, spec).unwrap().with_interval(interval_s);
        (0..3).for_each(|i| writer.push(Array2::from_elem((2, 4), i as f32).view()).unwrap());
        writer.finish().unwrap();
        let scale = FrameReader::open(&path).unwrap().scale();
        assert_eq!((scale.pixel_um, scale.interval_s), (pixel_um.map(|um| [um; 2]), interval_s));

        let mut decoder = tiff::decoder::Decoder::new(std::fs::File::open(&path).unwrap()).unwrap();
        let text = decoder.get_tag_ascii_string(tiff::tags::Tag::ImageDescription).unwrap();
        let tree = roxmltree::Document::parse(&text).unwrap();
        let namespace = "http://www.openmicroscopy.org/Schemas/OME/2016-06";
        let pixels: Vec<_> = tree.descendants().filter(|n| n.has_tag_name((namespace, "Pixels"))).collect();
        assert_eq!(pixels.len(), 1, "{text}");
        let number = |name| pixels[0].attribute(name).map(|v| v.parse::<f64>().unwrap());
        assert_eq!([number("PhysicalSizeX"), number("PhysicalSizeY")], [pixel_um; 2]);
        assert_eq!(number("TimeIncrement"), interval_s);
        let unit = |name| pixels[0].attribute(name);
        let micro = pixel_um.map(|_| "\u{b5}m");
        assert_eq!([unit("PhysicalSizeXUnit"), unit("PhysicalSizeYUnit")], [micro; 2]);
        assert_eq!(unit("TimeIncrementUnit"), interval_s.map(|_| "s"));
        assert_eq!(
            [unit("SizeT"), unit("SizeX"), unit("SizeY"), unit("SizeC"), unit("SizeZ")].map(Option::unwrap),
            ["3", "4", "2", "1", "1"]
        );
        for name in ["PhysicalSizeX=", "PhysicalSizeY=", "TimeIncrement=", "DeltaT", "Plane "] {
            let most = usize::from(name.ends_with('='));
            assert!(text.matches(name).count() <= most, "{name} in {text}");
        }
    }
}

#[test]
fn channels_are_not_taken_for_frames() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.tif");
    let write = |description: &str| {
        let mut encoder = tiff::encoder::TiffEncoder::new(std::fs::File::create(&path).unwrap()).unwrap();
        let mut image = encoder.new_image::<tiff::encoder::colortype::Gray8>(2, 2).unwrap();
        image.encoder().write_tag(tiff::tags::Tag::ImageDescription, description).unwrap();
        image.write_data(&[1, 2, 3, 4]).unwrap();
    };
    for (description, axis) in [
        (r#"<OME><Pixels SizeC="2" SizeT="3" SizeZ="1"/></OME>"#, "channels"),
        (r#"<OME><Pixels SizeC="1" SizeT="3" SizeZ="4"/></OME>"#, "focal planes"),
        ("ImageJ=1.53t\nimages=6\nchannels=2\nframes=3\n", "channels"),
        ("ImageJ=1.53t\nimages=6\nslices=2\nframes=3\n", "focal planes"),
    ] {
        write(description);
        mentions(&FrameReader::open(&path).unwrap_err().to_string(), &["a.tif", axis, "expected 1", "of its own"]);
    }
    for description in ["ImageJ=1.53t\nimages=1\nslices=1\n", r#"<OME><Pixels SizeC="1" SizeT="1"/></OME>"#, ""] {
        write(description);
        assert_eq!(FrameReader::open(&path).unwrap().read(0).unwrap()[[1, 1]], 4.0);
    }
}

#[test]
fn a_truncated_tif_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.tif");
    stack::write(&path, ramp(3, 40, 50).view()).unwrap();
    assert_eq!(stack::read(&path).unwrap(), ramp(3, 40, 50));
    let bytes = std::fs::read(&path).unwrap();
    for keep in [0, 3, 8, 100, bytes.len() / 2, bytes.len() - 1] {
        std::fs::write(&path, &bytes[..keep]).unwrap();
        let error = FrameReader::open(&path).and_then(|mut r| (0..3).try_for_each(|i| r.read(i).map(drop)));
        mentions(&error.unwrap_err().to_string(), &["a.tif"]);
    }
}

#[test]
fn numbers_that_are_none_are_refused_where_they_are_read() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.npy");
    let data: Vec<u8> = [1.0f32, f32::NAN].iter().flat_map(|v| v.to_le_bytes()).collect();
    std::fs::write(&path, npy("<f4", "False", "(1, 1, 2)", &data)).unwrap();
    let error = FrameReader::open(&path).unwrap().read(0).unwrap_err().to_string();
    mentions(&error, &["a.npy", "frame 0, pixel (0, 1)", "NaN"]);
}

#[test]
fn each_damage_to_a_session_has_its_error() {
    let toml = |from: &'static str, to: &'static str| damaged(move |s| edit(&s.join("session.toml"), from, to));
    let csv = |from: &'static str, to: &'static str| damaged(move |s| edit(&s.join("bead.csv"), from, to));
    mentions(&damaged(|s| std::fs::remove_file(s.join("bead.npy")).unwrap()), &["bead.npy", "nothing of that name"]);
    mentions(&damaged(|s| std::fs::remove_file(s.join("session.toml")).unwrap()), &["session.toml"]);
    mentions(&toml("format = 1", "format = 2"), &["format: expected 1, found 2"]);
    mentions(&toml("rows = 4", "rows = 7"), &["bead.npy", "[2, 7, 5]", "[2, 4, 5]"]);
    mentions(&toml("rows = 3", "rows = 9"), &["truth.npy", "[2, 9, 2]", "[2, 3, 2]"]);
    mentions(&toml("bit_depth", "bitdepth"), &["bitdepth", "line"]);
    mentions(&toml("pixel_pitch_um = 2.0", "pixel_pitch_um = nan"), &["sensor.pixel_pitch_um", "NaN"]);
    mentions(&toml("pixel_um = 4.0", "pixel_um = 5.0"), &["object.pixel_um", "4.0000"]);
    mentions(&toml("exposure_ms = 10.0", "exposure_ms = -1.0"), &["exposure_ms", "-1"]);
    mentions(&toml("psf_window_px = 3", "psf_window_px = 4"), &["psf_window_px", "odd"]);
    let nm = "psf_window_px = 3\nwavelength_um = 525";
    mentions(&toml("psf_window_px = 3", nm), &["optics.wavelength_um", "0.2 to 2 um", "525"]);
    mentions(&toml("table = \"bead.csv\"", ""), &["table of bead stack", "x_um"]);
    let truth = |lines: &'static str| toml("truth = \"truth.npy\"", lines);
    mentions(&truth("truth = \"truth.npy\"\ntruth_registration_px = -0.1"), &["truth_registration_px", "-0.1"]);
    mentions(&truth("truth_registration_px = 0.5"), &["truth_registration_px", "a stack with `truth`", "0.5"]);
    mentions(
        &truth("truth = \"truth.npy\"\ntruth_registration_per_frame = true"),
        &["truth_registration_per_frame", "above zero"],
    );
    mentions(&csv("x_um", "x"), &["bead.csv", "column `x_um`", "states no unit"]);
    mentions(&csv("x_um", "east"), &["bead.csv", "column `x_um`", "columns frame, east"]);
    mentions(&csv("x_um", "x_px"), &["bead.csv", "x and y in the same unit"]);
    mentions(&csv("\n1,-2", "\n1,-inf"), &["line 3, column `x_um`", "`-inf` in `1,-inf,"]);
    mentions(&csv("\n1,-2", "\n1,9.0"), &["column `x_um`, frame 1", "on the object grid", "found 9"]);
    mentions(&csv("\n1,-2", "\n0,-2"), &["each frame once"]);
    // The column, the value and the unit are those of the table.
    let renamed = |from: [&str; 2], rows: [&str; 2]| {
        let [head, rows] = [from.map(String::from), rows.map(String::from)];
        damaged(move |s| {
            let path = s.join("bead.csv");
            let text = std::fs::read_to_string(&path).unwrap();
            let names = text.lines().next().unwrap().replace("x_um", &head[0]).replace("y_um", &head[1]);
            let tail = |line: &str| line.split(',').skip(3).map(|cell| format!(",{cell}")).collect::<String>();
            let tails: Vec<String> = text.lines().skip(1).map(tail).collect();
            std::fs::write(&path, format!("{names}\n0,{}{}\n1,{}{}\n", rows[0], tails[0], rows[1], tails[1])).unwrap();
        })
    };
    let mm = renamed(["X (mm)", "Y (mm)"], ["0,0", "0.009,0"]);
    mentions(&mm, &["column `X (mm)`, frame 1", "to 0.004 mm", "found 0.009 mm"]);
    // The object has 3 rows and 2 columns.
    let one = renamed(["x_px", "y_px"], ["1,1", "2,3"]);
    mentions(&one, &["column `y_px`, frame 1", "-0.5 to 2.5 px", "found 3 px", "look counted from 1"]);
    let far = renamed(["x_px", "y_px"], ["0,0", "1,9"]);
    mentions(&far, &["column `y_px`, frame 1", "found 9 px", "enlarge [object]"]);
    let centre = renamed(["x_px", "y_px"], ["0,-9", "0,0"]);
    mentions(&centre, &["column `y_px`, frame 0", "-1.5 to 1.5 px", "found -9 px"]);
    mentions(&csv("\n1,-2", "\n5,-2"), &["frame 5"]);
    mentions(&csv(",10,", ",-10,"), &["column `exposure_ms`", "-10"]);
    mentions(
        &damaged(|s| truncate_last_line(&s.join("bead.csv"))),
        &["expected one row for each of 2 frames, found 1 rows"],
    );
}

fn truncate_last_line(path: &Path) {
    let text = std::fs::read_to_string(path).unwrap();
    std::fs::write(path, text.lines().take(2).map(|l| format!("{l}\n")).collect::<String>()).unwrap();
}

#[test]
fn a_negative_truth_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("s");
    write_session(&path);
    stack::write(&path.join("truth.npy"), (-ramp(2, 3, 2)).view()).unwrap();
    let session = Session::open(&path).unwrap();
    let error = session.stacks()[1].truth().unwrap().unwrap().read(0).unwrap_err().to_string();
    mentions(&error, &["truth.npy", "object 0, pixel (0, 1)", "-1"]);
}

#[test]
fn an_unfinished_stack_leaves_nothing_behind() {
    let dir = tempfile::tempdir().unwrap();
    for name in ["a.npy", "a.tif"] {
        let spec = StackSpec { frames: 2, rows: 2, cols: 2, samples: SampleType::U8, pixel_um: None };
        let mut writer = FrameWriter::create(&dir.path().join(name), spec).unwrap();
        writer.push(Array2::zeros((2, 2)).view()).unwrap();
        mentions(&writer.push(array![[0.0f32, 256.0], [0.0, 0.0]].view()).unwrap_err().to_string(), &["(0, 1)", "256"]);
        mentions(&writer.push(Array2::zeros((2, 3)).view()).unwrap_err().to_string(), &["2 x 3"]);
        mentions(&writer.finish().unwrap_err().to_string(), &["expected 2 frames, found 1"]);
    }
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);
}

#[test]
fn a_foreign_folder_is_never_replaced() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("s");
    write_session(&path);
    let again = |existing| SessionWriter::create(&path, &manifest(), existing).map(|w| w.finish());
    mentions(&again(Existing::Keep).unwrap_err().to_string(), &["already exists"]);
    mentions(&again(Existing::ReplaceIfHas("mark")).unwrap_err().to_string(), &["already exists"]);
    std::fs::write(path.join("mark"), "").unwrap();
    again(Existing::ReplaceIfHas("mark")).unwrap().unwrap();
    assert!(Session::open(&path).unwrap().stacks().is_empty());
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1, "the old folder is gone");
}

#[test]
fn tables_as_people_save_them_are_read_as_the_usual_one() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("s");
    write_session(&path);
    let table = path.join("bead.csv");
    let usual = std::fs::read_to_string(&table).unwrap();
    let bead = || {
        let session = Session::open(&path).unwrap();
        let stack = session.stacks_of(Role::Bead).next().unwrap();
        let at = |i: &FrameInfo| [i.frame as f64, i.x_um, i.y_um, i.z_um, i.exposure_ms];
        (stack.info().iter().map(at).collect::<Vec<_>>(), session.notes().join("; "))
    };
    let (expected, notes) = bead();
    assert!(notes.is_empty(), "{notes}");
    let hold = |text: String, words: &str| {
        std::fs::write(&table, &text).unwrap();
        let (found, notes) = bead();
        assert_eq!(found, expected, "{text}");
        assert!(notes.contains(words), "{notes}");
    };
    let decimal = usual.replace(',', ";").replace('.', ",");
    hold(usual.replace(',', ";"), "");
    hold(usual.replace(',', "\t"), "");
    hold(decimal.clone(), if usual.contains('.') { "decimal commas" } else { "" });
    hold(format!("\u{feff}sep=;\r\n{}", decimal.replace('\n', "\r\n")), "");
    hold(format!("# stage 2\n{usual}\n\n,,,,,,\n"), "");
    hold(usual.replacen("x_um", "X (um)", 1).replacen("y_um", "Stage_Y [µm]", 1), "`X (um)` as x_um");
    let rows = |change: &dyn Fn(&mut Vec<String>)| -> String {
        let change = |line: &str| {
            let mut cells: Vec<String> = line.split(',').map(String::from).collect();
            change(&mut cells);
            cells.join(",")
        };
        let (head, rest) = usual.split_once('\n').unwrap();
        format!("{head}\n{}\n", rest.lines().map(change).collect::<Vec<_>>().join("\n"))
    };
    let scaled = |factor: f64| {
        rows(&move |cells| {
            for cell in &mut cells[1..3] {
                *cell = (cell.parse::<f64>().unwrap() * factor).to_string();
            }
        })
    };
    let named = |text: String, unit: &str| {
        text.replacen("x_um", &format!("x_{unit}"), 1).replacen("y_um", &format!("y_{unit}"), 1)
    };
    hold(named(scaled(1e-3), "mm"), "(times 1000)");
    hold(named(scaled(0.25), "px"), "object pixels of 4 um, counted from the centre");
    hold(rows(&|cells| cells[0] = (cells[0].parse::<usize>().unwrap() + 1).to_string()), "numbered from 1");
    let wide: Vec<u8> = usual.encode_utf16().flat_map(u16::to_le_bytes).collect();
    std::fs::write(&table, [&[0xff, 0xfe][..], &wide].concat()).unwrap();
    assert_eq!(bead().0, expected);
}

#[test]
fn places_of_lenses_are_checked_and_kept() {
    let with = |rows: usize, cols: usize, places: &[[f64; 2]]| {
        let mut m = manifest();
        (m.sensor.rows, m.sensor.cols) = (50, 60);
        m.array = ArrayGeometry { lenses_px: Some(places.to_vec()), ..ArrayGeometry::grid(rows, cols, 20.0) };
        m
    };
    let places = [[10.0, 12.0], [10.0, 40.5], [30.0, 26.0]];
    let right = with(1, 3, &places);
    right.check(Path::new("session.toml")).unwrap();
    assert_eq!(right.array.places_px(&right.sensor), places);
    assert_eq!((right.array.words().as_str(), right.array.lens_name(2).as_str()), ("3 lenses", "3"));
    let text = toml::to_string(&right).unwrap();
    assert_eq!(Manifest::parse(Path::new("session"), &text).unwrap(), right);
    for (rows, cols, places, word) in [
        (1, 2, &places[..], "rows = 1 and cols = 3"),
        (1, 3, &[[10.0, 12.0], [10.0, 60.0], [30.0, 26.0]][..], "50 x 60"),
        (1, 3, &[[10.0, 12.0], [10.0, f64::NAN], [30.0, 26.0]][..], "50 x 60"),
        (1, 3, &[[10.0, 12.0], [10.0, 19.0], [30.0, 26.0]][..], "half of array.pitch_px"),
    ] {
        let error = with(rows, cols, places).check(Path::new("session.toml")).unwrap_err().to_string();
        assert!(error.contains("array.lenses_px") && error.contains(word), "{error}");
    }
    // A grid that is centred on the sensor.
    let grid = ArrayGeometry::grid(3, 3, 50.0);
    let places = grid.places_px(&SensorSpec { rows: 214, cols: 200, ..right.sensor });
    assert_eq!((places[4], places[2], grid.words().as_str()), ([106.5, 99.5], [56.5, 149.5], "3 x 3 lenses"));
    assert_eq!(grid.lens_name(5), "2, 3");
}

#[test]
fn a_folder_of_both_kinds_of_files_or_of_two_recordings_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let write = |name: &str| stack::write(&dir.path().join(name), ramp(1, 4, 5).view()).unwrap();
    ["f_0.tif", "f_1.tif", "f_10.tif", "f_2.tif"].iter().for_each(|name| write(name));
    let open = || FrameReader::open(dir.path());
    let numbers: Vec<_> = open().unwrap().parts().iter().map(|part| part.number).collect();
    assert_eq!(numbers, [0, 1, 2, 10].map(Some));
    std::fs::write(dir.path().join("preview.avi"), "").unwrap();
    mentions(
        &open().unwrap_err().to_string(),
        &["expected AVIs or TIFFs", "such as preview.avi, and TIFFs, such as f_0.tif"],
    );
    std::fs::remove_file(dir.path().join("preview.avi")).unwrap();
    write("background.tif");
    mentions(&open().unwrap_err().to_string(), &["found background.tif beside 4 files like f_0.tif"]);
    let avis = tempfile::tempdir().unwrap();
    ["a_1.avi", "b_0.avi"].iter().for_each(|name| std::fs::write(avis.path().join(name), "").unwrap());
    mentions(&FrameReader::open(avis.path()).unwrap_err().to_string(), &["found a_1.avi and b_0.avi; rename"]);
}

#[cfg(unix)]
#[test]
fn what_is_neither_file_nor_folder_is_refused_and_not_waited_for() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("pipe.tif");
    assert!(std::process::Command::new("mkfifo").arg(&path).status().unwrap().success());
    mentions(
        &FrameReader::open(&path).unwrap_err().to_string(),
        &["pipe.tif", "a file or a folder", "write the frames"],
    );
}
