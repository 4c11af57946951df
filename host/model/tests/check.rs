//! Sessions of the virtual instrument with wrong tables, frames and manifests: each is named, and none is calibrated
//! without an error.
#![allow(clippy::unwrap_used)]

use ndarray::{Array3, Axis};
use ommatidia_bench::BenchConfig;
use ommatidia_model::calibrate::{CalibrateConfig, calibrate};
use ommatidia_model::check::{Severity, check};
use ommatidia_session::{Role, Session, stack};
use std::path::Path;
use std::sync::LazyLock;
use tempfile::TempDir;

/// The demo's instrument and scan.
static DEMO: LazyLock<TempDir> = LazyLock::new(|| measured(&BenchConfig::default(), 3));

/// Micrometres of the stage for one sensor pixel, by the manifest.
const UM_PER_PX: f64 = 1.85 / 0.660714;

fn measured(config: &BenchConfig, seed: u64) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let roles = [Role::Dark, Role::Flat, Role::Bead];
    config.build(&[]).unwrap().measure_some(&folder.path().join("session"), seed, &roles, |_| ()).unwrap();
    folder
}

/// A copy of a session, changed by `spoil`.
fn spoiled(original: &TempDir, spoil: &dyn Fn(&Path)) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let to = folder.path().join("session");
    std::fs::create_dir(&to).unwrap();
    for entry in std::fs::read_dir(original.path().join("session")).unwrap().map(Result::unwrap) {
        std::fs::copy(entry.path(), to.join(entry.file_name())).unwrap();
    }
    spoil(&to);
    folder
}

/// Changes all positions of the bead table at once: [y, x] um of each frame.
fn positions(session: &Path, change: impl Fn(Vec<[f64; 2]>) -> Vec<[f64; 2]>) {
    let file = session.join("bead.csv");
    let text = std::fs::read_to_string(&file).unwrap();
    let mut lines = text.lines();
    let names: Vec<&str> = lines.next().unwrap().split(',').collect();
    let column = |name: &str| names.iter().position(|n| *n == name).unwrap();
    let (x, y) = (column("x_um"), column("y_um"));
    let mut rows: Vec<Vec<String>> = lines.map(|l| l.split(',').map(str::to_string).collect()).collect();
    let number = |text: &String| text.parse::<f64>().unwrap();
    let new = change(rows.iter().map(|r| [number(&r[y]), number(&r[x])]).collect());
    for (row, [new_y, new_x]) in rows.iter_mut().zip(new) {
        (row[y], row[x]) = (new_y.to_string(), new_x.to_string());
    }
    let rows: Vec<String> = rows.iter().map(|r| r.join(",")).collect();
    std::fs::write(&file, format!("{}\n{}\n", names.join(","), rows.join("\n"))).unwrap();
}

fn frames(session: &Path, change: impl Fn(Array3<f32>) -> Array3<f32>) {
    let file = session.join("bead.npy");
    let frames = change(stack::read(&file).unwrap());
    stack::write(&file, frames.view()).unwrap();
}

/// The errors that the checks find.
fn errors(folder: &TempDir) -> Vec<String> {
    let found = check(&Session::open(folder.path().join("session")).unwrap(), || ()).unwrap();
    found.at_least(Severity::Error).map(|f| format!("{}: {}", f.topic, f.text)).collect()
}

/// The checks must find an error that holds all `words`, and the calibration must stop with it.
fn named(what: &str, folder: &TempDir, words: &[&str]) {
    let config = CalibrateConfig { replicates: 0, ..CalibrateConfig::default() };
    let error = calibrate(&Session::open(folder.path().join("session")).unwrap(), &config, || ());
    let error = error.map(|_| ()).expect_err(what).to_string();
    assert!(words.iter().all(|w| error.contains(w)), "{what}: {error}");
}

