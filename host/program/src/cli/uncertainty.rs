//! `uncertainty`: learns intervals for each pixel of a method's reconstructions, on the virtual instrument.

use super::common::in_json;
use super::files::{Content, Files};
use super::{Outcome, Run};
use anyhow::{Context, bail, ensure};
use ommatidia_closing::Account;
use ommatidia_model::instrument::Instrument;
use ommatidia_network::methods::{MethodKind, title};
use ommatidia_network::uncertainty::{CalibrateWidths, EffectError, KIND, VirtualConfig};
use ommatidia_physics::scene::Specimen;
use ommatidia_session::artifact::{Provenance, file_hash};
use ommatidia_session::kind::FileKind;
use serde_json::json;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Options of `uncertainty`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Instrument file
    instrument: PathBuf,
    /// Checkpoint or network file, or the instrument itself with --method [default: the instrument]
    #[arg(long = "with", value_name = "FILE")]
    with: Option<PathBuf>,
    /// Method [default: svfouriernet for checkpoints and network files, wiener for instruments]
    #[arg(long, value_name = "METHOD")]
    method: Option<MethodKind>,
    /// Widths to write, for `reconstruct --uncertainty`
    #[arg(short, long, value_name = "WIDTHS")]
    output: PathBuf,
    /// Account of `close` for this instrument: the errors of the effects that it found are drawn, too
    #[arg(long, value_name = "CLOSING")]
    account: Option<PathBuf>,
    /// Number of virtual scenes; a fifth sets the scale of errors, the others calibrate
    #[arg(long, value_name = "N", default_value_t = CalibrateWidths::default().count)]
    count: usize,
    /// Share of pixels whose truth is to be inside
    #[arg(long, value_name = "SHARE", default_value_t = CalibrateWidths::default().coverage)]
    level: f64,
    /// Number of scenes that look alike from which the limits of one frame are taken
    #[arg(long, value_name = "N", default_value_t = CalibrateWidths::default().neighbours)]
    neighbours: usize,
    /// Kind of specimen, or several with commas between them (default: beads, cells, neurons, vessels, worms, target
    /// and section)
    #[arg(long, value_name = "KIND", value_delimiter = ',')]
    specimen: Vec<Specimen>,
    /// Signal of the brightest pixel of a frame, electrons, drawn between LOW and HIGH (default: 100 to 20,000, at most
    /// 80 % of full scale)
    #[arg(long, num_args = 2, value_names = ["LOW", "HIGH"])]
    peak_e: Option<Vec<f64>>,
}

impl Args {
    /// What the verb reads and writes.
    pub fn files(&self) -> Files {
        Files::reading([&self.instrument])
            .and_reading(&self.with)
            .and_reading(&self.account)
            .writing([&self.output], Content::artifact(KIND))
    }
}

/// The instrument by which intervals are made: the one that is given, or the file that the method is made from.
///
/// # Errors
/// Neither is an instrument.
pub(super) fn instrument_for(with: &Path, given: Option<&PathBuf>) -> anyhow::Result<PathBuf> {
    if let Some(given) = given {
        return Ok(given.clone());
    }
    match FileKind::of(with)? {
        FileKind::Artifact(kind) if kind == "instrument" => Ok(with.into()),
        found => bail!(
            "--instrument: {} is {found}; intervals need the instrument too, by which the widths were made: add \
             --instrument FILE",
            with.display()
        ),
    }
}

/// The standard errors of the effects of an instrument, from the account of `close`.
fn effect_errors(account: &Path, instrument: &Instrument) -> anyhow::Result<Vec<EffectError>> {
    let closing = Account::read(account)?.closing;
    let mut errors = Vec::new();
    for effect in closing.effects.iter().filter(|e| instrument.effects.iter().any(|own| own.id == e.id)) {
        for value in effect.params.iter().filter(|v| v.sigma.is_finite() && v.sigma > 0.0) {
            errors.push(EffectError { id: effect.id.clone(), name: value.name.clone(), sigma: value.sigma });
        }
    }
    // The bend of a response that flats show is part of a calibration, and its error is far below that of the noise.
    ensure!(
        !errors.is_empty() || instrument.bends().count() == instrument.effects.len(),
        "{}: expected the account of the effects of this instrument ({}), found none of them; give the account that \
         `close` wrote beside it",
        account.display(),
        instrument.effects.iter().map(|e| e.id.as_str()).collect::<Vec<_>>().join(", ")
    );
    Ok(errors)
}

/// Runs the verb.
///
/// # Errors
/// A file cannot be read or is of another kind, a setting is out of range, or the output cannot be written.
pub fn run(args: &Args, run: &Run) -> anyhow::Result<Outcome> {
    let start = Instant::now();
    let instrument = Instrument::read(&args.instrument)?;
    let with = args.with.as_ref().unwrap_or(&args.instrument);
    let kind = args.method.map_or_else(|| MethodKind::default_for(with), Ok)?;
    let method = kind.open(with, run.seed)?;
    let errors = args.account.as_ref().map(|path| effect_errors(path, &instrument)).transpose()?.unwrap_or_default();
    let peak_e = args.peak_e.as_deref().and_then(|p| Some([*p.first()?, *p.get(1)?]));
    let specimens = if args.specimen.is_empty() { VirtualConfig::default().specimens } else { args.specimen.clone() };
    let config = VirtualConfig { specimens, peak_e };
    let scenes = config.build(&instrument, &errors).with_context(|| args.instrument.display().to_string())?;
    let settings = CalibrateWidths { count: args.count, coverage: args.level, neighbours: args.neighbours };
    let hashes = [file_hash(with)?, file_hash(&args.instrument)?];
    let bar = run.progress(args.count as u64, "uncertainty");
    let widths = settings.run(method.as_ref(), &instrument, &scenes, hashes, run.seed, |n| bar.inc(n as u64))?;
    bar.finish_and_clear();
    let all = json!({ "settings": settings, "scenes": config, "effect_errors": errors, "method": kind });
    let mut provenance = Provenance::new("uncertainty", run.seed, &all).with_input(&args.instrument)?;
    for path in args.with.iter().chain(&args.account) {
        provenance = provenance.with_input(path)?;
    }
    widths.write(&args.output, provenance)?;
    let (made, seconds) = (&widths.made, start.elapsed().as_secs_f64());
    let text = format!(
        "{}: intervals of {:.0} % for {}, from {} virtual scenes ({} for the scale of errors), brightest pixel {:.0} \
         to {:.0} e-, {} replicates of the calibration, {} errors of effects, {seconds:.0} s\n\
         how often they are right: ommatidia coverage {0} --with FILE\n",
        args.output.display(),
        100.0 * made.coverage,
        title(method.name()),
        made.scale_scenes + made.scenes,
        made.scale_scenes,
        made.peak_e[0],
        made.peak_e[1],
        scenes.replicates(),
        errors.len(),
    );
    let json = json!({
        "uncertainty": in_json(&args.output), "made": made, "replicates": scenes.replicates(), "effect_errors": errors,
        "seconds": seconds,
    });
    Ok(Outcome { json, text })
}
