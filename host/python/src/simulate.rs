//! Training pairs that are simulated when they are needed.

use crate::arrays::given;
use crate::closing::InstrumentPlace;
use crate::error::raised;
use crate::work;
use clap::ValueEnum;
use ommatidia_model::dataset::{SimulateConfig, Simulation};
use ommatidia_model::instrument::Instrument;
use ommatidia_physics::scene::{SceneConfig, Specimen};
use pyo3::exceptions::PyIndexError;
use pyo3::prelude::*;
use std::path::PathBuf;

/// Pairs of frames and objects, each simulated when it is asked for.
#[pyclass(frozen, module = "ommatidia", name = "Simulation")]
pub struct PySimulation {
    simulation: Simulation,
    noise: bool,
}

/// Frame and object of a pair.
type Pair<'py> = (Bound<'py, PyAny>, Bound<'py, PyAny>);

/// Plans training pairs of an instrument: the pairs that `simulate` writes, with the same numbers.
#[pyfunction]
#[pyo3(signature = (instrument, count, *, specimens = Vec::new(), images = None, video_frames = 1, peak_e = None,
                    vary = Vec::new(), noise = false, seed = 1))]
#[expect(clippy::too_many_arguments, reason = "keyword arguments of Python")]
pub fn simulate(
    py: Python<'_>,
    instrument: InstrumentPlace<'_>,
    count: usize,
    specimens: Vec<String>,
    images: Option<PathBuf>,
    video_frames: usize,
    peak_e: Option<[f64; 2]>,
    vary: Vec<String>,
    noise: bool,
    seed: u64,
) -> PyResult<PySimulation> {
    let chosen = specimens.iter().map(|name| {
        let names: Vec<_> = Specimen::value_variants().iter().filter_map(Specimen::to_possible_value).collect();
        let names: Vec<&str> = names.iter().map(|name| name.get_name()).collect();
        Specimen::from_str(name, false)
            .map_err(|_| raised(anyhow::anyhow!("specimen: expected one of {}, found `{name}`", names.join(", "))))
    });
    let chosen = chosen.collect::<PyResult<Vec<_>>>()?;
    let specimens = if chosen.is_empty() && images.is_none() { Specimen::for_training() } else { chosen };
    let scenes = SceneConfig { specimens, images, video_frames, ..SceneConfig::default() };
    let effect = |text: &String| text.parse().map_err(|why| raised(anyhow::anyhow!("vary: {text}: {why}")));
    let vary = vary.iter().map(effect).collect::<PyResult<_>>()?;
    let config = SimulateConfig { count, scenes, peak_e, vary, ..SimulateConfig::default() };
    let scratch = tempfile::tempdir().map_err(raised)?;
    let file = instrument.filed(scratch.path()).map_err(raised)?;
    let simulation = work::short(py, || Ok(config.build(&Instrument::read(&file)?, &file, seed)?))?;
    Ok(PySimulation { simulation, noise })
}

#[pymethods]
impl PySimulation {
    /// Rows and columns of an object.
    #[getter]
    fn object_shape(&self) -> (usize, usize) {
        self.simulation.plan().object.into()
    }

    /// Rows and columns of a frame.
    #[getter]
    fn sensor_shape(&self) -> (usize, usize) {
        self.simulation.plan().frame.into()
    }

    fn __len__(&self) -> usize {
        self.simulation.plan().count
    }

    /// All pairs in order.
    fn __iter__<'py>(slf: &Bound<'py, Self>) -> PyResult<Bound<'py, PyAny>> {
        let builtins = slf.py().import("builtins")?;
        let numbers = builtins.call_method1("range", (slf.get().__len__(),))?;
        builtins.call_method1("map", (slf.getattr("__getitem__")?, numbers))
    }

    /// Pair `i`: the frame, float32 [sensor rows, sensor cols], electrons without noise, or with `noise` whole DN; and
    /// the object, float32 [object rows, object cols], with maximum 1.
    fn __getitem__<'py>(&self, py: Python<'py>, i: isize) -> PyResult<Pair<'py>> {
        let len = self.simulation.plan().count;
        let at = if i < 0 { i + len as isize } else { i };
        let at = usize::try_from(at).ok().filter(|at| *at < len);
        let at = at.ok_or_else(|| PyIndexError::new_err(format!("pair {i}: there are {len}")))?;
        let (object, frame) = work::short(py, || {
            let (object, frame_e) = self.simulation.pair(at)?;
            let frame = if self.noise { self.simulation.drawn_dn(at, frame_e) } else { frame_e };
            Ok((object, frame))
        })?;
        Ok((given(py, frame), given(py, object)))
    }
}
