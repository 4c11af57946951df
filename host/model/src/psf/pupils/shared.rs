//! The pupils of an instrument, fitted once.

use super::{PupilModel, Scale};
use crate::psf::{ChiefRays, LowRankPsf};
use std::sync::{Arc, OnceLock};

/// The pupils of an instrument and of all its copies: fitted to its PSFs when they are first asked for.
#[derive(Clone, Debug, Default)]
pub struct Pupils(Arc<OnceLock<Option<PupilModel>>>);

impl Pupils {
    /// The pupils that explain `psf`, of a scan in one plane. None: the scan has several depths, or no pupil explains
    /// it.
    pub fn of(&self, psf: &LowRankPsf, rays: &ChiefRays, pixel_pitch_um: f64) -> Option<&PupilModel> {
        if psf.node_depths_um.len() == 1 { self.fitted(psf, rays, pixel_pitch_um) } else { None }
    }

    /// The pupils that explain `psf`, of a scan at several depths, and how it changes from depth to depth. None: the
    /// scan has one depth, or no pupil explains it.
    pub fn between_depths(&self, psf: &LowRankPsf, rays: &ChiefRays, pixel_pitch_um: f64) -> Option<&PupilModel> {
        if psf.node_depths_um.len() == 1 { None } else { self.fitted(psf, rays, pixel_pitch_um) }
    }

    fn fitted(&self, psf: &LowRankPsf, rays: &ChiefRays, pixel_pitch_um: f64) -> Option<&PupilModel> {
        // No lock is held while threads share out the fit: another thread may fit as well, and one result counts.
        if self.0.get().is_none() {
            let scale = Scale { magnification: rays.magnification, pixel_pitch_um };
            let fitted = PupilModel::fit(psf, psf.depth_nearest(0.0), &rays.dead, scale);
            let _ = self.0.set(match psf.node_depths_um.len() {
                1 => fitted,
                _ => fitted.and_then(|pupils| pupils.with_depths(psf)),
            });
        }
        self.0.get()?.as_ref()
    }
}
