//! What the arguments name: every file and folder that a browser may see, and nothing else.
//!
//! A browser names files by their number in this list, so no request can lead to another one. Files behind links that
//! lead out of a named folder are listed, and not shown; so are files of unknown kinds. The frames of a session are
//! those that its manifest names, wherever they lie.

use anyhow::{Context, bail, ensure};
use ommatidia_closing::account;
use ommatidia_model::dataset::{DataSetPlan, PLAN_FILE};
use ommatidia_model::instrument::INSTRUMENT_KIND;
use ommatidia_network::evaluate::{self, receptive};
use ommatidia_network::network_file::NetworkFile;
use ommatidia_network::uncertainty;
use ommatidia_session::kind::FileKind;
use ommatidia_session::stack::is_zarr;
use ommatidia_session::{FrameReader, Manifest, ObjectGrid, SensorSpec, Session, artifact, causes};
use serde::Serialize;
use serde_json::Value;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Most files that are listed.
const MOST: usize = 2000;
/// Folders within folders that are looked into.
const DEEPEST: usize = 4;

/// Kind of a file that is shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// A stack of frames, or a folder of a recording.
    Stack,
    /// The folder of a session.
    Session,
    /// The folder of a data set.
    DataSet,
    /// An instrument.
    Instrument,
    /// A residual, or the account of a closed loop.
    Account,
    /// An evaluation.
    Evaluation,
    /// A checkpoint.
    Checkpoint,
    /// A network file.
    Network,
    /// Widths of intervals.
    Widths,
    /// Receptive fields, or figures that a command printed: shown as a report.
    Figures,
    /// A page.
    Page,
    /// A picture, .png.
    Picture,
    /// What cannot be shown.
    Unshown,
}

/// A file in the list.
#[derive(Clone, Debug, Serialize)]
pub struct Entry {
    /// Its path, as the arguments name it.
    pub name: String,
    /// Its kind.
    pub kind: Kind,
    /// Why it is not shown.
    pub why: Option<String>,
    /// Rows and columns of the frames that it is for.
    pub frame: Option<[usize; 2]>,
    /// Rows and columns of its objects.
    pub object: Option<[usize; 2]>,
    /// Side of an object pixel, um, where it is known.
    pub object_um: Option<f64>,
    /// Where it lies.
    #[serde(skip)]
    pub path: PathBuf,
    /// Its sensor and its object, which give the size of pixels.
    #[serde(skip)]
    pub grids: Option<(SensorSpec, ObjectGrid)>,
}

/// The files that are shown.
#[derive(Clone, Debug, Default)]
pub struct Listing {
    /// The files, in the order of the arguments and of their names.
    pub entries: Vec<Entry>,
    /// Number of files beyond the most that are listed.
    pub left_out: usize,
    /// Arguments of which nothing can be shown, each with the reason.
    pub refused: Vec<String>,
    seen: BTreeSet<PathBuf>,
}

impl Listing {
    /// Lists files, and the files in folders. An argument of which nothing can be shown is listed with the reason, and
    /// does not keep the others from being shown.
    ///
    /// # Errors
    /// Nothing can be shown: every argument is missing, of a kind that cannot be shown, or a folder without a file that
    /// can be shown.
    pub fn new(paths: &[PathBuf]) -> anyhow::Result<Self> {
        let mut this = Self::default();
        for path in paths {
            let before = this.entries.len();
            if let Err(error) = this.add_argument(path) {
                let why = causes(error.as_ref()).join("; ");
                if this.entries.len() == before {
                    this.entries.push(Entry::unshown(path, why.clone()));
                }
                this.refused.push(why);
            }
        }
        ensure!(this.entries.iter().any(|e| e.kind != Kind::Unshown), "{}", this.refused.join("\n"));
        Ok(this)
    }

    /// Adds what an argument names.
    ///
    /// # Errors
    /// Nothing of it can be shown.
    fn add_argument(&mut self, path: &Path) -> anyhow::Result<()> {
        let named = path.display();
        let root = path.canonicalize().map_err(|e| {
            let remedy = ommatidia_session::remedy(&e);
            anyhow::anyhow!("{named}: cannot be opened ({e}); {remedy}")
        })?;
        if root.is_dir() && plain_folder(path)? {
            self.add_folder(path, &root, 0)?;
            // A file that an argument before has named counts, too.
            let inside = |e: &Entry| e.path.canonicalize().is_ok_and(|whole| whole.starts_with(&root));
            let shown = self.entries.iter().any(|e| e.kind != Kind::Unshown && inside(e));
            ensure!(shown, "{named}: no file in this folder can be shown; name a folder of results, or a file");
            return Ok(());
        }
        let before = self.entries.len();
        self.add(path, &root);
        if let Some(Entry { kind: Kind::Unshown, why: Some(why), .. }) = self.entries.get(before) {
            bail!("{named}: cannot be shown: {why}");
        }
        Ok(())
    }

