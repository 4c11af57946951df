//! Renders artifacts to one self-contained HTML page. It computes no figure of merit: all come from the artifacts.
//!
//! ```
//! use ommatidia_session::artifact::Provenance;
//! use ommatidia_report::{bytes, render, seconds};
//!
//! let folder = tempfile::tempdir()?;
//! let path = folder.path().join("lab.instrument");
//! let instrument = ommatidia_model::testing::instrument([9, 11], [30, 33], 5, 3);
//! instrument.write(&path, Provenance::default())?;
//!
//! let page = render(&[path])?;
//! assert!(page.contains("<title>Made up</title>") && page.contains("DN/e"));
//! assert_eq!((seconds(0.0123), bytes(2048)), ("12.3 ms".to_string(), "2 KiB".to_string()));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod chart;
mod closing;
mod colour;
mod device;
mod error;
mod json;
mod look;
mod optics;
mod page;
mod panel;
mod peers;
mod picture;
mod prediction;
mod recording;
mod scenes;
#[cfg(test)]
mod tests;
mod ticks;
mod training;

pub use closing::smoothed;
pub use colour::{ABSENT, ColourMap};
pub use error::ReportError;
pub use json::json_name;
pub use look::Look;
pub use page::STYLE;
pub use picture::{Scale, Tone, number};
pub use recording::Pixels;
pub use scenes::{bytes, seconds};

use closing::Asked;
use maud::{Markup, html};
use ommatidia_closing::account::{self, Account};
use ommatidia_model::dataset::PLAN_FILE;
use ommatidia_model::instrument::Instrument;
use ommatidia_network::evaluate::Evaluation;
use ommatidia_network::evaluate::receptive::{self, ReceptiveFields};
use ommatidia_network::train::Sample;
use ommatidia_session::artifact;
use ommatidia_session::kind::FileKind;
use ommatidia_session::{ObjectGrid, SensorSpec, Session};
use ommatidia_shared::blob::{Header, Network};
use page::{Key, Numbers, Section};
use recording::Recording;
use serde_json::Value;
use std::path::{Path, PathBuf};

/// A file that was read for a report.
struct Piece {
    path: PathBuf,
    /// The header of an artifact, or the JSON that a command printed.
    json: Value,
    content: Content,
}

enum Content {
    Instrument(Box<Instrument>),
    Evaluation(Box<Evaluation>),
    Closing(Box<Account>, Asked),
    Checkpoint(Vec<Sample>),
    Blob(Box<Header>, u64),
    Session(Box<Session>),
    Device,
    /// The effect that a demo hid from the loop.
    Hidden,
    /// Figures of `resolution`.
    Resolution,
    /// Figures of `ablate`.
    Ablation,
    Receptive(Box<ReceptiveFields>),
    /// Frames of one's own: reconstructions or raw frames.
    Recording(Box<Recording>),
    Other,
}

/// Renders files to one HTML page: instruments, checkpoints, evaluations, accounts of closed loops, network files,
/// session folders, recordings of frames or objects (files and folders), and JSON.
///
/// Chapters appear in a fixed order, whatever the order of `paths`. Pictures and styles are inside the page.
///
/// # Errors
/// A file cannot be read, or is of a kind that a report does not show.
pub fn render(paths: &[PathBuf]) -> Result<String, ReportError> {
    let mut pieces = paths.iter().map(|p| load(p)).collect::<Result<Vec<_>, _>>()?;
    name_the_host(&mut pieces);
    let mut numbers = Numbers::default();
    let chapters: [(&'static str, &'static str, Chapter); 13] = [
        ("scenes", "Reconstructions", |p, _, n| match &p.content {
            Content::Evaluation(e) => Ok(Some(scenes::pictures(e, n)?)),
            _ => Ok(None),
        }),
        ("recordings", "Recordings", |p, all, n| match &p.content {
            Content::Recording(r) => Ok(Some(recording::recording(r, &grids(all), n)?)),
            _ => Ok(None),
        }),
        ("methods", "Methods compared", |p, _, n| match &p.content {
            Content::Evaluation(e) => Ok(Some(scenes::figures(e, n)?)),
            _ => Ok(None),
        }),
        ("resolution", "Resolution", |p, _, n| match &p.content {
            Content::Resolution => Ok(Some(peers::resolution(&p.json, n)?)),
            Content::Evaluation(e) => peers::spectra(e, n),
            _ => Ok(None),
        }),
        ("receptive", "Receptive field", |p, _, n| match &p.content {
            Content::Receptive(r) => Ok(Some(peers::receptive(r, n)?)),
            _ => Ok(None),
        }),
        ("ablation", "Ablations", |p, _, n| match &p.content {
            Content::Ablation => Ok(Some(peers::ablation(&p.json, n))),
            _ => Ok(None),
        }),
        ("prediction", "Measured and predicted", |p, _, n| match &p.content {
            Content::Evaluation(e) => prediction::prediction(e, n),
            _ => Ok(None),
        }),
        ("device", "On the device", |p, _, n| match &p.content {
            Content::Device => Ok(Some(device::device(&p.json, n))),
            Content::Blob(header, bytes) => Ok(Some(device::blob(header, *bytes, n))),
            _ => Ok(None),
        }),
        ("residual", "Residual", |p, all, n| loop_of(p, Asked::Residual, all, n)),
        ("closing", "Closing the loop", |p, all, n| loop_of(p, Asked::Close, all, n)),
        ("optics", "Optics", |p, _, n| match &p.content {
            Content::Instrument(i) => Ok(Some(optics::optics(i, n)?)),
            _ => Ok(None),
        }),
        ("sensor", "Sensor", |p, _, n| match &p.content {
            Content::Instrument(i) => Ok(Some(optics::noise(i, n)?)),
            _ => Ok(None),
        }),
        ("training", "Training", |p, _, n| match &p.content {
            Content::Checkpoint(samples) => Ok(Some(training::training(&p.json, samples, n)?)),
            _ => Ok(None),
        }),
    ];
    let mut sections = Vec::new();
    for (id, title, chapter) in chapters {
        let parts = pieces
            .iter()
            .filter_map(|p| chapter(p, &pieces, &mut numbers).transpose())
            .collect::<Result<Vec<_>, _>>()?;
        if !parts.is_empty() {
            // Tables of a device and of its network file stand side by side.
            let class = if id == "device" { "two" } else { "" };
            let title = if id == "device" && not_on_a_device(&pieces) { "Not run on a device" } else { title };
            sections.push(Section {
                id,
                title: title.into(),
                body: html! { div class=(class) { @for part in parts { (part) } } },
            });
        }
    }
    sections.push(Section { id: "provenance", title: "Provenance".into(), body: provenance(&pieces) });
    Ok(page::document(&heading(&pieces), &lead(&pieces), &keys(&pieces), &sections))
}

