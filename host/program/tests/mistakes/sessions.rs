//! Sessions that are wrong: tables, axes, arrays and frames.

use crate::{Mistake, hold};
use ndarray::{Array3, Axis};
use ommatidia_session::stack;
use std::path::Path;

const CALIBRATE: &str = "calibrate session -o other";
const CHECK: &str = "check session";

/// Changes the text of a file of the session.
fn text(name: &'static str, change: impl Fn(String) -> String + Sync + 'static) -> impl Fn(&Path) + Sync + 'static {
    move |desk| {
        let file = desk.join("session").join(name);
        let before = std::fs::read_to_string(&file).unwrap();
        let after = change(before.clone());
        assert_ne!(before, after, "{name} did not change");
        std::fs::write(&file, after).unwrap();
    }
}

/// Changes the positions of the bead table: [y, x] um of all rows.
fn positions(change: impl Fn(&mut Vec<[f64; 2]>) + Sync + 'static) -> impl Fn(&Path) + Sync + 'static {
    text("bead.csv", move |table| {
        let mut lines = table.lines();
        let names: Vec<&str> = lines.next().unwrap().split(',').collect();
        let [y, x] = ["y_um", "x_um"].map(|name| names.iter().position(|n| *n == name).unwrap());
        let mut rows: Vec<Vec<String>> = lines.map(|l| l.split(',').map(str::to_string).collect()).collect();
        let mut all = rows.iter().map(|r| [r[y].parse().unwrap(), r[x].parse().unwrap()]).collect();
        change(&mut all);
        for (row, at) in rows.iter_mut().zip(all) {
            (row[y], row[x]) = (at[0].to_string(), at[1].to_string());
        }
        let rows: Vec<String> = rows.iter().map(|r| r.join(",")).collect();
        format!("{}\n{}\n", names.join(","), rows.join("\n"))
    })
}

/// Gives the positions in another unit, which the names of the columns state.
fn in_unit(unit: &'static str, factor: f64) -> impl Fn(&Path) + Sync + 'static {
    move |desk| {
        positions(move |t| t.iter_mut().flatten().for_each(|v| *v *= factor))(desk);
        let named = move |axis: &str, t: &str| t.replacen(&format!("{axis}_um"), &format!("{axis}_{unit}"), 1);
        text("bead.csv", move |t| named("y", &named("x", &t)))(desk);
    }
}

/// Changes the frames of a stack.
fn frames(name: &'static str, change: fn(Array3<f32>) -> Array3<f32>) -> impl Fn(&Path) + Sync + 'static {
    move |desk| {
        let file = desk.join("session").join(name);
        let changed = change(stack::read(&file).unwrap());
        stack::write(&file, changed.view()).unwrap();
    }
}

fn tables() -> Vec<Mistake> {
    let row = |what: &str, words: &[&str]| Mistake::new(what, CALIBRATE).says(words);
    // Read, and said so.
    let read = |what: &str, words: &[&str]| {
        Mistake::new(what, "calibrate session -o other --replicates 0").exit(0).says(words)
    };
    let column = |from: &'static str, to: &'static str| text("bead.csv", move |t| t.replacen(from, to, 1));
    vec![
        row("The table has no header", &["bead.csv", "header row is missing", "frame,x_um,y_um"])
            .with(text("bead.csv", |t| t.split_once('\n').unwrap().1.into())),
        row("Numbers have decimal commas", &["bead.csv", "decimal commas", "decimal points"])
            .with(text("bead.csv", |t| t.replace('.', ","))),
        row("A column of positions has no unit", &["bead.csv", "x_um", "states no unit"]).with(column("x_um", "X")),
        read("Semicolons separate numbers with decimal commas", &["bead.csv", "with decimal commas"])
            .with(text("bead.csv", |t| t.replace(',', ";").replace('.', ","))),
        read("Columns are in millimetres, and named so", &["bead.csv", "`x_mm` as x_um (times 1000)"])
            .with(in_unit("mm", 1e-3)),
        read("Columns are in pixels, and named so", &["bead.csv", "object pixels of 2.8 um"])
            .with(in_unit("px", 1.0 / 2.8)),
        read("Columns have other names", &["bead.csv", "`Stage X (um)` as x_um"]).with(column("x_um", "Stage X (um)")),
        read("Frames are numbered from 1", &["bead.csv", "numbered from 1"]).with(text("bead.csv", |t| {
            let mut lines = t.lines();
            let head = lines.next().unwrap().to_string();
            let next = |l: &str| {
                let (frame, rest) = l.split_once(',').unwrap();
                format!("{},{rest}", frame.parse::<usize>().unwrap() + 1)
            };
            format!("{head}\n{}\n", lines.map(next).collect::<Vec<_>>().join("\n"))
        })),
        row("A row is missing", &["bead.csv", "25 frames", "24 rows"])
            .with(text("bead.csv", |t| t.trim_end().rsplit_once('\n').unwrap().0.into())),
        row("A frame is listed twice", &["bead.csv", "each frame once"])
            .with(text("bead.csv", |t| t.replacen("\n7,", "\n6,", 1))),
        row("A cell is empty", &["bead.csv", "finite number"]).with(text("bead.csv", |t| {
            t.lines()
                .enumerate()
                .map(|(i, l)| {
                    let mut cells: Vec<&str> = l.split(',').collect();
                    if i == 3 {
                        cells[1] = "";
                    }
                    cells.join(",")
                })
                .collect::<Vec<_>>()
                .join("\n")
        })),
        row("Cells hold units", &["bead.csv", "without units"]).with(text("bead.csv", |t| {
            t.lines()
                .enumerate()
                .map(|(i, l)| {
                    let mut cells: Vec<String> = l.split(',').map(str::to_string).collect();
                    if i == 3 {
                        cells[1].push_str(" um");
                    }
                    cells.join(",")
                })
                .collect::<Vec<_>>()
                .join("\n")
        })),
        row("Positions are in nanometres", &["bead.csv", "object grid", "unit"])
            .with(positions(|t| t.iter_mut().flatten().for_each(|v| *v *= 1e3))),
        row("Positions are in millimetres", &["units", "millimetres", "1000"])
            .with(positions(|t| t.iter_mut().flatten().for_each(|v| *v /= 1e3))),
        row("Positions are in pixels", &["units", "look like pixels"])
            .with(positions(|t| t.iter_mut().flatten().for_each(|v| *v /= 2.8))),
        row("Positions are half of what they were", &["units", "times as far"])
            .with(positions(|t| t.iter_mut().flatten().for_each(|v| *v /= 2.0))),
    ]
}

fn axes() -> Vec<Mistake> {
    let row = |what: &str, words: &[&str]| Mistake::new(what, CALIBRATE).says(words);
    vec![
        row("x and y are exchanged", &["orientation", "x and y of bead.csv look exchanged"])
            .with(positions(|t| t.iter_mut().for_each(|p| p.swap(0, 1)))),
        row("x is mirrored", &["orientation", "x of bead.csv looks mirrored", "change the sign of x"])
            .with(positions(|t| t.iter_mut().for_each(|p| p[1] = -p[1]))),
        row("The frames are upside down", &["orientation", "upside down"]).with(frames("bead.npy", |mut f| {
            f.invert_axis(Axis(1));
            f
        })),
        row("The image of the lens is not turned back", &["orientation", "rotated by 180 degrees"]).with(frames(
            "bead.npy",
            |mut f| {
                f.invert_axis(Axis(1));
                f.invert_axis(Axis(2));
                f
            },
        )),
        row("The frames are transposed", &["orientation", "look transposed"])
            .with(frames("bead.npy", |f| f.permuted_axes([0, 2, 1]))),
        row("The rows are shifted by one frame", &["order", "shifted by one frame"])
            .with(positions(|t| t.rotate_right(1))),
        row("The stage went to and fro", &["order", "every second line"])
            .with(positions(|t| t.chunks_mut(5).skip(1).step_by(2).for_each(<[_]>::reverse))),
        row("One position is wrong", &["single positions", "bead.npy: frame 11:", "correct the row"])
            .with(positions(|t| t[11] = [t[11][0] + 14.0, t[11][1] - 14.0])),
        row("Two rows are exchanged", &["single positions", "frame 6:", "frame 18:"])
            .with(positions(|t| t.swap(6, 18))),
        row("The table belongs to another scan", &["positions", "do not move as bead.csv says"])
            .with(positions(|t| *t = (0..25).map(|i| t[(i * 7 + 3) % 25]).collect())),
        Mistake::new("The same, looked at before", CHECK)
            .says(&["1 error", "x and y of bead.csv look exchanged"])
            .with(positions(|t| t.iter_mut().for_each(|p| p.swap(0, 1)))),
        Mistake::new("Calibrated all the same", "calibrate session -o other --accept --replicates 0")
            .exit(0)
            .says(&["WARN", "single positions", "frame 11:"])
            .with(positions(|t| t[11] = [t[11][0] + 14.0, t[11][1] - 14.0])),
    ]
}

fn optics() -> Vec<Mistake> {
    let row = |what: &str, words: &[&str]| Mistake::new(what, CALIBRATE).says(words);
    let array = |change: fn(&str) -> String| {
        text("session.toml", move |t| {
            let (head, array) = t.split_once("[array]").unwrap();
            format!("{head}[array]{}", change(array))
        })
    };
    vec![
        row("2 x 2 lenses declared for 3 x 3", &["array", "form 3 x 3 lenses", "declares 2 x 2", "[array]"])
            .with(array(|t| t.replacen("rows = 3", "rows = 2", 1).replacen("cols = 3", "cols = 2", 1))),
        row("4 x 4 lenses declared for 3 x 3", &["array", "form 3 x 3 lenses", "declares 4 x 4", "[array]"])
            .with(array(|t| t.replacen("rows = 3", "rows = 4", 1).replacen("cols = 3", "cols = 4", 1))),
        row("Half the pitch", &["array", "correct array.pitch_px"])
            .with(array(|t| t.replacen("pitch_px = 20.0", "pitch_px = 10.0", 1))),
        row("Twice the pitch", &["array", "correct array.pitch_px"])
            .with(array(|t| t.replacen("pitch_px = 20.0", "pitch_px = 40.0", 1))),
        row("Another magnification", &["session.toml", "object.pixel_um", "magnification"])
            .with(text("session.toml", |t| t.replacen("pixel_pitch_um = 1.85", "pixel_pitch_um = 3.7", 1))),
    ]
}

fn values() -> Vec<Mistake> {
    let row = |what: &str, words: &[&str]| Mistake::new(what, CALIBRATE).says(words);
    vec![
        row("Darks are subtracted from the beads", &["black level", "bead.npy", "subtracted already"])
            .with(frames("bead.npy", |f| f - 100.0)),
        row("Beads are scaled from 0 to 1", &["scale", "bead.npy", "raw digital numbers"])
            .with(frames("bead.npy", |f| f / 4095.0)),
        row("12 bits are stored in the upper bits of 16", &["bit depth", "bead.npy", "shifted left by 4 bits"])
            .with(frames("bead.npy", |f| f * 16.0)),
        row("Fewer bits are declared than the frames have", &["bit depth", "set sensor.bit_depth"])
            .with(text("session.toml", |t| t.replacen("bit_depth = 12", "bit_depth = 8", 1))),
        row("Flats of several levels have no table", &["flats", "several levels count as one", "illumination"])
            .with(text("session.toml", |t| t.replacen("table = \"flat.csv\"\n", "", 1))),
        Mistake::new("There are no darks", "calibrate session -o other --replicates 0")
            .exit(0)
            .says(&["WARN", "no dark frames"])
            .with(text("session.toml", |t| {
                let stacks: Vec<&str> = t.split("[[stack]]").filter(|s| !s.contains("role = \"dark\"")).collect();
                stacks.join("[[stack]]")
            })),
    ]
}

#[test]
fn sessions_that_are_wrong() {
    let all = [tables(), axes(), optics(), values()];
    hold("Sessions", all.into_iter().flatten().collect());
}
