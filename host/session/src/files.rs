//! What a verb reads and writes, and the rule for all of them: no run costs anybody a file.
//!
//! 1. An output is never an input, by whatever name.
//! 2. An output never replaces a file of another kind, nor a folder that this verb did not fill.
//! 3. An output that exists is kept, unless `--force` is given or the verb continues what is there.
//! 4. No output lies in the folder of a recording that is read: its reader would take it for a part of the recording.
//! 5. One run at a time writes a file or folder: it holds a lock while it runs.
//!
//! Every verb lists its files ([`Files`]); [`Files::hold`] checks the rule before the verb begins its work.

mod ours;

pub use super::lock::Lock;

use super::artifact::folder_of;
use super::kind::FileKind;
use super::stack::folder_of_recording;
use super::{MANIFEST, Manifest};
use anyhow::{Context, bail};
use same_file::is_same_file;
use std::path::{Path, PathBuf};

/// What a verb reads and writes.
#[derive(Debug, Default)]
pub struct Files {
    reads: Vec<PathBuf>,
    writes: Vec<Output>,
    share: Option<String>,
    hint: &'static str,
    after_stop: Option<&'static str>,
}

/// A file or folder that a verb writes.
#[derive(Debug)]
struct Output {
    path: PathBuf,
    content: Content,
    existing: Existing,
}

/// What an output holds, which decides what it may replace.
#[derive(Clone, Debug)]
pub enum Content {
    /// A file that is recognised by its content.
    File(FileKind),
    /// A text that begins with these characters.
    Text(&'static str),
    /// The flash memory of an emulated board: a file of this many bytes.
    Flash(u64),
    /// A folder that may be continued or replaced if it holds this file.
    Folder(&'static str),
    /// A folder in which every entry has a name that this function accepts.
    Named(fn(&str) -> bool),
    /// A folder of Zarr that this program wrote, and nothing else in it.
    Zarr,
    /// A session as `import` wrote it, and nothing else in its folder.
    Imported,
}

/// What becomes of an output that exists.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Existing {
    /// It is kept, and the run ends with an error, unless `--force` is given.
    Keep,
    /// The verb continues or updates it.
    Continue,
}

impl Content {
    /// An artifact of a kind, see [`FileKind::Artifact`].
    pub fn artifact(kind: &str) -> Self {
        Self::File(FileKind::Artifact(kind.into()))
    }

    /// What is expected at the path, for messages.
    fn name(&self) -> String {
        match self {
            Self::File(kind) => kind.to_string(),
            Self::Text(start) => format!("a text that begins with `{}`", start.trim_end()),
            Self::Flash(bytes) => format!("the flash memory of a board, {bytes} bytes"),
            Self::Folder(marker) => format!("an empty folder, or one with a {marker}"),
            Self::Named(_) => "an empty folder, or that of an earlier run".into(),
            Self::Zarr => "an empty folder, or a Zarr that this program wrote".into(),
            Self::Imported => "an empty folder, or a session as `import` wrote it".into(),
        }
    }

    /// What is wrong with what exists at the path; `None` if it is of this kind.
    fn misfit(&self, path: &Path) -> anyhow::Result<Option<String>> {
        let named = || path.display().to_string();
        let file = std::fs::metadata(path).with_context(named)?;
        if let Self::Folder(_) | Self::Named(_) | Self::Zarr | Self::Imported = self {
            if !file.is_dir() {
                return Ok(Some("a file".into()));
            }
            let names = ours::names(path).with_context(named)?;
            return match self {
                Self::Folder(marker) if names.is_empty() || names.iter().any(|n| n == marker) => Ok(None),
                Self::Named(known) => Ok(names.into_iter().find(|name| !known(name))),
                Self::Zarr => ours::not_of_our_zarr(path).with_context(named),
                Self::Imported => ours::not_of_our_import(path).with_context(named),
                _ => Ok(names.into_iter().next()),
            };
        }
        if file.is_dir() {
            return Ok(Some("a folder".into()));
        }
        if !file.is_file() {
            return Ok(Some("neither a file nor a folder".into()));
        }
        if file.len() == 0 {
            return Ok(None);
        }
        Ok(match self {
            Self::File(kind) => match FileKind::of(path) {
                Ok(found) if found == *kind => None,
                Ok(found) => Some(found.to_string()),
                Err(_) => Some("a file that cannot be read".into()),
            },
            Self::Text(start) => {
                let found = std::fs::read(path).with_context(named)?;
                (!found.starts_with(start.as_bytes())).then(|| "another file".into())
            }
            Self::Flash(bytes) => (file.len() != *bytes).then(|| format!("a file of {} bytes", file.len())),
            Self::Folder(_) | Self::Named(_) | Self::Zarr | Self::Imported => None,
        })
    }
}

impl Files {
    /// Files and folders that a verb reads.
    pub fn reading<P: AsRef<Path>>(paths: impl IntoIterator<Item = P>) -> Self {
        Self::default().and_reading(paths)
    }

    /// Further files and folders that it reads.
    pub fn and_reading<P: AsRef<Path>>(mut self, paths: impl IntoIterator<Item = P>) -> Self {
        self.reads.extend(paths.into_iter().map(|path| path.as_ref().to_path_buf()));
        self
    }

    /// Outputs of one kind (none or one for an option) that are kept where they exist.
    pub fn writing<P: AsRef<Path>>(self, paths: impl IntoIterator<Item = P>, content: Content) -> Self {
        self.with(paths, &content, Existing::Keep)
    }

    /// Outputs of one kind that the verb continues where they exist.
    pub fn continuing<P: AsRef<Path>>(self, paths: impl IntoIterator<Item = P>, content: Content) -> Self {
        self.with(paths, &content, Existing::Continue)
    }

