//! `close`: finds the effects that an instrument lacks and adds them.

use super::common::{left_out, odd_scenes, yes_or_no};
use super::files::{Content, Files};
use super::retrain::Networks;
use super::{Outcome, Run};
use ommatidia_closing::{
    CloseOutcome, CloseRequest, Closing, Effect, FineTuning, JudgedOn, Plan, Progress, account_path, close_session,
};
use ommatidia_model::calibrate::CalibrateConfig;
use ommatidia_network::methods::frame_range;
use ommatidia_physics::effects::Stage;
use ommatidia_session::Session;
use ommatidia_session::kind::FileKind;

use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Options of `close`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example: ommatidia close session/ --instrument lab.instrument -o closed.instrument --report \
                  close.html")]
pub struct Args {
    /// Folder of the measured session
    session: PathBuf,
    /// Instrument file to close
    #[arg(long, value_name = "FILE")]
    instrument: PathBuf,
    /// Instrument file to write; the account is written beside it, with suffix .closing
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Bring every bead frame to the same total light, or keep its brightness (yes, no), as for calibrate; used if the
    /// PSFs must be calibrated again [default: decided from the data]
    #[arg(long, value_name = "YES|NO", num_args = 0..=1, require_equals = true, default_missing_value = "yes",
        value_parser = yes_or_no)]
    normalise_beads: Option<bool>,
    /// Fine-tune this network on the closed instrument, write it beside the output with suffix .network, and compare
    /// both networks on held-out scenes
    #[arg(long, value_name = "CHECKPOINT")]
    retrain: Option<PathBuf>,
    /// Steps of fine-tuning
    #[arg(long, value_name = "N", default_value_t = 1000, requires = "retrain")]
    steps: u64,
    /// Find the measurements that would separate effects that this session confuses, and test those that it cannot test
    #[arg(long)]
    plan: bool,
    /// Write a report of the account to this HTML file
    #[arg(long, value_name = "FILE")]
    report: Option<PathBuf>,
}

impl Args {
    /// What the verb reads and writes.
    pub fn files(&self) -> Files {
        let network = self.retrain.as_ref().map(|_| network_path(&self.output));
        Files::reading([&self.session, &self.instrument])
            .and_reading(&self.retrain)
            .writing([&self.output], Content::artifact("instrument"))
            .writing([account_path(&self.output)], Content::artifact("closing"))
            .writing(network, Content::artifact("checkpoint"))
            .writing(&self.report, Content::File(FileKind::Page))
    }
}

/// Where the fine-tuned network goes.
fn network_path(output: &Path) -> PathBuf {
    output.with_extension("network")
}

/// Runs the verb.
///
/// # Errors
/// A file cannot be read or written, or session and instrument have different layouts.
pub fn run(args: &Args, run: &Run) -> anyhow::Result<Outcome> {
    let started = Instant::now();
    let session = Session::open(&args.session)?;
    let mut warnings = odd_scenes(&session, frame_range(&args.instrument)?)?;
    warnings.extend(left_out(&session));
    let fine_tuning = args.retrain.as_deref();
    let request = CloseRequest {
        session: &args.session,
        instrument: &args.instrument,
        output: &args.output,
        calibration: CalibrateConfig { normalise_beads: args.normalise_beads, ..CalibrateConfig::default() },
        plan: args.plan,
        fine_tuning: fine_tuning.map(|checkpoint| FineTuning { trainer: &Networks, checkpoint, steps: args.steps }),
        seed: run.seed,
    };
    let mut bar = run.spinner("close");
    let CloseOutcome { closed, account_file } = close_session(&request, &mut |progress| match progress {
        Progress::Step(name) => {
            bar.set_message(name.to_string());
            bar.tick();
        }
        Progress::FineTuning => {
            bar.finish_and_clear();
            // The network, and the control.
            bar = run.progress(2 * args.steps, "retrain");
        }
        Progress::FineTuned(steps) => bar.set_position(steps),
    })?;
    bar.finish_and_clear();
    if let Some(report) = &args.report {
        let page = ommatidia_report::render(&[account_file.clone(), args.output.clone()])?;
        ommatidia_session::artifact::write_whole(report, page.as_bytes())?;
    }
    let seconds = started.elapsed().as_secs_f64();
    let closing = &closed.account.closing;
    let mut json = serde_json::to_value(closing)?;
    json["seconds"] = seconds.into();
    json["warnings"] = warnings.into();
    json["account"] = account_file.display().to_string().into();
    Ok(Outcome { json, text: table(closing, &args.output, &account_file, seconds) })
}

/// What the figures of an account are of.
pub(super) fn judged_on(closing: &Closing) -> &'static str {
    match closing.judged_on {
        JudgedOn::Known if closing.own_beads => "on the bead frames of the calibration itself",
        JudgedOn::Known => "on held-out data",
        JudgedOn::SelfConsistency => "on blocks of the frames that were left out of the estimates of the specimens",
        JudgedOn::Even => "on held-out flats and darks",
        JudgedOn::Nothing => "not judged: no frame shows light that is known",
    }
}

/// A figure of an account; a dash where it is not judged.
pub(super) fn figure(value: f64) -> String {
    if value.is_finite() { format!("{value:.5}") } else { "-".into() }
}

