//! Images of scenes as changed wavefronts change them ([`crate::psf::pupils`]).

use super::{Forward, SceneLight};
use crate::psf::pupils::{PupilModel, Wavefronts};
use crate::psf::{CalibratedOptics, LensImage, LowRankOperator, OperatorConfig};
use ndarray::Array2;
use ommatidia_physics::effects::{Chain, FrameContext, Stage};
use ommatidia_physics::optics::Wavefront;
use std::sync::{Arc, Mutex, PoisonError};

/// Wavefronts that are kept with what was computed of them: those of a state, and of steps from it.
const KEPT: usize = 4;

/// Wavefronts, and what was computed of them.
type Entry<T> = (Arc<Wavefronts>, Arc<T>);

/// What was last computed, by wavefronts; the latest last.
#[derive(Clone, Debug)]
pub(super) struct Kept<T>(Arc<Mutex<Vec<Entry<T>>>>);

impl<T> Default for Kept<T> {
    fn default() -> Self {
        Self(Arc::default())
    }
}

impl<T> Kept<T> {
    /// The value for wavefronts, computed where it is not kept. No lock is held while it is computed.
    fn of(&self, by: &Wavefronts, compute: impl FnOnce() -> Option<T>) -> Option<Arc<T>> {
        let lock = || self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, found)) = lock().iter().find(|(key, _)| **key == *by) {
            return Some(found.clone());
        }
        let found = Arc::new(compute()?);
        let mut kept = lock();
        if kept.len() >= KEPT {
            kept.remove(0);
        }
        kept.push((Arc::new(by.clone()), found.clone()));
        Some(found)
    }
}

/// The change of the image of each lens; None: a dead one.
pub(super) type Changes = Vec<Option<LensImage>>;

impl Forward {
    /// The pupils, if effects ask for them and they explain the PSFs. They are fitted when they are first asked for:
    /// the corners and the centre of the object say whether they are.
    fn pupils_asked(&self, effects: &Chain, cx: &FrameContext<'_>) -> Option<&PupilModel> {
        let of = &self.calibrated;
        if !effects.acts_at(Stage::Geometry) || self.depths_um.len() > 1 {
            return None;
        }
        let few = of.object.map(|n| vec![0.0, (n as f64 - 1.0) / 3.0, n as f64 - 1.0]);
        // Whether any is added does not depend on how a depth is converted.
        if !self.added(effects, &few, |_, z_um| z_um, cx).change_psfs() {
            return None;
        }
        of.pupils.of(&of.psf, &of.rays, self.pixel_pitch_um)
    }

    /// The wavefronts that effects add at nodes (rows and columns of the object), by the defocus of a depth through a
    /// lens.
    fn added(
        &self,
        effects: &Chain,
        [rows, cols]: &[Vec<f64>; 2],
        defocus_waves: impl Fn(usize, f64) -> f64,
        cx: &FrameContext<'_>,
    ) -> Wavefronts {
        let lens = |l: usize| {
            Array2::from_shape_fn((rows.len(), cols.len()), |(i, j)| {
                let ray = self.ray(l, self.image_of(l, [rows[i], cols[j]]));
                let cx = FrameContext { lens: l, ..*cx };
                let mut wavefront: Wavefront = effects.wavefront(&ray, &cx);
                wavefront.coefficient[3] += defocus_waves(l, effects.shift_ray(&ray, &cx).z_um);
                wavefront
            })
        };
        Wavefronts((0..self.layout.lenses).map(lens).collect())
    }

    /// The change of the images of a scene by the wavefronts that effects add, DN above black at the exposure of the
    /// calibration; foci keep their centroids. None: they add nothing, or no pupil explains the PSFs.
    pub(super) fn wavefront_changes(
        &self,
        scene: &SceneLight,
        effects: &Chain,
        cx: &FrameContext<'_>,
    ) -> Option<Arc<Changes>> {
        let of = &self.calibrated;
        let pupils = self.pupils_asked(effects, cx)?;
        let by = self.added(effects, pupils.nodes_px(), |l, z_um| pupils.defocus_waves(l, z_um), cx);
        if !by.change_psfs() {
            return None;
        }
        scene.changes.of(&by, || {
            let operator = self.changed.of(&by, || {
                let psf = pupils.change(&of.psf, 0, &by);
                let optics = CalibratedOptics { psf: &psf, rays: &of.rays, object: of.object, sensor: of.sensor };
                let config = OperatorConfig { depth: 0, ..of.config };
                LowRankOperator::plan(optics, &of.rays, config).ok()
            })?;
            let mut lenses = vec![None; self.layout.lenses];
            // An object of another shape was refused when its scene was made.
            let _ = operator.each_lens(scene.emitted.view(), |l, image| lenses[l] = Some(image));
            Some(lenses)
        })
    }
}
