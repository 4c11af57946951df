//! The pupils of an instrument, fitted once.

use super::fit::LensPupil;
use super::{PupilModel, Scale};
use crate::psf::{ChiefRays, LowRankPsf};
use serde::{Deserialize, Serialize};
use std::sync::{Arc, OnceLock};

/// The pupils of an instrument and of all its copies: fitted to its PSFs when they are first asked for.
#[derive(Clone, Debug, Default)]
pub struct Pupils(Arc<OnceLock<Option<PupilModel>>>);

/// What a file holds of pupils that were fitted: the rest follows from the PSFs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct StoredPupils {
    /// None: no pupil explains the PSFs.
    model: Option<StoredModel>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct StoredModel {
    lenses: Vec<Option<LensPupil>>,
    depth: usize,
    scanned_waves_per_um: Vec<Option<f64>>,
    misfit: f64,
}

impl StoredModel {
    /// Whether it fits PSFs.
    fn is_of(&self, psf: &LowRankPsf) -> bool {
        let (lenses, .., depths, _, _) = psf.coefficients.dim();
        let scanned = self.scanned_waves_per_um.len();
        self.lenses.len() == lenses
            && self.lenses.iter().flatten().all(LensPupil::is_possible)
            && self.depth < depths
            && scanned == if depths > 1 { lenses } else { 0 }
    }
}

impl Pupils {
    /// What a file holds of them. None: they are not fitted yet.
    pub(crate) fn stored(&self) -> Option<StoredPupils> {
        let model = self.0.get()?.as_ref().map(|model| StoredModel {
            lenses: model.lenses.clone(),
            depth: model.depth,
            scanned_waves_per_um: model.scanned_waves_per_um.clone(),
            misfit: model.misfit,
        });
        Some(StoredPupils { model })
    }

    /// Those of a file, which were fitted to `psf`. None: they do not belong to it.
    pub(crate) fn restored(
        stored: StoredPupils,
        psf: &LowRankPsf,
        rays: &ChiefRays,
        pixel_pitch_um: f64,
    ) -> Option<Self> {
        let scale = Scale { magnification: rays.magnification, pixel_pitch_um };
        let model = match stored.model {
            None => None,
            Some(of) if !of.is_of(psf) => return None,
            Some(of) => {
                let mut model = PupilModel::of(psf, of.lenses, of.depth, scale);
                (model.scanned_waves_per_um, model.misfit) = (of.scanned_waves_per_um, of.misfit);
                Some(model)
            }
        };
        Some(Self(Arc::new(OnceLock::from(model))))
    }

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

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::psf::pupils::{FUNCTIONS, TERMS};
    use ndarray::Array2;

    #[test]
    fn stored_pupils_come_back_and_those_of_other_psfs_are_refused() {
        let it = crate::testing::instrument([9, 11], [30, 33], 7, 3);
        let (lenses, .., depths, _, _) = it.psf.coefficients.dim();
        let terms = Array2::from_shape_fn((TERMS, FUNCTIONS), |(k, f)| 0.1 / (1.0 + k as f64 + 0.3 * f as f64));
        let lens = LensPupil { terms, apodisation: 0.2, radius: 0.21, misfit: 0.03 };
        let scanned = vec![Some(1.0 / 3.0); if depths > 1 { lenses } else { 0 }];
        let model =
            StoredModel { lenses: vec![Some(lens); lenses], depth: 0, scanned_waves_per_um: scanned, misfit: 0.03 };
        let restored = |model: &StoredModel| {
            let json = serde_json::to_string(&StoredPupils { model: Some(model.clone()) }).unwrap();
            let stored = serde_json::from_str(&json).unwrap();
            Pupils::restored(stored, &it.psf, &it.geometry, it.manifest.sensor.pixel_pitch_um)
        };
        let back = restored(&model).unwrap();
        assert_eq!(back.stored().unwrap().model, Some(model.clone()));
        assert!(back.0.get().unwrap().as_ref().unwrap().defocus_waves(0, 1.0, 0.53) > 0.0);
        let refused = |change: &dyn Fn(&mut StoredModel)| {
            let mut other = model.clone();
            change(&mut other);
            restored(&other).is_none()
        };
        assert!(refused(&|m| m.lenses.truncate(1)));
        assert!(refused(&|m| m.depth = depths));
        assert!(refused(&|m| m.scanned_waves_per_um.push(None)));
        assert!(refused(&|m| m.lenses[0].as_mut().unwrap().radius = 0.0));
        assert!(refused(&|m| m.lenses[0].as_mut().unwrap().terms = Array2::zeros((TERMS, 1))));
    }
}