/// The account as a table.
pub fn table(closing: &Closing, output: &Path, account: &Path, seconds: f64) -> String {
    let mut out = String::new();
    let on = judged_on(closing);
    // Writing to a string cannot fail.
    let _ = writeln!(out, "{}\n", closing.verdict.words());
    let _ = writeln!(out, "{:<24} {:>12} {:>12}   {on}", "", "before", "after");
    let (b, a) = (closing.before, closing.after);
    for (name, before, after) in
        [("chi2 / pixel", b.chi2_ndf, a.chi2_ndf), ("NRMSE (with noise)", b.nrmse, a.nrmse), ("PCC", b.pcc, a.pcc)]
    {
        let [before, after] = [before, after].map(figure);
        let _ = writeln!(out, "{name:<24} {before:>12} {after:>12}");
    }
    if closing.effects.is_empty() {
        let _ = writeln!(out, "\nno effect found");
    }
    let of_records = |e: &&Effect| e.stage == Stage::Record.part();
    let (faults, others): (Vec<&Effect>, Vec<&Effect>) = closing.effects.iter().partition(of_records);
    for e in faults.iter().take(FEW).chain(&others) {
        let _ = writeln!(out, "\n{} ({}, z = {:.1}){}", e.id, e.stage, e.z, explained(e));
        let _ = writeln!(out, "  {}", e.description);
        if !e.ambiguity.is_empty() {
            let separate = e.separate_by.as_deref().unwrap_or("more data");
            let _ = writeln!(out, "  could also be {}; to distinguish them: {separate}", e.ambiguity.join(", "));
        }
    }
    if let Some(more) = more_faults(faults.len()) {
        let _ = writeln!(out, "\n{more}");
    }
    for n in &closing.nearest {
        let _ = writeln!(out, "\nlike {} (z = {:.1}), which is not shown as the cause: {}", n.id, n.z, n.why);
    }
    if closing.catalogue_incomplete {
        let _ = writeln!(out, "\nThe residual still has structure that no effect of the catalogue explains.");
    }
    let limits: Vec<String> = closing
        .rejected
        .iter()
        .filter_map(|r| {
            let unit = if r.unit == "1" { String::new() } else { format!(" {}", r.unit) };
            Some(format!("{} {} < {:.2e}{unit}", r.id, r.param, r.upper_limit?))
        })
        .collect();
    let _ = writeln!(out, "\nnot found (upper limits, 95 %): {}", limits.join("; "));
    let untestable: Vec<&str> =
        closing.rejected.iter().filter(|r| r.upper_limit.is_none()).map(|r| r.id.as_str()).collect();
    if !untestable.is_empty() {
        let _ = writeln!(out, "not testable with this session: {}", untestable.join(", "));
    }
    if let Some(r) = &closing.retrained {
        let _ = writeln!(
            out,
            "network on {} held-out scenes: {:.2} dB, SSIM {:.3} -> {:.2} dB, SSIM {:.3} after {} steps on the closed \
             instrument",
            r.frames.len(),
            r.psnr_db_before,
            r.ssim_before,
            r.psnr_db_after,
            r.ssim_after,
            r.steps
        );
        if let Some(c) = &r.control {
            let _ = writeln!(
                out,
                "control, the same steps on the instrument before: {:.2} dB, SSIM {:.3}; {:+.2} dB are owed to \
                 the loop",
                c.psnr_db,
                c.ssim,
                r.psnr_db_after - c.psnr_db
            );
        }
    }
    if let Some(plan) = &closing.plan {
        out.push_str(&planned(plan));
    }
    for note in &closing.notes {
        let _ = writeln!(out, "note: {note}");
    }
    let _ = writeln!(out, "{seconds:.1} s\n-> {}\n-> {}", output.display(), account.display());
    out
}

/// Number of faults of the records that are listed on the screen.
pub(super) const FEW: usize = 4;

/// A line in the place of further faults of the records. None: all are listed.
pub(super) fn more_faults(faults: usize) -> Option<String> {
    let more = faults.checked_sub(FEW).filter(|n| *n > 0)?;
    Some(format!("{more} more frames have faults in their records; `--json` lists all"))
}

/// The measurements that are advised, each with what it is expected to separate.
fn planned(plan: &Plan) -> String {
    let mut out = String::new();
    if plan.goals.is_empty() {
        return "\nmeasure next: nothing is ambiguous, and everything is testable\n".into();
    }
    let _ = writeln!(out, "\nmeasure next, for {:.0} sigma each:", plan.enough_sigma);
    for (i, m) in plan.measurements.iter().enumerate() {
        let _ = writeln!(out, "{}. {}", i + 1, m.words);
        for (g, goal) in plan.goals.iter().enumerate().filter(|(g, _)| plan.reached_by(*g) == Some(i)) {
            let _ = writeln!(
                out,
                "   {} ({} = {:.3e}): {:.1} -> {:.1} sigma",
                goal.words(),
                goal.param,
                goal.strength,
                goal.sigmas_now,
                m.sigmas[g]
            );
        }
    }
    let open = |g: &usize| plan.reached_by(*g).is_none() && plan.goals[*g].sigmas_now < plan.enough_sigma;
    let left: Vec<String> = (0..plan.goals.len()).filter(open).map(|g| plan.goals[g].words()).collect();
    if !left.is_empty() {
        let _ = writeln!(out, "no measurement of the catalogue reaches that for: {}", left.join("; "));
    }
    for a in &plan.assumptions {
        let _ = writeln!(out, "assumed: {a}");
    }
    out
}

fn explained(e: &Effect) -> String {
    e.excess_explained.map_or(String::new(), |f| format!(", explains {:.0} % of the excess", 100.0 * f))
}
