//! Configuration of the virtual instrument. The default is the demo instrument.

use super::error::BenchError;
use super::family::config::{FamilyName, KernelsConfig, RelayConfig};
use ommatidia_physics::scene::SceneConfig;
use ommatidia_session::{ArrayGeometry, Manifest, ObjectGrid, Optics, SensorSpec};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Number of scenes that pass the optics together: each PSF is computed once for all of them.
pub(super) const SCENES_AT_ONCE: usize = 16;

/// Properties of the virtual instrument, and what it measures. In TOML each field is a table; every key is optional.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BenchConfig {
    /// Seed of the lenses and of the sensor's fixed patterns. The seed of a run draws noise and scenes only.
    pub instrument_seed: u64,
    /// How the lenses are computed.
    #[serde(skip_serializing_if = "is_default")]
    pub family: FamilyName,
    /// The image sensor.
    pub sensor: SensorConfig,
    /// The microlens array.
    pub array: ArrayConfig,
    /// Optics common to all lenses.
    pub optics: OpticsConfig,
    /// Aberrations of the lenses of family `pupils`.
    pub aberrations: AberrationConfig,
    /// Aberrations of the lenses of family `relay`.
    #[serde(skip_serializing_if = "is_default")]
    pub relay: RelayConfig,
    /// PSFs of the lenses of family `kernels`.
    #[serde(skip_serializing_if = "is_default")]
    pub kernels: KernelsConfig,
    /// Pixel grid of the objects.
    pub object: ObjectConfig,
    /// The bead scan.
    pub scan: ScanConfig,
    /// Numbers of frames, exposures and light levels.
    pub stacks: StackConfig,
    /// Specimens of the scenes.
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
    /// Bits of the analogue-to-digital converter, 1 to 16.
    pub bit_depth: u32,
    /// Conversion gain, DN per electron.
    pub gain_dn_per_e: f64,
    /// Black level, DN.
    pub black_level_dn: f64,
    /// Read noise, electrons rms.
    pub read_noise_e: f64,
    /// Fixed pattern of offsets, DN rms.
    pub offset_rms_dn: f64,
    /// Photo-response non-uniformity, relative, rms.
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
    /// Nominal distance between neighbouring chief rays on the sensor, pixels.
    pub pitch_px: f64,
    /// Nominal focus (row, col) of each lens for a source on the axis, sensor pixels; None: they form a centred grid.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lenses_px: Option<Vec<[f64; 2]>>,
    /// Placement error of the lenses, as the displacement of their anchors on the sensor, pixels rms along each axis.
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
    /// Nominal magnification (image size over object size), as in the manifest.
    pub magnification: f64,
    /// Relative error of the nominal magnification: true over nominal, minus one.
    pub magnification_error: f64,
    /// Diameter of a lens, um.
    pub aperture_um: f64,
    /// Share of the lens radius over which the transmitted amplitude falls to zero, 0 (hard edge) to 1.
    pub soft_edge: f64,
    /// Angular response of a lens: tangent of the angle at which it transmits half the light, in addition to the cos^4
    /// law.
    pub half_response_tangent: f64,
    /// Distortion: displacement of a focus at the corner of the object for a lens on the optical axis, pixels. It grows
    /// with the cube of the field angle.
    pub distortion_px: f64,
    /// Side of the window for one focus in the manifest, pixels; odd.
    pub psf_window_px: usize,
    /// Side of the field in which a PSF is computed, pixels; odd, and at least the window, so that PSFs have tails.
    pub psf_field_px: usize,
    /// Samples per pixel along each axis; odd.
    pub oversampling: usize,
}

/// Aberrations as Noll's Zernike coefficients, waves rms. Terms that vary over the field are given for the corner of
/// the object and a lens on the optical axis.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AberrationConfig {
    /// Defocus, constant over the field.
    pub defocus: f64,
    /// Spherical aberration, constant over the field.
    pub spherical: f64,
    /// Field curvature: defocus that grows with the square of the field angle.
    pub field_curvature: f64,
    /// Astigmatism, which grows with the square of the field angle.
    pub astigmatism: f64,
    /// Coma, which grows with the field angle.
    pub coma: f64,
    /// Manufacturing tolerance: rms of each coefficient over the lenses.
    pub scatter: f64,
    /// Manufacturing tolerance: rms tilt of the lenses, as defocus at the corner of the object.
    pub tilt_scatter: f64,
}

/// Pixel grid of the objects.
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

