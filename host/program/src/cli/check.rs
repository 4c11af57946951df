//! `check`: looks at a session before it is calibrated.

use super::common::{Findings, any_session, in_json};
use super::files::{Content, Files};
use super::{Outcome, Run};
use anyhow::Context;
use ommatidia_model::check::{Finding, SessionCheck, Severity, Shown, check};
use ommatidia_session::artifact::write_whole;
use ommatidia_session::kind::FileKind;
use ommatidia_session::{Role, Session, Stack};
use serde_json::json;
use std::fmt::Write;
use std::path::PathBuf;

/// Side of the picture, pixels, about.
const SIDE: usize = 1000;
/// Foci that lie farther than this from where they were predicted are joined by a line, sensor pixels.
const APART_PX: f64 = 2.0;
/// Most frames of the mean that is drawn where there is no bead scan.
const MEAN_OF: usize = 24;

/// Options of `check`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example: ommatidia check session/ -o check.png")]
pub struct Args {
    /// Folder of the measured session
    session: PathBuf,
    /// Write a picture to this PNG file: the foci of some bead frames that by the table draw a letter F behind each
    /// lens. Rings show where the table puts them, dots where they were found; a line joins the two where they
    /// disagree. Of a session whose bead frames show nothing, or without any: the mean of some frames
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
}

impl Args {
    /// What the verb reads and writes.
    pub fn files(&self) -> Files {
        Files::reading([&self.session]).writing(&self.output, Content::File(FileKind::Picture))
    }
}

/// Runs the verb. Errors in the session make it fail, after all findings are printed.
///
/// # Errors
/// The session cannot be read, it has an error, or the picture cannot be written.
pub fn run(args: &Args, run: &Run) -> anyhow::Result<Outcome> {
    if let Some(file) = &args.output {
        let png = file.extension().is_some_and(|e| e.eq_ignore_ascii_case("png"));
        anyhow::ensure!(png, "{}: the picture is a PNG; choose a name that ends in .png", file.display());
    }
    let session = any_session(&args.session, run.seed)?;
    // Bead frames are read twice.
    let reads = |s: &Stack| s.len() as u64 * if s.role() == Role::Bead { 2 } else { 1 };
    let bar = run.progress(session.stacks().iter().map(reads).sum(), "check");
    let started = std::time::Instant::now();
    let found = check(&session, || bar.inc(1))?;
    bar.finish_and_clear();
    let mut of_picture = String::new();
    if let Some(file) = &args.output {
        let mean;
        let shown = match &found.scan {
            Some(scan) => &scan.shown,
            None => {
                (mean, of_picture) = mean_frame(&session)?;
                &mean
            }
        };
        write_whole(file, &picture(shown, [session.manifest().sensor.rows, session.manifest().sensor.cols])?)?;
    }
    let errors = found.at_least(Severity::Error).count();
    let mut json = json!({
        "session": in_json(&args.session), "errors": errors, "findings": found.findings,
        "warnings": found.at_least(Severity::Warning).count() - errors,
        "scan": found.scan, "picture": args.output.as_ref().map(in_json),
    });
    json["seconds"] = json!(started.elapsed().as_secs_f64());
    if errors > 0 {
        return Err(Findings { text: text(&found, args, &of_picture).trim_end().into(), json }.into());
    }
    Ok(Outcome { json, text: text(&found, args, &of_picture) })
}

/// The mean of some frames of the first stack of scenes (else of flats, else of the first stack), above its darkest
/// pixels; and what it is, in words.
///
/// # Errors
/// There is no stack, or a frame cannot be read.
fn mean_frame(session: &Session) -> anyhow::Result<(Shown, String)> {
    let of = |role| session.stacks_of(role).next();
    let stack = of(Role::Scene).or_else(|| of(Role::Flat)).or_else(|| session.stacks().first());
    let stack = stack.with_context(|| format!("{}: no stack to draw", session.dir().display()))?;
    let (mut frames, count) = (stack.frames()?, stack.len().min(MEAN_OF));
    let mut light = frames.read(0)?;
    for i in 1..count {
        light += &frames.read(i * stack.len() / count)?;
    }
    light /= count as f32;
    let mut values: Vec<f32> = light.iter().copied().collect();
    let at = values.len() / 100;
    let darkest = *values.select_nth_unstable_by(at, f32::total_cmp).1;
    let words = format!(" (no bead scan to draw: the mean of {count} frames of {})", stack.entry().file);
    Ok((Shown { pairs: Vec::new(), light: light - darkest, bin: 1 }, words))
}

