//! The firmware image: a given file, or built from this workspace.

use super::error::DeviceError;
use ommatidia_shared::boards::Board;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Names a folder of images that are built already, `BOARD/TARGET/firmware/PROGRAM` in it.
const IMAGES: &str = "OMMATIDIA_FIRMWARE";

/// An image on disk, for a board.
#[derive(Clone, Debug)]
pub struct Firmware {
    board: Board,
    path: PathBuf,
}

impl Firmware {
    /// An existing image.
    ///
    /// # Errors
    /// There is no such file.
    pub fn given(board: Board, path: &Path) -> Result<Self, DeviceError> {
        if path.is_file() {
            return Ok(Self { board, path: path.into() });
        }
        Err(DeviceError::NoFirmware { detail: format!("{}: no such file", path.display()) })
    }

    /// Builds program `bin` (`app`, `bench` or `watchdog`) for a board. If the environment variable
    /// `OMMATIDIA_FIRMWARE` names a folder of prebuilt images, takes the image from there.
    ///
    /// # Errors
    /// The sources or the compiler for the target are missing, or the build fails.
    pub fn build(board: Board, bin: &str) -> Result<Self, DeviceError> {
        if let Some(folder) = std::env::var_os(IMAGES) {
            let path = Path::new(&folder).join(board.name).join(board.target).join("firmware").join(bin);
            return Self::given(board, &path);
        }
        let missing = |detail: String| DeviceError::NoFirmware { detail };
        let workspace = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
        if !workspace.join("firmware/Cargo.toml").is_file() {
            return Err(missing("the source code of the firmware was not found".into()));
        }
        if !can_build(board) {
            let target = board.target;
            return Err(missing(format!("no compiler for the board; `rustup target add {target}` installs one")));
        }
        let output = Command::new("cargo")
            .current_dir(&workspace)
            .args(["build", "--profile", "firmware", "-p", "ommatidia-firmware", "--features", board.name])
            .args(["--target", board.target, "--bin", bin, "--message-format", "json-render-diagnostics"])
            // A folder a board: their images have the same names.
            .arg("--target-dir")
            .arg(target_dir(&workspace).join("boards").join(board.name))
            .env("CARGO_ENCODED_RUSTFLAGS", board.rustflags.join("\x1f"))
            // Incremental builds divide the code otherwise, and its instructions are counted.
            .env("CARGO_INCREMENTAL", "0")
            .output()
            .map_err(|source| DeviceError::Start { program: "cargo".into(), source })?;
        if !output.status.success() {
            let log = String::from_utf8_lossy(&output.stderr);
            let last = log.lines().rev().take(8).collect::<Vec<_>>().into_iter().rev().collect::<Vec<_>>().join("\n");
            return Err(DeviceError::FirmwareBuild { log: last });
        }
        executable(&output.stdout, bin)
            .map(|path| Self { board, path })
            .ok_or_else(|| missing(format!("the build produced no program `{bin}`")))
    }

    /// The board that it runs on.
    pub fn board(&self) -> Board {
        self.board
    }

    /// The file.
    pub fn path(&self) -> &Path {
        &self.path
    }
}

/// Where cargo builds.
fn target_dir(workspace: &Path) -> PathBuf {
    std::env::var_os("CARGO_TARGET_DIR").map_or_else(|| workspace.join("target"), PathBuf::from)
}

/// Whether the compiler has the target's core library.
fn can_build(board: Board) -> bool {
    let output = Command::new("rustc").args(["--print", "target-libdir", "--target", board.target]).output();
    output.is_ok_and(|output| {
        output.status.success() && Path::new(String::from_utf8_lossy(&output.stdout).trim()).is_dir()
    })
}

/// The executable named in the messages of cargo.
fn executable(messages: &[u8], bin: &str) -> Option<PathBuf> {
    String::from_utf8_lossy(messages).lines().find_map(|line| {
        let message: serde_json::Value = serde_json::from_str(line).ok()?;
        let is_bin = message["target"]["name"] == bin && message["target"]["kind"][0] == "bin";
        if is_bin { message["executable"].as_str().map(PathBuf::from) } else { None }
    })
}
