//! Disks that are full, and inputs that may not be read.

use crate::{Mistake, hold};

const NETWORK: &str = "--with network.omm";

#[test]
fn disks_that_are_full() {
    let row = |what: &str, command: &str| {
        Mistake::new(what, command).full_disk("full").says(&["full/", "the disk is full", "make room"])
    };
    hold(
        "Full disks",
        vec![
            row("An instrument", "calibrate session -o full/new"),
            row("A picture", "check session -o full/new.png"),
            row("Training pairs", "simulate instrument -o full/pairs --count 4"),
            row("A checkpoint", "train pairs -o full/new --filters 2 --steps 2"),
            row("A network file", "quantize network -o full/new.omm"),
            row("Frames", "predict instrument objects.npy -o full/new.npy"),
            row("Reconstructions, .npy", &format!("reconstruct frames.npy -o full/new.npy {NETWORK}")),
            row("Reconstructions, .tif", &format!("reconstruct frames.npy -o full/new.tif {NETWORK}")),
            row("A closed instrument", "close scenes --instrument scenes.instrument -o full/new"),
            row("An evaluation", "evaluate scenes --with scenes.instrument -o full/new --methods central"),
            row("A report", "report instrument -o full/new.html"),
            row("A virtual session", "bench full/new --config bench.toml"),
            row("Flash memory", &format!("device flash {NETWORK} --on host --state full/new.flash")),
        ],
    );
}

#[test]
fn inputs_that_may_not_be_read() {
    let row = |input: &'static str, what: &str, command: &str| {
        Mistake::new(what, command).unreadable(input).says(&[input, "check the permissions"])
    };
    hold(
        "Inputs that may not be read",
        vec![
            row("session/session.toml", "The manifest of a session", "check session"),
            row("session/bead.npy", "Frames of a session", "calibrate session -o new"),
            row("session/bead.csv", "A table of a session", "calibrate session -o new"),
            row("session", "The folder of a session", "calibrate session -o new"),
            row("instrument", "An instrument", "simulate instrument -o new --count 4"),
            row("pairs", "Training pairs: the folder", "train pairs -o new --filters 2 --steps 2"),
            row("pairs/dataset.json", "Training pairs: the plan", "train pairs -o new --filters 2 --steps 2"),
            row("network", "A checkpoint", "quantize network -o new.omm"),
            row("network.omm", "A network file", &format!("reconstruct frames.npy -o new.tif {NETWORK}")),
            row("frames.npy", "Frames", &format!("reconstruct frames.npy -o new.tif {NETWORK}")),
            row("objects.npy", "Objects", "predict instrument objects.npy -o new.npy"),
            row(
                "scenes.instrument",
                "The instrument that is to be closed",
                "close scenes --instrument scenes.instrument -o new",
            ),
            row("scenes/scene.npy", "Scenes", "evaluate scenes --with scenes.instrument --methods central -o new"),
            row("instrument", "What a report shows", "report instrument -o new.html"),
            row("bench.toml", "The configuration of a virtual session", "bench new --config bench.toml"),
            row("network.omm", "A network file for the device", &format!("device flash {NETWORK} --on host")),
        ],
    );
}
