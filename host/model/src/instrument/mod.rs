//! The instrument: the result of a calibration, as data, and its file.
//!
//! Nothing here computes: [`crate::calibrate`] makes instruments, [`crate::forward`] predicts frames with them.
//!
//! ```
//! use ommatidia_session::artifact::Provenance;
//! use ommatidia_model::instrument::Instrument;
//!
//! let folder = tempfile::tempdir()?;
//! let path = folder.path().join("lab.instrument");
//! ommatidia_model::testing::instrument([9, 11], [30, 33], 5, 3).write(&path, Provenance::default())?;
//! let instrument = Instrument::read(&path)?;
//! assert_eq!(instrument.psf.basis.dim(), (2, 3, 5, 5)); // lenses, terms, window rows, window cols
//! assert_eq!(instrument.noise.gain_dn_per_e, 0.5);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod file;

pub use file::{INSTRUMENT_KIND, INSTRUMENT_VERSION, InstrumentError};

use crate::bead::BeadBackground;
use crate::psf::pupils::{PupilModel, Pupils};
use crate::psf::{CalibratedOptics, ChiefRays, LowRankPsf};
use ndarray::{Array1, Array2, Axis};
use ommatidia_physics::effects::{EffectSetting, find};
use ommatidia_physics::noise::{MapErrors, NoiseModel, Source, inverse_response};
use ommatidia_session::Manifest;
use serde::{Deserialize, Serialize};

/// The calibrated model of one instrument. Lenses are numbered row by row, `l = i * array.cols + j`.
///
/// On disk it is an artifact of kind `instrument`: a safetensors file whose metadata hold the provenance and
/// the small numbers as JSON and whose tensors are the arrays, so that Python reads it as it is.
#[derive(Clone, Debug)]
pub struct Instrument {
    /// Manifest of the calibrated session, without its stacks; `psf_window_px` is the side of the basis PSFs.
    pub manifest: Manifest,
    /// Noise of the sensor.
    pub noise: NoiseModel,
    /// Offset of each pixel from the black level, DN, [sensor rows, sensor cols]; None where no darks were measured.
    pub offset_dn: Option<Array2<f32>>,
    /// Response of each pixel to light relative to the mean, without lamp shading, [sensor rows, sensor cols]; None
    /// where the flats do not determine it.
    pub response: Option<Array2<f32>>,
    /// Variance of the reading of each pixel, rounding included, DN^2, [sensor rows, sensor cols]; None where the darks
    /// show no difference between pixels, so that `noise` holds for all of them.
    pub reading_dn2: Option<Array2<f32>>,
    /// Chief rays.
    pub geometry: ChiefRays,
    /// Low-rank spatially varying PSFs.
    pub psf: LowRankPsf,
    /// Jackknife replicates of the PSF model: J refits, each of which leaves out one group of beads. Empty where the
    /// uncertainty is not known.
    ///
    /// Let s_j be any figure predicted with replicate j in place of `psf` (see [`Instrument::replicate`]). The variance
    /// of s due to the calibration is `(J-1)/J * sum_j (s_j - mean s)^2`. Each replicate has a basis of its own; the
    /// basis of one and the coefficients of another cannot be combined. Chief rays, noise and light unit are the same
    /// in all, so that the error of the light unit (one scale common to all predictions) is not part of this variance.
    pub replicates: Vec<LowRankPsf>,
    /// Effects beside the optics: the bend of the sensor's response, where the flats of the calibration show one, and
    /// those that `close` added, in the order in which they were accepted.
    pub effects: Vec<EffectSetting>,
    /// The unit of light in objects.
    pub light_unit: LightUnit,
    /// Errors of the model on the bead scan.
    pub quality: Quality,
    /// Curves and maps of the calibration, for reports.
    pub diagnostics: Diagnostics,
    /// The pupils that explain `psf`, fitted when an effect first needs them; a part of the file once they are.
    pub pupils: Pupils,
}

