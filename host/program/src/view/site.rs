//! Answers a browser: the page, the list of files, and what is in them.
//!
//! | path | answer |
//! |---|---|
//! | `/`, its scripts, `/style.css` | the page |
//! | `/files` | the files, their kinds, and the colours of pictures; JSON |
//! | `/file/N` | description of file N, JSON |
//! | `/data/N/G/P/F` | frame F of pane P of group G of file N ([`pixels`]) |
//! | `/reconstruct/N/G/P/F?with=M` | its reconstruction by network M; with `widths=W` its intervals, too |
//! | `/geometry/N` | lenses of instrument N, JSON |
//! | `/psf/N?depth=D&y_um=Y&x_um=X` | its PSFs for a source at a place |
//! | `/report/N` | file N as `ommatidia report` renders it |
//! | `/raw/N` | file N, a page or a picture |

use super::facts;
use super::listing::{Entry, Kind, Listing};
use super::pairs::PairSource;
use super::pixels;
use super::psf::PointSources;
use super::reconstruct::Networks;
use super::session::SessionSource;
use super::source::{Description, Pane, Picture, Source};
use super::stack::StackSource;
use super::tensors::TensorSource;
use crate::http::{Answer, Request, Status};
use anyhow::{Context, ensure};
use ommatidia_network::uncertainty::Widths;
use ommatidia_report::{ABSENT, ColourMap};
use ommatidia_session::{ObjectGrid, SensorSpec, causes};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::SystemTime;

const PAGE: &str = include_str!("view.html");
const STYLE: &str = include_str!("view.css");
const SCRIPTS: [(&str, &str); 3] =
    [("draw.js", include_str!("draw.js")), ("psf.js", include_str!("psf.js")), ("view.js", include_str!("view.js"))];

/// Most files that are open at once.
const MOST_OPEN: usize = 8;
/// Largest page or picture that is sent as it is, bytes.
const LARGEST_RAW: u64 = 256 << 20;

/// Files, ready to be asked for by a browser.
pub struct Site {
    listing: Listing,
    grids: Vec<(SensorSpec, ObjectGrid)>,
    sources: Open<Box<dyn Source>>,
    instruments: Open<PointSources>,
    networks: Mutex<Networks>,
}

/// An error that is not the fault of a file.
struct Missing(String);

type Found<T> = Result<T, Missing>;

impl Site {
    /// A site for the files of a list.
    pub fn new(listing: Listing) -> Self {
        let grids = listing.grids();
        let networks = Mutex::default();
        Self { listing, grids, sources: Open::default(), instruments: Open::default(), networks }
    }

    /// Answers a request. It never fails: what cannot be shown is an answer, too.
    pub fn answer(&self, request: &Request) -> Answer {
        let path: Vec<&str> = request.path.iter().map(String::as_str).collect();
        let json = |value: &Value| Answer::new("application/json", value.to_string());
        let answer = match path[..] {
            [] => return Answer::new("text/html; charset=utf-8", PAGE),
            ["style.css"] => {
                return Answer::new("text/css; charset=utf-8", format!("{}\n{STYLE}", ommatidia_report::STYLE));
            }
            [name] if SCRIPTS.iter().any(|(own, _)| *own == name) => {
                let script = SCRIPTS.iter().find(|(own, _)| *own == name).map_or("", |(_, text)| text);
                return Answer::new("text/javascript; charset=utf-8", script);
            }
            ["files"] => return json(&self.files()),
            ["file", n] => self.entry(n).map(|(n, entry)| self.file(n, entry).map(|value| json(&value))),
            ["data", n, group, pane, frame] => self.frame(n, [group, pane, frame]).map(|(pane, picture)| {
                let Picture { values, label } = picture?;
                Ok(pixels::picture(&values, pane.samples, pane.look, &label))
            }),
            ["reconstruct", n, group, pane, frame] => self.reconstruct(request, n, [group, pane, frame]),
            ["geometry", n] => self.of_kind(n, Kind::Instrument).map(|(n, entry)| {
                let open = self.instruments.get(n, &entry.path, PointSources::open)?;
                Ok(json(&lock(&open).geometry()))
            }),
            ["psf", n] => self.psf(request, n),
            ["report", n] => self.entry(n).map(|(_, entry)| {
                ensure!(entry.kind != Kind::Unshown, entry.why.clone().unwrap_or_default());
                Ok(Answer::page_of_a_file(ommatidia_report::render(std::slice::from_ref(&entry.path))?))
            }),
            ["raw", n] => self.entry(n).map(|(_, entry)| raw(entry)),
            _ => Err(Missing("there is no such page".into())),
        };
        match answer {
            Ok(Ok(answer)) => answer,
            Ok(Err(error)) => Answer::refused(Status::Unshown, &causes(error.as_ref()).join("\n  because: ")),
            Err(Missing(why)) => Answer::refused(Status::NotFound, &why),
        }
    }

