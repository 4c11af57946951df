//! `arena`: methods on the same virtual scenes of many specimens, light levels and instruments.

use super::evaluate::{Entry, EntrySource, entries};
use super::files::{Content, Files};
use super::{Outcome, Run};
use anyhow::Context;
use clap::ValueEnum;
use ommatidia_bench::BenchConfig;
use ommatidia_network::evaluate::{Arena, Bout, Entrant, Scenes, Source, judge};
use ommatidia_network::methods::MethodKind;
use ommatidia_physics::effects::EffectSetting;
use ommatidia_physics::scene::{SceneConfig, Specimen};
use ommatidia_session::artifact::write_whole;
use ommatidia_session::kind::FileKind;
use ommatidia_session::{Role, Session};
use std::path::PathBuf;

/// The condition without an effect.
const CALIBRATED: &str = "as calibrated";

/// Options of `arena`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Configuration of the virtual instrument, TOML: the one that was calibrated (default: the demo instrument)
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Checkpoint, network file, or instrument (may be given again)
    #[arg(long = "with", value_name = "FILE", required = true)]
    with: Vec<PathBuf>,
    /// Methods to make from an instrument
    #[arg(long, value_name = "METHOD", value_delimiter = ',', default_value = "richardson-lucy,admm")]
    methods: Vec<MethodKind>,
    /// Scenes of each specimen, light level and condition
    #[arg(long, value_name = "N", default_value_t = 2, value_parser = clap::value_parser!(u16).range(1..))]
    scenes: u16,
    /// Expected signal of the brightest pixel, electrons
    #[arg(long, value_name = "E", value_delimiter = ',', default_value = "100,500,2500,8000",
        value_parser = super::common::positive)]
    peaks: Vec<f64>,
    /// Kinds of specimens [default: section and the usual ones]
    #[arg(long, alias = "specimen", value_name = "KIND", value_delimiter = ',', value_enum)]
    specimens: Vec<Specimen>,
    /// Folder of grey .tif or .png pictures as one more kind of specimen, by the folder's name (may be given again)
    #[arg(long, value_name = "DIR")]
    images: Vec<PathBuf>,
    /// Effect that the instrument has in one more condition, beside the one without effects (may be given again)
    #[arg(long, value_name = "ID=STRENGTH[,NAME=VALUE..]")]
    effect: Vec<String>,
    /// Folder for the page `arena.md` and for `arena.json` with the figures of each scene
    #[arg(short, long, value_name = "FOLDER")]
    output: PathBuf,
}

/// The files in the output folder.
const PAGE: &str = "arena.md";
const FIGURES: &str = "arena.json";

impl Args {
    /// What the verb reads and writes.
    pub fn files(&self) -> Files {
        Files::reading(&self.with)
            .and_reading(&self.config)
            .and_reading(&self.images)
            .writing([&self.output], Content::Named(|name| name == FIGURES))
    }

    /// The kinds of specimens by name, each with its scenes.
    fn kinds(&self) -> anyhow::Result<Vec<(String, SceneConfig)>> {
        let usual = || [Specimen::Section].into_iter().chain(Specimen::USUAL).collect();
        let specimens = if self.specimens.is_empty() { usual() } else { self.specimens.clone() };
        let of = |kind: Specimen| {
            let name = kind.to_possible_value().map_or_else(String::new, |v| v.get_name().into());
            (name, SceneConfig { specimens: vec![kind], ..SceneConfig::default() })
        };
        let picture = |folder: &PathBuf| {
            let name = folder.file_name().with_context(|| format!("--images {}: has no name", folder.display()))?;
            let scenes = SceneConfig { specimens: Vec::new(), images: Some(folder.clone()), ..SceneConfig::default() };
            anyhow::Ok((format!("{} (pictures)", name.to_string_lossy()), scenes))
        };
        let pictures = self.images.iter().map(picture);
        specimens.into_iter().map(|kind| Ok(of(kind))).chain(pictures).collect()
    }

