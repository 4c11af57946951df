//! Figures of a calibration for tables and programs, its provenance, and the number of frames that it reads.

use super::session::{CalibrateConfig, Calibration};
use crate::bead::PASSES;
use crate::instrument::Instrument;
use ommatidia_physics::noise::ROUNDING_DN2;
use ommatidia_session::artifact::{ArtifactError, Provenance};
use ommatidia_session::{Role, Session, Stack};
use serde_json::{Value, json};

/// Number of frame reads of a calibration; beads are read several times.
pub fn frames_read(session: &Session) -> u64 {
    let frames = |role| session.stacks_of(role).map(|s| s.len() as u64).sum::<u64>();
    frames(Role::Dark) + frames(Role::Flat) + PASSES * frames(Role::Bead)
}

/// Distribution of the read noise over the pixels, electrons rms.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PixelReadNoise {
    /// Median.
    pub median_e: f64,
    /// 99th percentile.
    pub p99_e: f64,
    /// Maximum.
    pub max_e: f64,
}

impl PixelReadNoise {
    /// The distribution for an instrument; None if all pixels have one common read noise.
    pub fn of(instrument: &Instrument) -> Option<Self> {
        let mut sorted: Vec<f32> = instrument.reading_dn2.as_ref()?.iter().copied().collect();
        sorted.sort_by(f32::total_cmp);
        let at = |q: f64| {
            let variance = f64::from(sorted[((sorted.len() - 1) as f64 * q) as usize]) - ROUNDING_DN2;
            variance.max(0.0).sqrt() / instrument.noise.gain_dn_per_e
        };
        Some(Self { median_e: at(0.5), p99_e: at(0.99), max_e: at(1.0) })
    }
}

/// Standard deviation of the response of the pixels, relative; None without a response map.
pub fn response_rms(instrument: &Instrument) -> Option<f64> {
    let map = instrument.response.as_ref()?;
    let square: f64 = map.iter().map(|r| (f64::from(*r) - 1.0).powi(2)).sum();
    Some((square / map.len().max(1) as f64).sqrt())
}

/// Where a calibration comes from: its session's manifest and stacks, or the configuration of a virtual instrument.
///
/// # Errors
/// A file cannot be read.
pub fn provenance(session: &Session, config: &CalibrateConfig, seed: u64) -> Result<Provenance, ArtifactError> {
    let inputs = if session.is_computed() {
        vec![session.dir().to_path_buf()]
    } else {
        std::iter::once(session.manifest_path()).chain(session.stacks().iter().map(Stack::path)).collect()
    };
    inputs.iter().try_fold(Provenance::new("calibrate", seed, config), |p, input| p.with_input(input))
}

impl Calibration {
    /// The figures that `calibrate` prints as JSON.
    pub fn figures(&self) -> Value {
        let i = &self.instrument;
        let cols = i.manifest.array.cols.max(1);
        let anchors: Vec<Vec<[f64; 2]>> = i.geometry.anchors_px.chunks(cols).map(<[_]>::to_vec).collect();
        let dead: Vec<usize> = (0..i.geometry.dead.len()).filter(|l| i.geometry.dead[*l]).collect();
        json!({
            "gain_dn_per_e": i.noise.gain_dn_per_e,
            "gain_sigma_dn_per_e": i.noise.gain_sigma,
            "read_noise_e": i.noise.read_noise_e,
            "read_noise_sigma_e": i.noise.read_noise_sigma,
            "black_level_dn": i.noise.black_level_dn,
            "noise_sources": i.noise.sources,
            "rank": i.rank(),
            "window_px": i.manifest.optics.psf_window_px,
            "replicates": i.replicates.len(),
            "response_rms": response_rms(i),
            "pixel_read_noise_e": PixelReadNoise::of(i)
                .map(|n| json!({ "median": n.median_e, "p99": n.p99_e, "max": n.max_e })),
            "depths_um": i.psf.node_depths_um,
            "sensor_only": i.sensor_only(),
            "approximation_error": i.quality.approximation_error,
            "whole_array_rank": i.whole_array_rank(),
            "error_by_rank": by_rank(i),
            "off_grid_error": i.quality.off_grid_error,
            "one_psf_error": i.quality.one_psf_error,
            "noise_floor": i.quality.noise_floor,
            "frame_error": i.quality.frame_error,
            "anchors_px": anchors,
            "magnification": i.geometry.magnification,
            "chief_ray_rms_px": i.quality.chief_ray_rms_px,
            "dead_lenses": dead,
            "background": i.quality.background.map(|b| json!({
                "level_e": b.mean_e[0], "rows_e": b.mean_e[1], "cols_e": b.mean_e[2],
                "level_sigma_e": b.sigma_e[0], "rows_sigma_e": b.sigma_e[1], "cols_sigma_e": b.sigma_e[2],
                "scatter_e": b.scatter_e, "significant": b.is_seen(), "tail_e": b.tail_e,
            })),
            "outside_window": i.quality.outside_window,
            "light_unit": i.light_unit,
            "pupils": i.pupil_model().map(|p| p.summary()),
            "notes": self.notes,
            "bend": self.bend.map(|b| json!({ "beta": b.beta, "sigma": b.sigma })),
            "beads_normalised": self.beads_normalised,
            "bead_scatter": self.bead_scatter,
        })
    }
}

/// Errors against the rank: on the scan, all lenses decomposed together, on positions left out.
fn by_rank(i: &Instrument) -> Vec<Value> {
    let d = &i.diagnostics;
    let row = |(k, row): (usize, ndarray::ArrayView1<'_, f32>)| {
        json!({
            "rank": row[0], "scan": row[1], "whole_array": d.whole_array_error.get(k), "held_out": row[2],
        })
    };
    d.error_by_rank.outer_iter().enumerate().map(row).collect()
}
