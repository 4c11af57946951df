//! The pupils of an instrument, fitted once.

use super::{PupilModel, Scale};
use crate::psf::{ChiefRays, LowRankPsf};
use std::sync::{Arc, OnceLock};

/// The pupils of an instrument and of all its copies: fitted to its PSFs when they are first asked for.
#[derive(Clone, Debug, Default)]
pub struct Pupils(Arc<OnceLock<Option<PupilModel>>>);

impl Pupils {
    /// The pupils that explain `psf`. None: the scan has several depths, which need no pupil, or none explains it.
    pub fn of(&self, psf: &LowRankPsf, rays: &ChiefRays, pixel_pitch_um: f64) -> Option<&PupilModel> {
        // No lock is held while threads share out the fit: another thread may fit as well, and one result counts.
        if self.0.get().is_none() {
            let scale = Scale { magnification: rays.magnification, pixel_pitch_um };
            let fitted = if psf.node_depths_um.len() == 1 { PupilModel::fit(psf, 0, &rays.dead, scale) } else { None };
            let _ = self.0.set(fitted);
        }
        self.0.get()?.as_ref()
    }
}
