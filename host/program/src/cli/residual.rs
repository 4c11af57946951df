//! `residual`: measured minus predicted, and what it depends on.

use super::close::{FEW, figure, judged_on, more_faults};
use super::common::{left_out, odd_scenes};
use super::files::{Content, Files};
use super::{Outcome, Run};
use ommatidia_closing::{ResidualOutcome, ResidualRequest, residual_session};
use ommatidia_network::methods::frame_range;
use ommatidia_session::Session;
use ommatidia_session::kind::FileKind;
use std::fmt::Write;
use std::path::PathBuf;

/// Options of `residual`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example: ommatidia residual session/ --instrument lab.instrument --report residual.html")]
pub struct Args {
    /// Folder of the measured session
    session: PathBuf,
    /// Instrument file
    #[arg(long, value_name = "FILE")]
    instrument: PathBuf,
    /// Write the account, with residual maps, to this file
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Write a report of the account to this HTML file
    #[arg(long, value_name = "FILE")]
    report: Option<PathBuf>,
}

impl Args {
    /// What the verb reads and writes.
    pub fn files(&self) -> Files {
        Files::reading([&self.session, &self.instrument])
            .writing(&self.output, Content::artifact("closing"))
            .writing(&self.report, Content::File(FileKind::Page))
    }
}

/// Runs the verb.
///
/// # Errors
/// A file cannot be read or written, or session and instrument have different layouts.
pub fn run(args: &Args, run: &Run) -> anyhow::Result<Outcome> {
    let session = Session::open(&args.session)?;
    let mut warnings = odd_scenes(&session, frame_range(&args.instrument)?)?;
    warnings.extend(left_out(&session));
    let request = ResidualRequest { session: &args.session, instrument: &args.instrument, seed: run.seed };
    let ResidualOutcome { account, provenance } = residual_session(&request)?;
    if let Some(output) = &args.output {
        account.write(output, provenance.clone())?;
    }
    if let Some(report) = &args.report {
        let folder = tempfile::tempdir()?;
        let file = folder.path().join("residual.closing");
        account.write(&file, provenance)?;
        let page = ommatidia_report::render(&[file.clone(), args.instrument.clone()])?;
        // The page names its sources, and this one is gone when somebody reads it.
        let name = args.output.as_ref().map_or("an account that was not kept".into(), |o| o.display().to_string());
        let page = page.replace(&file.display().to_string(), &name);
        ommatidia_session::artifact::write_whole(report, page.as_bytes())?;
    }
    let c = &account.closing;
    let mut text = String::new();
    // Writing to a string cannot fail.
    let _ = writeln!(
        text,
        "chi2 / pixel {}, NRMSE {}, PCC {} {}\n",
        figure(c.before.chi2_ndf),
        figure(c.before.nrmse),
        figure(c.before.pcc),
        judged_on(c)
    );
    for note in &c.notes {
        let _ = writeln!(text, "note: {note}");
    }
    for fault in c.faults.iter().take(FEW) {
        let _ = writeln!(text, "record: {}", fault.words());
    }
    if let Some(more) = more_faults(c.faults.len()) {
        let _ = writeln!(text, "record: {more}");
    }
    let _ = writeln!(text, "{:<40} {:>10} {:>10} {:>8}", "the residual depends on", "chi2", "expected", "sigma");
    for d in &c.dependences_before {
        let _ = writeln!(text, "{:<40} {:>10.1} {:>10.1} {:>8.1}", d.covariate.words(), d.chi2, d.expected, d.z);
    }
    let mut json = c.residual_figures();
    json["warnings"] = warnings.into();
    Ok(Outcome { json, text })
}
