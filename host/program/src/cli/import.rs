//! `import`: recordings of other programs in, a session out.

use super::common::{Strict, in_json, warn};
use super::files::{Content, Files};
use super::{Outcome, Run};
use anyhow::{Context, bail};
use clap::builder::{OsStringValueParser, TypedValueParser};
use ommatidia_session::import::{Found, ImportRequest, LengthUnit, Source, import};
use ommatidia_session::kind::FileKind;
use ommatidia_session::{Manifest, Role, Session, artifact};
use serde_json::json;
use std::ffi::{OsStr, OsString};
use std::path::{Path, PathBuf};

/// Options of `import`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Recordings: a folder of numbered .avi or .tif files (such as that of a UCLA Miniscope), an OME-Zarr, or a
    /// file .avi, .tif, .mat or .npy. `dark=`, `flat=`, `bead=` or `scene=` in front says what it shows
    /// [default: beads where there are positions, else scenes]
    #[arg(required = true, value_name = "[ROLE=]PATH", value_parser = OsStringValueParser::new().try_map(source))]
    recordings: Vec<Source>,
    /// Folder of the session
    #[arg(short, long, value_name = "SESSION")]
    output: PathBuf,
    /// Copy the frames into the session as .npy [default: refer to the files where they are]
    #[arg(long)]
    copy: bool,
    /// Instrument or session with the sizes of sensor, array, optics and object [default: a camera with one lens, whose
    /// pixels are those of the object]
    #[arg(long, value_name = "FILE")]
    like: Option<PathBuf>,
    /// Table of the stage positions of bead frames [default: names of the files, or the only .csv in their folder]
    #[arg(long, value_name = "CSV")]
    positions: Option<PathBuf>,
    /// Name of the array in .mat files that hold several [default: the only one of three axes]
    #[arg(long, value_name = "NAME")]
    variable: Option<String>,
    /// Unit of positions in names of files that state none: um, mm or px (object pixels)
    #[arg(long, value_name = "UNIT")]
    unit: Option<LengthUnit>,
    /// Side of an object pixel, um, without --like [default: as the files say, or 1]
    #[arg(long, value_name = "UM", value_parser = super::common::positive, conflicts_with = "like")]
    pixel_um: Option<f64>,
    /// Exposure, ms [default: the time between frames]
    #[arg(long, value_name = "MS", value_parser = super::common::positive)]
    exposure_ms: Option<f64>,
    /// Bits of the converter [default: as --like says, or the fewest of 8, 10, 12, 14, 16 that hold all values]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=32))]
    bit_depth: Option<u32>,
    #[command(flatten)]
    strict: Strict,
}

fn source(word: OsString) -> Result<Source, String> {
    let roles = [Role::Dark, Role::Flat, Role::Bead, Role::Scene];
    // The name of a file may hold a `=`.
    if Path::new(&word).exists() {
        return Ok(Source { role: None, path: word.into() });
    }
    for role in roles {
        match behind(&word, &format!("{}=", role.name())) {
            Some(path) if path.is_empty() => {
                let name = role.name();
                return Err(format!("nothing follows `{name}=`; write {name}=PATH"));
            }
            Some(path) => return Ok(Source { role: Some(role), path: path.into() }),
            None => {}
        }
    }
    match word.to_string_lossy().split_once('=') {
        Some((name, _)) if name.chars().all(char::is_alphabetic) => {
            Err(format!("`{name}` is none of the roles dark, flat, bead and scene, and there is no file of that name"))
        }
        _ => Ok(Source { role: None, path: word.into() }),
    }
}

/// What follows `start` in a word, which need not be text.
fn behind(word: &OsStr, start: &str) -> Option<OsString> {
    if let Some(text) = word.to_str() {
        return text.strip_prefix(start).map(Into::into);
    }
    #[cfg(unix)]
    {
        use std::os::unix::ffi::OsStrExt;
        word.as_bytes().strip_prefix(start.as_bytes()).map(|rest| OsStr::from_bytes(rest).into())
    }
    #[cfg(not(unix))]
    None
}

impl Args {
    /// What the verb reads and writes.
    pub fn files(&self) -> Files {
        Files::reading(self.recordings.iter().map(|source| &source.path))
            .and_reading(&self.like)
            .and_reading(&self.positions)
            .writing([&self.output], Content::Imported)
    }
}

