//! Images of scenes as changed wavefronts change them ([`crate::psf::pupils`]).

use super::{Forward, SceneLight};
use crate::psf::pupils::{PupilModel, WAVELENGTH_UM, Wavefronts};
use crate::psf::{CalibratedOptics, LensImage, LowRankOperator, LowRankPsf, OperatorConfig};
use ndarray::Array2;
use ommatidia_physics::effects::{Chain, FrameContext, Stage};
use ommatidia_physics::optics::Wavefront;
use std::sync::{Arc, Mutex, PoisonError};

/// Changed images of one scene, and operators that make them, that are kept for each lens: those of a state, and of
/// steps from it.
const KEPT_IMAGES: usize = 4;
/// Changed PSFs that are kept for each lens: those of all columns of a fit, which the frames ask for in turn. They are
/// small: 100 KB each for windows of 61 px.
const KEPT_PSFS: usize = 64;

/// Index of Noll's Z_4 among the coefficients of a wavefront.
const DEFOCUS: usize = 3;

/// A lens with its wavefronts.
type Key = (usize, Wavefronts);

/// A lens with its wavefronts, and what was computed of them.
type Entry<T> = (Key, Arc<T>);

/// What was last computed, by lens and wavefronts.
#[derive(Clone, Debug)]
pub(super) struct Kept<T> {
    /// The latest last.
    entries: Arc<Mutex<Vec<Entry<T>>>>,
    /// Entries of each lens, at most.
    most: usize,
}

/// Changes of the optics by wavefronts, and what is made of them.
#[derive(Clone, Debug)]
pub(super) struct Changes {
    psfs: Kept<LowRankPsf>,
    operators: Kept<LowRankOperator>,
}

impl Default for Changes {
    fn default() -> Self {
        Self { psfs: Kept::new(KEPT_PSFS), operators: Kept::images() }
    }
}

impl<T> Kept<T> {
    /// For images of scenes, or what is as large.
    pub(super) fn images() -> Self {
        Self::new(KEPT_IMAGES)
    }

    /// For at most that many entries of each lens.
    pub(super) fn new(most: usize) -> Self {
        Self { entries: Arc::default(), most }
    }

    /// The value for wavefronts of a lens, computed where it is not kept. No lock is held while it is computed.
    fn of(&self, by: &Key, compute: impl FnOnce() -> Option<T>) -> Option<Arc<T>> {
        let lock = || self.entries.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, found)) = lock().iter().find(|(key, _)| *key == *by) {
            return Some(found.clone());
        }
        let found = Arc::new(compute()?);
        let mut kept = lock();
        let same = |(key, _): &&Entry<T>| key.0 == by.0;
        if kept.iter().filter(same).count() >= self.most
            && let Some(oldest) = kept.iter().position(|(key, _)| key.0 == by.0)
        {
            kept.remove(oldest);
        }
        kept.push((by.clone(), found.clone()));
        Some(found)
    }
}

/// Standard deviation of wavelengths in use round [`WAVELENGTH_UM`], relative: even from 20 % below to 20 % above.
const WAVELENGTH_ERROR: f64 = 0.115;
/// Relative error of the square of the radius of a pupil, which a soft rim does not have: depths came out 7 % too small
/// on the virtual instrument, 4 and 7 % too small on one other simulator, and 1 and 3 % too large on another.
const RADIUS_ERROR: f64 = 0.08;

impl Forward {
    /// Whether effects add wavefronts that change PSFs, with pupils that explain the PSFs.
    pub fn changes_wavefronts(&self, effects: &Chain, cx: &FrameContext<'_>) -> bool {
        self.pupils_asked(effects, cx).is_some()
    }

    /// How far the own defocus of each lens may lie from that of its pupil, waves rms (standard deviation); zero where
    /// no pupil explains the PSFs. Pupils are fitted when they are first asked for.
    pub fn doubts_waves(&self) -> Vec<f64> {
        let of = &self.calibrated;
        let pupils = of.pupils.of(&of.psf, &of.rays, self.pixel_pitch_um);
        (0..self.layout.lenses).map(|l| pupils.map_or(0.0, |p| p.doubt_waves(l))).collect()
    }

    /// Relative error of depths that pupils tell, beyond that of the fit; 0 where the beads were scanned at several
    /// depths. A depth is inversely proportional to the wavelength, and to the square of the radius of the pupil.
    pub fn depth_error(&self) -> f64 {
        let of_wavelength = if self.wavelength_um.is_some() { 0.0 } else { WAVELENGTH_ERROR };
        if self.calibrated.psf.node_depths_um.len() == 1 { RADIUS_ERROR.hypot(of_wavelength) } else { 0.0 }
    }

    /// Depths of the planes of beads that the PSFs were calibrated at, um, ascending.
    pub fn calibrated_depths_um(&self) -> &[f64] {
        &self.calibrated.psf.node_depths_um
    }