    /// This run writes only a share of its outputs, so that runs with other shares may write beside it.
    pub fn share(self, share: impl ToString) -> Self {
        Self { share: Some(share.to_string().replace('/', "-of-")), ..self }
    }

    /// As [`Files::share`], for a run that may have one.
    pub fn share_of(self, share: Option<impl ToString>) -> Self {
        match share {
            Some(share) => self.share(share),
            None => self,
        }
    }

    /// How to go on after a run was stopped, for the message.
    pub fn after_stop(self, how: &'static str) -> Self {
        Self { after_stop: Some(how), ..self }
    }

    /// The files that lock the outputs while a run writes them.
    pub fn locks(&self) -> Vec<PathBuf> {
        self.writes.iter().map(|output| Lock::path_of(&output.path, self.share.as_deref())).collect()
    }

    /// The outputs, and how to go on after a run was stopped.
    pub fn advice(&self) -> (Vec<PathBuf>, &'static str) {
        let outputs = self.writes.iter().map(|output| output.path.clone()).collect();
        (outputs, self.after_stop.unwrap_or("no output was changed: run the same command again"))
    }

    /// What else one can do where an output exists, for the message: begins with a comma.
    pub fn hint(self, hint: &'static str) -> Self {
        Self { hint, ..self }
    }

    fn with<P: AsRef<Path>>(
        mut self,
        paths: impl IntoIterator<Item = P>,
        content: &Content,
        existing: Existing,
    ) -> Self {
        let output = |path: P| Output { path: path.as_ref().into(), content: content.clone(), existing };
        self.writes.extend(paths.into_iter().map(output));
        self
    }

    /// Checks the rule and locks all outputs, until the locks are dropped. `force` replaces outputs of the same kind.
    ///
    /// # Errors
    /// An output breaks the rule, its folder is missing or not writable, or another run is writing it.
    pub fn hold(&self, force: bool) -> anyhow::Result<Vec<Lock>> {
        for (i, output) in self.writes.iter().enumerate() {
            if self.writes[..i].iter().any(|other| same(&other.path, &output.path)) {
                bail!("{}: named for two outputs; give each a name of its own", output.path.display());
            }
            self.check(output, force)?;
        }
        self.writes.iter().map(|output| Lock::of(&output.path, self.share.as_deref())).collect()
    }

    fn check(&self, Output { path, content, existing }: &Output, force: bool) -> anyhow::Result<()> {
        let named = path.display();
        if self.reads.iter().any(|read| same(read, path)) {
            bail!("{named}: this is an input of the command, which no output replaces; choose another name");
        }
        let folder = folder_of(path);
        if folder.is_file() {
            bail!("{named}: {} is a file, not a folder; choose another name", folder.display());
        }
        if !folder.is_dir() {
            bail!("{named}: the folder {} does not exist; create it, or choose another", folder.display());
        }
        if let Some(recording) = self.reads.iter().flat_map(|read| recordings(read)).find(|r| lies_in(path, r)) {
            let recording = recording.display();
            bail!(
                "{named}: lies in the recording {recording}, which the command reads: the next reader would take it \
                 for a part of the recording; choose another folder"
            );
        }
        if !path.exists() {
            return Ok(());
        }
        if let Some(found) = content.misfit(path)? {
            let expected = content.name();
            bail!("{named}: expected {expected}, found {found}, which is never replaced; choose another name");
        }
        if let Some(input) = self.reads.iter().find(|read| lies_in(path, read)).filter(|_| !content.is_result()) {
            let input = input.display();
            bail!(
                "{named}: lies in {input}, an input of the command, whose files are never replaced; choose another name"
            );
        }
        if folder.join(MANIFEST).is_file() && !content.is_result() {
            bail!("{named}: lies in the folder of a session, whose files are never replaced; choose another name");
        }
        if *existing == Existing::Keep && !force {
            let hint = self.hint;
            bail!("{named}: exists already and is kept; choose another name, or replace it with --force{hint}");
        }
        Ok(())
    }
}

impl Content {
    /// Whether a file of this kind is never one of the measured files of a folder.
    fn is_result(&self) -> bool {
        match self {
            Self::File(FileKind::Artifact(kind)) => kind != "shard",
            Self::File(kind) => matches!(kind, FileKind::Blob | FileKind::Page | FileKind::Picture),
            _ => false,
        }
    }
}

/// Whether two paths name the same file or folder; of those that do not exist, whether they are the same path.
fn same(a: &Path, b: &Path) -> bool {
    is_same_file(a, b).unwrap_or_else(|_| {
        let whole = |p: &Path| Some(folder_of(p).canonicalize().ok()?.join(p.file_name()?));
        a == b || whole(a).is_some_and(|a| Some(a) == whole(b))
    })
}

/// Whether a file lies in a folder, or a folder below it, or would if it existed.
fn lies_in(path: &Path, folder: &Path) -> bool {
    match (folder_of(path).canonicalize(), folder.canonicalize()) {
        (Ok(path), Ok(folder)) => folder.is_dir() && path.starts_with(&folder),
        _ => false,
    }
}

/// The folders of recordings that a command reads with an input: its own, or those that the manifest of a session
/// names.
fn recordings(input: &Path) -> Vec<PathBuf> {
    let manifest = input.join(MANIFEST);
    let Some(text) = std::fs::read_to_string(&manifest).ok() else {
        return folder_of_recording(input).into_iter().collect();
    };
    // What is wrong with a manifest is said where the session is opened.
    let stacks = Manifest::parse(&manifest, &text).map(|m| m.stacks).unwrap_or_default();
    stacks.iter().filter_map(|stack| folder_of_recording(&input.join(&stack.file))).collect()
}
