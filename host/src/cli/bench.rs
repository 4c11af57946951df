//! `bench`: the virtual instrument measures a session.

use super::{Outcome, Run};
use crate::bench::BenchConfig;
use crate::effects::{self, EffectError, EffectSetting};
use std::path::PathBuf;

/// Options of `bench`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example: ommatidia bench session --effect halo=0.05 --frames 24 --seed 7")]
pub struct Args {
    /// Folder of the session; one that a virtual instrument measured before is replaced
    session: PathBuf,
    /// Configuration of the instrument, TOML [default: the demo instrument]
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Effect to inject, with its strength, the first of its parameters (may be given again)
    #[arg(long, value_name = "ID=STRENGTH")]
    effect: Vec<String>,
    /// Number of scene frames
    #[arg(long, value_name = "N")]
    frames: Option<usize>,
}

/// Runs the verb.
///
/// # Errors
/// Whatever the library says.
pub fn run(args: &Args, run: &Run) -> anyhow::Result<Outcome> {
    let started = std::time::Instant::now();
    let mut config = args.config.as_deref().map_or_else(|| Ok(BenchConfig::default()), BenchConfig::read)?;
    if let Some(n) = args.frames {
        config.stacks.scene_frames = n;
    }
    let settings = args.effect.iter().map(|e| setting(e)).collect::<anyhow::Result<Vec<_>>>()?;
    let instrument = config.build(&settings)?;
    let bar = run.progress(instrument.frames() as u64, "bench");
    let summary = instrument.measure(&args.session, run.seed, |n| bar.inc(n as u64))?;
    bar.finish_and_clear();
    let seconds = started.elapsed().as_secs_f64();
    let frames: Vec<_> = summary.frames.iter().map(|(role, n)| format!("{n} {role}")).collect();
    let text = format!(
        "{}: {} frames of {}x{}\nbrightest pixel: bead {:.0} e-, scenes {:.0} e-, full scale {:.0} e-\n{:.1} s\n",
        args.session.display(),
        frames.join(", "),
        config.sensor.rows,
        config.sensor.cols,
        summary.bead_peak_e,
        summary.scene_peak_e,
        summary.full_scale_e,
        seconds,
    );
    let json = serde_json::json!({
        "session": args.session, "frames": summary.frames, "sensor": [config.sensor.rows, config.sensor.cols],
        "bead_peak_e": summary.bead_peak_e, "scene_peak_e": summary.scene_peak_e, "full_scale_e": summary.full_scale_e,
        "effects": settings, "seed": run.seed, "seconds": seconds,
    });
    Ok(Outcome { json, text })
}

/// Parses `ID=STRENGTH`.
fn setting(text: &str) -> anyhow::Result<EffectSetting> {
    let parsed = text.split_once('=').and_then(|(id, v)| Some((id, v.parse::<f64>().ok()?)));
    let Some((id, strength)) = parsed else {
        anyhow::bail!("--effect: expected ID=STRENGTH, e.g. halo=0.05, found `{text}`");
    };
    let Some(effect) = effects::find(id) else {
        return Err(EffectError::Unknown { found: id.into(), known: effects::ids().join(", ") }.into());
    };
    let name = effect.descriptor().expanded(1).into_iter().next().map_or_else(String::new, |(name, _)| name);
    Ok(EffectSetting::new(id, &[(&name, strength)]))
}
