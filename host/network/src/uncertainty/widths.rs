//! What was learned of the errors of one method with one instrument, and its use on frames without a truth.

use super::UncertaintyError;
use super::neighbours::{median, nearest};
use super::observer::{FRAME, GROUPS, Observer, RINGS, Seen, class_of, ring_of};
use super::scale::Scale;
use super::scores::{BINS, Limits};
use ndarray::{Array2, ArrayView2};
use ommatidia_model::instrument::Instrument;
use serde::{Deserialize, Serialize};

/// Pixels of a group that a scene needs to count for it.
const LEAST_PIXELS: f64 = 8.0;
/// Scenes that a group needs; with fewer, the class of brightness over all rings is used, then all pixels.
const LEAST_SCENES: usize = 10;

/// Settings and small numbers of a file of widths.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Made {
    /// Name of the method.
    pub method: String,
    /// SHA-256 of the file that the method was made from.
    pub method_file: String,
    /// SHA-256 of the instrument's file.
    pub instrument: String,
    /// Nominal coverage.
    pub coverage: f64,
    /// Scenes that the scale was fitted to.
    pub scale_scenes: usize,
    /// Scenes for conformal calibration.
    pub scenes: usize,
    /// Scenes that the limits of one frame are taken from.
    pub neighbours: usize,
    /// Rows and columns of the object grid.
    pub object: [usize; 2],
    /// Range of the brightest pixel of the scenes, electrons.
    pub peak_e: [f64; 2],
    /// Share that is left out in each ring of the field, so that the mean coverage of scenes that were left out of
    /// their own calibration is the nominal one, with the finite-sample correction.
    pub miss: [f64; RINGS],
    /// Logarithm of the misfit, relative to scenes that look alike, which 0.5 % of the scenes exceed: of single pixels,
    /// and of means of 4 x 4.
    pub alarm: [f64; 2],
    /// Distance to the scenes that look alike which 0.5 % of the scenes exceed.
    pub far: f64,
    /// Units of the features of frames.
    pub(super) units: [f64; FRAME],
}

/// What was learned.
#[derive(Clone, Debug)]
pub struct Widths {
    /// Settings and small numbers.
    pub made: Made,
    pub(super) scale: Scale,
    /// Features of each scene.
    pub(super) frames: Vec<[f64; FRAME]>,
    /// Misfits of each scene.
    pub(super) misfits: Vec<[f64; 2]>,
    /// Histograms of scores: scene, group, bin.
    pub(super) histograms: Vec<f32>,
}

/// Why the intervals of a frame may be wrong.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Suspicion {
    /// Misfit of the frame that the reconstruction predicts, relative to scenes that look alike: the ratio of the root
    /// mean squared residuals, the larger one of single pixels and of means of 4 x 4. 1 is usual.
    pub misfit: f64,
    /// Whether this misfit is larger than that of 99 % of the frames of the calibration. The intervals are then wider
    /// by its value.
    pub inconsistent: bool,
    /// Distance to the scenes of the calibration that look alike, relative to the largest usual one.
    pub distance: f64,
    /// Whether no scene of the calibration looks like this frame.
    pub unlike: bool,
}

/// A reconstruction with its intervals, all [object rows, object cols], in the unit of the reconstruction.
#[derive(Clone, Debug)]
pub struct Intervals {
    /// Lower limits, >= 0.
    pub lower: Array2<f32>,
    /// Upper limits, >= the reconstruction.
    pub upper: Array2<f32>,
    /// What is suspicious about the frame.
    pub suspicion: Suspicion,
    /// Light, in the instrument's unit, of one unit of the reconstruction.
    pub light: f64,
}

impl Widths {
    /// Widths for an instrument that was read, ready for frames.
    ///
    /// # Errors
    /// The instrument is inconsistent, or has another object grid.
    pub fn on(self, instrument: &Instrument) -> Result<Ready, UncertaintyError> {
        let observer = Observer::new(instrument)?;
        let (expected, found) = (observer.object_shape(), self.made.object);
        if expected != found {
            return Err(UncertaintyError::Shape { expected, found });
        }
        Ok(Ready { widths: self, observer })
    }

    /// The histogram of one group of one scene.
    pub(super) fn histogram(&self, scene: usize, group: usize) -> &[f32] {
        let at = (scene * GROUPS + group) * BINS;
        &self.histograms[at..at + BINS]
    }