impl Instrument {
    /// Factor that corrects each pixel to the mean response, [sensor rows, sensor cols]; None where the response is not
    /// known.
    pub fn inverse_response(&self) -> Option<Array2<f32>> {
        self.response.as_ref().map(inverse_response)
    }
}

impl Instrument {
    /// The pupils that explain the PSFs of a scan in one plane, for what the scan does not show: another depth, another
    /// wavefront. None: the scan has several depths, or no pupil explains the PSFs.
    pub fn pupil_model(&self) -> Option<&PupilModel> {
        self.pupils.of(&self.psf, &self.geometry, self.manifest.sensor.pixel_pitch_um)
    }

    /// Fits the pupils where none are fitted yet: those of a scan in one plane, or those that tell of the depths
    /// between the planes of a scan.
    pub fn fit_pupils(&self) {
        let pitch_um = self.manifest.sensor.pixel_pitch_um;
        self.pupils.of(&self.psf, &self.geometry, pitch_um);
        self.pupils.between_depths(&self.psf, &self.geometry, pitch_um);
    }

    /// The instrument with its PSF model replaced by replicate `j`; None where there is no such replicate.
    pub fn replicate(&self, j: usize) -> Option<Self> {
        if !self.effects.is_empty() {
            // Replicates share the pupils, which must be those of the PSFs themselves.
            self.fit_pupils();
        }
        let psf = self.replicates.get(j)?.clone();
        Some(Self { psf, replicates: Vec::new(), ..self.clone() })
    }

    /// Its effects that bend the response of the sensor: flats show them, and they are part of a calibration.
    pub fn bends(&self) -> impl Iterator<Item = &EffectSetting> {
        self.effects.iter().filter(|e| find(&e.id).is_some_and(|effect| effect.bends_noise()))
    }

    /// The calibrated optics, from which [`crate::psf::LowRankOperator`] is planned.
    pub fn optics(&self) -> CalibratedOptics<'_> {
        let m = &self.manifest;
        CalibratedOptics {
            psf: &self.psf,
            rays: &self.geometry,
            object: [m.object.rows, m.object.cols],
            sensor: [m.sensor.rows, m.sensor.cols],
        }
    }

    /// Smallest rank at which one joint decomposition of all lenses has at most the error of this model on the scan;
    /// None where it is not known or lies beyond the ranks that were tried.
    pub fn whole_array_rank(&self) -> Option<usize> {
        let errors = &self.diagnostics.whole_array_error;
        Some(1 + errors.iter().position(|e| f64::from(*e) <= self.quality.approximation_error)?)
    }

    /// Number of basis PSFs a lens.
    pub fn rank(&self) -> usize {
        self.psf.basis.len_of(Axis(1))
    }

    /// Whether only the sensor was calibrated: there was no bead scan, and the optics are the identity.
    pub fn sensor_only(&self) -> bool {
        self.diagnostics.positions_px.is_empty() && self.psf.basis.len_of(Axis(1)) == 1
    }
}

impl Instrument {
    /// Replaces the gain by one that was measured later, DN per electron, with its standard error. PSFs are in DN and
    /// stay as they are, and so do the frames that they predict; what the model holds in electrons (read noise,
    /// backgrounds) is converted.
    pub fn set_gain(&mut self, gain_dn_per_e: f64, sigma: f64) {
        let electrons = self.noise.gain_dn_per_e / gain_dn_per_e;
        self.noise.read_noise_e *= electrons;
        self.noise.read_noise_sigma *= electrons;
        self.noise.gain_dn_per_e = gain_dn_per_e;
        self.noise.gain_sigma = sigma;
        self.noise.sources.gain = Source::Measured;
        self.quality.background = self.quality.background.map(|b| b.scaled(electrons));
        self.diagnostics.background_e.mapv_inplace(|v| (f64::from(v) * electrons) as f32);
    }
}