    /// The files, and what a page needs to draw any of them.
    fn files(&self) -> Value {
        let maps = [
            ("grey", ColourMap::Grey),
            ("inferno", ColourMap::Inferno),
            ("viridis", ColourMap::Viridis),
            ("diverging", ColourMap::Diverging),
        ];
        let colours: serde_json::Map<String, Value> = maps
            .into_iter()
            .map(|(name, map)| {
                let levels = usize::from(map.levels()) + 1;
                (name.to_string(), json!({ "levels": levels, "rgb": map.palette()[..3 * levels] }))
            })
            .collect();
        json!({
            "version": env!("CARGO_PKG_VERSION"), "files": self.listing.entries, "left_out": self.listing.left_out,
            "colours": colours, "absent": ABSENT,
        })
    }

    fn entry(&self, number: &str) -> Found<(usize, &Entry)> {
        let all = &self.listing.entries;
        let entry = number.parse().ok().and_then(|n: usize| Some((n, all.get(n)?)));
        entry.ok_or_else(|| Missing(format!("there is no file {number}: the list has 0 to {}", all.len().max(1) - 1)))
    }

    fn of_kind(&self, number: &str, kind: Kind) -> Found<(usize, &Entry)> {
        let (n, entry) = self.entry(number)?;
        if entry.kind == kind { Ok((n, entry)) } else { Err(Missing(format!("{}: is of another kind", entry.name))) }
    }

    /// Description of a file.
    fn file(&self, n: usize, entry: &Entry) -> anyhow::Result<Value> {
        let plain = |facts| Description { facts, ..Description::default() };
        let description = match entry.kind {
            Kind::Unshown => anyhow::bail!("{}", entry.why.clone().unwrap_or_default()),
            Kind::Checkpoint | Kind::Network => plain(facts::of_network(entry.frame, entry.object)),
            Kind::Widths => plain(facts::of_widths(&Widths::read(&entry.path)?.made)),
            Kind::Figures | Kind::Page | Kind::Picture => Description::default(),
            _ => {
                let source = self.source(n, entry)?;
                lock(&source).description().clone()
            }
        };
        let report = !matches!(entry.kind, Kind::Page | Kind::Picture | Kind::DataSet | Kind::Widths);
        Ok(json!({ "name": entry.name, "kind": entry.kind, "report": report, "shows": description }))
    }

    fn source(&self, n: usize, entry: &Entry) -> anyhow::Result<Arc<Mutex<Box<dyn Source>>>> {
        self.sources.get(n, &entry.path, |path| {
            Ok(match entry.kind {
                Kind::Stack => Box::new(StackSource::open(path, &self.grids)?) as Box<dyn Source>,
                Kind::Session => Box::new(SessionSource::open(path)?),
                Kind::DataSet => Box::new(PairSource::open(path, &self.grids)?),
                Kind::Instrument => Box::new(TensorSource::instrument(path)?),
                Kind::Account => Box::new(TensorSource::account(path, &self.grids)?),
                Kind::Evaluation => Box::new(TensorSource::evaluation(path)?),
                _ => anyhow::bail!("{}: has no pictures", entry.name),
            })
        })
    }

    /// One picture of a file, by the numbers of its group, pane and frame.
    fn frame(&self, n: &str, at: [&str; 3]) -> Found<(Pane, anyhow::Result<Picture>)> {
        let (n, entry) = self.entry(n)?;
        let [group, pane, frame] = at.map(str::parse::<usize>);
        let (Ok(g), Ok(p), Ok(f)) = (group, pane, frame) else {
            return Err(Missing("group, pane and frame are whole numbers".into()));
        };
        let nothing = |e: anyhow::Error| Missing(causes(e.as_ref()).join("; "));
        let source = self.source(n, entry).map_err(nothing)?;
        let mut source = lock(&source);
        let Some(group) = source.description().groups.get(g) else {
            return Err(Missing(format!("{}: has no group {g}", entry.name)));
        };
        let Some(pane) = group.panes.get(p).cloned() else {
            return Err(Missing(format!("{}: `{}` has no pane {p}", entry.name, group.name)));
        };
        if f >= group.frames {
            let last = group.frames.max(1) - 1;
            return Err(Missing(format!("{}: frame {f}: `{}` has frames 0 to {last}", entry.name, group.name)));
        }
        Ok((pane, source.read(g, p, f)))
    }

