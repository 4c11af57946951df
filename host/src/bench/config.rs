//! What the virtual instrument is built like. The default is the demo instrument.

use super::BenchError;
use crate::scene::SceneConfig;
use crate::session::{ArrayGeometry, Manifest, ObjectGrid, Optics, SensorSpec};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// What the virtual instrument is built like, and what it measures. As TOML: one table a field, every key optional.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BenchConfig {
    /// Makes the instrument: its lenses, its sensor's patterns. The seed of a run draws noise and scenes only.
    pub instrument_seed: u64,
    /// The image sensor.
    pub sensor: SensorConfig,
    /// The microlens array.
    pub array: ArrayConfig,
    /// Its optics.
    pub optics: OpticsConfig,
    /// Aberrations of the lenses.
    pub aberrations: AberrationConfig,
    /// The grid of objects.
    pub object: ObjectConfig,
    /// The bead scan.
    pub scan: ScanConfig,
    /// The stacks.
    pub stacks: StackConfig,
    /// What the scenes show.
    pub scenes: SceneConfig,
}

/// The image sensor.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SensorConfig {
    /// Rows, pixels.
    pub rows: usize,
    /// Columns, pixels.
    pub cols: usize,
    /// Pixel pitch, um.
    pub pixel_pitch_um: f64,
    /// Bits of the converter.
    pub bit_depth: u32,
    /// Conversion gain, DN per electron.
    pub gain_dn_per_e: f64,
    /// Black level, DN.
    pub black_level_dn: f64,
    /// Read noise, electrons rms.
    pub read_noise_e: f64,
    /// Fixed-pattern offset, DN rms.
    pub offset_rms_dn: f64,
    /// Photo-response non-uniformity, rms.
    pub prnu_rms: f64,
}

/// The microlens array.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ArrayConfig {
    /// Rows of lenses.
    pub rows: usize,
    /// Columns of lenses.
    pub cols: usize,
    /// Nominal distance of neighbouring chief rays on the sensor, pixels.
    pub pitch_px: f64,
    /// Placement error of a lens as seen by its chief ray on the sensor, pixels rms in each direction.
    pub placement_rms_px: f64,
}

/// Optics common to all lenses.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OpticsConfig {
    /// Wavelength, um.
    pub wavelength_um: f64,
    /// Distance from the object to the lenses, um.
    pub object_distance_um: f64,
    /// Nominal magnification, image per object: what the manifest says.
    pub magnification: f64,
    /// True magnification over the nominal one, less one: the array is never glued exactly where it was meant to be.
    pub magnification_error: f64,
    /// Diameter of a lens, um.
    pub aperture_um: f64,
    /// Share of the radius over which the transmitted amplitude falls to zero, 0 to 1.
    pub soft_edge: f64,
    /// Angular response: tangent of the angle at which a lens passes half the light, besides cos^4.
    pub half_response_tangent: f64,
    /// Distortion: displacement of a focus, pixels, at the corner of the object seen by a lens on the axis; grows with the cube.
    pub distortion_px: f64,
    /// Window that the manifest gives for one focus, pixels; odd.
    pub psf_window_px: usize,
    /// Field in which a PSF is computed, pixels; odd, and wider than the window, so that its tails are real.
    pub psf_field_px: usize,
    /// Samples per pixel in each direction; odd.
    pub oversampling: usize,
}

/// Aberrations, waves rms (Noll). Field terms are those at the corner of the object, seen by a lens on the axis.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AberrationConfig {
    /// Defocus everywhere.
    pub defocus: f64,
    /// Spherical aberration everywhere.
    pub spherical: f64,
    /// Field curvature: defocus, with the square of the field angle.
    pub field_curvature: f64,
    /// Astigmatism, with the square of the field angle.
    pub astigmatism: f64,
    /// Coma, with the field angle.
    pub coma: f64,
    /// Manufacturing: rms of each term from lens to lens.
    pub scatter: f64,
    /// Manufacturing: rms of a lens's tilt, as defocus at the corner of the object.
    pub tilt_scatter: f64,
}

/// The grid of objects.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ObjectConfig {
    /// Rows, object pixels.
    pub rows: usize,
    /// Columns, object pixels.
    pub cols: usize,
    /// Side of an object pixel, um.
    pub pixel_um: f64,
}

/// The bead scan: even steps from edge to edge of the object.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ScanConfig {
    /// Rows of positions.
    pub rows: usize,
    /// Columns of positions.
    pub cols: usize,
    /// Depths, um: every position is taken at each.
    #[serde(skip_serializing_if = "in_focus_only")]
    pub depths_um: Vec<f64>,
    /// Light of the bead through one lens straight above it, electrons.
    pub bead_e: f64,
}

