//! Whether the views of each frame agree with one another, whatever its specimen is, and where the truths lie beside
//! the specimens that the frames show.

use crate::data::{Fault, FaultKind, Observations, Shown};
use crate::evidence::{Placement, figures, placement};
use crate::fit::record::fisher;
use crate::fit::truth::{Grid, Registered};
use crate::fit::{Model, estimate_specimens, refit};
use crate::options::CloseError;
use ommatidia_model::instrument::Instrument;

/// The views agree if the chi-squared per pixel that they leave is above 1 by no more than this,
const AGREE: f64 = 0.02;
/// or by no more than this share of what the truths leave: what changes one view of several leaves most of it.
const AGREE_SHARE: f64 = 0.1;
/// Truths are misplaced if moving them leaves at most this share of `1 - r^2` between them and the specimens,
const EXPLAINED: f64 = 0.5;
/// and moves a corner of the field by at least this, apart from the shift, object pixels: a shift of all views alike
/// may be one of the array, and smaller displacements are fitted well as those of effects.
const CORNER_PX: f64 = 0.5;
/// Truths are misplaced one by one if they lie so far from their mean place, root mean square, object pixels,
const SCATTER_PX: f64 = 0.2;
/// and so many times farther than what turn and scale move them: the turns and scales of single truths are errors.
const CLEAR: f64 = 3.0;
/// Number of scenes that this takes.
const SCENES: usize = 3;

/// What frames show without their truths.
#[derive(Clone, Debug)]
pub(super) struct Views {
    /// chi-squared per pixel of the blocks that were left out, with specimens that were estimated from the frames.
    chi2: f64,
    /// Where the truths lie, taken together.
    together: Placement,
    /// Where each of them lies.
    each: Vec<Placement>,
    grid: Grid,
    /// Index of the first of their frames in its stack.
    first: usize,
}

impl Views {
    /// Estimates the specimens of known scenes from their frames, under the instrument as it was calibrated. None: few
    /// truths are known, or objects or sensor have too many pixels.
    ///
    /// # Errors
    /// The parts of the instrument disagree.
    pub fn of(instrument: &Instrument, seen: &Observations) -> Result<Option<Self>, CloseError> {
        let known = seen.frames.iter().filter(|f| matches!(f.shown, Shown::Object(_))).count();
        // A region of large frames would say little of where all of a truth lies, and takes long.
        if known < SCENES || seen.is_part() || instrument.geometry.anchors_px.len() < 2 {
            return Ok(None);
        }
        let mut unknown = seen.clone();
        unknown.forget_truths();
        estimate_specimens(instrument, &mut unknown);
        // The frames before them are gone as well.
        unknown.frames.retain(|f| f.shown != Shown::Unknown);
        unknown.frames.iter_mut().for_each(|f| f.previous = None);
        if unknown.is_part() || unknown.frames.iter().filter(|f| f.shown == Shown::Estimated).count() < SCENES {
            return Ok(None);
        }
        let model = Model::new(instrument, &unknown)?;
        let fit = refit(&model, model.state(instrument)?)?;
        let Some(specimens) = &fit.state.specimens else { return Ok(None) };
        let truth_of = |k: usize| {
            let f = &unknown.frames[k];
            let known = seen.frames.iter().find(|o| o.stack == f.stack && o.info.frame == f.info.frame)?;
            match known.shown {
                Shown::Object(truth) => seen.truths.get(truth),
                _ => None,
            }
        };
        let pairs: Vec<(usize, [_; 2])> = (0..unknown.frames.len())
            .filter_map(|k| Some((unknown.frames[k].info.frame, [truth_of(k)?, specimens.object(k)?])))
            .collect();
        let all: Vec<_> = pairs.iter().map(|(_, pair)| *pair).collect();
        let each = all.iter().filter_map(|pair| placement(&[*pair])).collect();
        let first = pairs.first().map_or(0, |(frame, _)| *frame);
        let chi2 = figures(&model, &fit).chi2_ndf;
        let found = placement(&all).map(|together| Self { chi2, together, each, grid: model.grid, first });
        tracing::info!("views: {found:?}");
        Ok(found)
    }

    /// chi-squared per pixel that they leave.
    pub fn chi2(&self) -> f64 {
        self.chi2
    }

    /// Whether the views agree with one another, of frames of which the truths leave a chi-squared per pixel of
    /// `known`.
    pub fn agree(&self, known: f64) -> bool {
        self.chi2 - 1.0 <= AGREE.max(AGREE_SHARE * (known - 1.0))
    }

    /// How the truths are misplaced, if they are; `agree`: whether the views agree. A turn or a magnification of the
    /// array makes views that contradict one another, and estimates of the specimens that lie beside the truths.
    /// Nothing that is the same in all frames displaces each of them by another amount. `fitted`: how a fit has placed
    /// the truths.
    pub fn misplaced(&self, agree: bool, fitted: Registered) -> Option<Fault> {
        let correlation = |unlike: f64| (1.0 - unlike).max(0.0).sqrt();
        let fault = |kind, left: f64| Fault {
            frame: self.first,
            kind,
            z: fisher(correlation(self.together.apart), correlation(left), self.together.pixels),
            correlation_before: correlation(self.together.apart),
            correlation_after: correlation(left),
        };
        let Placement { parts, left, share, .. } = self.together;
        let corner_px = |parts: Registered| parts[2].hypot(parts[3]);
        let off: Registered = std::array::from_fn(|i| parts[i] - fitted[i]);
        if agree && share <= EXPLAINED && corner_px(off) >= CORNER_PX {
            let (turn_mrad, scale) = (self.grid.turn_mrad(parts[2]), self.grid.scale(parts[3]));
            let [row_px, col_px, ..] = parts;
            let kind = FaultKind::Misplaced { row_px, col_px, turn_mrad, scale, corner_px: corner_px(parts) };
            return Some(fault(kind, left));
        }
        let [rms_px, of_corners] = [0, 2].map(|first| self.scatter_px(first));
        let mut explained: Vec<(f64, f64)> = self.each.iter().map(|p| (p.share, p.left)).collect();
        explained.sort_by(|a, b| a.0.total_cmp(&b.0));
        // Of most frames.
        let (share, left) = *explained.get(3 * explained.len() / 4)?;
        let is_clear = rms_px >= SCATTER_PX.max(CLEAR * of_corners);
        (share <= EXPLAINED && is_clear).then(|| fault(FaultKind::MisplacedOneByOne { rms_px }, left))
    }

    /// Scatter of two parts between the frames, root mean square of both together, object pixels.
    fn scatter_px(&self, first: usize) -> f64 {
        let n = self.each.len().max(1) as f64;
        let square = |i: usize| {
            let mean = self.each.iter().map(|p| p.parts[i]).sum::<f64>() / n;
            self.each.iter().map(|p| (p.parts[i] - mean).powi(2)).sum::<f64>() / n
        };
        (square(first) + square(first + 1)).sqrt()
    }
}