    /// The pupils, if effects ask for them and they explain the PSFs. They are fitted when they are first asked for:
    /// the corners and the centre of the object say whether they are.
    fn pupils_asked(&self, effects: &Chain, cx: &FrameContext<'_>) -> Option<&PupilModel> {
        let of = &self.calibrated;
        if !effects.acts_at(Stage::Geometry) || self.depths_um.len() > 1 {
            return None;
        }
        let few = of.object.map(|n| vec![0.0, (n as f64 - 1.0) / 3.0, n as f64 - 1.0]);
        // Whether any is added does not depend on how a depth is converted.
        let asks = |l| self.wavefronts(effects, l, (&few, 1.0), cx).change_psfs();
        if !(0..self.layout.lenses).any(asks) {
            return None;
        }
        of.pupils.of(&of.psf, &of.rays, self.pixel_pitch_um)
    }

    /// The wavefronts that effects add for a lens at nodes (rows and columns of the object), by the defocus of a source
    /// that is 1 um away.
    fn wavefronts(
        &self,
        effects: &Chain,
        lens: usize,
        ([rows, cols], waves_per_um): (&[Vec<f64>; 2], f64),
        cx: &FrameContext<'_>,
    ) -> Wavefronts {
        let cx = FrameContext { lens, ..*cx };
        let added = Array2::from_shape_fn((rows.len(), cols.len()), |(i, j)| {
            let ray = self.ray(lens, self.image_of(lens, [rows[i], cols[j]]));
            let mut wavefront: Wavefront = effects.wavefront(&ray, &cx);
            wavefront.coefficient[DEFOCUS] += waves_per_um * effects.shift_ray(&ray, &cx).z_um;
            wavefront
        });
        Wavefronts { added, misjudged_waves: effects.misjudged_defocus(&cx) }
    }

    /// The change of the image of a scene through a lens by the wavefronts that effects add, DN above black at the
    /// exposure of the calibration; foci keep their centroids. None: they add nothing, or no pupil explains the PSFs.
    pub(super) fn wavefront_change(
        &self,
        scene: &SceneLight,
        lens: usize,
        effects: &Chain,
        cx: &FrameContext<'_>,
    ) -> Option<Arc<LensImage>> {
        let pupils = self.pupils_asked(effects, cx)?;
        let waves_per_um = pupils.defocus_waves(lens, 1.0, self.wavelength_um.unwrap_or(WAVELENGTH_UM));
        let by = self.wavefronts(effects, lens, (pupils.nodes_px(), waves_per_um), cx);
        self.changed(scene, &scene.changes, pupils, (lens, by))
    }

    /// The pupils that say how PSFs change between the depths of the scan, where the model is planned at several.
    pub(super) fn pupils_between_depths(&self) -> Option<&PupilModel> {
        let of = &self.calibrated;
        let several = self.depths_um.len() > 1;
        several.then(|| of.pupils.between_depths(&of.psf, &of.rays, self.pixel_pitch_um)).flatten()
    }

    /// The change of the image of a scene through a lens where its sources lie `z_um` (a function of their place in the
    /// object, rows and columns) from the planned plane, DN above black at the exposure of the calibration; foci keep
    /// their centroids. `kept` is where it is kept. None: they lie in the plane.
    pub(super) fn depth_change(
        &self,
        scene: &SceneLight,
        kept: &Kept<LensImage>,
        (pupils, lens): (&PupilModel, usize),
        z_um: impl Fn([f64; 2]) -> f64,
    ) -> Option<Arc<LensImage>> {
        let waves_per_um = pupils.defocus_waves(lens, 1.0, WAVELENGTH_UM);
        let [rows, cols] = pupils.nodes_px();
        let added = Array2::from_shape_fn((rows.len(), cols.len()), |(i, j)| {
            let mut wavefront = Wavefront::default();
            wavefront.coefficient[DEFOCUS] = waves_per_um * z_um([rows[i], cols[j]]);
            wavefront
        });
        let depths_um = &self.calibrated.psf.node_depths_um;
        let from_fitted = self.depth_um() - depths_um.get(pupils.depth()).copied().unwrap_or(0.0);
        self.changed(scene, kept, pupils, (lens, Wavefronts { added, misjudged_waves: waves_per_um * from_fitted }))
    }

    /// The change of the image of a scene through a lens by wavefronts. None: they change nothing.
    fn changed(
        &self,
        scene: &SceneLight,
        kept: &Kept<LensImage>,
        pupils: &PupilModel,
        by: Key,
    ) -> Option<Arc<LensImage>> {
        if !by.1.change_psfs() {
            return None;
        }
        let of = &self.calibrated;
        kept.of(&by, || {
            let operator = self.changes.operators.of(&by, || {
                let psf = self.changes.psfs.of(&by, || pupils.change(&of.psf, (by.0, of.config.depth), &by.1))?;
                let rays = of.rays.of_lens(by.0)?;
                let optics = CalibratedOptics { psf: &psf, rays: &rays, object: of.object, sensor: of.sensor };
                LowRankOperator::plan(optics, &rays, OperatorConfig { depth: 0, ..of.config }).ok()
            })?;
            let mut change = None;
            // An object of another shape was refused when its scene was made.
            let _ = operator.each_lens(scene.emitted.view(), |_, image| change = Some(image));
            change
        })
    }
}