#[test]
fn sessions_that_are_right_pass_on_other_seeds_and_instruments() {
    let mut sessions = vec![measured(&BenchConfig::default(), 4)];
    for instrument_seed in [11, 12] {
        let mut config = BenchConfig { instrument_seed, ..BenchConfig::default() };
        (config.array.rows, config.array.cols) = (2, 2);
        (config.scan.rows, config.scan.cols) = (7, 9);
        sessions.push(measured(&config, 5));
    }
    for session in sessions {
        let found = check(&Session::open(session.path().join("session")).unwrap(), || ()).unwrap();
        let bad: Vec<_> = found.at_least(Severity::Warning).collect();
        assert!(bad.is_empty(), "{bad:#?}");
        let scan = found.scan.unwrap();
        assert!(scan.coincidence > 0.6 && scan.coincidence == scan.best_coincidence, "{}", scan.coincidence);
    }
}

/// A table whose positions run away from the frames: `drift_px(t)` sensor pixels [row, col], t from 0 to 1.
fn drifting(original: &TempDir, drift_px: impl Fn(f64) -> [f64; 2]) -> TempDir {
    spoiled(original, &|session| {
        // Room for positions beyond the edge of the object.
        manifest(session, "rows = 96\ncols = 96", "rows = 104\ncols = 104");
        positions(session, |all| {
            let last = (all.len() - 1) as f64;
            let at = |(i, p): (usize, [f64; 2])| {
                let by = drift_px(i as f64 / last);
                [0, 1].map(|a| p[a] - UM_PER_PX * by[a])
            };
            all.into_iter().enumerate().map(at).collect()
        });
    })
}

fn drift_of(folder: &TempDir) -> (ommatidia_model::check::Drift, Vec<String>) {
    let found = check(&Session::open(folder.path().join("session")).unwrap(), || ()).unwrap();
    let named = found.at_least(Severity::Warning).filter(|f| f.topic == "drift").map(|f| f.text.clone()).collect();
    (found.scan.unwrap().drift.unwrap(), named)
}

#[test]
fn a_drift_during_the_scan_is_named_with_its_size() {
    for (what, by, words) in [
        ("along the columns", [0.0, 1.2], "drift by 1.2"),
        ("along the rows, as a wrong magnification would", [0.6, 0.0], "drift by 0.6"),
        ("a little of both", [-0.25, 0.2], "drift by 0.3"),
    ] {
        let (drift, named) = drift_of(&drifting(&DEMO, |t| by.map(|v| v * t)));
        assert!(drift.seen && named.len() == 1 && named[0].contains(words), "{what}: {drift:?} {named:?}");
        for ((found, sigma), want) in drift.moved_px.iter().zip(drift.sigma_px).zip(by) {
            assert!((found - want).abs() < 4.0 * sigma + 0.05, "{what}: {drift:?}");
        }
    }
    // There and back again: nothing is left at the end.
    let (drift, named) = drift_of(&drifting(&DEMO, |t| [0.0, 3.0 * t * (1.0 - t)]));
    assert!(drift.seen && (drift.range_px - 0.75).abs() < 0.15, "{drift:?}");
    assert!(named[0].contains("wander by up to 0.7") || named[0].contains("wander by up to 0.8"), "{named:?}");
}

/// Distortion, placement errors and a wrong magnification are no drift: none of these instruments moved. The threshold
/// was chosen on instruments 120 to 125; these are others.
#[test]
fn no_drift_is_found_where_nothing_moved() {
    let mut worst = 0.0f64;
    for seed in 40..46 {
        for (lenses, scan) in [([3, 3], [9, 9]), ([2, 2], [7, 9]), ([1, 2], [7, 7]), ([1, 1], [9, 7])] {
            let mut config = BenchConfig { instrument_seed: 100 + seed, ..BenchConfig::default() };
            [config.array.rows, config.array.cols] = lenses;
            [config.scan.rows, config.scan.cols] = scan;
            config.optics.magnification_error = 0.003 * (seed as f64 - 42.5);
            let (drift, named) = drift_of(&measured(&config, seed));
            assert!(!drift.seen && named.is_empty(), "{seed}, {lenses:?}: {drift:?}");
            worst = worst.max(drift.range_px);
        }
    }
    eprintln!("largest drift where nothing moved: {worst:.3} px");
}

