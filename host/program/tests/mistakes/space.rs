//! Disks without room.

use ommatidia_session::remedy;
use std::path::Path;
use std::process::Command;
use std::sync::LazyLock;

/// How a folder comes to have no room. What is left in it after the run is printed, with exit code 98.
#[derive(Clone, Copy, Debug)]
pub enum Space {
    /// A file system in memory of one page (4 KiB) in the folder, in a mount namespace that `unshare` makes with these
    /// options: as root, or where users may have namespaces of their own.
    Disk(&'static [&'static str]),
    /// No file may be larger than 4 to 8 KiB: for all systems and users. The program prints another text then.
    FileLimit,
}

/// Error number of Unix: no space left on device.
const FULL: i32 = 28;
/// Error number of Unix: file too large.
const LARGE: i32 = 27;

impl Space {
    /// The best that this system and user have.
    pub fn found() -> Self {
        static FOUND: LazyLock<Space> = LazyLock::new(|| {
            let folder = tempfile::tempdir().unwrap();
            let works = |space: &Space| {
                let mut command = space.shell(&folder.path().join("full"));
                command.arg("true").output().is_ok_and(|out| out.status.success())
            };
            let disks = [["--mount"].as_slice(), &["--user", "--map-root-user", "--mount"]].map(Space::Disk);
            disks.into_iter().find(works).unwrap_or(Space::FileLimit)
        });
        *FOUND
    }

    /// The program, with no room in `folder`, which it makes.
    pub fn command(self, folder: &Path) -> Command {
        let mut command = self.shell(folder);
        command.arg(env!("CARGO_BIN_EXE_ommatidia"));
        command
    }

    /// A shell that runs the command in its further arguments.
    fn shell(self, folder: &Path) -> Command {
        const DISK: &str = "mount -t tmpfs -o size=4k tmpfs \"$folder\" || exit 97";
        const LIMIT: &str = "trap '' XFSZ; ulimit -f 8";
        let (mut command, full) = match self {
            Self::Disk(options) => {
                let mut command = Command::new("unshare");
                command.args(options).arg("sh");
                (command, DISK)
            }
            Self::FileLimit => (Command::new("sh"), LIMIT),
        };
        let script = format!(
            "folder=$1; shift; mkdir -p \"$folder\"; {full}; \"$@\"; code=$?; left=$(ls -A \"$folder\"); \
             if [ -n \"$left\" ]; then echo \"left behind: $left\" >&2; exit 98; fi; exit $code"
        );
        command.args(["-c", &script, "sh"]).arg(folder);
        command
    }

    /// What would be printed on a full disk.
    pub fn as_full(self, printed: &str) -> String {
        let words = |code| {
            let error = std::io::Error::from_raw_os_error(code);
            [error.to_string(), remedy(&error).to_string()]
        };
        match self {
            Self::Disk(_) => printed.into(),
            Self::FileLimit => words(LARGE).iter().zip(words(FULL)).fold(printed.into(), |p, (a, b)| p.replace(a, &b)),
        }
    }
}