    /// Sensors and objects of instruments, sessions and evaluations.
    pub fn grids(&self) -> Vec<(SensorSpec, ObjectGrid)> {
        self.entries.iter().filter_map(|e| e.grids).collect()
    }

    fn add_folder(&mut self, folder: &Path, root: &Path, depth: usize) -> anyhow::Result<()> {
        let entries = std::fs::read_dir(folder).with_context(|| folder.display().to_string())?;
        let mut paths: Vec<PathBuf> = entries.flatten().map(|e| e.path()).collect();
        paths.retain(|p| p.file_name().is_some_and(|n| !n.to_string_lossy().starts_with('.')));
        paths.sort();
        for path in paths {
            let inside = path.canonicalize().is_ok_and(|whole| whole.starts_with(root));
            if inside && path.is_dir() && plain_folder(&path).unwrap_or(false) {
                if depth < DEEPEST {
                    self.add_folder(&path, root, depth + 1)?;
                }
            } else {
                self.add(&path, root);
            }
        }
        Ok(())
    }

    fn add(&mut self, path: &Path, root: &Path) {
        if self.entries.len() >= MOST {
            self.left_out += 1;
            return;
        }
        let whole = path.canonicalize().ok().filter(|whole| whole.starts_with(root));
        if whole.as_ref().is_some_and(|whole| !self.seen.insert(whole.clone())) {
            return;
        }
        let entry = match whole {
            None => Entry::unshown(path, "it is a link that leads out of the folder, or nowhere".into()),
            Some(_) => Entry::of(path),
        };
        self.entries.push(entry);
    }
}

impl Entry {
    /// A file that is not shown, and why.
    fn unshown(path: &Path, why: String) -> Self {
        Self {
            name: path.display().to_string(),
            kind: Kind::Unshown,
            why: Some(why),
            frame: None,
            object: None,
            object_um: None,
            path: path.into(),
            grids: None,
        }
    }

    /// A file, or why it is not shown.
    fn of(path: &Path) -> Self {
        let mut entry = Self { why: None, ..Self::unshown(path, String::new()) };
        match entry.look() {
            Ok(()) => entry,
            Err(why) => Self::unshown(path, causes(why.as_ref()).join("; ")),
        }
    }

    /// Finds out what the file is.
    fn look(&mut self) -> anyhow::Result<()> {
        let path = &self.path;
        let meta = std::fs::metadata(path)?;
        // Opening a pipe would wait for its other end.
        ensure!(meta.is_file() || meta.is_dir(), "it is neither a file nor a folder");
        self.kind = match FileKind::of(path)? {
            FileKind::Artifact(kind) => {
                let body = artifact::inspect(path)?["body"].take();
                match kind.as_str() {
                    INSTRUMENT_KIND => {
                        let m: Manifest = serde_json::from_value(body["manifest"].clone())?;
                        self.are(m.sensor, m.object);
                        Kind::Instrument
                    }
                    evaluate::KIND => {
                        let grid = |name: &str| body[name].clone();
                        self.are(serde_json::from_value(grid("sensor"))?, serde_json::from_value(grid("object"))?);
                        Kind::Evaluation
                    }
                    account::KIND => Kind::Account,
                    uncertainty::KIND => Kind::Widths,
                    receptive::KIND => Kind::Figures,
                    "checkpoint" => {
                        self.frame = size(&body["network"]["frame"]);
                        self.object = size(&body["network"]["object"]);
                        Kind::Checkpoint
                    }
                    "shard" => bail!("it is a part of a data set, whose {PLAN_FILE} is missing"),
                    other => bail!("it is an artifact of kind `{other}`, which this version does not know"),
                }
            }
            FileKind::Blob => {
                let header = NetworkFile::read(path)?.header()?;
                let size = |s: ommatidia_shared::blob::Size| Some([s.rows.into(), s.cols.into()]);
                (self.frame, self.object) = (size(header.frame), size(header.object));
                Kind::Network
            }
            FileKind::Session => {
                let session = Session::open(path)?;
                self.are(session.manifest().sensor, session.manifest().object);
                Kind::Session
            }
            FileKind::Folder if path.join(PLAN_FILE).is_file() => {
                let plan = DataSetPlan::read(path)?;
                (self.frame, self.object) = (Some(plan.frame), Some(plan.object));
                Kind::DataSet
            }
            FileKind::Folder | FileKind::Stack => {
                // Its frames are not read here.
                FrameReader::open(path)?;
                Kind::Stack
            }
            FileKind::Json => {
                let file = std::io::BufReader::new(std::fs::File::open(path)?);
                serde_json::from_reader::<_, serde::de::IgnoredAny>(file)
                    .context("it begins as JSON, but is damaged or cut short")?;
                Kind::Figures
            }
            FileKind::Page => Kind::Page,
            FileKind::Picture => Kind::Picture,
            found @ FileKind::Manifest => bail!("it is {found}{}", found.advice()),
            found @ (FileKind::Tensors | FileKind::Unknown) => {
                bail!("it is {found}; expected frames, a session, a data set, an artifact, a network file or a page")
            }
        };
        Ok(())
    }

