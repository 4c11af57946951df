//! `import-pth` and `export`: import and export of the published PyTorch weights.

use super::common::in_json;
use super::files::{Content, Files};
use super::{Outcome, Run};
use anyhow::Context;
use ommatidia_model::instrument::Instrument;
use ommatidia_network::train::pth::{self, ImportConfig};
use ommatidia_network::train::{Checkpoint, weights};
use ommatidia_physics::noise::{NoiseModel, Sources};
use ommatidia_physics::sensor::SensorMaps;
use ommatidia_session::artifact::Provenance;
use ommatidia_session::kind::FileKind;
use std::path::PathBuf;

/// Options of `import-pth`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// State dictionary of an SV-FourierNet as `torch.save` writes it
    weights: PathBuf,
    /// Checkpoint to write
    #[arg(short, long, value_name = "CHECKPOINT")]
    output: PathBuf,
    /// Instrument whose frames the network reconstructs: sizes, noise, sensor maps
    #[arg(long, value_name = "FILE", conflicts_with_all = ["frame", "object", "black_level"])]
    instrument: Option<PathBuf>,
    /// Rows and columns of frames [default for filters of 4200: 2886 3500]
    #[arg(long, num_args = 2, value_names = ["ROWS", "COLS"])]
    frame: Option<Vec<usize>>,
    /// Rows and columns of objects [default for filters of 4200: 2400 2400]
    #[arg(long, num_args = 2, value_names = ["ROWS", "COLS"])]
    object: Option<Vec<usize>>,
    /// Black level of the frames, DN
    #[arg(long, value_name = "DN", default_value_t = 0.0)]
    black_level: f64,
}

/// Options of `export`.
#[derive(Debug, clap::Args)]
pub struct Export {
    /// Checkpoint of an SV-FourierNet
    checkpoint: PathBuf,
    /// Safetensors to write, with the names and the crop of the published network
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
}

impl Args {
    /// What `import-pth` reads and writes.
    pub fn files(&self) -> Files {
        Files::reading([&self.weights])
            .and_reading(&self.instrument)
            .writing([&self.output], Content::artifact("checkpoint"))
    }
}

impl Export {
    /// What `export` reads and writes.
    pub fn files(&self) -> Files {
        Files::reading([&self.checkpoint]).writing([&self.output], Content::File(FileKind::Tensors))
    }
}

/// Runs `import-pth`.
///
/// # Errors
/// The file is not a state dictionary of an SV-FourierNet, or the checkpoint cannot be written.
pub fn run(args: &Args, run: &Run) -> anyhow::Result<Outcome> {
    let named = || args.weights.display().to_string();
    let checkpoint = pth::import(&args.weights, import_config(args)?).with_context(named)?;
    let config = serde_json::json!({ "network": checkpoint.body.network });
    let mut provenance = Provenance::new("import-pth", run.seed, &config).with_input(&args.weights)?;
    if let Some(path) = &args.instrument {
        provenance = provenance.with_input(path)?;
    }
    checkpoint.write(&args.output, provenance)?;
    let n = &checkpoint.body.network;
    let parameters = weights::count(n);
    let text = format!(
        "{}\n  {} filters of {} x {}, {} groups of {} blocks of {} features: {parameters} parameters\n  frames {} \
         x {}, objects {} x {}\n",
        args.output.display(),
        n.channels,
        n.filter_size,
        n.filter_size,
        n.groups,
        n.blocks,
        n.width,
        n.frame[0],
        n.frame[1],
        n.object[0],
        n.object[1],
    );
    Ok(Outcome {
        json: serde_json::json!({ "checkpoint": in_json(&args.output), "network": n, "parameters": parameters }),
        text,
    })
}

/// Sizes, noise and maps from the instrument or the options.
fn import_config(args: &Args) -> anyhow::Result<ImportConfig> {
    if let Some(path) = &args.instrument {
        let instrument = Instrument::read(path)?;
        let (sensor, object) = (&instrument.manifest.sensor, &instrument.manifest.object);
        return Ok(ImportConfig {
            frame: Some([sensor.rows, sensor.cols]),
            object: Some([object.rows, object.cols]),
            noise: instrument.noise,
            maps: instrument.sensor_maps()?,
        });
    }
    let pair = |sides: &Option<Vec<usize>>| sides.as_deref().and_then(|s| Some([*s.first()?, *s.get(1)?]));
    // The network divides a frame by its maximum, so the gain has no effect.
    let noise = NoiseModel {
        black_level_dn: args.black_level,
        gain_dn_per_e: 1.0,
        gain_sigma: 0.0,
        read_noise_e: 0.0,
        read_noise_sigma: 0.0,
        saturation_dn: 65535.0,
        sources: Sources::default(),
    };
    Ok(ImportConfig { frame: pair(&args.frame), object: pair(&args.object), noise, maps: SensorMaps::default() })
}

/// Runs `export`.
///
/// # Errors
/// The checkpoint cannot be read or holds another network, or the file cannot be written.
pub fn export(args: &Export, _run: &Run) -> anyhow::Result<Outcome> {
    let checkpoint = Checkpoint::read(&args.checkpoint)?;
    let tensors = pth::export(&checkpoint, &args.output)?;
    Ok(Outcome {
        json: serde_json::json!({ "weights": in_json(&args.output), "tensors": tensors }),
        text: format!("{}: {tensors} tensors\n", args.output.display()),
    })
}