fn text(found: &SessionCheck, args: &Args, of_picture: &str) -> String {
    let mut out = String::new();
    let word = |s: Severity| match s {
        Severity::Fact => "",
        Severity::Ok => "ok",
        Severity::Warning => "warning",
        Severity::Error => "ERROR",
    };
    let errors = found.at_least(Severity::Error).count();
    if errors > 0 {
        let _ = writeln!(out, "{}: {errors} {}", args.session.display(), if errors == 1 { "error" } else { "errors" });
    }
    for Finding { topic, severity, text } in &found.findings {
        // Writing to a string cannot fail.
        let _ = writeln!(out, "{:<8} {topic:<16} {text}", word(*severity));
    }
    if let Some(file) = &args.output {
        let _ = writeln!(out, "-> {}{of_picture}", file.display());
    }
    out
}

/// The picture of predicted over found foci, as PNG.
fn picture(shown: &Shown, sensor: [usize; 2]) -> anyhow::Result<Vec<u8>> {
    let Shown { pairs, light, bin } = shown;
    let zoom = (SIDE / sensor[0].max(sensor[1])).max(1);
    let mut canvas = Canvas::new([sensor[0] * zoom, sensor[1] * zoom]);
    let top = light.iter().fold(0.0f32, |m, v| m.max(*v)).max(f32::MIN_POSITIVE);
    for r in 0..canvas.rows {
        for c in 0..canvas.cols {
            let small = [r / zoom / bin, c / zoom / bin];
            let value = light.get(small).copied().unwrap_or(0.0).max(0.0) / top;
            let grey = (30.0 + 200.0 * value.sqrt()) as u8;
            canvas.put([r as f64, c as f64], [grey; 3]);
        }
    }
    let on = |p: [f64; 2]| p.map(|v| (v + 0.5) * zoom as f64);
    let (orange, cyan, red) = ([255, 150, 30], [60, 220, 255], [255, 60, 60]);
    for (predicted, found) in pairs.iter().filter_map(|p| Some((p.predicted_px, p.found_px?))) {
        if (predicted[0] - found[0]).hypot(predicted[1] - found[1]) > APART_PX {
            canvas.line(on(predicted), on(found), red);
        }
    }
    for pair in pairs {
        let predicted = on(pair.predicted_px);
        if let Some(found) = pair.found_px {
            canvas.disc(on(found), 0.7 * zoom as f64, cyan);
        }
        canvas.ring(predicted, (3.2 * zoom as f64).max(4.0), orange);
    }
    canvas.png()
}

/// An RGB picture to draw on.
struct Canvas {
    rows: usize,
    cols: usize,
    bytes: Vec<u8>,
}

impl Canvas {
    fn new([rows, cols]: [usize; 2]) -> Self {
        Self { rows, cols, bytes: vec![0; 3 * rows * cols] }
    }

    fn put(&mut self, [r, c]: [f64; 2], colour: [u8; 3]) {
        let inside = |v: f64, n: usize| (v >= 0.0 && v < n as f64).then_some(v as usize);
        if let (Some(r), Some(c)) = (inside(r, self.rows), inside(c, self.cols)) {
            let at = 3 * (r * self.cols + c);
            self.bytes[at..at + 3].copy_from_slice(&colour);
        }
    }

    fn disc(&mut self, [r, c]: [f64; 2], radius: f64, colour: [u8; 3]) {
        let reach = radius.ceil() as i64;
        for dr in -reach..=reach {
            for dc in -reach..=reach {
                if (dr as f64).hypot(dc as f64) <= radius {
                    self.put([r + dr as f64, c + dc as f64], colour);
                }
            }
        }
    }

    fn ring(&mut self, [r, c]: [f64; 2], radius: f64, colour: [u8; 3]) {
        let reach = radius.ceil() as i64 + 1;
        for dr in -reach..=reach {
            for dc in -reach..=reach {
                if ((dr as f64).hypot(dc as f64) - radius).abs() < 0.9 {
                    self.put([r + dr as f64, c + dc as f64], colour);
                }
            }
        }
    }

    fn line(&mut self, from: [f64; 2], to: [f64; 2], colour: [u8; 3]) {
        let steps = (from[0] - to[0]).abs().max((from[1] - to[1]).abs()).ceil().max(1.0);
        for i in 0..=steps as usize {
            let t = i as f64 / steps;
            self.disc([0, 1].map(|a| from[a] + t * (to[a] - from[a])), 1.0, colour);
        }
    }

    fn png(&self) -> anyhow::Result<Vec<u8>> {
        let mut out = Vec::new();
        let mut encoder = png::Encoder::new(&mut out, self.cols as u32, self.rows as u32);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        let mut writer = encoder.write_header()?;
        writer.write_image_data(&self.bytes)?;
        writer.finish()?;
        Ok(out)
    }
}
