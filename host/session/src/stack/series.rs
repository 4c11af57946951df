//! A stack in an AVI, or spread over the numbered files of a folder: AVIs, or TIFFs.

use super::avi::{Movie, MovieReader};
use super::layout::{Shape, StackScale};
use super::names::{self, last_number, listed, name, natural};
use super::tif::TifSource;
use crate::error::SessionError;
use std::path::{Path, PathBuf};

/// One file of a stack that is spread over several, and what is in it.
#[derive(Clone, Debug, PartialEq)]
pub struct Part {
    /// The file.
    pub path: PathBuf,
    /// Number in the name of the file.
    pub number: Option<u64>,
    /// Number of whole frames, which are the frames of the stack.
    pub frames: usize,
    /// Number of frames that the file lists, whole or not.
    pub listed: usize,
    /// Which of the listed frames have no data, counted from 0.
    pub empty: Vec<usize>,
    /// Which of the listed frames end too early or have a damaged head, counted from 0.
    pub torn: Vec<usize>,
    /// What is wrong with the file, if anything is.
    pub damage: Option<String>,
    /// Of the frames that have been read, those whose compressed data are damaged: the number of each among the listed
    /// ones, counted from 0, and what the decoder says.
    pub damaged: Vec<(usize, String)>,
    /// Whether codes are of limited range, as of videos for the eye: black is 16 and white 235 (of 8 bits).
    pub limited: bool,
    /// What is taken of a video that is coded with colours: its luma, or its green.
    pub taken_of_colours: Option<&'static str>,
}

impl Part {
    fn new(number: Option<u64>, path: PathBuf) -> Self {
        let (empty, torn, damaged) = Default::default();
        let (damage, limited, taken_of_colours) = (None, false, None);
        Self { path, number, frames: 0, listed: 0, empty, torn, damage, damaged, limited, taken_of_colours }
    }

    /// The number of each whole frame among the listed ones, counted from 0.
    pub fn places(&self) -> impl Iterator<Item = usize> + '_ {
        (0..self.listed).filter(|i| self.empty.binary_search(i).is_err() && self.torn.binary_search(i).is_err())
    }

    /// Notes what is wrong with whole frame `frame`, once.
    fn found_damaged(&mut self, frame: usize, what: String) {
        let place = self.places().nth(frame).unwrap_or(frame);
        if let Err(at) = self.damaged.binary_search_by_key(&place, |(known, _)| *known) {
            self.damaged.insert(at, (place, what));
        }
    }
}

/// An open stack of several files. One file is open at a time.
#[derive(Debug)]
pub(super) struct SeriesSource {
    parts: Vec<Part>,
    contents: Vec<Content>,
    /// Number of frames before each part.
    starts: Vec<usize>,
    pub scale: StackScale,
    open: Option<(usize, Open)>,
}

#[derive(Debug)]
enum Content {
    Movie(Box<Movie>),
    Tif,
    /// Damaged: no frames.
    Nothing,
}

#[derive(Debug)]
enum Open {
    Movie(Box<MovieReader>),
    Tif(Box<TifSource>),
}

impl SeriesSource {
    /// Opens one AVI.
    pub fn of_file(path: &Path) -> Result<(Shape, Self), SessionError> {
        Self::of(path, vec![(None, path.into())])
    }

    /// Opens the numbered AVIs of a folder, or its numbered TIFFs.
    pub fn of_folder(path: &Path) -> Result<(Shape, Self), SessionError> {
        let files = numbered_files(path)?;
        Self::of(path, files)
    }

    fn of(path: &Path, files: Vec<(Option<u64>, PathBuf)>) -> Result<(Shape, Self), SessionError> {
        let one = files.len() == 1;
        let (mut parts, mut contents, mut starts): (Vec<Part>, Vec<Content>, Vec<usize>) = Default::default();
        let mut whole: Option<(Shape, StackScale)> = None;
        let mut first_error = None;
        for (number, file) in files {
            let mut part = Part::new(number, file);
            let content = match part_of(&mut part) {
                Ok((shape, scale, content)) => {
                    whole = Some(joined(whole, shape, scale, &part)?);
                    content
                }
                // A file that a recorder began and did not finish. Whether it matters is for the reader of `parts`.
                Err(e @ (SessionError::Format { .. } | SessionError::Size { .. })) if !one => {
                    part.damage = Some(e.without_path());
                    first_error = first_error.or(Some(e));
                    Content::Nothing
                }
                Err(e) => return Err(e),
            };
            starts.push(parts.iter().map(|p: &Part| p.frames).sum());
            parts.push(part);
            contents.push(content);
        }
        match (whole, first_error) {
            (Some((shape, scale)), _) => Ok((shape, Self { parts, contents, starts, scale, open: None })),
            (None, Some(error)) => Err(error),
            (None, None) => Err(nothing(path, "no such file")),
        }
    }

    pub fn parts(&self) -> &[Part] {
        &self.parts
    }

