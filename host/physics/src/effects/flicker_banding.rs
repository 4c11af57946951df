//! Flicker banding: a flickering lamp with a rolling shutter makes bands across the frame that move from frame to
//! frame.
//!
//! `mu -> mu (1 + m_cos cos a + m_sin sin a)`, `a = 2 pi (cycles_per_row row + frame_hz time)`. A row is exposed one
//! line time after the row above, so a lamp at f Hz gives `cycles_per_row = f * line time`. Frames at even intervals
//! determine f only up to a multiple of their rate; `frame_hz` may be any such alias. Flats may be taken with a lamp of
//! their own, which does not flicker: `in_flats` is 0 then.

use super::context::FrameContext;
use super::descriptor::{Descriptor, Lookalike, Param, Stage};
use super::effect::Effect;
use super::evidence::{Evidence, EvidenceFrame};
use super::wave::{Spectrum, wave};
use ndarray::Array2;
use ommatidia_session::Role;
use std::f64::consts::TAU;

/// The effect; its formula is in the documentation of the module.
pub(super) struct FlickerBanding;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "flicker_banding",
    stage: Stage::Light,
    summary: "mu (1 + m_cos cos a + m_sin sin a), a = 2 pi (cycles_per_row row + frame_hz time): \
              lamp flicker with a rolling shutter",
    params: &[
        Param::strength("m_cos", "1", 0.001, -1.0, 1.0),
        Param::strength("m_sin", "1", 0.001, -1.0, 1.0),
        Param::shape("cycles_per_row", "1/row", 0.02, 0.0002, [0.0, 0.5], &[]),
        Param::shape("frame_hz", "Hz", 7.0, 0.1, [-1e5, 1e5], &[]),
        Param::choice("in_flats", "1", 1.0, [0.0, 1.0]),
    ],
    lookalikes: &[
        Lookalike {
            id: "row_pattern",
            separate_by: "darks, or later frames: a fixed pattern does not move and is there without light",
        },
        Lookalike { id: "row_noise", separate_by: "darks: row noise is there without light" },
        Lookalike { id: "lamp_drift", separate_by: "rows of one frame: a drift is the same in all rows" },
    ],
};

impl Effect for FlickerBanding {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn on_light(&self, p: &[f64], light_e: &mut Array2<f32>, cx: &FrameContext<'_>) {
        let lit = match cx.role {
            Role::Dark => false,
            Role::Flat => p[4] != 0.0,
            Role::Scene | Role::Bead => true,
        };
        if (p[0] == 0.0 && p[1] == 0.0) || !lit {
            return;
        }
        // cos(b + c) and sin(b + c): the phase c from the time enters the two amplitudes.
        let (sin, cos) = (TAU * (p[3] * cx.time_s).fract()).sin_cos();
        let bands = wave(light_e.nrows(), p[0] * cos + p[1] * sin, p[1] * cos - p[0] * sin, 1.0 / p[2].max(1e-12));
        for (mut row, band) in light_e.outer_iter_mut().zip(bands) {
            let factor = (1.0 + band).max(0.0);
            row.mapv_inplace(|v| v * factor);
        }
    }

    fn chances(&self, [rows, _]: [usize; 2], frames: usize) -> f64 {
        (rows * frames.max(2)) as f64 / 4.0
    }

    /// Peaks over (cycles per row, Hz) in the spectrum of the rows' residuals, weighted by their light: of all lit
    /// frames, and of those that are no flats.
    fn guess(&self, evidence: &Evidence<'_>) -> Vec<Vec<f64>> {
        let of = |in_flats: bool| {
            let lit = |f: &&EvidenceFrame<'_>| f.cx.role != Role::Dark && (in_flats || f.cx.role != Role::Flat);
            let frames: Vec<&EvidenceFrame<'_>> = evidence.frames.iter().filter(lit).collect();
            let start = move |[per_row, hz]: [f64; 2]| vec![0.0, 0.0, per_row, hz, f64::from(u8::from(in_flats))];
            peaks(&frames).into_iter().map(start)
        };
        let has =
            |flats: bool| evidence.frames.iter().any(|f| (f.cx.role == Role::Flat) == flats && f.cx.role != Role::Dark);
        of(true).chain(of(false).take(if has(true) && has(false) { KEEP } else { 0 })).collect()
    }
}

