//! Frames that no sensor delivers: scaled, subtracted, of fewer bits, dark, saturated, constant.

use crate::{Mistake, hold};
use ndarray::Array3;
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
            .exit(0)
            .says(&["scene.npy: frame 0", "black level looks subtracted"]),
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
