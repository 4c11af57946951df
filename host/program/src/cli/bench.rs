//! `bench`: the virtual instrument measures a session.

use super::common::{Outcome, Run, in_json};
use super::files::{Content, Files};
use ommatidia_bench::{BenchConfig, FamilyName, MeasuredPsfs, StackOf, virtual_session};
use ommatidia_network::evaluate::resolution;
use ommatidia_physics::effects::EffectSetting;
use std::path::PathBuf;

/// Options of `bench`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Example: ommatidia bench session --effect halo=0.05,sigma_px=20 --frames 24 --seed 7\n         \
                  ommatidia bench changed --family relay --instrument 3 --effect array_shift=0.4 --seed 2"
)]
pub struct Args {
    /// Folder of the session to write; with --force a session of a virtual instrument in it is replaced
    session: PathBuf,
    /// Configuration of the instrument, TOML (default: the demo instrument)
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// How the lenses are computed: pupils (diffraction), relay (traced rays) or kernels (given PSFs) (default: that of
    /// the configuration)
    #[arg(long, value_name = "NAME")]
    family: Option<FamilyName>,
    /// Draw a small instrument (3 x 3 lenses on 98 x 98 pixels) at random, as `study` does: the number N stands for it
    #[arg(long, value_name = "N", conflicts_with = "config")]
    instrument: Option<u64>,
    /// Measured PSFs for the family kernels: files or folders of .npy or .tif stacks, separated by commas (default:
    /// PSFs drawn at random)
    #[arg(long, value_name = "PATH,..", value_delimiter = ',')]
    psfs: Vec<String>,
    /// What the frames of such a stack are: one PSF at even steps of depth (depths), or PSFs on a square grid over the
    /// field (field)
    #[arg(long, value_name = "WHAT", requires = "psfs", default_value = "depths")]
    psfs_of: StackOf,
    /// Effect to inject, with its strength and further parameters by name; repeat the option for more effects (default:
    /// none)
    #[arg(long, value_name = "ID=STRENGTH[,NAME=VALUE..]")]
    effect: Vec<String>,
    /// Number of scene frames (default: that of the configuration)
    #[arg(long, value_name = "N")]
    frames: Option<usize>,
    /// Measure resolution targets as scenes, one bar period per frame, at half of full scale, for `ommatidia
    /// resolution`
    #[arg(long, conflicts_with = "frames")]
    targets: bool,
    /// Depths of the specimens, um, separated by commas; each scene is measured at each depth (default: that of the
    /// configuration)
    #[arg(long, value_name = "UM", value_delimiter = ',', allow_hyphen_values = true)]
    depths: Vec<f64>,
}

impl Args {
    /// What the verb reads and writes.
    pub fn files(&self) -> Files {
        Files::reading(&self.config).and_reading(&self.psfs).writing([&self.session], Content::Named(virtual_session))
    }
}

impl Args {
    /// The configuration that the options ask for.
    fn instrument(&self) -> anyhow::Result<BenchConfig> {
        let measured = MeasuredPsfs { paths: self.psfs.clone(), stack_of: self.psfs_of };
        let measured = Some(&measured).filter(|m| !m.paths.is_empty());
        if let Some(n) = self.instrument {
            return Ok(BenchConfig::drawn(self.family.unwrap_or_default(), n, measured)?);
        }
        let mut config = self.config.as_deref().map_or_else(|| Ok(BenchConfig::default()), BenchConfig::read)?;
        config.family = self.family.unwrap_or(config.family);
        if let Some(measured) = measured {
            (config.kernels.psfs, config.kernels.stack_of) = (measured.paths.clone(), measured.stack_of);
        }
        Ok(config)
    }
}

/// Runs the verb.
///
/// # Errors
/// The configuration or an effect is invalid, or the session cannot be written.
pub fn run(args: &Args, run: &Run) -> anyhow::Result<Outcome> {
    let started = std::time::Instant::now();
    let mut config = args.instrument()?;
    if let Some(n) = args.frames {
        config.stacks.scene_frames = n;
    }
    if args.targets {
        config.scenes.targets = true;
        let (object, stacks) = (config.manifest().object, &mut config.stacks);
        (stacks.scene_frames, stacks.scene_peak) = (resolution::frames(&object), [0.5; 2]);
    }
    if !args.depths.is_empty() {
        config.stacks.scene_depths_um = args.depths.clone();
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
        "session": in_json(&args.session), "frames": summary.frames, "sensor": [config.sensor.rows, config.sensor.cols],
        "bead_peak_e": summary.bead_peak_e, "scene_peak_e": summary.scene_peak_e, "full_scale_e": summary.full_scale_e,
        "family": config.family, "effects": settings, "seed": run.seed, "seconds": seconds,
    });
    Ok(Outcome { json, text })
}

/// An effect as the option gives it.
fn setting(text: &str) -> anyhow::Result<EffectSetting> {
    text.parse().map_err(|e| anyhow::anyhow!("--effect {text}: {e}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn effects_are_read_with_their_parameters_or_the_fault_is_named() {
        assert_eq!(setting("halo=0.05").unwrap(), EffectSetting::new("halo", &[("weight", 0.05)]));
        let two = EffectSetting::new("halo", &[("weight", 0.05), ("sigma_px", 20.0)]);
        assert_eq!(setting("halo=0.05,sigma_px=20").unwrap(), two);
        assert_eq!(setting("lens_gain=0.1").unwrap().params["change_0"], 0.1);
        let fault = |text: &str| setting(text).unwrap_err().to_string();
        assert!(fault("halo").contains("--effect halo: expected ID=STRENGTH"));
        assert!(fault("hallo=1").contains("`hallo`: unknown"));
        assert!(fault("halo=much").contains("a number, found `much`"));
        assert!(fault("halo=1,20").contains("NAME=VALUE, found `20`"));
        assert!(fault("halo=1,sigma_px=wide").contains("a number, found `wide`"));
        assert!(fault("halo=1,weight=2").contains("`weight` once"));
    }
}
