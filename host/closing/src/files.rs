//! Closes the loop from files to files.

use super::account::{Account, Closed, Filed, Recalibrated, Retrain, RetrainRequest, adopt};
use super::close::{close, residual};
use super::data::{Budget, Observations};
use super::layout::{check_layout, contradiction};
use super::options::{CalibratedOn, CloseOptions};
use super::search::trial_calibration;
use super::sensor::complete_sensor;
use anyhow::Context;
use ommatidia_model::calibrate::CalibrateConfig;
use ommatidia_model::instrument::Instrument;
use ommatidia_session::Session;
use ommatidia_session::artifact::{self, Provenance};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// What [`close_session`] reads and writes.
#[derive(Clone, Copy)]
pub struct CloseRequest<'a> {
    /// Folder of the measured session.
    pub session: &'a Path,
    /// File of the instrument to close.
    pub instrument: &'a Path,
    /// Instrument file to write. The account goes to [`account_path`] of it.
    pub output: &'a Path,
    /// How to calibrate, where the session shows that the PSFs must be calibrated again.
    pub calibration: CalibrateConfig,
    /// Whether to find the measurements that would separate what the session leaves open.
    pub plan: bool,
    /// Network to fine-tune on the closed instrument, if any.
    pub fine_tuning: Option<FineTuning<'a>>,
    /// Seed of all random draws.
    pub seed: u64,
}

/// A network that is fine-tuned on the closed instrument. The result is written beside the output, with suffix
/// `.network`.
#[derive(Clone, Copy)]
pub struct FineTuning<'a> {
    /// What trains it.
    pub trainer: &'a dyn Retrain,
    /// Checkpoint of the network.
    pub checkpoint: &'a Path,
    /// Steps of fine-tuning.
    pub steps: u64,
}

/// What [`close_session`] has written.
pub struct CloseOutcome {
    /// The closed instrument and its account.
    pub closed: Closed,
    /// File of the account.
    pub account_file: PathBuf,
}

/// Progress of [`close_session`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Progress<'a> {
    /// A step begins; its name.
    Step(&'a str),
    /// The fine-tuning begins.
    FineTuning,
    /// Number of steps of the fine-tuning that are done.
    FineTuned(u64),
}

/// Closes the loop for a session on disk: reads session and instrument, searches for effects, recalibrates where the
/// session requires it, fine-tunes a network if one is given, and writes the closed instrument and the account.
///
/// # Errors
/// A file cannot be read or written, session and instrument have different layouts, or the session holds no frame to
/// compare with.
pub fn close_session(
    request: &CloseRequest<'_>,
    progress: &mut dyn FnMut(Progress<'_>),
) -> anyhow::Result<CloseOutcome> {
    let (session, mut instrument) = read(request.session, request.instrument)?;
    let mut seen = Observations::read(&session, &Budget::default())?;
    let completed = complete_sensor(&mut instrument, &session, &seen);
    let calibrated_on = calibrated_on(&session, request.instrument)?;
    // A scan that is too sparse, or a check that fails, is no reason to search for nothing else.
    let (trial, untried) = match trial_calibration(&session, &instrument, &request.calibration) {
        Ok(trial) => (trial, None),
        Err(e) => (None, Some(format!("no new calibration was tried on the beads of this session: {e:#}"))),
    };
    let options = CloseOptions {
        session_name: &session.manifest().name,
        seed: request.seed,
        trial_calibration: trial.as_ref(),
        plan: request.plan,
        calibrated_on: &calibrated_on,
        ..CloseOptions::default()
    };
    let mut closed = close(&instrument, &mut seen, &options, |step| progress(Progress::Step(step)))
        .with_context(|| request.session.display().to_string())?;
    let notes = &mut closed.account.closing.notes;
    notes.splice(0..0, contradiction(&instrument.manifest, session.manifest()));
    notes.extend(completed.into_iter().chain(untried));
    if let Some(trial) = trial.as_ref().filter(|_| closed.needs_calibration()) {
        progress(Progress::Step("recalibrating"));
        adopt(&mut closed, &session, Recalibrated { before: &instrument, trial }, &request.calibration)?;
    }
    let mut provenance = provenance("close", request.seed, &session, request.instrument)?;
    for stack in session.stacks() {
        provenance = provenance.with_input(&stack.path())?;
    }
    closed.instrument.write(request.output, provenance.clone())?;
    if let Some(tuning) = &request.fine_tuning {
        progress(Progress::FineTuning);
        let retrained = tuning.trainer.retrain(
            &RetrainRequest {
                session: &session,
                closed: Filed { instrument: &closed.instrument, file: request.output },
                before: Some(Filed { instrument: &instrument, file: request.instrument }),
                checkpoint: tuning.checkpoint,
                output: &request.output.with_extension("network"),
                held_out_frames: &closed.account.closing.held_out_frames,
                steps: tuning.steps,
                seed: request.seed,
            },
            &mut |step| progress(Progress::FineTuned(step)),
        )?;
        closed.account.closing.retrained = Some(retrained);
    }
    let account_file = account_path(request.output);
    closed.account.write(&account_file, provenance)?;
    Ok(CloseOutcome { closed, account_file })
}

/// What [`residual_session`] reads.
#[derive(Clone, Copy, Debug)]
pub struct ResidualRequest<'a> {
    /// Folder of the measured session.
    pub session: &'a Path,
    /// File of the instrument.
    pub instrument: &'a Path,
    /// Seed of all random draws.
    pub seed: u64,
}