/// The stacks.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct StackConfig {
    /// Exposure of every frame that has no other, ms.
    pub exposure_ms: f64,
    /// Time from frame to frame, ms.
    pub interval_ms: f64,
    /// Dark frames an exposure.
    pub dark_frames: usize,
    /// Exposures of the darks, ms; none: `exposure_ms` alone.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub dark_exposures_ms: Vec<f64>,
    /// Light levels of the flats, share of full scale in `exposure_ms`.
    pub flat_levels: Vec<f64>,
    /// Exposures of the flats, ms: every level is taken at each; none: `exposure_ms` alone.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub flat_exposures_ms: Vec<f64>,
    /// Flat frames a level and exposure.
    pub flat_frames: usize,
    /// Scenes.
    pub scene_frames: usize,
    /// Depths of the specimens, um: every scene is taken at each.
    #[serde(skip_serializing_if = "in_focus_only")]
    pub scene_depths_um: Vec<f64>,
    /// Brightest pixel of a scene, share of full scale: drawn between these, its logarithm evenly.
    pub scene_peak: [f64; 2],
}

// What is as it always was is left out of a session's truth.
fn in_focus_only(depths_um: &[f64]) -> bool {
    depths_um == [0.0]
}

impl Default for BenchConfig {
    fn default() -> Self {
        Self {
            instrument_seed: 2026,
            sensor: SensorConfig::default(),
            array: ArrayConfig::default(),
            optics: OpticsConfig::default(),
            aberrations: AberrationConfig::default(),
            object: ObjectConfig::default(),
            scan: ScanConfig::default(),
            stacks: StackConfig::default(),
            scenes: SceneConfig::default(),
        }
    }
}

impl Default for SensorConfig {
    fn default() -> Self {
        Self {
            rows: 214,
            cols: 214,
            pixel_pitch_um: 1.85,
            bit_depth: 12,
            gain_dn_per_e: 0.4,
            black_level_dn: 64.0,
            read_noise_e: 2.0,
            offset_rms_dn: 1.5,
            prnu_rms: 0.002,
        }
    }
}

impl Default for ArrayConfig {
    fn default() -> Self {
        Self { rows: 3, cols: 3, pitch_px: 50.0, placement_rms_px: 0.35 }
    }
}

impl Default for OpticsConfig {
    fn default() -> Self {
        Self {
            wavelength_um: 0.525,
            object_distance_um: 600.0,
            magnification: 0.660714,
            magnification_error: 0.003,
            aperture_um: 54.0,
            soft_edge: 1.0,
            half_response_tangent: 0.3,
            distortion_px: 0.1,
            psf_window_px: 15,
            psf_field_px: 35,
            oversampling: 3,
        }
    }
}

impl Default for AberrationConfig {
    fn default() -> Self {
        Self {
            defocus: 0.03,
            spherical: 0.02,
            field_curvature: 0.11,
            astigmatism: 0.085,
            coma: 0.075,
            scatter: 0.028,
            tilt_scatter: 0.02,
        }
    }
}

impl Default for ObjectConfig {
    fn default() -> Self {
        Self { rows: 96, cols: 96, pixel_um: 2.8 }
    }
}

impl Default for ScanConfig {
    fn default() -> Self {
        Self { rows: 13, cols: 13, depths_um: vec![0.0], bead_e: 34_000.0 }
    }
}

impl Default for StackConfig {
    fn default() -> Self {
        Self {
            exposure_ms: 10.0,
            interval_ms: 20.0,
            dark_frames: 32,
            dark_exposures_ms: Vec::new(),
            flat_levels: vec![0.05, 0.15, 0.3, 0.45, 0.6],
            flat_exposures_ms: Vec::new(),
            flat_frames: 8,
            scene_frames: 12,
            scene_depths_um: vec![0.0],
            scene_peak: [0.25, 0.7],
        }
    }
}

impl BenchConfig {
    /// Reads a TOML file; what it leaves out is as in the demo instrument.
    ///
    /// # Errors
    /// The file is missing, no valid TOML, or has an unknown key.
    pub fn read(path: &Path) -> Result<Self, BenchError> {
        let text = std::fs::read_to_string(path).map_err(|source| BenchError::Io { path: path.into(), source })?;
        toml::from_str(&text).map_err(|e| BenchError::Syntax { path: path.into(), detail: e.to_string() })
    }

    /// Full scale of the converter above the black level, electrons.
    pub fn full_scale_e(&self) -> f64 {
        let sensor = &self.sensor;
        ((2f64).powi(sensor.bit_depth as i32) - 1.0 - sensor.black_level_dn) / sensor.gain_dn_per_e
    }

    /// True magnification, image per object.
    pub fn true_magnification(&self) -> f64 {
        self.optics.magnification * (1.0 + self.optics.magnification_error)
    }

    /// Scene frames: every scene at each depth.
    pub fn scene_count(&self) -> usize {
        self.stacks.scene_frames * self.stacks.scene_depths_um.len()
    }

    /// Exposures of the darks, ms.
    pub fn dark_exposures_ms(&self) -> Vec<f64> {
        self.or_common(&self.stacks.dark_exposures_ms)
    }

    /// Exposures of the flats, ms.
    pub fn flat_exposures_ms(&self) -> Vec<f64> {
        self.or_common(&self.stacks.flat_exposures_ms)
    }