    /// The conditions by name, each with its effect.
    fn conditions(&self) -> anyhow::Result<Vec<(String, Vec<EffectSetting>)>> {
        let effect = |text: &String| {
            let effect = text.parse().map_err(|e| anyhow::anyhow!("--effect {text}: {e}"))?;
            anyhow::Ok((text.clone(), vec![effect]))
        };
        [Ok((CALIBRATED.to_string(), Vec::new()))].into_iter().chain(self.effect.iter().map(effect)).collect()
    }
}

/// Runs the verb.
///
/// # Errors
/// A file cannot be read or does not fit the virtual instrument, a light level exceeds full scale, an effect is
/// invalid, or the output cannot be written.
pub fn run(args: &Args, run: &Run) -> anyhow::Result<Outcome> {
    let existed = args.output.is_dir();
    std::fs::create_dir_all(&args.output).with_context(|| args.output.display().to_string())?;
    let written = fight(args, run).and_then(|arena| write(&arena, args, run));
    if written.is_err() && !existed {
        // Only an empty folder can be removed.
        let _ = std::fs::remove_dir(&args.output);
    }
    written
}

/// Every method on every scene.
fn fight(args: &Args, run: &Run) -> anyhow::Result<Arena> {
    let config = args.config.as_deref().map_or_else(|| Ok(BenchConfig::default()), BenchConfig::read)?;
    let full = config.full_scale_e();
    if let Some(peak) = args.peaks.iter().find(|peak| **peak > full) {
        anyhow::bail!("--peaks: expected at most {full:.0} e-, the full scale of the virtual instrument, found {peak}");
    }
    let entries = entries(&args.with, &args.methods, &[], run, &[])?;
    let (kinds, conditions) = (args.kinds()?, args.conditions()?);
    let mut arena = Arena::default();
    for entry in &entries {
        let trained = !matches!(FileKind::of(&entry.source)?, FileKind::Artifact(kind) if kind == "instrument");
        let (name, source) = (entry.name.clone(), entry.source.display().to_string());
        arena.entrants.push(Entrant { name, source, trained, seconds_per_frame: 0.0 });
    }
    let cells = kinds.len() * conditions.len() * args.peaks.len();
    let bar = run.progress((cells * entries.len() * usize::from(args.scenes)) as u64, "arena");
    let scratch = tempfile::tempdir().context("a folder for the scenes")?;
    for (condition, effects) in &conditions {
        for &peak_e in &args.peaks {
            for (specimen, scenes) in &kinds {
                let mut config = BenchConfig { scenes: scenes.clone(), ..config.clone() };
                config.stacks.scene_frames = args.scenes.into();
                config.stacks.scene_peak = [peak_e / full; 2];
                // Scenes of their own in every cell, and the same ones for every method.
                let seed = run.seed.wrapping_add(arena.bouts.len() as u64);
                let folder = scratch.path().join("scenes");
                config.build(effects)?.measure_some(&folder, seed, &[Role::Scene], |_| ())?;
                let cell = (specimen.clone(), peak_e, condition.clone());
                let seconds = judge_all(&entries, &Session::open(&folder)?, cell, &mut arena.bouts, || bar.inc(1))?;
                let entrants = arena.entrants.iter_mut().zip(seconds);
                entrants.for_each(|(entrant, seconds)| entrant.seconds_per_frame += seconds / cells as f64);
            }
        }
    }
    bar.finish_and_clear();
    Ok(arena)
}

