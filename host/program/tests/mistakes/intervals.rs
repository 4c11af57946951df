//! Intervals of another network, of another instrument, or of no widths at all.

use crate::common::ommatidia;
use crate::{Mistake, hold};
use std::path::Path;

/// Makes widths for the network and the instrument of the desk.
fn widths(desk: &Path) {
    let words = "uncertainty instrument --with network.omm -o widths --count 60 --neighbours 10";
    let words: Vec<&str> = words.split_whitespace().collect();
    ommatidia(&words).current_dir(desk).assert().success();
}

#[test]
fn intervals_that_belong_to_something_else() {
    let reconstruct = |rest: &str| format!("reconstruct frames.npy -o out.npy --with network.omm {rest}");
    hold(
        "Intervals",
        vec![
            Mistake::new(
                "An instrument given as widths",
                reconstruct("--uncertainty instrument --instrument instrument"),
            )
            .says(&["instrument", "uncertainty"]),
            Mistake::new("A network alone: no instrument to predict frames with", reconstruct("--uncertainty widths"))
                .with(widths)
                .says(&["network.omm", "--instrument"]),
            Mistake::new(
                "Widths of another network",
                "reconstruct frames.npy -o out.npy --with network --uncertainty widths --instrument instrument",
            )
            .with(widths)
            .says(&["widths", "another method file", "ommatidia uncertainty"]),
            Mistake::new(
                "Widths of another instrument",
                "coverage widths --with network.omm --instrument scenes.instrument",
            )
            .with(widths)
            .says(&["widths", "another instrument", "ommatidia uncertainty"]),
            Mistake::new("Too few scenes", "uncertainty instrument --with network.omm -o other --count 10")
                .says(&["count", "40 scenes or more"]),
            Mistake::new("Intervals in a video for the eye", {
                "reconstruct frames.npy -o out.mp4 --with network.omm --uncertainty widths --instrument instrument"
            })
            .with(widths)
            .says(&["out.mp4", ".tif"]),
            Mistake::new("Lower limits that exist", reconstruct("--uncertainty widths --instrument instrument"))
                .with(|desk| {
                    widths(desk);
                    std::fs::copy(desk.join("objects.npy"), desk.join("out.lower.npy")).unwrap();
                })
                .says(&["out.lower.npy", "exists already", "--force"]),
        ],
    );
}
