//! `close`: what an instrument lacks, found in a session.

use super::{Outcome, Run};
use crate::closing::model::Model;
use crate::closing::observe::{Budget, Observations};
use crate::closing::search::search;
use crate::instrument::Instrument;
use crate::session::Session;
use std::path::PathBuf;

/// Options of `close`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Folder of the measured session
    session: PathBuf,
    /// Instrument to close
    #[arg(long, value_name = "FILE")]
    instrument: PathBuf,
    /// Instrument file to write
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
}

/// Runs the verb.
///
/// # Errors
/// A file cannot be read or written.
pub fn run(args: &Args, _run: &Run) -> anyhow::Result<Outcome> {
    let session = Session::open(&args.session)?;
    let instrument = Instrument::read(&args.instrument)?;
    let seen = Observations::read(&session, &instrument, &Budget::default())?;
    let model = Model::new(&instrument, &seen)?;
    let state = model.state(&instrument)?;
    let out = search(&model, &instrument, state, |_| ())?;
    let text = format!(
        "{:?}\n{:?}\nchi2 {} -> {} held out {:?} -> {:?}\n",
        out.found,
        out.after.state,
        out.before.chi2 / out.before.pixels as f64,
        out.after.chi2 / out.after.pixels as f64,
        out.before.held_out.0 / out.before.held_out.1 as f64,
        out.after.held_out.0 / out.after.held_out.1 as f64
    );
    Ok(Outcome { json: serde_json::json!({}), text })
}