/// The manifest of an instrument or a session.
fn like(path: &Path) -> anyhow::Result<Manifest> {
    match FileKind::of(path)? {
        FileKind::Session => Ok(Session::open(path)?.manifest().clone()),
        FileKind::Artifact(kind) if kind == "instrument" => {
            let manifest = artifact::inspect(path)?["body"]["manifest"].take();
            serde_json::from_value(manifest).with_context(|| format!("{}: the instrument is damaged", path.display()))
        }
        found => bail!("{}: expected an instrument or a session folder, found {found}", path.display()),
    }
}

/// Runs the verb.
///
/// # Errors
/// A recording cannot be read, or something is not known that only the user can say. No session is left then.
pub fn run(args: &Args, run: &Run) -> anyhow::Result<Outcome> {
    let started = std::time::Instant::now();
    for source in &args.recordings {
        if source.path.is_dir() && FileKind::of(&source.path)? == FileKind::Session {
            let path = source.path.display();
            bail!(
                "{path}: is a session already; `ommatidia check {path}` looks at it. To import one of its stacks, \
                   name the file of its frames"
            );
        }
    }
    let frames = args.recordings.iter().map(|s| Ok(s.frames(args.variable.as_deref())?.len() as u64));
    let frames = frames.sum::<anyhow::Result<u64>>()?;
    let request = ImportRequest {
        sources: &args.recordings,
        output: &args.output,
        like: args.like.as_deref().map(like).transpose()?,
        pixel_um: args.pixel_um,
        exposure_ms: args.exposure_ms,
        bit_depth: args.bit_depth,
        positions: args.positions.as_deref(),
        variable: args.variable.as_deref(),
        unit: args.unit,
        copy: args.copy,
        replace: run.force,
    };
    let bar = run.progress(frames, "import");
    let found = import(&request, || bar.inc(1))?;
    bar.finish_and_clear();
    let session = Session::open(&args.output)?;
    let sensor = session.manifest().sensor;
    let warnings = warn(found.iter().flat_map(|f| f.warnings.iter().cloned()));
    let mut text: String = found.iter().map(|f| shown(f, run.quiet)).collect();
    let mut notes = Vec::new();
    if args.bit_depth.is_none() && args.like.is_none() {
        notes.push(format!("{} bits are the fewest that hold all values (--bit-depth)", sensor.bit_depth));
    }
    if args.like.is_none() {
        let um = session.manifest().object.pixel_um;
        notes.push(format!("one lens, and pixels of {um} um, are assumed (--like INSTRUMENT, or --pixel-um)"));
    }
    if !run.quiet {
        notes.iter().for_each(|note| text += &format!("note: {note}\n"));
    }
    let seconds = started.elapsed().as_secs_f64();
    let lossy = found.iter().any(|f| f.losses.any());
    let lost: usize = found.iter().map(|f| f.losses.lost).sum();
    text += &format!(
        "-> {} ({}, read at {:.0} frames a second)\n",
        args.output.display(),
        used(&found, frames, lost, lossy),
        frames as f64 / seconds
    );
    let json = json!({
        "session": in_json(&args.output), "copied": args.copy, "bit_depth": sensor.bit_depth, "recordings": found,
        "notes": notes, "frames": frames, "lost": lost, "warnings": warnings, "seconds": seconds,
    });
    args.strict.judge(lossy, Outcome { json, text })
}

/// What was found in a recording, with its notes unless they are not wanted.
fn shown(found: &Found, quiet: bool) -> String {
    let notes = found.notes.iter().filter(|_| !quiet).map(|note| format!("  note        {note}\n"));
    std::iter::once(found.text()).chain(notes).collect()
}

/// How many frames are used of how many that were recorded.
fn used(found: &[Found], frames: u64, lost: usize, lossy: bool) -> String {
    let damaged: usize = found.iter().map(|f| f.losses.damaged_frames.len()).sum();
    let which = if damaged > 0 { format!(", {damaged} of them damaged") } else { String::new() };
    match (lossy, lost) {
        (false, _) if frames == 1 => "1 frame".into(),
        (false, _) => format!("all {frames} frames are used"),
        (true, 0) if damaged > 0 => format!("{frames} frames are used{which}"),
        // A file is damaged, and no table or length of files says what was in it.
        (true, 0) => format!("{frames} frames are used; see the warnings"),
        (true, lost) => format!("{frames} of {} frames are used{which}", frames + lost as u64),
    }
}