/// The session with other foci: behind each lens a spot of 1.3 px standard deviation at the position of the table,
/// displaced by `displaced_px(lens, [y, x])`; the corners of the object lie at -1 and 1.
fn with_foci(original: &TempDir, displaced_px: impl Fn(usize, [f64; 2]) -> [f64; 2]) -> TempDir {
    spoiled(original, &|session| {
        let opened = Session::open(session).unwrap();
        let (m, at) = (opened.manifest(), opened.stacks_of(Role::Bead).next().unwrap().info().to_vec());
        let px_per_um = m.optics.magnification / m.sensor.pixel_pitch_um;
        let edge_um = 0.5 * (m.object.rows - 1) as f64 * m.object.pixel_um;
        let middle = 0.5 * (m.sensor.rows - 1) as f64;
        frames(session, |mut all| {
            for (mut frame, info) in all.outer_iter_mut().zip(&at) {
                let h = [info.y_um, info.x_um].map(|um| um / edge_um);
                // Read noise of about a DN, without which nothing has a scatter.
                frame.indexed_iter_mut().for_each(|((r, c), v)| *v = 64.0 + ((r * 7919 + c * 104_729) % 5) as f32);
                for lens in 0..9 {
                    let by = displaced_px(lens, h);
                    let anchor = [lens / 3, lens % 3].map(|i| middle + m.array.pitch_px * (i as f64 - 1.0));
                    let y = anchor[0] + info.y_um * px_per_um + by[0];
                    let x = anchor[1] + info.x_um * px_per_um + by[1];
                    for ((r, c), v) in frame.indexed_iter_mut() {
                        let far = (r as f64 - y).powi(2) + (c as f64 - x).powi(2);
                        if far < 64.0 {
                            *v += (900.0 * (-far / 3.38).exp()).round() as f32;
                        }
                    }
                }
            }
            all
        });
    })
}

/// Foci that coma and distortion displace by up to 3.4 px at the corners, somewhat differently behind each lens, are
/// not those of wrong rows; wrong rows of 5.7 px in such a field are found, in its middle, at its edge and in its
/// corner.
#[test]
fn aberrations_of_the_field_are_no_wrong_rows_and_hide_none() {
    let strong = |lens: usize, [y, x]: [f64; 2]| {
        let far = (1.0 + 0.2 * (lens as f64).sin()) * 1.2 * (y * y + x * x);
        [y * far, x * far]
    };
    for (what, original, side, depths) in [("one depth", &DEMO, 13, 1), ("three depths", &DEEP, 7, 3)] {
        let right = with_foci(original, strong);
        assert_eq!(errors(&right), Vec::<String>::new(), "{what}");
        let of_middle = (depths / 2) * side * side;
        for n in [0, side - 1, side / 2, side * (side / 2) + side / 2] {
            let n = of_middle + n;
            let wrong = spoiled(&right, &|session| {
                positions(session, |mut t| {
                    t[n] = [t[n][0] + 4.0 * UM_PER_PX, t[n][1] + 4.0 * UM_PER_PX];
                    t
                });
                manifest(session, "rows = 96\ncols = 96", "rows = 112\ncols = 112");
            });
            let found = errors(&wrong);
            let named = format!("frame {n}:");
            assert!(found.len() == 1 && found[0].contains(&named), "{what}, {n}: {found:?}");
            assert_eq!(found[0].matches("the table says").count(), 1, "{what}, {n}: {found:?}");
        }
    }
}

