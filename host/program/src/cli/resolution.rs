//! `resolution`: the finest line pairs that methods resolve, by position in the field and by depth.

use super::evaluate::{EntrySource, entries};
use super::files::{Content, Files};
use super::{Outcome, Run};
use anyhow::{Context, ensure};
use ommatidia_network::evaluate::Scenes;
use ommatidia_network::evaluate::resolution::{
    DepthRange, Resolution, depth_range, frames, is_target, read, summarise,
};
use ommatidia_network::methods::{MethodKind, title};
use ommatidia_physics::scene::resolution::PERIODS_PX;
use ommatidia_session::Session;
use ommatidia_session::artifact::write_whole;
use ommatidia_session::kind::FileKind;
use std::fmt::Write;
use std::path::PathBuf;

/// Options of `resolution`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Folder of a session made by `bench --targets`
    session: PathBuf,
    /// Checkpoint, network file, or instrument (may be given again)
    #[arg(long = "with", value_name = "FILE", required = true)]
    with: Vec<PathBuf>,
    /// Methods to make from an instrument
    #[arg(long, value_name = "METHOD", value_delimiter = ',', default_value = "wiener,central")]
    methods: Vec<MethodKind>,
    /// Keep all figures and line profiles as JSON, for `report`
    #[arg(short, long, value_name = "JSON")]
    output: Option<PathBuf>,
}

impl Args {
    /// What the verb reads and writes.
    pub fn files(&self) -> Files {
        Files::reading([&self.session]).and_reading(&self.with).writing(&self.output, Content::File(FileKind::Json))
    }
}

/// Runs the verb.
///
/// # Errors
/// The session shows no targets, a file cannot be read or does not fit, or the output cannot be written.
pub fn run(args: &Args, run: &Run) -> anyhow::Result<Outcome> {
    let session = Session::open(&args.session)?;
    let mut scenes = Scenes::of(&session, None)?;
    let grid = session.manifest().object;
    let entries = entries(&args.with, &args.methods, &[], run, &[])?;
    let named = || args.session.display().to_string();
    let targets = frames(&grid);
    ensure!(
        scenes.count() > 0
            && scenes.count().is_multiple_of(targets)
            && is_target(&grid, 0, scenes.case(0)?.truth.view()),
        "{}: expected the scenes of `bench --targets`, found other scenes",
        named()
    );
    let bar = run.progress((entries.len() * scenes.count()) as u64, "resolution");
    let mut found: Vec<Resolution> = Vec::new();
    for entry in &entries {
        let EntrySource::Method(method) = &entry.from else {
            continue;
        };
        for first in (0..scenes.count()).step_by(targets) {
            let mut readings = Vec::new();
            for (i, period) in (first..).zip(PERIODS_PX.into_iter().take(targets)) {
                let frame = scenes.case(i).with_context(named)?.frame_dn;
                let object = method.reconstruct(frame.view()).with_context(|| format!("scene frame {i}"))?;
                readings.extend(read(&grid, period, object.view()));
                bar.inc(1);
            }
            found.push(summarise(&entry.name, scenes.z_um(first), &grid, readings));
        }
    }
    bar.finish_and_clear();
    let finest = |r: &Resolution| [r.centre_um, r.edges_um].map(|v| v.unwrap_or(f64::INFINITY));
    found.sort_by(|a, b| {
        let ([a0, a1], [b0, b1]) = (finest(a), finest(b));
        let by_depth = a.z_um.abs().total_cmp(&b.z_um.abs()).then(a.z_um.total_cmp(&b.z_um));
        by_depth.then(a1.total_cmp(&b1)).then(a0.total_cmp(&b0))
    });
    let names = found.iter().take_while(|r| r.z_um == found[0].z_um).map(|r| r.name.clone());
    let of = |name: &str| found.iter().filter(|r| r.name == name).collect::<Vec<_>>();
    let ranges: Vec<DepthRange> = names.map(|name| depth_range(&name, &of(&name))).collect();
    let several = scenes.count() > targets;
    let mut json = serde_json::json!({
        "session": session.manifest().name, "object_pixel_um": grid.pixel_um, "periods_px": PERIODS_PX,
        "resolution": found,
    });
    if several {
        json["depth_ranges"] = serde_json::to_value(&ranges)?;
    }
    if let Some(output) = &args.output {
        write_whole(output, format!("{json}\n").as_bytes())?;
    }
    Ok(Outcome { text: text(&found, if several { &ranges } else { &[] }, grid.pixel_um), json })
}

fn text(found: &[Resolution], ranges: &[DepthRange], pixel_um: f64) -> String {
    let width = found.iter().map(|r| title(&r.name).chars().count()).max().unwrap_or(0).max(6);
    let mut text = format!(
        "finest line pair resolved along both axes, um; contrast of the pair of {:.1} um, mean\n\
         {:width$}  {:>8}  {:>8} {:>8}   {:>8} {:>8}\n",
        3.0 * pixel_um,
        "method",
        "depth",
        "centre",
        "edges",
        "centre",
        "edges"
    );
    for r in found {
        let um = |v: Option<f64>| v.map_or("-".into(), |v| format!("{v:.1}"));
        let contrast = |centre: bool| {
            let of = r.readings.iter().filter(|r| r.period_px == 3.0 && (r.place == "centre") == centre);
            let all: Vec<f64> = of.map(|r| r.contrast).collect();
            all.iter().sum::<f64>() / all.len().max(1) as f64
        };
        // Writing to a string cannot fail.
        let _ = writeln!(
            text,
            "{:width$}  {:>8}  {:>8} {:>8}   {:>8.3} {:>8.3}",
            title(&r.name),
            r.z_um,
            um(r.centre_um),
            um(r.edges_um),
            contrast(true),
            contrast(false)
        );
    }
    for r in ranges {
        let range = match r.range_um {
            Some([low, high]) => format!("{low} to {high} um"),
            None => "none: not resolved in focus".into(),
        };
        let _ = writeln!(text, "keeps its resolution in depth, {}: {range}", title(&r.name));
    }
    text
}
