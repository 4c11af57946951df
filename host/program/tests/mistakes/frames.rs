//! Frames that no sensor delivers: scaled, subtracted, of fewer bits, dark, saturated, constant.

use crate::common::desk;
use crate::{Mistake, hold};
use ndarray::Array3;
use ommatidia_model::bead::BeadBackground;
use ommatidia_model::instrument::Instrument;
use ommatidia_session::artifact::Provenance;
use ommatidia_session::{FrameWriter, SampleType, StackSpec, stack};
use std::path::Path;

#[test]
fn frames_that_cannot_be_are_reconstructed_with_a_warning() {
    let with = |name: &'static str, change: fn(f32) -> f32| {
        move |desk: &Path| stack::write(&desk.join(name), raw().mapv(change).view()).unwrap()
    };
    let warned = |what: &str, file: &'static str, change: fn(f32) -> f32| {
        let command = format!("reconstruct {file} -o out.npy --with network.omm");
        Mistake::new(what, command).with(with(file, change)).exit(0)
    };
    hold(
        "Frames",
        vec![
            warned("Frames scaled to 0 to 1", "unit.npy", |v| v / 4095.0).says(&[
                "unit.npy: frame 0 (2 more of 3",
                "below the black level",
                "0 to 1",
            ]),
            warned("Frames of 8 bits for a sensor of 12", "bits.npy", |v| (v / 16.0).floor()).says(&[
                "bits.npy: frame 0",
                "below the black level",
                "8 bits",
            ]),
            warned("Frames of which the darks were subtracted", "net.npy", |v| (v - 100.0).max(0.0)).says(&[
                "net.npy: frame 0",
                "black level looks subtracted",
                "nothing subtracted",
            ]),
            warned("Frames of a sensor with a lower black level", "other.npy", |v| v - 40.0)
                .says(&["other.npy: frame 0", "another sensor or setting"]),
            warned("All pixels are saturated", "white.npy", |_| 4095.0).says(&[
                "white.npy: frame 0",
                "100.0 % of the pixels",
                "full scale",
                "shorter",
            ]),
            warned("12 bits in the high bits of 16", "high.npy", |v| 16.0 * v).says(&[
                "high.npy: frame 0",
                "full scale is 4095 DN",
                "shifted",
            ]),
            warned("The camera sent one value", "flat.npy", |_| 100.0)
                .says(&["flat.npy: frame 0", "every pixel is 100 DN"]),
            warned("The shutter was closed", "dark.npy", |v| 98.0 + (v * 7919.0).rem_euclid(5.0)).says(&[
                "dark.npy: frame 0",
                "no light",
                "shutter",
            ]),
            Mistake::new(
                "A session of 10 bits, the calibration of 12",
                "close scenes --instrument scenes.instrument -o new",
            )
            .with(|desk| {
                for name in ["dark.npy", "flat.npy", "bead.npy", "scene.npy"] {
                    let file = desk.join("scenes").join(name);
                    let frames = stack::read(&file).unwrap().mapv(|v| (v / 4.0).floor());
                    stack::write(&file, frames.view()).unwrap();
                }
            })
            .says(&["another unit", "for 64.0 DN", "multiply those of the session by 4"]),
            Mistake::new("Scenes scaled to 0 to 1", "close scenes --instrument scenes.instrument -o new")
                .with(|desk| scaled_scenes(desk, 1.0 / 4095.0))
                .says(&["scene frames are not as the sensor delivers them", "0 to 1"]),
            Mistake::new("Scenes alone multiplied by a half", "close scenes --instrument scenes.instrument -o new")
                .with(|desk| scaled_scenes(desk, 0.5))
                .says(&["another unit", "where their objects are dark", "multiply the scenes by 2"]),
            Mistake::new(
                "One frame of three is dark: a classical method",
                "reconstruct gap.npy -o out.npy --with instrument --method central",
            )
            .with(|desk| {
                let mut frames = raw();
                frames.index_axis_mut(ndarray::Axis(0), 1).fill(0.0);
                stack::write(&desk.join("gap.npy"), frames.view()).unwrap();
            })
            .exit(0)
            .says(&["gap.npy: frame 1:", "every pixel is 0 DN"]),
            Mistake::new("Scaled frames, with a checkpoint", "reconstruct unit.npy -o out.npy --with network")
                .with(with("unit.npy", |v| v / 4095.0))
                .exit(0)
                .says(&["unit.npy: frame 0", "0 to 1"]),
            Mistake::new("Scaled frames, on the device", "device run --with network.omm --frames unit.npy --on host")
                .with(with("unit.npy", |v| v / 4095.0))
                .exit(0)
                .says(&["unit.npy: frame 0", "0 to 1"]),
            Mistake::new(
                "Scaled frames are streamed to the device",
                "device stream --with network.omm --frames unit.npy --on host",
            )
            .with(with("unit.npy", |v| v / 4095.0))
            .exit(0)
            .says(&["unit.npy: frame 0", "0 to 1"]),
            Mistake::new(
                "Raw frames where light above black is expected",
                "predict instrument raw.npy --adjoint -o out.npy",
            )
            .with(with("raw.npy", |v| v))
            .exit(0)
            .says(&["raw.npy: frame 0", "still hold the black level"]),
            Mistake::new("Objects with negative light", "predict instrument less.npy -o out.npy")
                .with(|desk| {
                    let objects = stack::read(&desk.join("objects.npy")).unwrap();
                    stack::write(&desk.join("less.npy"), objects.mapv(|v| v - 5.0).view()).unwrap();
                })
                .says(&["less.npy: objects 0", "expected a finite value >= 0"]),
            Mistake::new("Objects without light", "predict instrument none.npy -o out.npy")
                .with(|desk| stack::write(&desk.join("none.npy"), Array3::zeros((1, 24, 24)).view()).unwrap())
                .exit(0)
                .says(&["none.npy: object 0", "dark everywhere"]),
            Mistake::new(
                "The scenes of a session were dark-subtracted: residual",
                "residual session --instrument instrument",
            )
            .with(subtracted_scenes)
            .says(&["scene.npy: frame 0", "3 of 3 scene frames", "black level looks subtracted"]),
            Mistake::new(
                "The scenes of a session were dark-subtracted: evaluate",
                "evaluate session --with instrument --methods central",
            )
            .with(subtracted_scenes)
            .exit(0)
            .says(&["scene.npy: frame 0", "black level looks subtracted"]),
        ],
    );
}

