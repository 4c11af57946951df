//! Which frames of unknown specimens are used.

use super::probe::MARGIN;
use crate::data::{Observations, Shown};
use crate::fit::projection::Views;
use ommatidia_model::instrument::Instrument;

/// Most object pixels whose normal matrix is factored: it takes 4 bytes for each pair, and half a gigabyte at most.
const MOST_UNKNOWNS: usize = 11_600;
/// Most values of the optics as a matrix, which take 4 bytes each: a gigabyte.
const MOST_VALUES: usize = 1 << 28;
/// Most frames whose specimens are estimated; of a longer recording frames are taken at even distances.
const MOST_FRAMES: usize = 8;

/// Marks the frames of unknown specimens whose specimens are estimated: where no frame shows a known object, and object
/// and sensor have few enough pixels. Their hold-outs are spatial blocks, which other lenses show as well.
pub fn estimate_specimens(instrument: &Instrument, seen: &mut Observations) {
    let known = |shown: &Shown| matches!(shown, Shown::Object(_) | Shown::Bead(_));
    let [rows, cols] = [instrument.manifest.object.rows, instrument.manifest.object.cols];
    let sampled = seen.pixels.len() < seen.sensor[0] * seen.sensor[1];
    let (lenses, side) = (instrument.geometry.anchors_px.len(), instrument.psf.basis.dim().2 + 2 * MARGIN);
    let large = rows * cols > MOST_UNKNOWNS || Views::values([rows, cols], side, lenses) > MOST_VALUES;
    let impossible = instrument.sensor_only() || large || sampled;
    if impossible || seen.frames.iter().any(|f| known(&f.shown)) {
        return;
    }
    let unknown: Vec<usize> = (0..seen.frames.len()).filter(|k| seen.frames[*k].shown == Shown::Unknown).collect();
    let Some(z_um) = unknown.first().map(|k| seen.frames[*k].info.z_um) else { return };
    let at_depth: Vec<usize> = unknown.into_iter().filter(|k| seen.frames[*k].info.z_um == z_um).collect();
    let n = at_depth.len();
    for i in 0..n.min(MOST_FRAMES) {
        let f = &mut seen.frames[at_depth[i * n / n.min(MOST_FRAMES)]];
        f.shown = Shown::Estimated;
        f.held_out = false;
    }
}

/// What a session of estimated specimens can and cannot show.
pub(crate) const UNKNOWN_NOTE: &str = "the specimens are unknown: they were estimated from the frames, and everything \
                                       that another specimen could make as well is not testable; the figures are of \
                                       blocks of the frames that were left out of the estimates, and noise alone gives \
                                       a chi-squared of 1";