    pub fn read(&mut self, i: usize) -> Result<Vec<f32>, SessionError> {
        // The last part that begins at or before the frame; parts without frames begin where the next one does.
        let part = self.starts.partition_point(|start| *start <= i).saturating_sub(1);
        let within = i - self.starts[part];
        let path = &self.parts[part].path;
        let open = match self.open.take().filter(|(at, _)| *at == part) {
            Some(open) => open,
            None => (part, opened(path, &self.contents[part])?),
        };
        let (_, open) = self.open.insert(open);
        match (open, &self.contents[part]) {
            (Open::Movie(reader), Content::Movie(movie)) => {
                let decoded = reader.read(path, movie, within)?;
                if let Some(what) = decoded.damage {
                    self.parts[part].found_damaged(within, what);
                }
                Ok(decoded.values)
            }
            (Open::Tif(source), _) => source.read(path, within),
            _ => Err(SessionError::format(path, "stack", format!("frame {i} is gone"))),
        }
    }
}

fn opened(path: &Path, content: &Content) -> Result<Open, SessionError> {
    match content {
        Content::Movie(_) => Ok(Open::Movie(Box::new(MovieReader::open(path)?))),
        _ => Ok(Open::Tif(Box::new(TifSource::open(path)?.1))),
    }
}

/// Reads the headers of one file.
fn part_of(part: &mut Part) -> Result<(Shape, StackScale, Content), SessionError> {
    if !is_avi(&part.path) {
        let (shape, source) = TifSource::open(&part.path)?;
        (part.frames, part.listed) = (shape.len, shape.len);
        return Ok((shape, source.scale, Content::Tif));
    }
    let mut movie = Movie::open(&part.path)?;
    (part.frames, part.listed) = (movie.frames(), movie.slots);
    (part.empty, part.torn) = (std::mem::take(&mut movie.empty), std::mem::take(&mut movie.torn));
    (part.damage, part.limited) = (movie.damage.take(), movie.limited);
    part.taken_of_colours = movie.taken_of_colours();
    let shape = Shape { len: part.frames, rows: movie.rows, cols: movie.cols, samples: movie.samples };
    let scale = StackScale { pixel_um: None, interval_s: movie.interval_s };
    Ok((shape, scale, Content::Movie(Box::new(movie))))
}

/// The shape of all parts so far and one more.
fn joined(
    before: Option<(Shape, StackScale)>,
    next: Shape,
    scale: StackScale,
    part: &Part,
) -> Result<(Shape, StackScale), SessionError> {
    let Some((shape, scale)) = before else { return Ok((next, scale)) };
    if (next.rows, next.cols, next.samples) != (shape.rows, shape.cols, shape.samples) {
        return Err(SessionError::Shape {
            path: part.path.clone(),
            expected: format!("{} x {} {}, as the files before", shape.rows, shape.cols, shape.samples.name()),
            found: format!("{} x {} {}", next.rows, next.cols, next.samples.name()),
            remedy: "give recordings of different shapes folders of their own",
        });
    }
    Ok((Shape { len: shape.len + next.len, ..shape }, scale))
}

pub(super) fn is_avi(path: &Path) -> bool {
    path.extension().is_some_and(|e| e.eq_ignore_ascii_case("avi"))
}

fn is_tif(path: &Path) -> bool {
    path.extension().is_some_and(|e| e.eq_ignore_ascii_case("tif") || e.eq_ignore_ascii_case("tiff"))
}

/// The AVIs of a folder that are no part of its recording: videos of another camera.
pub fn left_out(folder: &Path, parts: &[Part]) -> Vec<String> {
    // A folder of TIFFs may have very many.
    if !parts.first().is_some_and(|part| is_avi(&part.path)) {
        return Vec::new();
    }
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|e| e.path());
    let other = |p: &PathBuf| is_avi(p) && !name(p).starts_with('.') && !parts.iter().any(|part| part.path == *p);
    let mut names: Vec<String> = entries.filter(other).map(|p| name(&p)).collect();
    names.sort_by_cached_key(|name| natural(name));
    names
}