    fn are(&mut self, sensor: SensorSpec, object: ObjectGrid) {
        (self.grids, self.object_um) = (Some((sensor, object)), Some(object.pixel_um));
        (self.frame, self.object) = (Some([sensor.rows, sensor.cols]), Some([object.rows, object.cols]));
    }
}

/// Rows and columns of a header.
fn size(value: &Value) -> Option<[usize; 2]> {
    serde_json::from_value(value.clone()).ok()
}

/// Whether a folder is none of the folders that are one thing: a session, a data set, an OME-Zarr, a recording.
fn plain_folder(path: &Path) -> anyhow::Result<bool> {
    let one = FileKind::of(path)? == FileKind::Session
        || path.join(PLAN_FILE).is_file()
        || is_zarr(path)
        || is_recording(path)?;
    Ok(!one)
}

/// Whether a folder holds one recording: numbered files of frames, and beside them nothing but tables and notes.
fn is_recording(path: &Path) -> anyhow::Result<bool> {
    let beside = ["csv", "json", "txt", "dat", "toml", "md"];
    let entries = std::fs::read_dir(path).with_context(|| path.display().to_string())?;
    let mut frames = 0;
    for file in entries.flatten().map(|e| e.path()).filter(|p| p.is_file()) {
        let suffix = file.extension().map(|s| s.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
        let hidden = file.file_name().is_some_and(|n| n.to_string_lossy().starts_with('.'));
        match suffix.as_str() {
            _ if hidden => {}
            "avi" | "tif" | "tiff" => frames += 1,
            suffix if beside.contains(&suffix) => {}
            _ => return Ok(false),
        }
    }
    // Files whose names differ in more than a number are not parts of one thing.
    let numbered = |r: FrameReader| {
        let numbers: BTreeSet<u64> = r.parts().iter().filter_map(|part| part.number).collect();
        numbers.len() == r.parts().len()
    };
    Ok(frames > 0 && FrameReader::open(path).is_ok_and(numbered))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use ndarray::Array3;
    use ommatidia_session::stack;

    fn frames(path: &Path) {
        stack::write(path, Array3::from_elem((2, 3, 4), 7.0).view()).unwrap();
    }

    fn names(listing: &Listing, folder: &Path) -> Vec<(String, Kind)> {
        let start = format!("{}/", folder.display());
        listing.entries.iter().map(|e| (e.name.replace(&start, ""), e.kind)).collect()
    }

    #[test]
    fn folders_are_listed_and_recordings_are_one_thing() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        std::fs::create_dir_all(at("run/inner")).unwrap();
        std::fs::create_dir_all(at("results")).unwrap();
        frames(&at("run/inner/0.tif"));
        frames(&at("run/inner/1.tif"));
        std::fs::write(at("run/inner/notes.txt"), "x").unwrap();
        frames(&at("results/raw.npy"));
        frames(&at("results/objects.tif"));
        std::fs::write(at("results/figures.json"), "{}").unwrap();
        std::fs::write(at(".hidden.json"), "{}").unwrap();
        std::fs::write(at("table.csv"), "a,b").unwrap();
        instrument(&at("lab.instrument"));
        let again = [folder.path().into(), at("results/raw.npy"), at("results")];
        let listing = Listing::new(&again).unwrap();
        let expected = [
            ("lab.instrument", Kind::Instrument),
            ("results/figures.json", Kind::Figures),
            ("results/objects.tif", Kind::Stack),
            ("results/raw.npy", Kind::Stack),
            ("run/inner", Kind::Stack),
            ("table.csv", Kind::Unshown),
        ];
        assert_eq!(names(&listing, folder.path()), expected.map(|(n, k)| (n.to_string(), k)));
        assert!(listing.entries[5].why.as_deref().is_some_and(|why| why.contains("an unknown file")));
        assert_eq!(listing.entries[0].frame, Some([30, 33]));
        assert_eq!(listing.grids().len(), 1);
    }

    fn instrument(path: &Path) {
        let instrument = ommatidia_model::testing::instrument([9, 11], [30, 33], 5, 3);
        instrument.write(path, artifact::Provenance::default()).unwrap();
    }

    #[cfg(unix)]
    #[test]
    fn links_out_of_a_folder_and_pipes_are_not_shown() {
        let (folder, other) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        frames(&other.path().join("secret.npy"));
        frames(&folder.path().join("own.npy"));
        let link = |name: &str, to: &Path| std::os::unix::fs::symlink(to, folder.path().join(name)).unwrap();
        link("file.npy", &other.path().join("secret.npy"));
        link("folder", other.path());
        link("nowhere", Path::new("/no/such/file"));
        link("same.npy", &folder.path().join("own.npy"));
        let listing = Listing::new(&[folder.path().into()]).unwrap();
        let shown: Vec<_> = listing.entries.iter().filter(|e| e.kind != Kind::Unshown).collect();
        assert_eq!(shown.len(), 1, "{shown:?}");
        assert!(shown[0].name.ends_with("own.npy"));
        let why = listing.entries[0].why.as_deref().unwrap();
        assert!(why.contains("leads out"), "{why}");
        // The same file is shown if it is named itself.
        let named = Listing::new(&[folder.path().join("file.npy")]).unwrap();
        assert_eq!(named.entries[0].kind, Kind::Stack);
    }

    #[test]
    fn arguments_that_cannot_be_shown_are_errors() {
        let folder = tempfile::tempdir().unwrap();
        let error = |path: PathBuf| Listing::new(&[path]).unwrap_err().to_string();
        assert!(error(folder.path().join("none.npy")).contains("check its name"));
        assert!(error(folder.path().into()).contains("no file in this folder"));
        std::fs::write(folder.path().join("x.csv"), "a,b").unwrap();
        assert!(error(folder.path().join("x.csv")).contains("cannot be shown: it is an unknown file"));
        assert!(error(folder.path().into()).contains("no file in this folder"));
    }

    #[test]
    fn one_argument_that_cannot_be_shown_is_listed_beside_the_others() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        frames(&at("own.npy"));
        std::fs::write(at("x.csv"), "a,b").unwrap();
        // Recognised by their first bytes, and not readable all the same.
        std::fs::write(at("figures.json"), "{\"rank\": ").unwrap();
        std::fs::write(at("film.mp4"), b"\0\0\0\x20ftypisom and more").unwrap();
        std::fs::write(at("cut.npy"), b"\x93NUMPY\x01\0").unwrap();
        std::fs::create_dir(at("empty")).unwrap();
        let names = ["none.npy", "x.csv", "own.npy", "figures.json", "film.mp4", "cut.npy", "empty"];
        let listing = Listing::new(&names.map(at)).unwrap();
        let shown: Vec<&Entry> = listing.entries.iter().filter(|e| e.kind != Kind::Unshown).collect();
        assert!(shown.len() == 1 && shown[0].path == at("own.npy"), "{shown:?}");
        assert!(listing.entries.iter().all(|e| e.kind != Kind::Unshown || e.why.is_some()));
        let refused = listing.refused.join("\n");
        for name in names.iter().filter(|name| **name != "own.npy") {
            assert!(refused.contains(name), "{name}: {refused}");
            assert!(listing.entries.iter().any(|e| e.path == at(name) && e.kind == Kind::Unshown), "{name}");
        }
        assert!(refused.contains("damaged or cut short") && refused.contains("check its name"), "{refused}");
    }
}