/// Aberrations that stretch the images of the lenses along the rows, each by another factor, look like a drift in a
/// scan line by line; they are none, and a drift beyond them is seen.
#[test]
fn aberrations_that_differ_between_lenses_are_no_drift() {
    let stretch_px = [0.5, -0.3, 0.4, -0.1, 0.2, -0.4, 0.6, 0.3, -0.2];
    let still = with_foci(&DEMO, |lens, [y, _]| [stretch_px[lens] * y, 0.0]);
    let (drift, named) = drift_of(&still);
    assert!(!drift.seen && named.is_empty(), "{drift:?}");
    assert!(drift.range_px > 0.1 && drift.between_lenses_px > 0.5, "{drift:?}");
    let (drift, named) = drift_of(&drifting(&still, |t| [0.0, 1.2 * t]));
    assert!(drift.seen && named.len() == 1 && named[0].contains("drift by 1."), "{drift:?}");
}

#[test]
fn seven_wrong_orientations_are_named_and_the_right_one_passes() {
    for i in 0..8 {
        let (exchanged, mirror_y, mirror_x) = (i & 4 != 0, i & 1 != 0, i & 2 != 0);
        let sign = |mirrored: bool| if mirrored { -1.0 } else { 1.0 };
        let folder = spoiled(&DEMO, &|session| {
            positions(session, |all| {
                let turn = |[y, x]: [f64; 2]| {
                    let [y, x] = if exchanged { [x, y] } else { [y, x] };
                    [sign(mirror_y) * y, sign(mirror_x) * x]
                };
                all.into_iter().map(turn).collect()
            });
        });
        let axes = match (mirror_y, mirror_x) {
            (false, false) => "",
            (true, false) => "y of bead.csv looks mirrored",
            (false, true) => "x of bead.csv looks mirrored",
            (true, true) => "x and y of bead.csv look mirrored",
        };
        match (exchanged, axes) {
            (false, "") => assert!(errors(&folder).is_empty(), "{:?}", errors(&folder)),
            (false, axes) => named(axes, &folder, &["orientation", axes]),
            // Exchanged and mirrored in one axis is turned by 90 degrees: its inverse mirrors the other axis.
            (true, _) => named("exchanged", &folder, &["orientation", "x and y of bead.csv look exchanged"]),
        }
    }
}

#[test]
fn turned_frames_are_named() {
    type Turn = fn(Array3<f32>) -> Array3<f32>;
    let turns: [(Turn, &str); 4] = [
        (
            |f| {
                let mut f = f;
                f.invert_axis(Axis(1));
                f
            },
            "upside down",
        ),
        (
            |f| {
                let mut f = f;
                f.invert_axis(Axis(2));
                f
            },
            "left to right",
        ),
        (
            |f| {
                let mut f = f;
                f.invert_axis(Axis(1));
                f.invert_axis(Axis(2));
                f
            },
            "180 degrees",
        ),
        (|f| f.permuted_axes([0, 2, 1]), "look transposed"),
    ];
    for (turn, words) in turns {
        named(words, &spoiled(&DEMO, &|session| frames(session, turn)), &["orientation", words]);
    }
}

