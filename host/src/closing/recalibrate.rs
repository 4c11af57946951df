//! When the PSFs vary more over the field than the model lets them, a number is no cure: the model needs more terms. They are
//! calibrated anew on the session's own bead scan: once on the beads that may be fitted, for the figures on those that may not,
//! and once on all of them, for the instrument.

use super::close::Closed;
use super::figures::figures;
use super::model::Model;
use super::observe::{Budget, Observations};
use super::refit::refit;
use super::result::Figures;
use crate::calibrate::{CalibrateConfig, calibrate};
use crate::instrument::Instrument;
use crate::session::{Existing, FrameInfo, Role, SampleType, Session, SessionWriter, StackEntry, StackSpec};
use anyhow::Context;
use std::path::Path;

/// Id of the effect that asks for it.
pub const ASKED_BY: &str = "rank_truncation";

/// By how much a new calibration must lower the NRMSE of held-out beads to count.
const BETTER: f64 = 0.9;

/// A new calibration by the beads that may be fitted, if the session has no known scenes to tell more by, and the beads that may not are the better
/// for it.
///
/// # Errors
/// The session cannot be read or calibrated, or there is no room for a copy of its beads.
pub fn anew(session: &Session, before: &Instrument, config: &CalibrateConfig) -> anyhow::Result<Option<Instrument>> {
    let known = session.stacks_of(Role::Scene).any(|s| s.entry().truth.is_some());
    if known || session.stacks_of(Role::Bead).next().is_none() {
        return Ok(None);
    }
    let folder = tempfile::tempdir().context("a folder for the beads that may be fitted")?;
    let part = folder.path().join("training");
    training_beads(session, &part)?;
    let first = calibrate(&Session::open(&part)?, config, || {})?.instrument;
    let nrmse = |instrument| -> anyhow::Result<f64> { Ok(held_out(session, instrument)?.nrmse) };
    Ok((nrmse(&first)? < BETTER * nrmse(before)?).then_some(first))
}

/// Whether the loop found that nothing less than a new calibration will do.
pub fn needed(closed: &Closed) -> bool {
    closed.account.closing.effects.iter().any(|e| e.id == ASKED_BY)
}

/// Puts a new calibration in the place of the old one: by all beads, with the figures of `first`, which has not seen all of them.
///
/// # Errors
/// The session cannot be read or calibrated.
pub fn adopt(
    closed: &mut Closed,
    session: &Session,
    [before, first]: [&Instrument; 2],
    config: &CalibrateConfig,
) -> anyhow::Result<()> {
    let whole = calibrate(session, config, || {})?.instrument;
    let closing = &mut closed.account.closing;
    closing.after = held_out(session, first)?;
    let terms = [before, &whole].map(|i| i.psf.basis.dim().1);
    if let Some(effect) = closing.effects.iter_mut().find(|e| e.id == ASKED_BY) {
        effect.description = format!(
            "the PSF varies over the field more than {} terms a lens let it: calibrated anew with {}, foci {:.2} px rms off their chief rays \
             (distortion) kept in the windows; NRMSE on beads that were left out {:.4} -> {:.4}",
            terms[0], terms[1], whole.quality.chief_ray_rms_px, closing.before.nrmse, closing.after.nrmse
        );
    }
    closing.notes.push(
        "the PSFs were calibrated anew on the session's own beads; what was found of chief rays and field dependence is inside their basis"
            .into(),
    );
    closed.instrument = whole;
    Ok(())
}

/// Figures of an instrument on the beads that no fit has seen.
///
/// # Errors
/// The session cannot be read, or is of another kind.
pub fn held_out(session: &Session, instrument: &Instrument) -> anyhow::Result<Figures> {
    let seen = Observations::read(session, &Budget::default())?;
    let model = Model::new(instrument, &seen)?;
    Ok(figures(&model, &refit(&model, model.state(instrument)?)?))
}

/// Writes a session of the beads that may be fitted, with all that is not beads as it is.
fn training_beads(session: &Session, target: &Path) -> anyhow::Result<()> {
    let seen = Observations::read(session, &Budget { beads: usize::MAX, ..Budget::default() })?;
    let manifest = crate::session::Manifest { stacks: Vec::new(), ..session.manifest().clone() };
    let mut writer = SessionWriter::create(target, &manifest, Existing::Keep)?;
    for (s, stack) in session.stacks().iter().enumerate().filter(|(_, stack)| stack.role() != Role::Scene) {
        let mut frames = stack.frames()?;
        let taken: Vec<usize> = match stack.role() {
            Role::Bead => seen.frames.iter().filter(|f| f.stack == s && !f.held_out).map(|f| f.info.frame).collect(),
            _ => (0..stack.len()).collect(),
        };
        let name = format!("stack{s}");
        let (rows, cols) = (session.manifest().sensor.rows, session.manifest().sensor.cols);
        let spec = StackSpec { frames: taken.len(), rows, cols, samples: SampleType::F32, pixel_um: None };
        let mut out = writer.frames(&format!("{name}.npy"), spec)?;
        for i in &taken {
            out.push(frames.read(*i)?.view())?;
        }
        out.finish()?;
        let rows: Vec<FrameInfo> =
            taken.iter().enumerate().map(|(n, i)| FrameInfo { frame: n, ..stack.info()[*i].clone() }).collect();
        writer.table(&format!("{name}.csv"), &rows)?;
        writer.add(StackEntry {
            role: stack.role(),
            file: format!("{name}.npy"),
            exposure_ms: stack.entry().exposure_ms,
            table: Some(format!("{name}.csv")),
            truth: None,
            expected: None,
        });
    }
    writer.finish()?;
    Ok(())
}