/// Whether there are runs of the firmware, and none of them on a device.
fn not_on_a_device(pieces: &[Piece]) -> bool {
    let mut runs = pieces.iter().filter(|p| matches!(p.content, Content::Device)).peekable();
    runs.peek().is_some() && runs.all(|p| device::on_host(&p.json))
}

/// Where `device run` ran on the host alone, no reconstruction is that of a device.
fn name_the_host(pieces: &mut [Piece]) {
    if !not_on_a_device(pieces) {
        return;
    }
    for piece in pieces {
        if let Content::Evaluation(e) = &mut piece.content {
            e.summary
                .methods
                .iter_mut()
                .filter(|m| m.name == "device")
                .for_each(|m| m.name = "firmware-on-host".into());
        }
    }
}

/// The sensors and objects of the instruments and sessions: their pixels give the scale of recordings.
fn grids(pieces: &[Piece]) -> Vec<(SensorSpec, ObjectGrid)> {
    let of = |p: &Piece| match &p.content {
        Content::Instrument(i) => Some((i.manifest.sensor, i.manifest.object)),
        Content::Session(s) => Some((s.manifest().sensor, s.manifest().object)),
        Content::Evaluation(e) => Some((e.summary.sensor, e.summary.object)),
        _ => None,
    };
    pieces.iter().filter_map(of).collect()
}

/// Renders a piece; the other pieces are there for context.
type Chapter = fn(&Piece, &[Piece], &mut Numbers) -> Result<Option<Markup>, ReportError>;

/// The chapter of an account, if the account is of the requested kind. The lenses are those of the first instrument.
fn loop_of(piece: &Piece, asked: Asked, all: &[Piece], numbers: &mut Numbers) -> Result<Option<Markup>, ReportError> {
    let instrument = all.iter().find_map(|p| match &p.content {
        Content::Instrument(i) => Some(&**i),
        _ => None,
    });
    match &piece.content {
        Content::Closing(a, of) if *of == asked => closing::chapter(a, asked, instrument, numbers).map(Some),
        Content::Hidden if asked == Asked::Close => Ok(Some(closing::hidden(&piece.json["hidden"]))),
        _ => Ok(None),
    }
}

fn load(path: &Path) -> Result<Piece, ReportError> {
    let kind = FileKind::of(path)?;
    let header = || artifact::inspect(path).map_err(ReportError::from);
    let read = || std::fs::read(path).map_err(|source| artifact::ArtifactError::Io { path: path.into(), source });
    let (json, content) = match &kind {
        FileKind::Artifact(name) => (
            header()?,
            match name.as_str() {
                "instrument" => Content::Instrument(Box::new(Instrument::read(path)?)),
                "evaluation" => Content::Evaluation(Box::new(Evaluation::read(path)?.0)),
                account::KIND => Content::Closing(Box::new(Account::read(path)?), asked(path)?),
                "checkpoint" => Content::Checkpoint(Sample::of(path)?),
                receptive::KIND => Content::Receptive(Box::new(ReceptiveFields::read(path)?)),
                _ => Content::Other,
            },
        ),
        FileKind::Stack => (Value::Null, Content::Recording(Box::new(Recording::read(path)?))),
        FileKind::Folder if !path.join(PLAN_FILE).exists() => {
            (Value::Null, Content::Recording(Box::new(Recording::read(path)?)))
        }
        FileKind::Session => (Value::Null, Content::Session(Box::new(Session::open(path)?))),
        FileKind::Blob => {
            let bytes = read()?;
            let network = Network::decode(&bytes).map_err(|e| ReportError::blob(path, e))?;
            (Value::Null, Content::Blob(Box::new(network.into_header()), bytes.len() as u64))
        }
        FileKind::Json => {
            let json: Value = serde_json::from_slice(&read()?)
                .map_err(|e| artifact::ArtifactError::Format { path: path.into(), detail: e.to_string() })?;
            let content = match &json {
                v if v.get("bit_exact").is_some() => Content::Device,
                v if v.get("hidden").is_some() => Content::Hidden,
                v if v.get("resolution").is_some() => Content::Resolution,
                v if v.get("ablation").is_some() => Content::Ablation,
                _ => Content::Other,
            };
            (json, content)
        }
        other => return Err(ReportError::Kind { path: path.into(), found: format!("{other}{}", other.advice()) }),
    };
    Ok(Piece { path: path.into(), json, content })
}