/// The bead scan, in even steps from edge to edge of the object.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ScanConfig {
    /// Rows of positions.
    pub rows: usize,
    /// Columns of positions.
    pub cols: usize,
    /// Depths of the scan, um. Every position is measured at each depth.
    #[serde(skip_serializing_if = "in_focus_only")]
    pub depths_um: Vec<f64>,
    /// Light of the bead through a lens straight above it, electrons.
    pub bead_e: f64,
    /// Whether every second row is scanned backwards.
    #[serde(skip_serializing_if = "is_default")]
    pub serpentine: bool,
}

/// Numbers of frames, exposures and light levels of the stacks.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct StackConfig {
    /// Exposure of every frame without another one, ms.
    pub exposure_ms: f64,
    /// Time from the start of one frame to the next, ms.
    pub interval_ms: f64,
    /// Number of dark frames at each exposure.
    pub dark_frames: usize,
    /// Exposures of the darks, ms. Empty: only `exposure_ms`.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub dark_exposures_ms: Vec<f64>,
    /// Light levels of the flats, as shares of full scale at `exposure_ms`.
    pub flat_levels: Vec<f64>,
    /// Exposures of the flats, ms. Every level is measured at each exposure. Empty: only `exposure_ms`.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub flat_exposures_ms: Vec<f64>,
    /// Number of flat frames at each level and exposure.
    pub flat_frames: usize,
    /// Number of scenes at each depth.
    pub scene_frames: usize,
    /// Depths of the specimens, um. Every scene is measured at each depth.
    #[serde(skip_serializing_if = "in_focus_only")]
    pub scene_depths_um: Vec<f64>,
    /// Range (low, high) of the brightest pixel of a scene, as shares of full scale; drawn log-uniformly.
    pub scene_peak: [f64; 2],
}

// Likewise what says nothing about the instrument.
fn is_default<T: Default + PartialEq>(value: &T) -> bool {
    *value == T::default()
}

// Default depths are left out of a session's truth, as in files written before depths existed.
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
            family: FamilyName::default(),
            relay: RelayConfig::default(),
            kernels: KernelsConfig::default(),
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
        Self { rows: 3, cols: 3, pitch_px: 50.0, lenses_px: None, placement_rms_px: 0.35 }
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
        Self { rows: 13, cols: 13, depths_um: vec![0.0], bead_e: 34_000.0, serpentine: false }
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

impl StackConfig {
    /// A short session of a small instrument that holds all kinds of frames, as studies measure it: flats of three
    /// levels at two exposures, darks of two exposures, eight scenes.
    pub fn of_a_study() -> Self {
        Self {
            interval_ms: 60.0,
            dark_frames: 16,
            dark_exposures_ms: vec![10.0, 40.0],
            flat_levels: vec![0.1, 0.3, 0.6],
            flat_exposures_ms: vec![5.0, 10.0],
            flat_frames: 16,
            scene_frames: 8,
            ..Self::default()
        }
    }
}

impl BenchConfig {
    /// Reads a configuration from a TOML file. Missing keys have the values of the demo instrument.
    ///
    /// # Errors
    /// The file is missing, is not valid TOML, or has an unknown key.
    pub fn read(path: &Path) -> Result<Self, BenchError> {
        let text = std::fs::read_to_string(path).map_err(|source| BenchError::Io { path: path.into(), source })?;
        toml::from_str(&text).map_err(|e| BenchError::Syntax { path: path.into(), detail: e.to_string() })
    }

    /// Full scale of the converter above the black level, electrons: `(2^bit_depth - 1 - black level) / gain`.
    pub fn full_scale_e(&self) -> f64 {
        let sensor = &self.sensor;
        ((2f64).powi(sensor.bit_depth as i32) - 1.0 - sensor.black_level_dn) / sensor.gain_dn_per_e
    }

    /// True magnification: image size over object size.
    pub fn true_magnification(&self) -> f64 {
        self.optics.magnification * (1.0 + self.optics.magnification_error)
    }

    /// Number of scene frames: every scene at each depth.
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

    /// Nominal focus (row, col) of each lens for a source on the axis, sensor pixels.
    pub fn places_px(&self) -> Vec<[f64; 2]> {
        let manifest = self.manifest();
        manifest.array.places_px(&manifest.sensor)
    }

    /// The manifest of the instrument's sessions, without stacks.
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
            array: ArrayGeometry {
                rows: array.rows,
                cols: array.cols,
                pitch_px: array.pitch_px,
                lenses_px: array.lenses_px.clone(),
            },
            optics: Optics {
                magnification: optics.magnification,
                psf_window_px: optics.psf_window_px,
                // PSFs that are given belong to no wavelength of this configuration.
                wavelength_um: (self.family != FamilyName::Kernels).then_some(optics.wavelength_um),
            },
            object: ObjectGrid { rows: object.rows, cols: object.cols, pixel_um: object.pixel_um },
            stacks: Vec::new(),
        }
    }
}
