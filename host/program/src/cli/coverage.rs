//! `coverage`: how often the truth lies inside the intervals, on scenes that no calibration has used.

use super::common::{in_json, warn};
use super::files::Files;
use super::uncertainty::instrument_for;
use super::{Outcome, Run};
use anyhow::{Context, bail};
use ommatidia_model::instrument::Instrument;
use ommatidia_network::evaluate::Scenes;
use ommatidia_network::methods::{MethodKind, title};
use ommatidia_network::uncertainty::{Coverage, CoverageTotals, Stratum, VirtualConfig, Widths};
use ommatidia_physics::effects::EffectSetting;
use ommatidia_physics::scene::Specimen;
use ommatidia_session::Session;
use serde_json::json;
use std::fmt::Write;
use std::path::PathBuf;

/// Options of `coverage`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Widths made by `uncertainty`
    widths: PathBuf,
    /// Checkpoint, network file, or instrument that the widths were made for
    #[arg(long = "with", value_name = "FILE")]
    with: PathBuf,
    /// Method [default: svfouriernet for checkpoints and network files, wiener for instruments]
    #[arg(long, value_name = "METHOD")]
    method: Option<MethodKind>,
    /// Instrument that the widths were made for [default: the file of --with, if it is an instrument]
    #[arg(long, value_name = "FILE")]
    instrument: Option<PathBuf>,
    /// Number of virtual scenes
    #[arg(long, value_name = "N", default_value_t = 840)]
    count: usize,
    /// Kind of specimen, or several with commas between them (default: beads, cells, neurons, vessels, worms, target
    /// and section)
    #[arg(long, value_name = "KIND", value_delimiter = ',')]
    specimen: Vec<Specimen>,
    /// Effect that the virtual frames have and the instrument does not, such as halo=0.05; repeat the option for more
    #[arg(long, value_name = "ID=STRENGTH[,NAME=VALUE..]", conflicts_with = "session")]
    effect: Vec<String>,
    /// Judge the scenes of a session with known objects instead of virtual ones
    #[arg(long, value_name = "SESSION", conflicts_with_all = ["count", "specimen"])]
    session: Option<PathBuf>,
}

impl Args {
    /// What the verb reads and writes.
    pub fn files(&self) -> Files {
        Files::reading([&self.widths, &self.with]).and_reading(&self.instrument).and_reading(&self.session)
    }
}

/// Runs the verb.
///
/// # Errors
/// A file cannot be read, or the widths belong to another method or instrument.
pub fn run(args: &Args, run: &Run) -> anyhow::Result<Outcome> {
    let widths = Widths::read(&args.widths)?;
    let path = instrument_for(&args.with, args.instrument.as_ref())?;
    let kind = args.method.map_or_else(|| MethodKind::default_for(&args.with), Ok)?;
    let method = kind.open(&args.with, run.seed)?;
    widths.check(&args.widths, method.name(), &args.with, &path)?;
    let instrument = Instrument::read(&path)?;
    let (peak_e, nominal) = (widths.made.peak_e, widths.made.coverage);
    let ready = widths.on(&instrument)?;
    let mut coverage = Coverage::new(&ready);
    if let Some(folder) = &args.session {
        let session = Session::open(folder)?;
        let mut scenes = Scenes::of(&session, None)?;
        let bar = run.progress(scenes.count() as u64, "coverage");
        for i in 0..scenes.count() {
            let case = scenes.case(i)?;
            let added = coverage.add_measured(&ready, method.as_ref(), i, &case.frame_dn, &case.truth);
            added.with_context(|| folder.display().to_string())?;
            bar.inc(1);
        }
        bar.finish_and_clear();
    } else {
        if args.count == 0 {
            bail!("--count: expected one scene or more, found 0");
        }
        let mut changed = instrument;
        for text in &args.effect {
            let effect: EffectSetting = text.parse().map_err(|e| anyhow::anyhow!("--effect {text}: {e}"))?;
            changed.effects.push(effect);
        }
        let specimens =
            if args.specimen.is_empty() { VirtualConfig::default().specimens } else { args.specimen.clone() };
        let scenes = VirtualConfig { specimens, peak_e: Some(peak_e) }.build(&changed, &[])?;
        let bar = run.progress(args.count as u64, "coverage");
        coverage.add_virtual(&ready, method.as_ref(), &scenes, run.seed, args.count, || bar.inc(1))?;
        bar.finish_and_clear();
    }
    let (totals, strata) = (coverage.totals(), coverage.strata());
    let few = strata.iter().any(|s| s.scenes < 20);
    let note = "some strata have fewer than 20 scenes: their coverage scatters by more than its range; raise --count";
    let warnings = warn((few && args.session.is_none()).then(|| note.into()));
    let json = json!({
        "widths": in_json(&args.widths), "method": method.name(), "nominal": nominal, "effects": args.effect,
        "session": args.session.as_ref().map(in_json), "seed": run.seed, "totals": totals,
        "strata": strata, "warnings": warnings,
    });
    Ok(Outcome { text: table(method.name(), nominal, &totals, &strata), json })
}

/// The figures, the lowest coverage first.
fn table(method: &str, nominal: f64, totals: &CoverageTotals, strata: &[Stratum]) -> String {
    let percent = |v: f64| 100.0 * v;
    let mut text = format!(
        "{}: {:.1} % of the pixels of {} scenes inside intervals of {:.0} % ({:.1} % of the lit pixels)\n\
         {} of {} strata within 2 %; lowest {:.1} %, highest {:.1} %\n\
         frames with a warning {:.1} % (not consistent {:.1} %, unlike the calibration {:.1} %); without one {:.1} % \
         of the pixels inside\n\n{:9} {:>15} {:>11} {:>7} {:>14} {:>6} {:>7} {:>7}\n",
        title(method),
        percent(totals.coverage),
        totals.scenes,
        percent(nominal),
        percent(totals.lit),
        totals.within,
        totals.strata,
        percent(totals.worst),
        percent(totals.highest),
        percent(totals.warned),
        percent(totals.inconsistent),
        percent(totals.unlike),
        percent(totals.coverage_without_warning),
        "specimen",
        "brightest, e-",
        "radius",
        "scenes",
        "inside, %",
        "lit",
        "width",
        "warned"
    );
    for s in strata {
        let error = s.standard_error.map_or(String::new(), |e| format!(" ± {:.1}", percent(e)));
        let name = s.specimen.map_or("-".into(), |kind| format!("{kind:?}").to_lowercase());
        // Writing to a string cannot fail.
        let _ = writeln!(
            text,
            "{name:9} {:>15} {:>11} {:>7} {:>14} {:>6} {:>7.3} {:>7.2}",
            format!("{:.0} to {:.0}", s.peak_e[0], s.peak_e[1]),
            format!("{:.2}-{:.2}", s.radius[0], s.radius[1]),
            s.scenes,
            format!("{:.1}{error}", percent(s.coverage)),
            s.lit.map_or("-".into(), |v| format!("{:.1}", percent(v))),
            s.width,
            s.warned
        );
    }
    text
}