#[test]
fn ten_wrong_tables_are_named() {
    type Table = fn(Vec<[f64; 2]>) -> Vec<[f64; 2]>;
    let tables: [(&str, Table, &[&str]); 12] = [
        (
            "next",
            |mut t| {
                t.rotate_right(1);
                t
            },
            &["order", "shifted by one frame"],
        ),
        (
            "previous",
            |mut t| {
                t.rotate_left(1);
                t
            },
            &["order", "shifted by one frame"],
        ),
        ("reversed", |t| t.into_iter().rev().map(|p| [p[0] * 0.97 + 2.0, p[1]]).collect(), &["bead.csv look"]),
        (
            "to and fro",
            |mut t| {
                t.chunks_mut(13).skip(1).step_by(2).for_each(<[_]>::reverse);
                t
            },
            &["order", "every second line"],
        ),
        ("millimetres", |t| t.into_iter().map(|p| p.map(|v| v / 1e3)).collect(), &["units", "millimetres"]),
        ("pixels", |t| t.into_iter().map(|p| p.map(|v| v / 2.8)).collect(), &["units", "look like pixels"]),
        ("metres", |t| t.into_iter().map(|p| p.map(|v| v / 1e6)).collect(), &["units", "metres"]),
        ("half", |t| t.into_iter().map(|p| p.map(|v| v / 2.0)).collect(), &["units", "times as far"]),
        (
            "one",
            |mut t| {
                t[40] = [-t[40][0] + 30.0, t[40][1] + 60.0];
                t
            },
            &["single positions", "bead.npy: frame 40:"],
        ),
        (
            "swapped",
            |mut t| {
                t.swap(20, 97);
                t
            },
            &["single positions", "frame 20:", "frame 97:"],
        ),
        ("all zero", |t| vec![[0.0; 2]; t.len()], &["positions", "do not move as"]),
        ("mixed up", |t| (0..t.len()).map(|i| t[(i * 50 + 7) % t.len()]).collect(), &["positions", "do not move as"]),
    ];
    for (what, table, words) in tables {
        named(what, &spoiled(&DEMO, &|session| positions(session, table)), words);
    }
}

/// Changes numbers of the manifest.
fn manifest(session: &Path, from: &str, to: &str) {
    let file = session.join("session.toml");
    let text = std::fs::read_to_string(&file).unwrap();
    assert!(text.contains(from), "{from} in {text}");
    std::fs::write(&file, text.replacen(from, to, 1)).unwrap();
}

#[test]
fn wrong_arrays_are_named() {
    let mut config = BenchConfig::default();
    (config.array.rows, config.array.cols) = (2, 2);
    (config.scan.rows, config.scan.cols) = (7, 7);
    let two = measured(&config, 6);
    let three = spoiled(&two, &|s| {
        let file = s.join("session.toml");
        let text = std::fs::read_to_string(&file).unwrap();
        let (head, array) = text.split_once("[array]").unwrap();
        let array = array.replacen("rows = 2", "rows = 3", 1).replacen("cols = 2", "cols = 3", 1);
        std::fs::write(file, format!("{head}[array]{array}")).unwrap();
    });
    named("3 x 3 for 2 x 2", &three, &["array", "form 2 x 2 lenses", "declares 3 x 3"]);
    let half = spoiled(&two, &|s| manifest(s, "pitch_px = 50.0", "pitch_px = 25.0"));
    named("half the pitch", &half, &["array", "correct array.pitch_px"]);
    let twice = spoiled(&DEMO, &|s| manifest(s, "pitch_px = 50.0", "pitch_px = 100.0"));
    named("twice the pitch", &twice, &["array", "correct array.pitch_px"]);
}

#[test]
fn wrong_frames_are_named() {
    let dark = spoiled(&DEMO, &|s| frames(s, |f| f - 64.0));
    named("darks subtracted", &dark, &["black level", "subtracted already"]);
    // Flats of several levels in the place of the darks, and flats of one level.
    let swap = |s: &Path, of: &dyn Fn(Array3<f32>) -> Array3<f32>| {
        let [dark, flat] = ["dark.npy", "flat.npy"].map(|name| s.join(name));
        let n = stack::read(&dark).unwrap().len_of(Axis(0));
        let flats = of(stack::read(&flat).unwrap());
        let first: Vec<usize> = (0..n).map(|i| i % flats.len_of(Axis(0))).collect();
        stack::write(&dark, flats.select(Axis(0), &first).view()).unwrap();
    };
    named("flats as darks", &spoiled(&DEMO, &|s| swap(s, &|f| f)), &["black level", "light fell on them"]);
    let one = |f: Array3<f32>| f.select(Axis(0), &[0]);
    named("one flat as darks", &spoiled(&DEMO, &|s| swap(s, &one)), &["black level", "the darks are no darks"]);
    let shifted = spoiled(&DEMO, &|s| frames(s, |f| f * 16.0));
    named("shifted", &shifted, &["bit depth", "shifted left by 4 bits"]);
    let scaled = spoiled(&DEMO, &|s| frames(s, |f| f / 4095.0));
    named("scaled", &scaled, &["scale", "0..1"]);
    let flats = spoiled(&DEMO, &|s| {
        let file = s.join("flat.csv");
        let text = std::fs::read_to_string(&file).unwrap();
        let names: Vec<&str> = text.lines().next().unwrap().split(',').collect();
        let at = names.iter().position(|n| *n == "illumination").unwrap();
        let one = |l: &str| {
            let mut cells: Vec<&str> = l.split(',').collect();
            cells[at] = "1";
            cells.join(",")
        };
        let rows: Vec<String> = text.lines().skip(1).map(one).collect();
        std::fs::write(file, format!("{}\n{}\n", names.join(","), rows.join("\n"))).unwrap();
    });
    named("levels", &flats, &["flats", "several levels count as one", "illumination"]);
}