/// Adds the scenes of a session with the figures of every method; returns the time of each method for a frame, s.
fn judge_all(
    entries: &[Entry],
    session: &Session,
    (specimen, peak_e, condition): (String, f64, String),
    bouts: &mut Vec<Bout>,
    mut done: impl FnMut(),
) -> anyhow::Result<Vec<f64>> {
    let mut cases = Scenes::of(session, None)?;
    let (first, count, grid) = (bouts.len(), cases.count(), session.manifest().object);
    let bout = Bout { specimen, peak_e, condition, psnr_db: Vec::new(), ssim: Vec::new() };
    bouts.extend(std::iter::repeat_n(bout, count));
    let mut seconds = Vec::new();
    for entry in entries {
        let source = match &entry.from {
            EntrySource::Method(method) => Source::Method(method.as_ref()),
            EntrySource::Stack(stack) => Source::Stack(stack),
        };
        let judged = judge(&source, &grid, count, &[], |i| cases.case(i), &mut done);
        let file = entry.source.display();
        let (figures, _) =
            judged.with_context(|| format!("{file}, on the virtual instrument that --config describes"))?;
        for (bout, figures) in bouts[first..].iter_mut().zip(&figures.frames) {
            bout.psnr_db.push(figures.psnr_db);
            bout.ssim.push(figures.ssim);
        }
        seconds.push(figures.seconds_per_frame.unwrap_or(0.0));
    }
    Ok(seconds)
}

/// Writes figures and page.
fn write(arena: &Arena, args: &Args, run: &Run) -> anyhow::Result<Outcome> {
    let page = arena.page(&command(args, run));
    let json = serde_json::to_value(arena)?;
    write_whole(&args.output.join(FIGURES), format!("{json}\n").as_bytes())?;
    write_whole(&args.output.join(PAGE), page.as_bytes())?;
    let table: Vec<&str> = page.lines().filter(|l| l.starts_with('|')).take(arena.entrants.len() + 2).collect();
    let text = format!("{}\n{}\n", table.join("\n"), args.output.join(PAGE).display());
    Ok(Outcome { json, text })
}

/// The command line that repeats the page.
fn command(args: &Args, run: &Run) -> String {
    let mut words = vec!["ommatidia arena".to_string()];
    let mut option = |name: &str, value: String| words.push(format!("{name} {value}"));
    if let Some(config) = &args.config {
        option("--config", config.display().to_string());
    }
    args.with.iter().for_each(|path| option("--with", path.display().to_string()));
    let list = |values: Vec<String>| values.join(",");
    option("--methods", list(args.methods.iter().map(|m| m.name().to_string()).collect()));
    option("--scenes", args.scenes.to_string());
    option("--peaks", list(args.peaks.iter().map(f64::to_string).collect()));
    if !args.specimens.is_empty() {
        let names = args.specimens.iter().filter_map(|s| s.to_possible_value()).map(|v| v.get_name().to_string());
        option("--specimens", list(names.collect()));
    }
    args.images.iter().for_each(|path| option("--images", path.display().to_string()));
    args.effect.iter().for_each(|effect| option("--effect", effect.clone()));
    option("--seed", run.seed.to_string());
    option("-o", args.output.display().to_string());
    words.join(" \\\n  ")
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        args: Args,
        #[command(flatten)]
        run: Run,
    }

    #[test]
    fn specimens_conditions_and_the_command_are_those_of_the_options() {
        let words = "arena --with a --with b --peaks 100,500 --images pictures/dots --effect halo=0.1 -o out";
        let line = Line::parse_from(words.split(' '));
        let kinds: Vec<String> = line.args.kinds().unwrap().into_iter().map(|(name, _)| name).collect();
        assert_eq!((kinds.len(), &kinds[0][..], &kinds[7][..]), (8, "section", "dots (pictures)"));
        let conditions: Vec<String> = line.args.conditions().unwrap().into_iter().map(|(name, _)| name).collect();
        assert_eq!(conditions, [CALIBRATED, "halo=0.1"]);
        let again = command(&line.args, &line.run).replace("\\\n ", "");
        let again = Line::parse_from(again.split_whitespace().skip(1));
        assert_eq!((again.args.with, again.args.peaks), (line.args.with, vec![100.0, 500.0]));
        assert_eq!((again.args.images, again.args.effect), (line.args.images, line.args.effect));
    }
}
