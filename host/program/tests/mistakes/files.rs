//! Files at risk: outputs that are inputs, that exist, or that are of another kind.

use crate::{Mistake, hold};
use std::path::Path;

fn copy(desk: &Path, from: &str, to: &str) {
    std::fs::copy(desk.join(from), desk.join(to)).unwrap();
}

#[test]
fn files_that_would_be_lost() {
    let input = ["input", "another name"];
    let kept = ["exists already", "--force"];
    let link = |desk: &Path| std::fs::hard_link(desk.join("frames.npy"), desk.join("raw.npy")).unwrap();
    let own = |desk: &Path| copy(desk, "objects.npy", "session/scene.npy");
    hold(
        "Files at risk",
        vec![
            Mistake::new("The output is the input", "reconstruct frames.npy -o frames.npy --with network.omm")
                .says(&input),
            Mistake::new(
                "The same, by another path",
                "reconstruct frames.npy -o ./session/../frames.npy --with network.omm",
            )
            .says(&input),
            Mistake::new("The same, by a hard link", "reconstruct frames.npy -o raw.npy --with network.omm --force")
                .with(link)
                .says(&input),
            Mistake::new("--force on an input", "predict instrument objects.npy -o objects.npy --force").says(&input),
            Mistake::new("A manifest as output", "calibrate session -o session/session.toml --force").says(&[
                "session.toml",
                "expected an artifact of kind `instrument`",
                "another name",
            ]),
            Mistake::new("A measured stack as output", "predict instrument objects.npy -o session/bead.npy --force")
                .says(&["folder of a session", "another name"]),
            Mistake::new(
                "Frames of the session that is read as output",
                "evaluate session --with instrument -o session/bead.npy --force",
            )
            .says(&["bead.npy", "expected an artifact of kind `evaluation`, found a stack"]),
            Mistake::new(
                "A recording whose table has the name of a session's",
                "device stream --with network.omm --frames frames.npy -o session/bead.tif --force",
            )
            .says(&["bead.csv", "page,frame"]),
            Mistake::new("A checkpoint replaced by a report", "report instrument -o network --force").says(&[
                "expected an HTML page",
                "checkpoint",
                "never replaced",
            ]),
            Mistake::new("A checkpoint replaced by a network file", "quantize network -o network").says(&input),
            Mistake::new(
                "An instrument replaced by a checkpoint",
                "train pairs -o instrument --filters 2 --steps 2 --force",
            )
            .says(&["checkpoint", "instrument", "never replaced"]),
            Mistake::new("A training that exists, without --resume", "train pairs -o network --filters 2 --steps 2")
                .says(&["exists already", "--force", "--resume"]),
            Mistake::new("An instrument that exists", "calibrate session -o instrument").says(&kept),
            Mistake::new("A report that exists", "report instrument -o report.html").says(&kept),
            Mistake::new("Frames that exist", "predict instrument objects.npy -o frames.npy").says(&kept),
            Mistake::new("A network file that exists", "quantize network -o network.omm").says(&kept),
            Mistake::new("Training pairs into a session", "simulate instrument -o session --count 4")
                .says(&["session", "dataset.json"]),
            Mistake::new("Training pairs into a file", "simulate instrument -o frames.npy --count 4")
                .says(&["found a file"]),
            Mistake::new("A virtual session over a measured one", "bench session --force").says(&["session"]),
            Mistake::new("A virtual session over training pairs", "bench pairs --force")
                .says(&["pairs", "another name"]),
            Mistake::new("A demo in a folder of one's own", "demo -o session --force")
                .says(&["session", "another name"]),
            Mistake::new("A study in a folder of one's own", "study -o session --quick").says(&["another name"]),
            Mistake::new(
                "An ablation in a folder of one's own",
                "ablate pairs --instrument instrument --session session -o session",
            )
            .says(&["another name"]),
            Mistake::new("Flash memory in a file of frames", "device status --state frames.npy --on host")
                .says(&["flash memory of a board", "never replaced"]),
            Mistake::new("Two outputs of one name", "close session --instrument instrument -o closed.closing")
                .says(&["two outputs"]),
            Mistake::new(
                "A report and an account of one name",
                "residual session --instrument instrument -o r --report r",
            )
            .says(&["two outputs"]),
            Mistake::new("An account that exists", "close session --instrument instrument -o new")
                .with(|desk| copy(desk, "frames.npy", "new.closing"))
                .says(&["new.closing", "expected an artifact of kind `closing`"]),
            Mistake::new("A folder as output", "calibrate session -o pairs").says(&["pairs", "found a folder"]),
            Mistake::new("A folder that does not exist", "calibrate session -o results/instrument.new").says(&[
                "results",
                "does not exist",
                "create it",
            ]),
            Mistake::new(
                "Evaluation over reconstructions",
                "evaluate session --with instrument --stack own=objects.npy -o objects.npy",
            )
            .says(&input),
            Mistake::new(
                "A page of samples over a data file",
                "train pairs -o new --page objects.npy --filters 2 --steps 2 --force",
            )
            .says(&["expected an HTML page", "never replaced"]),
            Mistake::new(
                "A scene among the files of the session that is read",
                "predict instrument session/scene.npy -o session/scene.npy --force",
            )
            .with(own)
            .says(&input),
        ],
    );
}