/// A scan of three depths, 7 x 7 positions each.
static DEEP: LazyLock<TempDir> = LazyLock::new(|| measured(&deep(vec![-20.0, 0.0, 20.0]), 8));

fn deep(depths_um: Vec<f64>) -> BenchConfig {
    let mut config = BenchConfig::default();
    (config.scan.rows, config.scan.cols, config.scan.depths_um) = (7, 7, depths_um);
    config
}

/// The findings about depths, and the depths that were judged.
fn depths(folder: &TempDir) -> (Vec<String>, Vec<f64>) {
    let found = check(&Session::open(folder.path().join("session")).unwrap(), || ()).unwrap();
    let named = found.findings.iter().filter(|f| f.topic == "depths").map(|f| f.text.clone()).collect();
    (named, found.scan.unwrap().depths_um)
}

#[test]
fn positions_are_judged_at_each_depth() {
    assert_eq!(errors(&DEEP), Vec::<String>::new());
    let (named, judged) = depths(&DEEP);
    assert_eq!(judged, [-20.0, 0.0, 20.0]);
    assert!(named.len() == 1 && named[0].contains("judged at z_um = -20, 0, 20"), "{named:?}");
    assert_eq!(depths(&DEMO).0, Vec::<String>::new());
    for depth in 0..3 {
        let of_depth = move |n: usize| n / 49 == depth;
        let wrong = spoiled(&DEEP, &|s| {
            positions(s, |mut at| {
                at.swap(49 * depth + 10, 49 * depth + 37);
                at
            })
        });
        let found = errors(&wrong);
        let rows = [10, 37].map(|n| format!("frame {}:", 49 * depth + n));
        assert!(found.len() == 1 && rows.iter().all(|row| found[0].contains(row)), "{depth}: {found:?}");
        let mirrored = spoiled(&DEEP, &|s| {
            positions(s, |at| {
                let turn = |(n, [y, x]): (usize, [f64; 2])| if of_depth(n) { [y, -x] } else { [y, x] };
                at.into_iter().enumerate().map(turn).collect()
            })
        });
        let found = errors(&mirrored);
        assert!(found.len() == 1 && found[0].contains("x of bead.csv looks mirrored"), "{depth}: {found:?}");
    }
    let all = spoiled(&DEEP, &|s| positions(s, |at| at.into_iter().map(|[y, x]| [y, -x]).collect()));
    assert_eq!(errors(&all).len(), 1, "{:?}", errors(&all));
}

#[test]
fn depths_without_enough_frames_are_said_to_be_unjudged() {
    let mut config = deep(vec![-20.0, 0.0]);
    (config.scan.rows, config.scan.cols) = (1, 3);
    let few = measured(&config, 9);
    let (named, judged) = depths(&few);
    assert_eq!(judged, Vec::<f64>::new());
    assert!(named.len() == 1 && named[0].contains("not judged at z_um = -20, 0"), "{named:?}");
}