/// The unit of light in objects.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum LightUnit {
    /// The bead of the calibration scan, in one object pixel.
    #[default]
    Bead,
    /// The light that gives 1 DN above black at the exposure of the model (no bead scan was measured).
    Dn,
    /// The unit of the session's scene truths.
    Truth {
        /// Truth units in the light of one bead (of 1 DN, without a bead scan).
        per_bead: f64,
    },
}

/// How well the model reproduces the bead scan. NRMSE is `|measured - predicted| / |measured|` (Euclidean norms over
/// all windows, black level taken off).
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Quality {
    /// NRMSE of the rank-K model on the bead frames that it was fitted to.
    pub approximation_error: f64,
    /// NRMSE on bead positions that were left out (checkerboard).
    pub off_grid_error: f64,
    /// NRMSE on the left-out positions of a model with one PSF for each lens, the mean over the other positions.
    pub one_psf_error: f64,
    /// NRMSE that the noise of the bead frames alone causes.
    pub noise_floor: f64,
    /// Root-mean-square distance of the foci from their chief rays (Eq. 1), over both axes, px: distortion and noise.
    pub chief_ray_rms_px: f64,
    /// Estimated errors of the sensor maps.
    pub maps: MapErrors,
    /// Background that was removed from the bead frames; None where it could not be measured.
    pub background: Option<BeadBackground>,
    /// Standard uncertainty of the light of a focus outside its window, as a share of the light inside. 0 where it
    /// could not be measured.
    pub outside_window: f64,
    /// NRMSE, without what noise makes of it, of bead frames that are predicted by the replicates that have not seen
    /// them, each at its own brightness. Unlike the errors of windows it holds what is lost where a sharp focus is
    /// moved by a fraction of a pixel. 0 without replicates.
    pub frame_error: f64,
}

impl Quality {
    /// An error of the PSFs, relative, below which none is worth a note.
    const WORTH: f64 = 0.02;

    /// NRMSE on bead positions that were left out, without what noise makes of it: how badly the PSFs between the
    /// positions of the scan are known.
    pub fn off_grid_excess(&self) -> f64 {
        (self.off_grid_error.powi(2) - self.noise_floor.powi(2)).max(0.0).sqrt()
    }

    /// How badly the frame of a single bead is predicted, without noise: the larger one of [`Self::off_grid_excess`]
    /// and [`Self::frame_error`].
    pub fn bead_error(&self) -> f64 {
        self.off_grid_excess().max(self.frame_error)
    }

    /// Whether [`Self::off_grid_excess`] exceeds the noise of the bead frames, and 2 %.
    pub fn is_coarse(&self) -> bool {
        self.off_grid_excess() > self.noise_floor.max(Self::WORTH)
    }
}

/// Curves and maps of the calibration, for reports and `inspect`; no figure depends on them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Diagnostics {
    /// Bead positions, object pixels, [bead, (row, col)].
    pub positions_px: Array2<f32>,
    /// Pearson correlation of each bead's foci with those of the bead nearest to the axis (Fig. 2a of the paper),
    /// one value for each bead.
    pub pcc: Array1<f32>,
    /// NRMSE of the rank-K model relative to each bead's own light, one value for each bead.
    pub bead_nrmse: Array1<f32>,
    /// Singular values of each lens's windows, largest first, [lens, bead].
    pub singular_values: Array2<f32>,
    /// Error by rank, [rank tried, (rank, approximation error, off-grid error)].
    pub error_by_rank: Array2<f32>,
    /// NRMSE on the scan of one joint decomposition of all lenses, for rank 1, 2, ...; empty where it is not known.
    pub whole_array_error: Array1<f32>,
    /// Background that was removed from each bead frame, e-, [bead, (level, change from the first to the last row, from
    /// the first to the last column)]; empty where it could not be measured.
    pub background_e: Array2<f32>,
    /// Photon transfer, [level, (mean above black in DN, temporal variance in DN^2, fitted variance in DN^2)].
    pub photon_transfer: Array2<f32>,
}