    fn or_common(&self, exposures_ms: &[f64]) -> Vec<f64> {
        if exposures_ms.is_empty() { vec![self.stacks.exposure_ms] } else { exposures_ms.to_vec() }
    }

    /// The manifest of what this instrument measures, without stacks.
    pub fn manifest(&self) -> Manifest {
        let (sensor, array, optics, object) = (&self.sensor, &self.array, &self.optics, &self.object);
        Manifest {
            format: 1,
            name: "virtual instrument".into(),
            sensor: SensorSpec {
                rows: sensor.rows,
                cols: sensor.cols,
                pixel_pitch_um: sensor.pixel_pitch_um,
                bit_depth: sensor.bit_depth,
            },
            array: ArrayGeometry { rows: array.rows, cols: array.cols, pitch_px: array.pitch_px },
            optics: Optics { magnification: optics.magnification, psf_window_px: optics.psf_window_px },
            object: ObjectGrid { rows: object.rows, cols: object.cols, pixel_um: object.pixel_um },
            stacks: Vec::new(),
        }
    }

    /// Checks what neither the manifest nor the pupil checks.
    ///
    /// # Errors
    /// The first number that cannot be.
    pub(super) fn check(&self) -> Result<(), BenchError> {
        let wrong =
            |field, expected: &str, found: String| Err(BenchError::Config { field, expected: expected.into(), found });
        let (sensor, optics, stacks) = (&self.sensor, &self.optics, &self.stacks);
        for (field, v) in [
            ("sensor.gain_dn_per_e", sensor.gain_dn_per_e),
            ("optics.object_distance_um", optics.object_distance_um),
            ("optics.half_response_tangent", optics.half_response_tangent),
            ("optics.magnification_error", 1.0 + self.optics.magnification_error),
            ("scan.bead_e", self.scan.bead_e),
            ("stacks.exposure_ms", stacks.exposure_ms),
        ] {
            if !(v.is_finite() && v > 0.0) {
                return wrong(field, "a number above zero", v.to_string());
            }
        }
        for (field, v) in [
            ("sensor.black_level_dn", sensor.black_level_dn),
            ("sensor.read_noise_e", sensor.read_noise_e),
            ("sensor.offset_rms_dn", sensor.offset_rms_dn),
            ("sensor.prnu_rms", sensor.prnu_rms),
            ("array.placement_rms_px", self.array.placement_rms_px),
            ("aberrations.scatter", self.aberrations.scatter),
            ("aberrations.tilt_scatter", self.aberrations.tilt_scatter),
            ("stacks.interval_ms", stacks.interval_ms),
        ] {
            if !(v.is_finite() && v >= 0.0) {
                return wrong(field, "a number, zero or more", v.to_string());
            }
        }
        if !(1..=16).contains(&sensor.bit_depth) {
            return wrong("sensor.bit_depth", "1 to 16", sensor.bit_depth.to_string());
        }
        if self.full_scale_e().is_nan() || self.full_scale_e() <= 0.0 {
            return wrong("sensor.black_level_dn", "less than the highest code", sensor.black_level_dn.to_string());
        }
        if optics.psf_field_px < optics.psf_window_px {
            return wrong("optics.psf_field_px", "at least psf_window_px", optics.psf_field_px.to_string());
        }
        for (field, n) in [
            ("scan.rows", self.scan.rows),
            ("scan.cols", self.scan.cols),
            ("scan.depths_um", self.scan.depths_um.len()),
            ("stacks.dark_frames", stacks.dark_frames),
            ("stacks.flat_frames", stacks.flat_frames),
            ("stacks.scene_frames", stacks.scene_frames),
            ("stacks.scene_depths_um", stacks.scene_depths_um.len()),
            ("stacks.flat_levels", stacks.flat_levels.len()),
        ] {
            if n == 0 {
                return wrong(field, "one or more", "0".into());
            }
        }
        for (field, exposures) in [
            ("stacks.dark_exposures_ms", &stacks.dark_exposures_ms),
            ("stacks.flat_exposures_ms", &stacks.flat_exposures_ms),
        ] {
            if let Some(v) = exposures.iter().find(|v| !(v.is_finite() && **v > 0.0)) {
                return wrong(field, "numbers above zero", v.to_string());
            }
        }
        for (field, depths) in
            [("scan.depths_um", &self.scan.depths_um), ("stacks.scene_depths_um", &stacks.scene_depths_um)]
        {
            if let Some(z) = depths.iter().find(|z| !z.is_finite()) {
                return wrong(field, "finite depths", z.to_string());
            }
        }
        let [low, high] = stacks.scene_peak;
        if !(low > 0.0 && high >= low && high.is_finite()) {
            return wrong("stacks.scene_peak", "two ascending shares above zero", format!("{:?}", stacks.scene_peak));
        }
        match stacks.flat_levels.iter().find(|l| !(l.is_finite() && **l >= 0.0)) {
            Some(level) => wrong("stacks.flat_levels", "shares of full scale, zero or more", level.to_string()),
            None => Ok(()),
        }
    }
}
