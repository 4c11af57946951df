//! The calibrated instrument: calibration, files, predictions, PSFs.

use crate::arrays::{Images, each, given};
use crate::error::raised;
use crate::operator::PyLight;
use crate::session::SessionPlace;
use crate::{json, work};
use anyhow::Context;
use ndarray::Array2;
use numpy::IntoPyArray;
use ommatidia_model::calibrate::{CalibrateConfig, Calibration, calibrate, frames_read, provenance};
use ommatidia_model::forward::{Depth, PredictRequest, Predicted, Predictor};
use ommatidia_model::instrument::Instrument;
use ommatidia_physics::noise::NoiseConfig;
use ommatidia_session::artifact::{self, Provenance};
use ommatidia_session::files::{Content, Files};
use pyo3::exceptions::{PyUserWarning, PyValueError};
use pyo3::prelude::*;
use std::cell::Cell;
use std::ffi::CString;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

/// Number of depths whose plans are kept.
const PLANS: usize = 4;

/// The calibrated model of an instrument.
#[pyclass(frozen, module = "ommatidia", name = "Instrument")]
pub struct PyInstrument {
    calibration: Arc<Calibration>,
    provenance: Provenance,
    /// The file that it was read from or written to last.
    file: Mutex<Option<PathBuf>>,
    /// Planned predictions, one a depth, the latest last.
    plans: Mutex<Vec<(Depth, Predictor)>>,
}

impl PyInstrument {
    /// The instrument at `path`.
    ///
    /// # Errors
    /// The file cannot be read or is not an instrument.
    pub fn read(path: &Path) -> anyhow::Result<Self> {
        let instrument = Instrument::read(path)?;
        let header = artifact::inspect(path)?;
        let provenance = serde_json::from_value(header["provenance"].clone())
            .with_context(|| format!("{}: provenance", path.display()))?;
        Ok(Self::new(
            Calibration { instrument, notes: Vec::new(), beads_normalised: false, bend: None, bead_scatter: None },
            provenance,
            Some(path.into()),
        ))
    }

    fn new(calibration: Calibration, provenance: Provenance, file: Option<PathBuf>) -> Self {
        Self { calibration: Arc::new(calibration), provenance, file: Mutex::new(file), plans: Mutex::new(Vec::new()) }
    }

    /// The instrument.
    pub fn instrument(&self) -> &Instrument {
        &self.calibration.instrument
    }

    /// A file of the instrument: its own, or one in the folder `scratch` where it has none.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn filed(&self, scratch: &Path) -> anyhow::Result<PathBuf> {
        let own = self.file.lock().unwrap_or_else(PoisonError::into_inner).clone();
        match own.filter(|path| path.exists()) {
            Some(path) => Ok(path),
            None => {
                let path = scratch.join("instrument.safetensors");
                self.instrument().write(&path, self.provenance.clone())?;
                Ok(path)
            }
        }
    }

    /// A prediction as `request` says; the plan for its depth is made once.
    fn predictor(&self, request: PredictRequest) -> anyhow::Result<Predictor> {
        let plans = || self.plans.lock().unwrap_or_else(PoisonError::into_inner);
        let found = plans().iter().find(|(depth, _)| *depth == request.depth).map(|(_, planned)| planned.clone());
        let planned = match found {
            Some(planned) => planned,
            None => {
                // Not under the lock: a thread that waits for a part of its plan may begin other work that needs it.
                let focus = PredictRequest { depth: request.depth, ..PredictRequest::default() };
                let planned = Predictor::new(self.instrument().clone(), focus)?;
                let mut plans = plans();
                if plans.len() == PLANS {
                    plans.remove(0);
                }
                plans.push((request.depth, planned.clone()));
                planned
            }
        };
        Ok(planned.with(request)?)
    }
}

/// The depth that two arguments of Python name.
fn depth(index: Option<usize>, z_um: Option<f64>) -> PyResult<Depth> {
    match (index, z_um) {
        (Some(_), Some(_)) => Err(PyValueError::new_err("depth and z_um: expected one of them, found both")),
        (Some(index), _) => Ok(Depth::Index(index)),
        (_, Some(z_um)) => Ok(Depth::Um(z_um)),
        _ => Ok(Depth::Focus),
    }
}

/// Warns in Python.
pub fn warn(py: Python<'_>, text: &str) -> PyResult<()> {
    let category = py.get_type::<PyUserWarning>();
    PyErr::warn(py, &category, &CString::new(text.replace('\0', ""))?, 2)
}

