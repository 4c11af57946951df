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

/// Makes an empty folder that nobody may write to.
fn locked(desk: &Path) {
    use std::os::unix::fs::PermissionsExt;
    std::fs::create_dir(desk.join("locked")).unwrap();
    std::fs::set_permissions(desk.join("locked"), std::fs::Permissions::from_mode(0o555)).unwrap();
}

#[test]
fn folders_that_cannot_take_an_output() {
    let row = |what: &str, command: &str| {
        let says = ["locked", "cannot be written", "check the permissions"];
        Mistake::new(what, command).with(locked).unprivileged().says(&says)
    };
    let network = "--with network.omm";
    hold(
        "Folders that take no output",
        vec![
            row("An instrument into a read-only folder", "calibrate session -o locked/new"),
            row("A picture into a read-only folder", "check session -o locked/new.png"),
            row("Training pairs into a read-only folder", "simulate instrument -o locked/pairs --count 4"),
            row("A checkpoint into a read-only folder", "train pairs -o locked/new --filters 2 --steps 2"),
            row("A network file into a read-only folder", "quantize network -o locked/new.omm"),
            row("Frames into a read-only folder", "predict instrument objects.npy -o locked/new.npy"),
            row(
                "Reconstructions into a read-only folder",
                &format!("reconstruct frames.npy -o locked/new.tif {network}"),
            ),
            row(
                "A closed instrument into a read-only folder",
                "close scenes --instrument scenes.instrument -o locked/new",
            ),
            row("An evaluation into a read-only folder", "evaluate scenes --with scenes.instrument -o locked/new"),
            row("A report into a read-only folder", "report instrument -o locked/new.html"),
            row("A virtual session into a read-only folder", "bench locked/new --config bench.toml"),
            row(
                "Flash memory into a read-only folder",
                &format!("device flash {network} --on host --state locked/new.flash"),
            ),
            Mistake::new("A file in place of the folder", "calibrate session -o frames.npy/new")
                .says(&["frames.npy is a file, not a folder"]),
            Mistake::new("The manifest in place of the session", "calibrate session/session.toml -o new").says(&[
                "session/session.toml",
                "manifest",
                "name its folder",
            ]),
            Mistake::new("A stack in place of the session", "evaluate session/bead.npy --with instrument").says(&[
                "session/bead.npy",
                "expected a folder",
                "session.toml",
            ]),
            Mistake::new("A session without scenes", "reconstruct session -o new.npy --with network.omm")
                .says(&["session.toml", "role = \"scene\""]),
            Mistake::new("A folder without frames", "reconstruct pairs -o new.npy --with network.omm")
                .says(&["pairs: stack", "a folder of numbered .avi or .tif files"]),
            Mistake::new("A folder in place of an instrument", "predict pairs objects.npy -o new.npy").says(&[
                "pairs",
                "found a folder",
                "name a file",
            ]),
            Mistake::new("A picture that is to be no PNG", "check session -o new.jpg")
                .says(&["new.jpg", "ends in .png"]),
            Mistake::new("A background of two numbers", "predict instrument objects.npy -o new.npy --background 8,4")
                .exit(2)
                .says(&["LEVEL,ROWS,COLS", "electrons"]),
            Mistake::new("A pixel of no size", "reconstruct frames.npy -o new.tif --with network.omm --pixel-um 0")
                .exit(2)
                .says(&["--pixel-um", "above 0"]),
        ],
    );
}
