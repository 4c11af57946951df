//! Images of scenes as changed wavefronts change them ([`crate::psf::pupils`]).

use super::{Forward, SceneLight};
use crate::psf::pupils::{PupilModel, Wavefronts};
use crate::psf::{CalibratedOptics, LensImage, LowRankOperator};
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
    /// The change of the images of a scene by the wavefronts that effects add, DN above black at the exposure of the
    /// calibration. None: they add nothing, or no pupil explains the PSFs.
    pub(super) fn wavefront_changes(
        &self,
        scene: &SceneLight,
        effects: &Chain,
        cx: &FrameContext<'_>,
    ) -> Option<Arc<Changes>> {
        let of = &self.calibrated;
        if !effects.acts_at(Stage::Geometry) || self.depths_um.len() > 1 {
            return None;
        }
        let added = |pupils: Option<&PupilModel>, nodes: &[Vec<f64>; 2]| {
            let lens = |l: usize| {
                let (rows, cols) = (&nodes[0], &nodes[1]);
                Array2::from_shape_fn((rows.len(), cols.len()), |(i, j)| {
                    let ray = self.ray(l, self.image_of(l, [rows[i], cols[j]]));
                    let cx = FrameContext { lens: l, ..*cx };
                    let mut wavefront: Wavefront = effects.wavefront(&ray, &cx);
                    let z_um = effects.shift_ray(&ray, &cx).z_um;
                    wavefront.coefficient[3] += pupils.map_or(z_um, |p| p.defocus_waves(z_um));
                    wavefront
                })
            };
            Wavefronts((0..self.layout.lenses).map(lens).collect())
        };
        // Before pupils are fitted: does any effect ask for them? The corners and the centre say so.
        let few = of.object.map(|n| vec![0.0, (n as f64 - 1.0) / 3.0, n as f64 - 1.0]);
        if !added(None, &few).change_psfs() {
            return None;
        }
        let pupils = of.pupils.of(&of.psf, &of.rays, self.pixel_pitch_um)?;
        let by = added(Some(pupils), pupils.nodes_px());
        if !by.change_psfs() {
            return None;
        }
        scene.changes.of(&by, || {
            let operator = self.changed.of(&by, || {
                let psf = pupils.change(&of.psf, 0, &by);
                let optics = CalibratedOptics { psf: &psf, rays: &of.rays, object: of.object, sensor: of.sensor };
                let config = crate::psf::OperatorConfig { depth: 0, ..of.config };
                LowRankOperator::plan(optics, &of.rays, config).ok()
            })?;
            let mut lenses = vec![None; self.layout.lenses];
            // An object of another shape was refused when its scene was made.
            let _ = operator.each_lens(scene.emitted.view(), |l, image| lenses[l] = Some(image));
            Some(lenses)
        })
    }
}