/// What [`residual_session`] has computed.
pub struct ResidualOutcome {
    /// The account: figures, tests of the residual, residual maps.
    pub account: Account,
    /// Its provenance, for the file that it is written to.
    pub provenance: Provenance,
}

/// Measures the residual of a session on disk without a search for effects.
///
/// # Errors
/// A file cannot be read, session and instrument have different layouts, or the session holds no frame to compare with.
pub fn residual_session(request: &ResidualRequest<'_>) -> anyhow::Result<ResidualOutcome> {
    let (session, mut instrument) = read(request.session, request.instrument)?;
    let mut seen = Observations::read(&session, &Budget::default())?;
    let completed = complete_sensor(&mut instrument, &session, &seen);
    let calibrated_on = calibrated_on(&session, request.instrument)?;
    let options = CloseOptions {
        session_name: &session.manifest().name,
        seed: request.seed,
        calibrated_on: &calibrated_on,
        ..CloseOptions::default()
    };
    let mut account =
        residual(&instrument, &mut seen, &options).with_context(|| request.session.display().to_string())?;
    account.closing.notes.splice(0..0, contradiction(&instrument.manifest, session.manifest()));
    account.closing.notes.extend(completed);
    let provenance = provenance("residual", request.seed, &session, request.instrument)?;
    Ok(ResidualOutcome { account, provenance })
}

/// The file of the account: that of the instrument, with suffix `.closing`.
pub fn account_path(output: &Path) -> PathBuf {
    output.with_extension("closing")
}

fn read(session: &Path, instrument: &Path) -> anyhow::Result<(Session, Instrument)> {
    let (open, instrument) = (Session::open(session)?, Instrument::read(instrument)?);
    check_layout(&instrument.manifest, open.manifest()).with_context(|| session.display().to_string())?;
    Ok((open, instrument))
}

/// The stacks of the session whose files the instrument's provenance names, by their hashes.
fn calibrated_on(session: &Session, instrument: &Path) -> anyhow::Result<Vec<CalibratedOn>> {
    let header = artifact::inspect(instrument)?;
    let inputs = header["provenance"]["inputs"].as_object();
    let hashes: BTreeSet<&str> = inputs.into_iter().flatten().filter_map(|(_, hash)| hash.as_str()).collect();
    let mut read = Vec::new();
    for (stack, entry) in session.stacks().iter().enumerate() {
        if hashes.contains(artifact::file_hash(&entry.path())?.as_str()) {
            read.push(CalibratedOn { stack, file: entry.entry().file.clone() });
        }
    }
    Ok(read)
}

fn provenance(verb: &str, seed: u64, session: &Session, instrument: &Path) -> anyhow::Result<Provenance> {
    let provenance = Provenance::new(verb, seed, &Budget::default());
    let mut provenance = provenance.with_input(&session.manifest_path())?.with_input(instrument)?;
    // What the instrument was calibrated on stays known through any number of closed loops.
    let header = artifact::inspect(instrument)?;
    for (name, hash) in header["provenance"]["inputs"].as_object().into_iter().flatten() {
        if let Some(hash) = hash.as_str() {
            provenance.inputs.entry(name.clone()).or_insert_with(|| hash.into());
        }
    }
    Ok(provenance)
}