/// Whether an account was written by `residual` or by `close`.
fn asked(path: &Path) -> Result<Asked, ReportError> {
    let verb = &artifact::inspect(path)?["provenance"]["verb"];
    Ok(if verb == "residual" { Asked::Residual } else { Asked::Close })
}

fn heading(pieces: &[Piece]) -> String {
    let name = pieces.iter().find_map(|p| match &p.content {
        Content::Evaluation(e) => Some(e.summary.session.clone()),
        Content::Closing(a, _) => Some(a.closing.session.clone()),
        Content::Instrument(i) => Some(i.manifest.name.clone()),
        Content::Session(s) => Some(s.manifest().name.clone()),
        _ => None,
    });
    let name = name.filter(|n| !n.is_empty()).unwrap_or_else(|| "Report".into());
    training::sentence(&name)
}

fn lead(pieces: &[Piece]) -> String {
    let manifest = pieces.iter().find_map(|p| match &p.content {
        Content::Instrument(i) => Some(&i.manifest),
        Content::Session(s) => Some(s.manifest()),
        _ => None,
    });
    manifest.map_or(String::new(), |m| {
        format!(
            "A multi-aperture miniscope with {} on a {} × {} pixel sensor (pitch {} µm, {} bit), \
                observing an object of \
             {} × {} pixels of {} µm at magnification {}.",
            m.array.words().replace('x', "×"),
            m.sensor.rows,
            m.sensor.cols,
            m.sensor.pixel_pitch_um,
            m.sensor.bit_depth,
            m.object.rows,
            m.object.cols,
            number(m.object.pixel_um),
            number(m.optics.magnification)
        )
    })
}

fn keys(pieces: &[Piece]) -> Vec<Key> {
    let of = |p: &Piece| match &p.content {
        Content::Evaluation(e) => scenes::keys(e),
        Content::Device => device::keys(&p.json),
        _ => Vec::new(),
    };
    pieces.iter().flat_map(of).collect()
}

fn provenance(pieces: &[Piece]) -> Markup {
    let pretty = |v: &Value| serde_json::to_string_pretty(v).unwrap_or_default();
    html! {
        p { "Each artifact names the program, the seed, the configuration, and the hashes of its input files." }
        @for piece in pieces {
            details {
                summary { code { (piece.path.display()) } " " (describe(piece)) }
                @match &piece.content {
                    Content::Session(s) => pre { (pretty(&serde_json::to_value(s.manifest()).unwrap_or_default())) },
                    Content::Blob(h, _) => pre { (pretty(&serde_json::to_value(&**h).unwrap_or_default())) },
                    Content::Recording(r) => p { (r.describe()) },
                    _ => pre { (pretty(piece.json.get("provenance").unwrap_or(&piece.json))) },
                }
            }
        }
    }
}

fn describe(piece: &Piece) -> String {
    let from = &piece.json["provenance"];
    let written = match (from["program"].as_str(), from["verb"].as_str()) {
        (Some(program), Some(verb)) => format!(", written by {program} {verb}, seed {}", from["seed"]),
        _ => String::new(),
    };
    let kind = match &piece.content {
        Content::Instrument(_) => "instrument",
        Content::Evaluation(_) => "evaluation",
        Content::Closing(_, Asked::Close) => "account of a closed loop",
        Content::Closing(_, Asked::Residual) => "residual",
        Content::Checkpoint(_) => "checkpoint",
        Content::Blob(..) => "network file",
        Content::Session(_) => "session",
        Content::Device => "device run",
        Content::Hidden => "effect hidden from the loop",
        Content::Resolution => "resolution",
        Content::Ablation => "ablations",
        Content::Receptive(_) => "receptive fields",
        Content::Recording(_) => "recording",
        Content::Other => match (json_name(&piece.json), piece.json["kind"].as_str()) {
            (Some(name), _) => return format!("— {name}{written}"),
            (None, kind) => kind.unwrap_or("JSON of an unknown kind"),
        },
    };
    format!("— {kind}{written}")
}