    /// Limits of the scores in each group, from the scenes `near`, with the share `miss` of each ring left out.
    pub(super) fn limits(&self, near: &[(usize, f64)], miss: &[f64; RINGS]) -> [Limits; GROUPS] {
        let pooled = |groups: &dyn Fn(usize) -> bool| {
            let (mut sum, mut scenes) = (vec![0.0f64; BINS], 0);
            for (scene, _) in near {
                let mut pixels = 0.0;
                for group in (0..GROUPS).filter(|g| groups(*g)) {
                    for (sum, n) in sum.iter_mut().zip(self.histogram(*scene, group)) {
                        *sum += f64::from(*n);
                        pixels += f64::from(*n);
                    }
                }
                scenes += usize::from(pixels >= LEAST_PIXELS);
            }
            (scenes >= LEAST_SCENES.min(near.len())).then_some(sum)
        };
        std::array::from_fn(|group| {
            let own = pooled(&|g| g == group);
            let class = || pooled(&|g| class_of(g) == class_of(group));
            let sum = own.or_else(class).or_else(|| pooled(&|_| true)).unwrap_or_else(|| vec![0.0; BINS]);
            Limits::of(&sum, miss[ring_of(group)])
        })
    }

    /// The scenes that look like `frame`; `without` leaves out one.
    pub(super) fn near(&self, frame: &[f64; FRAME], without: Option<usize>) -> Vec<(usize, f64)> {
        nearest(&self.frames, &self.made.units, frame, self.made.neighbours, without)
    }

    /// Logarithms of misfits relative to scenes that look alike.
    pub(super) fn relative_misfit(&self, misfit: &[f64; 2], near: &[(usize, f64)]) -> [f64; 2] {
        std::array::from_fn(|k| misfit[k] - median(near.iter().map(|(i, _)| self.misfits[*i][k]).collect()))
    }
}

/// Widths with the instrument that they are for.
#[derive(Clone, Debug)]
pub struct Ready {
    pub(super) widths: Widths,
    pub(super) observer: Observer,
}

impl Ready {
    /// What was learned.
    pub fn widths(&self) -> &Widths {
        &self.widths
    }

    /// Intervals of a reconstruction, [object rows, object cols] in any unit, of a frame, DN, [sensor rows, sensor
    /// cols].
    ///
    /// # Errors
    /// A shape is not that of the instrument.
    pub fn intervals(&self, frame_dn: ArrayView2<'_, f32>, found: &Array2<f32>) -> Result<Intervals, UncertaintyError> {
        Ok(self.of(&self.observer.see(frame_dn, found)?))
    }

    /// Intervals of what was seen, in the unit of the reconstruction.
    pub(super) fn of(&self, seen: &Seen) -> Intervals {
        let widths = &self.widths;
        let near = widths.near(&seen.frame, None);
        let limits = widths.limits(&near, &widths.made.miss);
        let suspicion = self.suspicion(seen, &near);
        let wider = if suspicion.inconsistent { suspicion.misfit } else { 1.0 };
        let (mut lower, mut upper) = (seen.object.clone(), seen.object.clone());
        let pixels = seen.pixels.iter().zip(&seen.groups);
        for ((low, high), (features, group)) in lower.iter_mut().zip(&mut upper).zip(pixels) {
            let scale = f64::from(widths.scale.of(features));
            let Limits { low: mut below, high: mut above } = limits[usize::from(*group)];
            if wider > 1.0 {
                // An error of unknown cause has no known sign.
                above = above.max(-below) * wider;
                below = -above;
            }
            *low = ((f64::from(*low) + below * scale) / seen.light).max(0.0) as f32;
            *high = ((f64::from(*high) + above * scale) / seen.light) as f32;
        }
        Intervals { lower, upper, suspicion, light: seen.light }
    }

    fn suspicion(&self, seen: &Seen, near: &[(usize, f64)]) -> Suspicion {
        let made = &self.widths.made;
        let off = self.widths.relative_misfit(&seen.misfit, near);
        let inconsistent = (0..2).any(|k| off[k] > made.alarm[k]);
        // Chi-squared is the square of residuals.
        let misfit = (off[0].max(off[1]) / 2.0).exp();
        let distance = near.last().map_or(f64::INFINITY, |(_, d)| *d) / made.far.max(1e-12);
        Suspicion { misfit, inconsistent, distance, unlike: distance > 1.0 }
    }
}
