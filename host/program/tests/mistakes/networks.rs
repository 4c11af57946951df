//! Networks of more than one pass where one is needed, and arenas that cannot be.

use crate::common::ommatidia;
use crate::{Mistake, hold};
use std::path::Path;

/// Trains a network of two passes for the desk.
fn two_passes(desk: &Path) {
    let words = "train pairs -o two --instrument instrument --filters 2 --steps 2 --passes 2";
    let words: Vec<&str> = words.split_whitespace().collect();
    ommatidia(&words).current_dir(desk).assert().success();
}

#[test]
fn passes_and_arenas_that_cannot_be() {
    hold(
        "Networks and arenas",
        vec![
            Mistake::new("Two passes, and no PSFs to predict frames with", "train pairs -o new --passes 2 --steps 2")
                .says(&["--passes", "--instrument"]),
            Mistake::new(
                "Two passes of another architecture",
                "train pairs -o new --passes 2 --network multiwienernet --instrument instrument --steps 2",
            )
            .says(&["--passes", "1 for this network"]),
            Mistake::new("Richardson-Lucy iterations, and no PSFs for them", {
                "train pairs -o new --richardson-lucy 20 --steps 2"
            })
            .says(&["--richardson-lucy", "--instrument"]),
            Mistake::new(
                "Richardson-Lucy iterations before another architecture",
                "train pairs -o new --richardson-lucy 20 --network multiwienernet --instrument instrument --steps 2",
            )
            .says(&["--richardson-lucy", "0 for this network"]),
            Mistake::new(
                "Pairs of a data set with an effect of their own",
                "train pairs -o new --vary background=4 --steps 2",
            )
            .says(&["--vary", "simulate"]),
            Mistake::new(
                "Training pairs with an effect that noise hides",
                "simulate instrument -o new --count 4 --vary row_noise=2",
            )
            .says(&["vary", "an effect on light", "row_noise"]),
            Mistake::new(
                "Training pairs with an effect of no strength",
                "train instrument -o new --vary array_shift=0 --steps 2",
            )
            .says(&["vary", "largest strength", "array_shift=0"]),
            Mistake::new("A network of two passes in integers", "quantize two -o two.omm --weights int8")
                .with(two_passes)
                .says(&["2 passes", "one pass for integers", "leave --weights"]),
            Mistake::new(
                "Features in integers for weights in half precision",
                "quantize network -o new.omm --activations int16",
            )
            .says(&["--activations int16", "--weights int8"]),
            Mistake::new(
                "Weights in integers for features in half precision",
                "quantize network -o new.omm --weights int8 --activations f16",
            )
            .says(&["--weights int8", "--activations int16"]),
            Mistake::new("A training for integers of a network of two passes", {
                "train pairs -o new --from two --filters 2 --passes 2 --quantize int8 --instrument instrument --steps 2"
            })
            .with(two_passes)
            .says(&["2 passes", "one pass for integers"]),
            Mistake::new("Receptive fields of two passes", "erf two --instrument instrument -o new")
                .with(two_passes)
                .says(&["passes", "one pass"]),
            Mistake::new("An arena brighter than full scale", "arena --with instrument --peaks 1e9 -o new")
                .says(&["--peaks", "full scale"]),
            Mistake::new("An arena with an effect that does not exist", {
                "arena --with instrument --effect hallo=1 -o new"
            })
            .says(&["--effect hallo=1", "unknown"]),
            Mistake::new("An arena of another instrument than the one that was calibrated", {
                "arena --with instrument --methods central --scenes 1 --peaks 100 --specimens worms -o new"
            })
            .says(&["instrument", "expected"]),
            Mistake::new("An arena in a folder of one's own", "arena --with instrument -o session")
                .says(&["session", "never replaced"]),
        ],
    );
}
