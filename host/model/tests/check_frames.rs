//! What `check` says of frames: constant ones, those without light, light that changes, and lines that do not
//! contradict each other.
#![allow(clippy::unwrap_used)]

use ndarray::{Array2, Axis};
use ommatidia_model::check::{Finding, SessionCheck, Severity, check};
use ommatidia_model::testing::Testbed;
use ommatidia_session::{Session, stack};
use std::path::Path;

/// The checks of a session that `spoil` changed after it was written.
fn checked(bed: &Testbed, spoil: impl Fn(&Path)) -> SessionCheck {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("session");
    Testbed { scenes: 0, ..bed.clone() }.write(&path);
    spoil(&path);
    check(&Session::open(&path).unwrap(), || ()).unwrap()
}

fn with(spoil: fn(usize, &mut Array2<f32>)) -> SessionCheck {
    checked(&Testbed { spoil, ..Testbed::new() }, |_| ())
}

fn of<'a>(found: &'a SessionCheck, topic: &str) -> Vec<&'a Finding> {
    found.findings.iter().filter(|f| f.topic == topic).collect()
}

/// Changes the lines of the bead table below its header.
fn rows(session: &Path, change: impl FnOnce(&mut Vec<String>)) {
    let file = session.join("bead.csv");
    let text = std::fs::read_to_string(&file).unwrap();
    let (head, rest) = text.split_once('\n').unwrap();
    let mut lines: Vec<String> = rest.lines().map(String::from).collect();
    change(&mut lines);
    std::fs::write(&file, format!("{head}\n{}\n", lines.join("\n"))).unwrap();
}

/// Cell `at` of a line.
fn cell(line: &str, at: usize) -> f64 {
    line.split(',').nth(at).unwrap().parse().unwrap()
}

/// A line with other cells, from the first one on.
fn with_cells(line: &str, cells: &[f64]) -> String {
    let new = cells.iter().map(f64::to_string);
    new.chain(line.split(',').skip(cells.len()).map(String::from)).collect::<Vec<_>>().join(",")
}

#[test]
fn frames_of_one_value_are_neither_scaled_nor_shifted() {
    for (value, spoil) in [(0, (|_, f| f.fill(0.0)) as fn(usize, &mut Array2<f32>)), (64, |_, f| f.fill(64.0))] {
        let found = with(spoil);
        let errors: Vec<&Finding> = found.at_least(Severity::Error).collect();
        let words = format!("all 81 frames: every pixel is {value} DN");
        assert!(errors.len() == 1 && errors[0].topic == "constant frames", "{errors:?}");
        assert!(errors[0].text.contains(&words) && errors[0].text.contains("recorded at all?"), "{errors:?}");
        assert!(of(&found, "bit depth").is_empty() && of(&found, "black level").is_empty(), "{:?}", found.findings);
        assert!(found.scan.is_none());
    }
}

#[test]
fn single_frames_of_one_value_are_named() {
    // Not among the 24 frames that are sampled for the figures.
    let found = with(|n, f| {
        if n == 8 {
            f.fill(0.0);
        }
    });
    let named = of(&found, "constant frames");
    assert!(named.len() == 1 && named[0].severity == Severity::Warning, "{named:?}");
    assert!(named[0].text.contains("bead.npy: frame 8: every pixel is 0 DN"), "{named:?}");
    assert_eq!(found.at_least(Severity::Warning).count(), 1, "{:?}", found.findings);
    assert!(of(&found, "orientation")[0].text.contains("80 bead frames"), "{:?}", found.findings);
}

#[test]
fn frames_without_light_are_named_and_not_counted_as_seen() {
    let found = with(|n, f| {
        if n == 30 {
            f.indexed_iter_mut().for_each(|((r, c), v)| *v = 64.0 + ((r * 7919 + c * 104_729) % 3) as f32);
        }
    });
    let light = of(&found, "light");
    assert!(light.len() == 1 && light[0].text.contains("1 bead frame shows less than 2 %"), "{:?}", found.findings);
    assert!(light[0].text.contains("frame 30"), "{light:?}");
    for topic in ["orientation", "array"] {
        assert!(of(&found, topic)[0].text.contains("80 bead frames"), "{:?}", found.findings);
    }
}

#[test]
fn nothing_is_well_where_something_is_wrong() {
    let wrong_row = |session: &Path| {
        rows(session, |lines| {
            let [x, y] = [cell(&lines[40], 1), cell(&lines[40], 2)];
            lines[40] = with_cells(&lines[40], &[40.0, x + 30.0, y + 20.0]);
        });
    };
    let found = checked(&Testbed::new(), wrong_row);
    let error = of(&found, "single positions");
    assert!(error.len() == 1 && error[0].severity == Severity::Error, "{:?}", found.findings);
    assert!(!error[0].text.contains("= -0,") && !error[0].text.contains("= -0 "), "{error:?}");
    let agrees = of(&found, "orientation");
    assert!(agrees.len() == 1 && agrees[0].severity == Severity::Fact, "{agrees:?}");
    assert!(agrees[0].text.contains("the foci of 80 of 81 bead frames"), "{agrees:?}");
    let none = checked(&Testbed { dark_frames: 0, flat_levels_e: Vec::new(), ..Testbed::new() }, |_| ());
    let counts = of(&none, "counts");
    assert!(counts.iter().all(|f| f.severity != Severity::Ok) && counts.len() == 3, "{counts:?}");
    assert!(counts[2].text.contains("0 darks, 0 flats, 81 beads"), "{counts:?}");
}

#[test]
fn vignetting_of_frames_in_any_order_is_no_drift_and_a_drift_is_one() {
    // Fainter towards the edge of the field, on all sides; the columns of the scan lie from the edges to the middle.
    let from_the_edge = |session: &Path| {
        let file = session.join("bead.npy");
        let mut order: Vec<usize> = (0..81).collect();
        rows(session, |lines| {
            let far = |n: &usize| cell(&lines[*n], 1).abs();
            order.sort_by(|a, b| far(b).total_cmp(&far(a)));
        });
        let mut frames = stack::read(&file).unwrap();
        rows(session, |lines| {
            let edge = lines.iter().map(|line| cell(line, 1).abs()).fold(0.0, f64::max);
            for (n, line) in lines.iter().enumerate() {
                let far2 = (cell(line, 1).powi(2) + cell(line, 2).powi(2)) / edge.powi(2);
                let dim = (1.0 - 0.25 * far2) as f32;
                frames.index_axis_mut(Axis(0), n).mapv_inplace(|v| (64.0 + (v - 64.0) * dim).round());
            }
            let sorted = order.iter().enumerate().map(|(i, n)| with_cells(&lines[*n], &[i as f64]));
            *lines = sorted.collect();
        });
        stack::write(&file, frames.select(Axis(0), &order).view()).unwrap();
    };
    let found = checked(&Testbed::new(), from_the_edge);
    assert!(of(&found, "drift").is_empty(), "{:?}", found.findings);
    let fading = with(|n, f| f.mapv_inplace(|v| (64.0 + (v - 64.0) * (1.0 - 0.3 * n as f32 / 80.0)).round()));
    let drift = of(&fading, "drift");
    assert!(drift.len() == 1 && drift[0].text.contains("changes by -2"), "{:?}", fading.findings);
}
