//! Families of instruments. Each computes the foci of its lenses in its own way, and none uses the low-rank model.
//!
//! | family | file | the focus of a point |
//! |---|---|---|
//! | `pupils` | [`pupils`] | diffraction at a pupil with Zernike terms |
//! | `relay` | [`relay`] | a spot diagram of traced rays with Seidel terms, blurred by a small diffraction kernel |
//! | `kernels` | [`kernels`] | a set of PSFs, drawn at random or measured, placed and morphed over the field |
//!
//! What they share is bookkeeping: where a point lies, how its light is added up, and the effects. An effect that moves
//! chief rays (stage `Geometry`) acts in one of two ways. A family that has the part that moves moves it: then
//! everything that hangs on that part changes too, not only what the effect's law knows. Else the law of the effect
//! displaces the focus and its source.

pub(crate) mod change;
pub(crate) mod config;
mod edges;
pub(crate) mod kernels;
mod lens;
mod plane;
pub(crate) mod pupils;
pub(crate) mod relay;

use super::config::BenchConfig;
use super::error::BenchError;
use super::foci::{Focus, Point};
use change::Change;
use config::FamilyName;
use ommatidia_physics::effects::{EffectSetting, Ray, RayShift};
use ommatidia_physics::optics::{Psf, PsfScratch, Pupil, Wavefront};

/// Working memory for one focus; each thread needs its own.
#[derive(Debug, Default)]
pub(crate) struct Work {
    /// The PSF of the last focus, [side, side]: the share of the light in each pixel. Its sum is 1.
    pub psf: Psf,
    /// Of the family `pupils`.
    pub pupil: Option<PsfScratch>,
    /// Of the same family: the pupil whose PSFs are larger by this share, and its working memory.
    pub grown: Option<(f64, Pupil, PsfScratch)>,
    /// Numbers along rows and columns, of the other families.
    pub lines: [Vec<f64>; 2],
    /// A PSF on its own grid, of the family `kernels`.
    pub kernel: Vec<f32>,
}

/// How effects move a source and its focus, and change the focus.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Moved {
    /// Displacement and growth.
    pub shift: RayShift,
    /// What is added to the wavefront, waves rms, while the centroid stays; only of the family `pupils`.
    pub wavefront: Wavefront,
}

impl From<RayShift> for Moved {
    fn from(shift: RayShift) -> Self {
        Self { shift, ..Self::default() }
    }
}

/// Why lenses without pupils refuse an effect; `None`: it needs none.
fn without_pupils(effect: &EffectSetting) -> Option<String> {
    let changes = effect.id == "wavefront_drift" && effect.params.values().any(|v| *v != 0.0);
    changes.then(|| "these lenses have no pupil whose wavefront could change".into())
}

/// The lenses of one instrument.
pub(crate) trait Lenses: std::fmt::Debug + Send + Sync {
    /// Side of the field in which PSFs are computed, pixels; odd.
    fn side(&self) -> usize;
    /// Focus (row, col) of the on-axis source through each lens, sensor pixels.
    fn anchors_px(&self) -> Vec<[f64; 2]>;
    /// Object position (y, x) on the axis of each lens, um.
    fn axes_um(&self) -> Vec<[f64; 2]>;
    /// The chief ray of the point at (y, x) um through lens `l`, as effects see it.
    fn ray(&self, l: usize, at_um: [f64; 2]) -> Ray;
    /// Where the chief ray of a point meets the sensor, (row, col) sensor pixels, displaced by `moved`.
    fn focus_px(&self, l: usize, point: Point, moved: Moved) -> [f64; 2];
    /// Computes the PSF of a point through lens `l` into `work`.
    fn focus(&self, l: usize, point: Point, moved: Moved, work: &mut Work) -> Focus;
    /// Allocates working memory.
    fn work(&self) -> Work {
        Work::default()
    }
    /// These lenses with parts that have moved; `None`: this family does not move that part itself.
    fn moved(&self, _change: &Change) -> Option<Box<dyn Lenses>> {
        None
    }
    /// Why an effect cannot act on such lenses as much as a setting says; `None`: it can.
    fn refuses(&self, _effect: &EffectSetting) -> Option<String> {
        None
    }
}

/// Builds the lenses of an instrument.
///
/// # Errors
/// A number of the configuration is impossible, or a file of PSFs cannot be read.
pub(crate) fn build(config: &BenchConfig) -> Result<Box<dyn Lenses>, BenchError> {
    Ok(match config.family {
        FamilyName::Pupils => Box::new(pupils::Pupils::build(config)?),
        FamilyName::Relay => Box::new(relay::Relay::build(config)?),
        FamilyName::Kernels => Box::new(kernels::Kernels::build(config)?),
    })
}

/// The whole sensor pixel under a focus, and the rest.
pub(crate) fn split(focus_px: [f64; 2]) -> ([i64; 2], [f64; 2]) {
    let centre = focus_px.map(f64::round);
    (centre.map(|c| c as i64), [focus_px[0] - centre[0], focus_px[1] - centre[1]])
}

#[cfg(test)]
mod tests;
