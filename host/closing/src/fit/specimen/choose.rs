//! Which frames of unknown specimens have their specimens estimated.

use super::probe::MARGIN;
use crate::data::{Observations, Shown, best_of_parts, content};
use crate::fit::projection::Views;
use ommatidia_model::instrument::Instrument;

/// Most object pixels whose normal matrix is factored: it takes 4 bytes for each pair, and 1.2 gigabytes at most. Up to
/// four states of a search have one.
const MOST_UNKNOWNS: usize = 17_000;
/// Most values of the optics as a matrix, which take 4 bytes each: a gigabyte.
const MOST_VALUES: usize = 1 << 28;
/// Most frames whose specimens are estimated: of so many parts of a longer recording the one that shows most.
const MOST_FRAMES: usize = 8;

/// Marks the frames of unknown specimens whose specimens are estimated: where no frame shows a known object, and object
/// and sensor have few enough pixels. Their hold-outs are spatial blocks, which other lenses show as well.
pub fn estimate_specimens(instrument: &Instrument, seen: &mut Observations) {
    let known = |shown: &Shown| matches!(shown, Shown::Object(_) | Shown::Bead(_));
    let [rows, cols] = [instrument.manifest.object.rows, instrument.manifest.object.cols];
    let sampled = seen.pixels.len() < seen.sensor[0] * seen.sensor[1];
    let (lenses, side) = (instrument.geometry.anchors_px.len(), instrument.psf.basis.dim().2 + 2 * MARGIN);
    let large = rows * cols > MOST_UNKNOWNS || Views::values([rows, cols], side, lenses) > MOST_VALUES;
    if instrument.sensor_only() || seen.frames.iter().any(|f| known(&f.shown)) {
        return;
    }
    let is_unknown = seen.frames.iter().any(|f| f.shown == Shown::Unknown);
    if large || sampled {
        seen.not_estimated = is_unknown.then(|| not_estimated([rows, cols], lenses, side));
        return;
    }
    let unknown: Vec<usize> = (0..seen.frames.len()).filter(|k| seen.frames[*k].shown == Shown::Unknown).collect();
    let Some(z_um) = unknown.first().map(|k| seen.frames[*k].info.z_um) else { return };
    let at_depth: Vec<usize> = unknown.into_iter().filter(|k| seen.frames[*k].info.z_um == z_um).collect();
    let full_dn = 0.99 * instrument.noise.saturation_dn;
    let contents: Vec<f64> = at_depth.iter().map(|k| content(&seen.frames[*k].measured, full_dn)).collect();
    for i in best_of_parts(&contents, MOST_FRAMES) {
        let f = &mut seen.frames[at_depth[i]];
        f.shown = Shown::Estimated;
        f.held_out = false;
    }
}

/// Says that specimens were not estimated, and why.
fn not_estimated([rows, cols]: [usize; 2], lenses: usize, side: usize) -> String {
    format!(
        "the specimens are unknown, and were not estimated, so that nothing here tests the optics: objects of {rows} x \
         {cols} pixels behind {lenses} lenses with windows of {side} x {side} pixels take more memory than `close` \
         uses. Objects of at most {MOST_UNKNOWNS} pixels are estimated, and {:.0} million values of the optics (object \
         pixels times lenses times pixels of a window): a coarser grid of object pixels or `calibrate --window` with \
         smaller windows makes it possible",
        MOST_VALUES as f64 / 1e6
    )
}

/// What a session of estimated specimens can and cannot show.
pub(crate) const UNKNOWN_NOTE: &str = "the specimens are unknown: they were estimated from the frames, and everything \
                                       that another specimen could make as well is not testable; the figures are of \
                                       blocks of the frames that were left out of the estimates, and noise alone gives \
                                       a chi-squared of 1";

/// The frames whose specimens were estimated, as the session numbers them: (stack, frame).
pub(crate) fn estimated_frames(seen: &Observations) -> Vec<(usize, usize)> {
    let estimated = seen.frames.iter().filter(|f| f.shown == Shown::Estimated);
    estimated.map(|f| (f.stack, f.info.frame)).collect()
}

/// Which frames of a recording took part, or why none did; None: all of them.
pub(crate) fn chosen_note(seen: &Observations) -> Option<String> {
    if seen.not_estimated.is_some() {
        return seen.not_estimated.clone();
    }
    let frames = estimated_frames(seen);
    (!frames.is_empty() && frames.len() < seen.recorded).then(|| {
        let several = frames.iter().any(|(stack, _)| *stack != frames[0].0);
        let words = |(stack, frame): &(usize, usize)| match several {
            true => format!("{stack}:{frame}"),
            false => frame.to_string(),
        };
        let list: Vec<String> = frames.iter().map(words).collect();
        format!(
            "specimens of {} of {} frames were estimated, a fixed budget: of each part of the recording the frame \
             whose light shows most of the optics. Frames{}: {}",
            frames.len(),
            seen.recorded,
            if several { " (stack:frame)" } else { "" },
            list.join(", ")
        )
    })
}
