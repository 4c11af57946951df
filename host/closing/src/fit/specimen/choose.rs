//! Which frames of unknown specimens have their specimens estimated.

use super::probe::MARGIN;
use super::region::{Size, blocks_per_side, region};
use crate::data::{Blocks, Observations, Shown, best_of_parts, content};
use crate::fit::projection::{Footprint, Views};
use ndarray::Array2;
use ommatidia_model::instrument::Instrument;
use ommatidia_physics::noise::NoiseModel;

/// Most object pixels whose normal matrix is factored: it takes 4 bytes for each pair, and 1.2 gigabytes at most. Up to
/// four states of a search have one.
const MOST_UNKNOWNS: usize = 17_000;
/// The same where they are those of a region: effects that move light make them more.
const MOST_OF_REGION: usize = 10_000;
/// Most values of the optics as a matrix, which take 4 bytes each: a gigabyte.
const MOST_VALUES: usize = 1 << 28;
/// Most sensor pixels: whole frames are predicted for each state.
const MOST_SENSOR: usize = 1 << 20;
/// Fewest spatial blocks along each side of a sensor of which a region is used.
const FEWEST_BLOCKS: usize = 6;
/// Most frames whose specimens are estimated: of so many parts of a longer recording the one that shows most.
const MOST_FRAMES: usize = 8;

/// Marks the frames of unknown specimens whose specimens are estimated: where no frame shows a known object. Their
/// hold-outs are spatial blocks, which other lenses show as well. Of large frames a region is used, in all frames.
pub fn estimate_specimens(instrument: &Instrument, seen: &mut Observations) {
    let known = |shown: &Shown| matches!(shown, Shown::Object(_) | Shown::Bead(_));
    if instrument.sensor_only() || seen.frames.iter().any(|f| known(&f.shown)) {
        return;
    }
    let unknown: Vec<usize> = (0..seen.frames.len()).filter(|k| seen.frames[*k].shown == Shown::Unknown).collect();
    let Some(z_um) = unknown.first().map(|k| seen.frames[*k].info.z_um) else { return };
    if let Err(why) = use_region(instrument, seen) {
        seen.not_estimated = Some(why);
        return;
    }
    let at_depth: Vec<usize> = unknown.into_iter().filter(|k| seen.frames[*k].info.z_um == z_um).collect();
    let full_dn = 0.99 * instrument.noise.saturation_dn;
    let contents: Vec<f64> = at_depth.iter().map(|k| content(&seen.frames[*k].measured, full_dn)).collect();
    for i in best_of_parts(&contents, MOST_FRAMES) {
        let f = &mut seen.frames[at_depth[i]];
        f.shown = Shown::Estimated;
        f.held_out = false;
    }
}

/// Uses a region of large frames, so that their specimens can be estimated. Says why there is none.
fn use_region(instrument: &Instrument, seen: &mut Observations) -> Result<(), String> {
    let object = [instrument.manifest.object.rows, instrument.manifest.object.cols];
    let (pixels, sensor) = (object[0] * object[1], seen.sensor);
    let footprint = footprint(instrument, sensor);
    let (lenses, side) = (footprint.corners.len(), footprint.side);
    let fits = pixels <= MOST_UNKNOWNS && Views::values(pixels, side, lenses) <= MOST_VALUES;
    let single = seen.is_single();
    let held_out = |region: &Array2<bool>, side: usize| {
        let mut out = Array2::from_elem((sensor[0], sensor[1]), false);
        let blocks = Blocks::of(sensor, |r, c| region[[r, c]], side, single);
        blocks.held_out_pixels().for_each(|p| out[[p as usize / sensor[1], p as usize % sensor[1]]] = true);
        out
    };
    if fits && !seen.is_part() {
        let (whole, now) = (Array2::from_elem((sensor[0], sensor[1]), true), seen.blocks.len().isqrt());
        let side = blocks_per_side(&footprint, &whole, now, |side| held_out(&whole, side));
        if side != now {
            seen.use_pixels(|_, _| true, side);
        }
        return Ok(());
    }
    let unestimated = |why: String| {
        format!("the specimens are unknown, and were not estimated, so that nothing here tests the optics: {why}")
    };
    if sensor[0] * sensor[1] > MOST_SENSOR {
        return Err(unestimated(format!(
            "frames of {} x {} pixels take too long. Frames of at most {MOST_SENSOR} pixels are used: calibrate and \
             measure a part of the sensor, or binned pixels",
            sensor[0], sensor[1]
        )));
    }
    let fitted = Blocks::fitted_share(single);
    let most = Size { pixels: MOST_VALUES / Views::values(1, side, lenses).max(1), unknowns: MOST_OF_REGION, fitted };
    let region = match fits {
        true => Some(footprint.alone(&Array2::from_elem(object, true), 1)),
        false => region(&footprint, &light(seen, &instrument.noise), most),
    };
    let region = region.filter(|region| region.iter().any(|v| *v)).ok_or_else(|| {
        unestimated(format!(
            "objects of {} x {} pixels behind {lenses} lenses with windows of {side} x {side} pixels take more memory \
             than `close` uses, and no part of the sensor sees few enough of their pixels by itself. A coarser grid of \
             object pixels or `calibrate --window` with smaller windows makes it possible",
            object[0], object[1]
        ))
    })?;
    // About as large as a window.
    let first = (sensor[0].min(sensor[1]) / side.max(1)).max(FEWEST_BLOCKS);
    let blocks = blocks_per_side(&footprint, &region, first, |side| held_out(&region, side));
    seen.use_pixels(|r, c| region[[r, c]], blocks);
    Ok(())
}