/// Largest number of frames that are used.
const FRAMES: usize = 64;
/// Largest number of frequencies over time that are tried.
const TIMES: usize = 257;
/// Fewest bands over the frame that are proposed where they do not move from frame to frame.
const STANDING: f64 = 1.5;
/// Number of proposals.
const KEEP: usize = 3;

/// The strongest waves over rows and time, as (cycles per row, Hz).
fn peaks(lit: &[&EvidenceFrame<'_>]) -> Vec<[f64; 2]> {
    let lit = &lit[..lit.len().min(FRAMES)];
    let Some(rows) = lit.first().map(|f| f.light_e.nrows()).filter(|n| *n >= 4) else { return Vec::new() };
    // For each frame, the sums of w R L by row, minus the part in proportion to the light: the scale of a frame is
    // free.
    let mut signals = Vec::new();
    for frame in lit {
        let (mut sums, mut powers) = (vec![0.0; rows], vec![0.0; rows]);
        let lines = frame.residual_dn.outer_iter().zip(frame.weight.outer_iter()).zip(frame.light_e.outer_iter());
        for (((residual, weight), light), (s, p)) in lines.zip(sums.iter_mut().zip(&mut powers)) {
            for ((r, w), l) in residual.iter().zip(&weight).zip(&light) {
                let wl = f64::from(*w) * f64::from(*l);
                *s += wl * f64::from(*r);
                *p += wl * f64::from(*l);
            }
        }
        let total: f64 = powers.iter().sum();
        let mean = if total > 0.0 { sums.iter().sum::<f64>() / total } else { 0.0 };
        let signal: Vec<f64> = sums.iter().zip(&powers).map(|(s, p)| s - mean * p).collect();
        signals.push((frame.cx.time_s, signal));
    }
    let spectrum = Spectrum::new(rows);
    let times = frequencies(&lit.iter().map(|f| f.cx.time_s).collect::<Vec<_>>());
    let turns: Vec<Vec<(f64, f64)>> =
        times.iter().map(|hz| signals.iter().map(|(t, _)| (TAU * hz * t).sin_cos()).collect()).collect();
    let mut found: Vec<(f64, usize, usize)> = Vec::new();
    for j in spectrum.indices() {
        let by_frame: Vec<[f64; 2]> = signals.iter().map(|(_, s)| spectrum.at(s, j)).collect();
        for (k, turns) in turns.iter().enumerate() {
            let mut sum = [0.0; 2];
            for ([re, im], (sin, cos)) in by_frame.iter().zip(turns) {
                sum[0] += re * cos + im * sin;
                sum[1] += im * cos - re * sin;
            }
            found.push((sum[0] * sum[0] + sum[1] * sum[1], j, k));
        }
    }
    found.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut kept: Vec<(usize, usize)> = Vec::new();
    let span = lit.iter().map(|f| f.cx.time_s).fold(f64::MIN, f64::max)
        - lit.iter().map(|f| f.cx.time_s).fold(f64::MAX, f64::min);
    for (power, j, k) in found {
        // Broad bands that stand still are shading.
        if times[k].abs() * span < 0.5 && spectrum.frequency(j) * (rows as f64) < STANDING {
            continue;
        }
        if power > 0.0 && kept.iter().all(|(i, _)| !Spectrum::same(*i, j)) {
            kept.push((j, k));
        }
        if kept.len() == KEEP {
            break;
        }
    }
    kept.into_iter().map(|(j, k)| [spectrum.frequency(j), times[k]]).collect()
}

/// Frequencies that frames at these times distinguish, Hz: up to half the rate of the closest two frames, in steps of
/// at most a quarter over the total time. Only zero if all frames have the same time.
fn frequencies(times: &[f64]) -> Vec<f64> {
    let mut sorted = times.to_vec();
    sorted.sort_by(f64::total_cmp);
    let closest = sorted.windows(2).map(|w| w[1] - w[0]).filter(|d| *d > 0.0).fold(f64::INFINITY, f64::min);
    let span = sorted.last().zip(sorted.first()).map_or(0.0, |(a, b)| a - b);
    if !closest.is_finite() || span <= 0.0 {
        return vec![0.0];
    }
    let top = 0.5 / closest;
    let half = ((top * 4.0 * span).ceil() as usize).clamp(1, TIMES / 2);
    (0..=2 * half).map(|i| top * (i as f64 / half as f64 - 1.0)).collect()
}
