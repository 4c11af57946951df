//! What maps are worth, measured on simulated specimens; and the maps as integers.

use super::fit::Fitted;
use super::{FALSE_ALARMS, WatchError, WatchMaps};
use crate::uncertainty::{VirtualConfig, VirtualFrame};
use ndarray::{Array2, Axis};
use ommatidia_model::forward::Forward;
use ommatidia_model::instrument::Instrument;
use ommatidia_physics::scene::Specimen;
use ommatidia_physics::sensor::sensor_codes;
use ommatidia_shared::watch::{MOMENTS, Maps, Statistic, blocks};
use rayon::prelude::*;

/// Frames that the statistics are judged on.
const FRAMES: usize = 220;
/// Brightest pixels of these frames as a share of full scale: so bright that noise hides nothing.
const PEAK: [f64; 2] = [0.5, 0.8];
/// The specimens make at least this share of the variance that is found: what noise makes is known so well.
const LEAST: f64 = 0.1;
/// Light below this share of full scale in the mean of all pixels does not count.
const DARK: f64 = 1e-3;

/// The maps as integers, with what noise and specimens make of them.
///
/// # Errors
/// No virtual frames can be made.
pub fn judged(fitted: Fitted, i: &Instrument, forward: &Forward, seed: u64) -> Result<WatchMaps, WatchError> {
    let noise = forward.noise();
    let basis = fitted.basis;
    let mut watch = WatchMaps {
        frame: basis.frame,
        block: basis.block,
        black_dn: noise.black_level_dn.round().clamp(0.0, f64::from(u16::MAX)) as u16,
        least_light_dn: 0.0,
        log_odds: 0.0,
        weights: vec![0; basis.len() / MOMENTS * Maps::weights_of_block(fitted.maps.nrows())],
        statistics: vec![Statistic::default(); fitted.maps.nrows()],
    };
    let mut squares = Vec::new();
    for (j, map) in fitted.maps.outer_iter().enumerate() {
        let unit = quantize(&fitted, j, &mut watch.weights);
        watch.statistics[j].scale = unit as f32;
        let (rows, cols) = (usize::from(basis.frame.rows), usize::from(basis.frame.cols));
        squares.push(Array2::from_shape_fn((rows, cols), |(r, c)| basis.value(map, r, c).powi(2) as f32));
    }
    let full = noise.saturation_dn - noise.black_level_dn;
    let pixels = f64::from(basis.frame.rows) * f64::from(basis.frame.cols);
    let specimens = Specimen::for_training();
    let config = VirtualConfig { specimens, peak_e: Some(PEAK.map(|part| part * noise.full_scale_e())) };
    let scenes = config.build(i, &[])?;
    let shape = [basis.frame.rows.into(), basis.frame.cols.into()];
    let seen: Vec<Vec<[f64; 3]>> = (0..FRAMES)
        .into_par_iter()
        .map(|n| {
            let VirtualFrame { frame_dn, .. } = scenes.frame(seed, "watch", n)?;
            let codes = sensor_codes(frame_dn.view(), shape).unwrap_or_default();
            let projection = watch.maps().project(&codes);
            let light = projection.light_dn.max(1) as f64;
            let black = noise.black_level_dn as f32;
            let of = |(j, square): (usize, &Array2<f32>)| {
                let value = projection.value(j, &watch.statistics[j]);
                let shot: f64 = square.iter().zip(&frame_dn).map(|(w, y)| f64::from(w * (y - black).max(0.0))).sum();
                [f64::from(value), noise.gain_dn_per_e * shot / light, light]
            };
            Ok(squares.iter().enumerate().map(of).collect())
        })
        .collect::<Result<_, WatchError>>()?;
    let reading = match forward.reading_dn2() {
        Some(map) => map.clone(),
        None => Array2::from_elem(shape, ((noise.gain_dn_per_e * noise.read_noise_e).powi(2) + 1.0 / 12.0) as f32),
    };
    for (j, (statistic, square)) in watch.statistics.iter_mut().zip(&squares).enumerate() {
        let values: Vec<f64> = seen.iter().map(|frame| frame[j][0]).collect();
        let mean = values.iter().sum::<f64>() / FRAMES as f64;
        let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (FRAMES - 1) as f64;
        statistic.shot = seen.iter().map(|frame| frame[j][1]).fold(0.0, f64::max) as f32;
        statistic.reading = square.iter().zip(&reading).map(|(w, v)| w * v).sum();
        let noise = seen.iter().map(|frame| (frame[j][1] + f64::from(statistic.reading) / frame[j][2]) / frame[j][2]);
        let specimens = (variance - noise.sum::<f64>() / FRAMES as f64).max(LEAST * variance);
        statistic.specimens = (2.0 * specimens).sqrt() as f32;
    }
    let used = watch.statistics.iter().filter(|statistic| statistic.is_used()).count();
    watch.least_light_dn = (DARK * full * pixels) as f32;
    watch.log_odds = (2.0 * used.max(1) as f64 / FALSE_ALARMS).ln() as f32;
    Ok(watch)
}

/// Writes map `j` as integers; returns what one of them is worth.
fn quantize(fitted: &Fitted, j: usize, weights: &mut [i16]) -> f64 {
    let (basis, map) = (fitted.basis, fitted.maps.index_axis(Axis(0), j));
    let side = usize::from(basis.block);
    let [down, across] = blocks(basis.frame, basis.block);
    let statistics = fitted.maps.nrows();
    let (shifts, of_block) = (2 * statistics / 3, Maps::weights_of_block(statistics));
    let (first, moments) = if j < shifts { (MOMENTS * j, MOMENTS) } else { (MOMENTS * shifts + j - shifts, 1) };
    let mut scaled = Vec::with_capacity(basis.len());
    for (r, c) in (0..down).flat_map(|r| (0..across).map(move |c| (r, c))) {
        let (at, _, [height, width]) = basis.at(r * side, c * side);
        // The device sums 16 times the light, and moments that are as many times larger as the block is long.
        let all = [map[at] / 16.0, map[at + 1] / height as f64, map[at + 2] / width as f64];
        scaled.extend_from_slice(&all[..moments]);
    }
    let unit = scaled.iter().fold(0.0f64, |m, v| m.max(v.abs())) / f64::from(i16::MAX);
    if unit > 0.0 {
        for (block, values) in scaled.chunks(moments).enumerate() {
            for (to, v) in weights[block * of_block + first..].iter_mut().zip(values) {
                *to = (v / unit).round() as i16;
            }
        }
    }
    unit
}