#[pymethods]
impl PyInstrument {
    /// Calibrates the instrument of a session.
    #[staticmethod]
    #[pyo3(signature = (session, *, rank = None, max_rank = None, window_px = None, one_psf = false,
                        replicates = None, normalise_beads = None, accept = false, gain_dn_per_e = None,
                        read_noise_e = None, seed = 1, progress = None))]
    #[expect(clippy::too_many_arguments, reason = "keyword arguments of Python")]
    fn calibrate(
        py: Python<'_>,
        session: SessionPlace<'_>,
        rank: Option<usize>,
        max_rank: Option<usize>,
        window_px: Option<usize>,
        one_psf: bool,
        replicates: Option<usize>,
        normalise_beads: Option<bool>,
        accept: bool,
        gain_dn_per_e: Option<f64>,
        read_noise_e: Option<f64>,
        seed: u64,
        progress: Option<Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let session = session.open(seed)?;
        let usual = CalibrateConfig::default();
        let config = CalibrateConfig {
            rank,
            max_rank: max_rank.unwrap_or(usual.max_rank),
            window_px,
            one_psf,
            replicates: replicates.unwrap_or(usual.replicates),
            normalise_beads,
            accept,
            noise: NoiseConfig { nominal_gain_dn_per_e: gain_dn_per_e, nominal_read_noise_e: read_noise_e },
        };
        let (calibration, provenance) = work::long(py, progress, move |steps| {
            let (total, done) = (frames_read(&session), Cell::new(0));
            let calibration = calibrate(&session, &config, || {
                done.set(done.get() + 1);
                steps.at("calibrate", done.get(), Some(total.max(done.get())));
            })?;
            // As the program does: its file holds them then.
            calibration.instrument.fit_pupils();
            Ok((calibration, provenance(&session, &config, seed)?))
        })?;
        Ok(Self::new(calibration, provenance, None))
    }

    /// Reads an instrument file.
    #[staticmethod]
    fn load(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        work::short(py, || Self::read(&path))
    }

    /// Writes the instrument to a file, which appears whole or not at all. One that exists is kept unless `force`.
    #[pyo3(signature = (path, *, force = false))]
    fn save(&self, py: Python<'_>, path: PathBuf, force: bool) -> PyResult<()> {
        let own = self.file.lock().unwrap_or_else(PoisonError::into_inner).clone();
        work::short(py, || {
            let _locks = Files::reading(own).writing([&path], Content::artifact("instrument")).hold(force)?;
            Ok(self.instrument().write(&path, self.provenance.clone())?)
        })?;
        *self.file.lock().unwrap_or_else(PoisonError::into_inner) = Some(path);
        Ok(())
    }

    /// The file that it was read from or written to last; None if it has none.
    #[getter]
    fn path(&self) -> Option<PathBuf> {
        self.file.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// What the calibration found, as `calibrate --json` prints it, without times.
    #[getter]
    fn figures<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        json::object(py, &self.calibration.figures())
    }

    /// Notes of the calibration for its user; empty for an instrument that was read from a file.
    #[getter]
    fn notes(&self) -> Vec<String> {
        self.calibration.notes.clone()
    }

    /// Where the instrument came from: program, verb, seed, hashes of inputs, configuration.
    #[getter]
    fn provenance<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        json::of(py, &self.provenance)
    }

    /// Manifest of the calibrated session: sensor, array, optics, object.
    #[getter]
    fn manifest<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        json::of(py, &self.instrument().manifest)
    }

    /// Effects that `close` has added.
    #[getter]
    fn effects<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        json::of(py, &self.instrument().effects)
    }

    /// Calibrated depths, um.
    #[getter]
    fn depths_um(&self) -> Vec<f64> {
        self.instrument().psf.node_depths_um.clone()
    }

    /// Rows and columns of an object.
    #[getter]
    fn object_shape(&self) -> (usize, usize) {
        (self.instrument().manifest.object.rows, self.instrument().manifest.object.cols)
    }

    /// Rows and columns of a frame.
    #[getter]
    fn sensor_shape(&self) -> (usize, usize) {
        (self.instrument().manifest.sensor.rows, self.instrument().manifest.sensor.cols)
    }

    /// Frames, DN, that the instrument is expected to show for objects.
    #[pyo3(signature = (objects, *, noise = false, exposure_ms = None, illumination = 1.0,
                        background_e = [0.0; 3], depth = None, z_um = None, seed = 1, progress = None))]
    #[expect(clippy::too_many_arguments, reason = "keyword arguments of Python")]
    fn predict<'py>(
        &self,
        py: Python<'py>,
        objects: Images<'py>,
        noise: bool,
        exposure_ms: Option<f64>,
        illumination: f64,
        background_e: [f64; 3],
        depth: Option<usize>,
        z_um: Option<f64>,
        seed: u64,
        progress: Option<Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let request = PredictRequest {
            output: if noise { Predicted::Noisy } else { Predicted::Expected },
            depth: self::depth(depth, z_um)?,
            exposure_ms,
            illumination,
            background_e,
            seed,
        };
        let predictor = work::short(py, || self.predictor(request))?;
        let mut clipped = 0;
        let frames = each(py, "object", &objects, progress, |i, object| {
            let frame = predictor.apply(i, object)?;
            clipped += usize::from(predictor.clipped_px(frame.view()) > 0);
            Ok(frame)
        })?;
        if clipped > 0 {
            warn(py, &format!("{clipped} frames clip at full scale: lower the illumination, or the objects"))?;
        }
        Ok(frames)
    }

    /// The exact transpose of the optics: frames, DN above black, back to the object grid.
    #[pyo3(signature = (frames, *, depth = None, z_um = None, progress = None))]
    fn adjoint<'py>(
        &self,
        py: Python<'py>,
        frames: Images<'py>,
        depth: Option<usize>,
        z_um: Option<f64>,
        progress: Option<Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let depth = self::depth(depth, z_um)?;
        let request = PredictRequest { output: Predicted::Adjoint, depth, ..PredictRequest::default() };
        let predictor = work::short(py, || self.predictor(request))?;
        each(py, "frame", &frames, progress, |i, frame| Ok(predictor.apply(i, frame)?))
    }

    /// The PSF at a place: windows, float32 [lens, row, col], electrons of a point source of unit light at the exposure
    /// of the calibration, and their chief rays, float64 [lens, (row, col)], px.
    #[pyo3(signature = (y_um, x_um, *, depth = None, z_um = None, window_px = None))]
    fn psf<'py>(
        &self,
        py: Python<'py>,
        y_um: f64,
        x_um: f64,
        depth: Option<usize>,
        z_um: Option<f64>,
        window_px: Option<usize>,
    ) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyAny>)> {
        let depth = self::depth(depth, z_um)?;
        let window_px = window_px.unwrap_or(self.instrument().manifest.optics.psf_window_px);
        let foci = work::short(py, || {
            let predictor = self.predictor(PredictRequest { depth, ..PredictRequest::default() })?;
            Ok(predictor.forward().foci([y_um, x_um], window_px)?)
        })?;
        let rays = Array2::from_shape_fn((foci.chief_rays_px.len(), 2), |(l, a)| foci.chief_rays_px[l][a]);
        Ok((given(py, foci.windows_e), rays.into_pyarray(py).into_any()))
    }

    /// The optics alone as a linear map and its transpose, planned once.
    #[pyo3(signature = (*, depth = None, z_um = None))]
    fn _light(&self, py: Python<'_>, depth: Option<usize>, z_um: Option<f64>) -> PyResult<PyLight> {
        let depth = self::depth(depth, z_um)?;
        let request = PredictRequest { output: Predicted::Adjoint, depth, ..PredictRequest::default() };
        Ok(PyLight { predictor: work::short(py, || self.predictor(request))? })
    }

    fn __repr__(&self) -> String {
        let m = &self.instrument().manifest;
        format!(
            "Instrument({:?}: {}, frames {} x {}, objects {} x {}, rank {}, {} effects)",
            m.name,
            m.array.words(),
            m.sensor.rows,
            m.sensor.cols,
            m.object.rows,
            m.object.cols,
            self.instrument().rank(),
            self.instrument().effects.len()
        )
    }

    /// Instruments travel to other processes as files: one that has none must be saved first.
    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> PyResult<(Bound<'py, PyAny>, (PathBuf,))> {
        let path = slf.get().path();
        let path = path.ok_or_else(|| raised(anyhow::anyhow!("an instrument without a file: save it first")))?;
        Ok((slf.get_type().getattr("load")?, (path,)))
    }
}
