//! `simulate`: simulates training pairs with an instrument.

use super::common::{Outcome, Run, in_json};
use super::files::{Content, Files};
use super::shard::shard;
use ommatidia_model::dataset::{PLAN_FILE, Share, SimulateConfig};
use ommatidia_model::instrument::Instrument;
use ommatidia_physics::effects::EffectSetting;
use ommatidia_physics::scene::{SceneConfig, Specimen};
use std::path::PathBuf;

/// Options of `simulate`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example: ommatidia simulate lab.instrument -o pairs --count 1024 --specimen beads,cells")]
pub struct Args {
    /// Instrument file to simulate frames with
    instrument: PathBuf,
    /// Folder of the data set; an interrupted run is resumed
    #[arg(short, long, value_name = "DATASET")]
    output: PathBuf,
    /// Number of pairs
    #[arg(long, value_name = "N")]
    count: usize,
    /// Kind of specimen, or several with commas between them (default: all kinds, or none with --images)
    #[arg(long, value_name = "KIND", value_delimiter = ',')]
    specimen: Vec<Specimen>,
    /// Folder of grey-scale .tif or .png pictures from which objects are cropped (default: none)
    #[arg(long, value_name = "DIR")]
    images: Option<PathBuf>,
    /// Frames per scene; more than one makes short videos with moving worms, 20 ms from frame to frame
    #[arg(long, value_name = "FRAMES", default_value_t = 1)]
    video: usize,
    /// Signal of the brightest pixel of a frame, electrons, drawn between LOW and HIGH (default: 1 % to 80 % of full
    /// scale)
    #[arg(long, num_args = 2, value_names = ["LOW", "HIGH"])]
    peak_e: Option<Vec<f64>>,
    /// Effect that half of the pairs have, with a strength drawn up to this one, so that networks lose less when
    /// the instrument has changed since its calibration (may be given again)
    #[arg(long, value_name = "ID=STRENGTH[,NAME=VALUE..]")]
    vary: Vec<EffectSetting>,
    /// Simulate only every N-th shard, starting with number I (counted from 1), so that N computers share the work;
    /// auto: as the scheduler says (docs/clusters.md)
    #[arg(long, value_name = "I/N", default_value = "1/1", value_parser = |text: &str| shard::<Share>(text, 1))]
    shard: Share,
}

impl Args {
    /// What the verb reads and writes.
    pub fn files(&self) -> Files {
        Files::reading([&self.instrument])
            .and_reading(&self.images)
            .continuing([&self.output], Content::Folder(PLAN_FILE))
            .share(self.shard)
            .after_stop("the same command goes on with the shards that are missing")
    }
}

/// Runs the verb.
///
/// # Errors
/// The instrument cannot be read, the configuration is invalid, or the data set cannot be written.
pub fn run(args: &Args, run: &Run) -> anyhow::Result<Outcome> {
    let started = std::time::Instant::now();
    let instrument = Instrument::read(&args.instrument)?;
    let config = SimulateConfig {
        count: args.count,
        scenes: scenes(args),
        peak_e: args.peak_e.as_deref().and_then(|p| Some([*p.first()?, *p.get(1)?])),
        vary: args.vary.clone(),
        ..SimulateConfig::default()
    };
    let simulation = config.build(&instrument, &args.instrument, run.seed)?;
    let bar = run.progress(args.count as u64, "simulate");
    let progress = simulation.run(&args.output, args.shard, |n| bar.inc(n as u64))?;
    bar.finish_and_clear();
    let plan = simulation.plan();
    let seconds = started.elapsed().as_secs_f64();
    let mut text = format!(
        "{}: {} pairs, objects {}x{}, frames {}x{}, brightest pixel {:.0} to {:.0} e-\n{} shards made, {} kept, {:.1} \
            s\n",
        args.output.display(),
        plan.count,
        plan.object[0],
        plan.object[1],
        plan.frame[0],
        plan.frame[1],
        plan.peak_e[0],
        plan.peak_e[1],
        progress.made,
        progress.kept,
        seconds,
    );
    if progress.missing > 0 {
        text += &format!("{} shards are still missing: run the other --shard values\n", progress.missing);
    }
    let json = serde_json::json!({
        "dataset": in_json(&args.output), "count": plan.count, "object": plan.object, "frame": plan.frame,
        "peak_e": plan.peak_e, "shards": plan.shards(), "shards_made": progress.made, "shards_kept": progress.kept,
        "shards_missing": progress.missing, "seconds": seconds,
    });
    Ok(Outcome { json, text })
}

fn scenes(args: &Args) -> SceneConfig {
    let specimens = match (&args.specimen[..], &args.images) {
        ([], None) => Specimen::for_training(),
        (chosen, _) => chosen.to_vec(),
    };
    SceneConfig { specimens, images: args.images.clone(), video_frames: args.video, ..SceneConfig::default() }
}