    fn reconstruct(&self, request: &Request, n: &str, at: [&str; 3]) -> Found<anyhow::Result<Answer>> {
        let named = |name: &str| {
            self.entry(
                request
                    .value(name)
                    .ok_or_else(|| Missing(format!("the query lacks `{name}`, the number of a file")))?,
            )
        };
        let (_, network) = named("with")?;
        if !matches!(network.kind, Kind::Network | Kind::Checkpoint) {
            return Err(Missing(format!("{}: is no network", network.name)));
        }
        let widths = match request.value("widths") {
            None => None,
            Some(_) => Some(named("widths")?.1).filter(|entry| entry.kind == Kind::Widths),
        };
        let (_, picture) = self.frame(n, at)?;
        let made = |kind| self.listing.entries.iter().filter(move |e| e.kind == kind).map(|e| e.path.clone());
        let instruments: Vec<PathBuf> = made(Kind::Instrument).collect();
        Ok(picture.and_then(|picture| {
            let widths = widths.map(|entry| (entry.path.as_path(), instruments.as_slice()));
            lock(&self.networks).reconstruct(&network.path, &picture.values, widths)
        }))
    }

    fn psf(&self, request: &Request, n: &str) -> Found<anyhow::Result<Answer>> {
        let (n, entry) = self.of_kind(n, Kind::Instrument)?;
        let depth = request.number("depth").unwrap_or(0);
        let (Some(y_um), Some(x_um)) = (request.number("y_um"), request.number("x_um")) else {
            return Err(Missing("the query lacks `y_um` and `x_um`, the place of the source".into()));
        };
        let open = self.instruments.get(n, &entry.path, PointSources::open);
        Ok(open.and_then(|open| lock(&open).foci(depth, [y_um, x_um])))
    }
}

/// A page or a picture, as it is.
fn raw(entry: &Entry) -> anyhow::Result<Answer> {
    ensure!(matches!(entry.kind, Kind::Page | Kind::Picture), "{}: is neither a page nor a picture", entry.name);
    let bytes = std::fs::metadata(&entry.path)?.len();
    ensure!(bytes <= LARGEST_RAW, "{}: is too large to be shown, {bytes} bytes", entry.name);
    let body = std::fs::read(&entry.path).with_context(|| entry.name.clone())?;
    Ok(if entry.kind == Kind::Page { Answer::page_of_a_file(body) } else { Answer::new("image/png", body) })
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Length and time of the last change of a file; of a folder, those of all files in it, but not in folders below it.
type Stamp = (u64, Option<SystemTime>);

fn stamp_of(path: &Path) -> std::io::Result<Stamp> {
    let meta = std::fs::metadata(path)?;
    let mut stamp = (meta.len(), meta.modified().ok());
    if meta.is_dir() {
        // A file that vanishes meanwhile changes the folder, too.
        let inner = std::fs::read_dir(path)?.flatten().filter_map(|entry| std::fs::metadata(entry.path()).ok());
        for file in inner.filter(std::fs::Metadata::is_file) {
            stamp = (stamp.0.wrapping_add(file.len()), stamp.1.max(file.modified().ok()));
        }
    }
    Ok(stamp)
}

/// Files that are open, the last one used last. A file that has changed is opened again.
struct Open<T>(Mutex<Vec<Opened<T>>>);

/// A file that is open: its number, its state when it was opened, and what was made of it.
struct Opened<T> {
    number: usize,
    stamp: Stamp,
    item: Arc<Mutex<T>>,
}

impl<T> Default for Open<T> {
    fn default() -> Self {
        Self(Mutex::default())
    }
}

impl<T> Open<T> {
    /// File `n` at `path`, which `open` opens unless it is open.
    fn get(
        &self,
        n: usize,
        path: &Path,
        open: impl FnOnce(&Path) -> anyhow::Result<T>,
    ) -> anyhow::Result<Arc<Mutex<T>>> {
        let stamp = stamp_of(path).with_context(|| format!("{}: is gone", path.display()))?;
        let mut all = lock(&self.0);
        if let Some(at) = all.iter().position(|file| (file.number, file.stamp) == (n, stamp)) {
            let found = all.remove(at);
            let item = Arc::clone(&found.item);
            all.push(found);
            return Ok(item);
        }
        // Others can be asked for while this one is opened.
        drop(all);
        let item = Arc::new(Mutex::new(open(path)?));
        let mut all = lock(&self.0);
        all.retain(|file| file.number != n);
        if all.len() >= MOST_OPEN {
            all.remove(0);
        }
        all.push(Opened { number: n, stamp, item: Arc::clone(&item) });
        Ok(item)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn a_recording_is_opened_again_when_one_of_its_files_grows() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("0.avi");
        std::fs::write(&file, "ten bytes.").unwrap();
        let open = Open::<usize>::default();
        let opened = |made: usize| *lock(&open.get(0, folder.path(), |_| Ok(made)).unwrap());
        assert_eq!((opened(1), opened(2)), (1, 1));
        std::fs::write(&file, "eleven byte").unwrap();
        assert_eq!((opened(3), opened(4)), (3, 3));
    }
}