/// Where the light of each object pixel falls, with the widest windows.
fn footprint(instrument: &Instrument, sensor: [usize; 2]) -> Footprint {
    let object = [instrument.manifest.object.rows, instrument.manifest.object.cols];
    let side = instrument.psf.basis.dim().2 + 2 * MARGIN;
    let rays = &instrument.geometry;
    let living = rays.anchors_px.iter().zip(&rays.dead).filter(|(_, dead)| !**dead);
    let corner = |(anchor, _): (&[f64; 2], _)| {
        [0, 1].map(|a| {
            let first = (anchor[a] - (object[a] as f64 - 1.0) / 2.0).round() as isize;
            first - (side / 2) as isize
        })
    };
    Footprint { object, sensor, side, corners: living.map(corner).collect() }
}

/// Mean light of the frames of unknown specimens, DN above black, [sensor rows, sensor cols]; 0 at pixels that are
/// saturated in one of them, which no frame uses.
fn light(seen: &Observations, noise: &NoiseModel) -> Array2<f32> {
    let (mut sum, mut count) = (Array2::zeros((seen.sensor[0], seen.sensor[1])), 0.0);
    for f in seen.frames.iter().filter(|f| f.shown == Shown::Unknown) {
        count += 1.0;
        sum.zip_mut_with(&f.measured, |sum, dn| {
            let clipped = f64::from(*dn) >= 0.99 * noise.saturation_dn;
            *sum = if clipped { f32::NEG_INFINITY } else { *sum + dn - noise.black_level_dn as f32 };
        });
    }
    sum.mapv(|v: f32| (v / f32::max(count, 1.0)).max(0.0))
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

/// Which part of the sensor was used, and which frames of a recording, or why no specimen was estimated; empty: all of
/// both.
pub(crate) fn chosen_notes(seen: &Observations) -> Vec<String> {
    match &seen.not_estimated {
        Some(why) => vec![why.clone()],
        None => [frames_note(seen), region_note(seen)].into_iter().flatten().collect(),
    }
}

/// Which frames of a recording took part; None: all of them.
fn frames_note(seen: &Observations) -> Option<String> {
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

/// Which part of the sensor was used; None: all of it, or no specimen was estimated.
fn region_note(seen: &Observations) -> Option<String> {
    let is_estimated = seen.frames.iter().any(|f| f.shown == Shown::Estimated);
    (is_estimated && seen.is_part()).then(|| {
        format!(
            "specimens were estimated on {} of the {} sensor pixels, in all frames: on those that see a part of a \
             large object and nothing else of it, or all of a small one. What all of a large object makes takes too \
             much memory to be taken out. Errors are those of the pixels that were used",
            seen.pixels.len(),
            seen.sensor[0] * seen.sensor[1]
        )
    })
}