/// Three frames that the desk's sensor might deliver: black level 100 DN, noise of some DN, a few spots.
fn raw() -> Array3<f32> {
    Array3::from_shape_fn((3, 80, 80), |(i, r, c)| {
        let noise = ((i * 7919 + r * 6133 + c * 2741 + r * c * 37) % 13) as f32 - 6.0;
        let spot = |y: f32, x: f32| (-((r as f32 - y).powi(2) + (c as f32 - x).powi(2)) / 18.0).exp();
        (100.0 + noise + 900.0 * (spot(20.0, 31.0) + spot(50.0 + i as f32, 60.0))).round()
    })
}

/// Adds electrons to every pixel of a stack of the small virtual instrument, whose gain is 0.4 DN/e-, whose black level
/// is 64 DN and whose frames are whole DN: `plane` from the place, 0 to 1 along rows and columns.
fn add_background(file: &Path, plane: impl Fn(f64, f64) -> f64) {
    let mut frames: Array3<f32> = stack::read(file).unwrap();
    let (_, rows, cols) = frames.dim();
    for ((i, r, c), v) in frames.indexed_iter_mut() {
        let e = plane(r as f64 / (rows - 1) as f64, c as f64 / (cols - 1) as f64);
        // Dithered, so that rounding adds no pattern.
        let part = ((i * 7919 + r * 104_729 + c * 1_299_709) % 1009) as f64 / 1009.0;
        *v += (0.4 * e + part).floor() as f32;
    }
    stack::write(file, frames.view()).unwrap();
}

