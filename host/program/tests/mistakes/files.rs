//! Files at risk: outputs that are inputs, that exist, or that are of another kind.

use crate::{Mistake, hold};

#[test]
fn files_that_would_be_lost() {
    hold(
        "Files at risk",
        vec![
            Mistake::new("The output is the input", "reconstruct frames.npy -o frames.npy --with network.omm")
                .says(&["frames.npy", "input"]),
        ],
    );
}