/// The numbered AVIs of a folder, or its TIFFs, in the order of the numbers in their names.
fn numbered_files(folder: &Path) -> Result<Vec<(Option<u64>, PathBuf)>, SessionError> {
    let entries = std::fs::read_dir(folder).map_err(|e| SessionError::io(folder, e))?;
    let paths = entries.map(|e| Ok(e?.path())).collect::<std::io::Result<Vec<_>>>();
    let mut paths = paths.map_err(|e| SessionError::io(folder, e))?;
    // Hidden files are those of other systems, such as `._0.avi` of a Mac.
    paths.retain(|p| p.is_file() && !name(p).starts_with('.'));
    let avis: Vec<PathBuf> = paths.iter().filter(|p| is_avi(p)).cloned().collect();
    let tifs: Vec<PathBuf> = paths.into_iter().filter(|p| is_tif(p)).collect();
    if avis.is_empty() && tifs.is_empty() {
        return Err(nothing(folder, &what_is_there(folder)));
    }
    if avis.is_empty() {
        let tifs = names::in_order(folder, tifs)?;
        return Ok(tifs.into_iter().map(|p| (last_number(&p), p)).collect());
    }
    if let Some(tif) = tifs.iter().min() {
        let first = avis.iter().min().unwrap_or(tif);
        let found = format!("AVIs, such as {}, and TIFFs, such as {}", name(first), name(tif));
        let remedy = "move the files that are no frames of the recording out of the folder, or name one file";
        return Err(SessionError::value(folder, "files of frames", "AVIs or TIFFs", found, remedy));
    }
    let mut numbered: Vec<(String, u64, PathBuf)> = Vec::new();
    for path in &avis {
        if let Some(number) = last_number(path) {
            let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
            let prefix = stem.trim_end_matches(|c: char| c.is_ascii_digit()).to_string();
            numbered.push((prefix, number, path.clone()));
        }
    }
    if numbered.is_empty() && avis.len() == 1 {
        return Ok(vec![(None, avis[0].clone())]);
    }
    let mut prefixes: Vec<&str> = numbered.iter().map(|(prefix, ..)| prefix.as_str()).collect();
    prefixes.sort_unstable();
    prefixes.dedup();
    // Version 3 writes the videos of the miniscope and of the camera over the arena into one folder.
    let is_miniscope = |prefix: &str| prefix.eq_ignore_ascii_case("msCam");
    let of_version_3 = prefixes.iter().all(|p| is_miniscope(p) || p.to_lowercase().starts_with("behavcam"));
    if prefixes.len() > 1 && of_version_3 && numbered.len() == avis.len() {
        numbered.retain(|(prefix, ..)| is_miniscope(prefix));
        return in_order(folder, numbered);
    }
    if prefixes.len() != 1 || numbered.len() != avis.len() {
        let mut named: Vec<&PathBuf> = avis.iter().collect();
        named.sort_by_cached_key(|p| natural(&name(p)));
        return Err(SessionError::value(
            folder,
            "AVI files",
            "one recording in names that end in their number: 0.avi, 1.avi, ...",
            listed(&named),
            "rename them so, or put each recording into a folder of its own, or name one file",
        ));
    }
    in_order(folder, numbered)
}

/// The files in the order of their numbers, each of which a recorder gives once.
fn in_order(
    folder: &Path,
    mut numbered: Vec<(String, u64, PathBuf)>,
) -> Result<Vec<(Option<u64>, PathBuf)>, SessionError> {
    numbered.sort_by(|a, b| (a.1, &a.2).cmp(&(b.1, &b.2)));
    if let Some(pair) = numbered.windows(2).find(|pair| pair[0].1 == pair[1].1) {
        let found = format!("{} and {} with the same number, {}", name(&pair[0].2), name(&pair[1].2), pair[0].1);
        let remedy = "leave one of them out of the folder: a copy, or a file of another recording";
        return Err(SessionError::value(folder, "AVI files", "one file of each number", found, remedy));
    }
    Ok(numbered.into_iter().map(|(_, number, path)| (Some(number), path)).collect())
}

/// The folder of a recording that a path names: a folder that holds files of frames, or an array of Zarr, and is no
/// session; or the folder of a Miniscope that a single AVI is named of. `None`: it is no part of such a folder.
pub fn folder_of_recording(path: &Path) -> Option<PathBuf> {
    if !path.is_dir() {
        let folder = crate::artifact::folder_of(path);
        return (is_avi(path) && crate::import::is_of_recorder(folder)).then(|| folder.into());
    }
    if super::is_zarr(path) {
        return Some(path.into());
    }
    let frames = |p: &PathBuf| (is_avi(p) || is_tif(p)) && !name(p).starts_with('.');
    let holds = || std::fs::read_dir(path).is_ok_and(|entries| entries.flatten().map(|e| e.path()).any(|p| frames(&p)));
    (!path.join(crate::MANIFEST).is_file() && holds()).then(|| path.into())
}

/// A folder without frames: names folders in it that have some.
fn nothing(folder: &Path, found: &str) -> SessionError {
    SessionError::value(
        folder,
        "stack",
        "a file of frames, or a folder of numbered .avi or .tif files",
        found,
        "name the file or folder that holds the frames",
    )
}

fn what_is_there(folder: &Path) -> String {
    let holds = |dir: &Path| {
        std::fs::read_dir(dir).is_ok_and(|entries| entries.flatten().any(|e| is_avi(&e.path()) || is_tif(&e.path())))
    };
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let mut inner: Vec<String> =
        entries.map(|e| e.path()).filter(|p| p.is_dir() && holds(p)).map(|p| name(&p)).collect();
    inner.sort();
    match inner.is_empty() {
        true => "a folder without them".into(),
        false => format!("none; its folders {} have some", inner.join(", ")),
    }
}