/// A background in the scenes is fitted, said, and no fault of the optics.
#[test]
fn an_evaluation_fits_the_background_of_the_frames() {
    let figures = |desk: &Path, verb: &str| -> serde_json::Value {
        let words: Vec<&str> = verb.split_whitespace().collect();
        let output = crate::common::ommatidia(&words).current_dir(desk).output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        serde_json::from_slice(&output.stdout).unwrap()
    };
    const EVALUATE: &str = "evaluate scenes --with scenes.instrument --methods central --json";
    let desk = desk::new();
    let without = figures(desk.path(), EVALUATE)["prediction"].clone();
    assert_eq!(without["background"]["added"], false, "{without}");
    add_background(&desk.path().join("scenes/scene.npy"), |r, c| 10.0 + 6.0 * r - 4.0 * c);
    let with = figures(desk.path(), EVALUATE)["prediction"].clone();
    let b = &with["background"];
    assert_eq!(b["added"], true, "{with}");
    for (found, want) in [(&b["mean_e"][0], 11.0), (&b["mean_e"][1], 6.0), (&b["mean_e"][2], -4.0)] {
        assert!((found.as_f64().unwrap() - want).abs() < 0.5, "{with}");
    }
    let number = |v: &serde_json::Value, name: &str| v[name].as_f64().unwrap();
    assert!(number(b, "chi2_ndf_without") > 1.5 * number(&with, "chi2_ndf"), "{with}");
    // Light that was added without its photon noise: chi-squared falls a little.
    assert!(number(&with, "chi2_ndf") < 1.1 * number(&without, "chi2_ndf"), "{without} {with}");
    assert!(number(&with, "nrmse") < 1.2 * number(&without, "nrmse"), "{without} {with}");
}

/// The bead frames have a background: a prediction says that it leaves it out, and takes it where it is asked to.
#[test]
fn a_prediction_says_what_background_it_leaves_out() {
    let desk = desk::new();
    // The small instruments have no room between their foci to find a background in: it is written down instead.
    let path = desk.path().join("background.instrument");
    let mut instrument = Instrument::read(&desk.path().join("scenes.instrument")).unwrap();
    let found = BeadBackground { mean_e: [12.0, 0.0, 0.0], sigma_e: [0.1; 3], ..BeadBackground::default() };
    instrument.quality.background = Some(found);
    instrument.write(&path, Provenance::new("test", 1, &())).unwrap();
    let run = |command: &str| {
        let words: Vec<&str> = command.split_whitespace().collect();
        let output = crate::common::ommatidia(&words).current_dir(desk.path()).output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let figures: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        figures["warnings"].to_string()
    };
    let object = Array3::<f32>::zeros((1, 18, 22));
    stack::write(&desk.path().join("dark.npy"), object.view()).unwrap();
    let said = run("predict background.instrument dark.npy -o out.npy --json");
    assert!(said.contains("had a background of 12.00") && said.contains("--background 12.00,0.00,0.00"), "{said}");
    let said = run("predict background.instrument dark.npy -o with.npy --background 12 --json");
    assert!(!said.contains("had a background of"), "{said}");
    let [without, with] = ["out.npy", "with.npy"].map(|f| stack::read(&desk.path().join(f)).unwrap());
    let more = (&with - &without).mean().unwrap();
    assert!((more - 0.4 * 12.0).abs() < 0.1, "{more}");
}

/// Multiplies the scenes of the session `scenes`, and not its darks and flats.
fn scaled_scenes(desk: &Path, factor: f32) {
    let file = desk.join("scenes/scene.npy");
    let frames = stack::read(&file).unwrap().mapv(|v| v * factor);
    stack::write(&file, frames.view()).unwrap();
}

/// Adds scenes of known objects to the session, from which the black level was subtracted.
fn subtracted_scenes(desk: &Path) {
    let session = desk.join("session");
    let spec = StackSpec { frames: 3, rows: 80, cols: 80, samples: SampleType::U16, pixel_um: None };
    let mut frames = FrameWriter::create(&session.join("scene.npy"), spec).unwrap();
    raw().outer_iter().for_each(|frame| frames.push(frame.mapv(|v| (v - 100.0).max(0.0)).view()).unwrap());
    frames.finish().unwrap();
    let objects = Array3::from_shape_fn((3, 24, 24), |(_, r, c)| if (r, c) == (9, 12) { 1.0 } else { 0.0 });
    stack::write(&session.join("truth.npy"), objects.view()).unwrap();
    let manifest = session.join("session.toml");
    let text = std::fs::read_to_string(&manifest).unwrap();
    let stack = "[[stack]]\nrole = \"scene\"\nfile = \"scene.npy\"\ntruth = \"truth.npy\"\nexposure_ms = 10.0\n";
    std::fs::write(&manifest, text + "\n" + stack).unwrap();
}
