//! A new calibration in the place of the old one, and its entry in the account.

use super::result::Closed;
use crate::search::{NEEDS_CALIBRATION, calibration_of, held_out_figures};
use ommatidia_model::calibrate::CalibrateConfig;
use ommatidia_model::instrument::Instrument;
use ommatidia_session::Session;

/// The two instruments that a recalibration is reported with.
#[derive(Clone, Copy, Debug)]
pub struct Recalibrated<'a> {
    /// The instrument before.
    pub before: &'a Instrument,
    /// The calibration on the training beads alone: only its figures on held-out beads are unbiased.
    pub trial: &'a Instrument,
}

/// Calibrates on all beads of the session and puts the result in the place of the closed instrument. The figures
/// "after" are those of the trial calibration, which did not use the held-out beads.
///
/// # Errors
/// The session cannot be read or calibrated.
pub fn adopt(
    closed: &mut Closed,
    session: &Session,
    instruments: Recalibrated<'_>,
    config: &CalibrateConfig,
) -> anyhow::Result<()> {
    let Recalibrated { before, trial } = instruments;
    let whole = calibration_of(session, before, config)?;
    let closing = &mut closed.account.closing;
    closing.after = held_out_figures(session, trial)?;
    let terms = [before, &whole].map(|i| i.psf.basis.dim().1);
    if let Some(effect) = closing.effects.iter_mut().find(|e| e.id == NEEDS_CALIBRATION) {
        effect.description = format!(
            "the PSF varies over the field more than {} terms per lens can describe: recalibrated with {} terms, foci \
             {:.2} px rms off their chief rays (distortion) kept inside the windows; NRMSE on held-out beads {:.4} -> \
             {:.4}",
            terms[0], terms[1], whole.quality.chief_ray_rms_px, closing.before.nrmse, closing.after.nrmse
        );
    }
    closing.notes.push(
        "the PSFs were recalibrated on the session's own beads; their basis now contains the changes of chief rays and \
         of the PSF over the field"
            .into(),
    );
    closed.instrument = whole;
    Ok(())
}
