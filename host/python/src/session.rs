//! Measured sessions and their stacks.

use crate::arrays::given;
use crate::error::raised;
use crate::{json, work};
use ndarray::{Array1, Array3, Axis};
use numpy::IntoPyArray;
use ommatidia_bench::{BenchConfig, open_session, virtual_session};
use ommatidia_physics::effects::EffectSetting;
use ommatidia_session::files::{Content, Files};
use ommatidia_session::{FrameInfo, FrameReader, Session, Stack};
use pyo3::exceptions::{PyIndexError, PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};

/// A measured session: one folder of frames with a manifest.
#[pyclass(frozen, module = "ommatidia", name = "Session")]
pub struct PySession {
    pub session: Session,
    /// Where it was opened: the folder, or the configuration of a virtual instrument.
    path: PathBuf,
    seed: u64,
}

/// A session, or the place where there is one.
#[derive(FromPyObject)]
pub enum SessionPlace<'py> {
    /// One that is open.
    Open(Bound<'py, PySession>),
    /// Its folder.
    Path(PathBuf),
}

impl SessionPlace<'_> {
    /// Where the session is.
    pub fn path(&self) -> PathBuf {
        match self {
            Self::Open(session) => session.get().path.clone(),
            Self::Path(path) => path.clone(),
        }
    }

    /// The open session.
    ///
    /// # Errors
    /// It cannot be opened.
    pub fn open(&self, seed: u64) -> PyResult<Session> {
        match self {
            Self::Open(session) => Ok(session.get().session.clone()),
            Self::Path(path) => open_session(path, seed).map_err(raised),
        }
    }
}

#[pymethods]
impl PySession {
    /// Opens and checks the session in a folder.
    #[staticmethod]
    #[pyo3(signature = (path, *, seed = 1))]
    fn open(py: Python<'_>, path: PathBuf, seed: u64) -> PyResult<Self> {
        let session = work::short(py, || Ok(open_session(&path, seed)?))?;
        Ok(Self { session, path, seed })
    }

    /// Measures a session with the virtual instrument into a folder, and opens it.
    #[staticmethod]
    #[pyo3(signature = (path, *, config = None, effects = Vec::new(), frames = None, seed = 1, force = false,
                        progress = None))]
    #[expect(clippy::too_many_arguments, reason = "keyword arguments of Python")]
    fn bench(
        py: Python<'_>,
        path: PathBuf,
        config: Option<PathBuf>,
        effects: Vec<String>,
        frames: Option<usize>,
        seed: u64,
        force: bool,
        progress: Option<Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let settings = effects.iter().map(|e| e.parse::<EffectSetting>().map_err(|why| (e, why)));
        let settings: Result<Vec<_>, _> = settings.collect();
        let settings = settings.map_err(|(e, why)| raised(anyhow::anyhow!("effect {e}: {why}")))?;
        let to = path.clone();
        work::long(py, progress, move |steps| {
            let files = Files::reading(&config).writing([&to], Content::Named(virtual_session));
            let _locks = files.hold(force)?;
            let mut bench = config.as_deref().map_or_else(|| Ok(BenchConfig::default()), BenchConfig::read)?;
            bench.stacks.scene_frames = frames.unwrap_or(bench.stacks.scene_frames);
            let instrument = bench.build(&settings)?;
            let total = instrument.frames() as u64;
            let done = AtomicU64::new(0);
            instrument.measure(&to, seed, |n| {
                let before = done.fetch_add(n as u64, Ordering::Relaxed);
                steps.at("bench", before + n as u64, Some(total));
            })?;
            Ok(())
        })?;
        Self::open(py, path, seed)
    }

    /// The folder.
    #[getter]
    fn path(&self) -> PathBuf {
        self.path.clone()
    }

    /// Name that the user gave the session.
    #[getter]
    fn name(&self) -> &str {
        &self.session.manifest().name
    }

    /// The manifest, as in `session.toml`.
    #[getter]
    fn manifest<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        json::of(py, self.session.manifest())
    }

    /// All stacks, in the order of the manifest.
    #[getter]
    fn stacks(&self) -> Vec<PyStack> {
        self.session.stacks().iter().cloned().map(|stack| PyStack { stack, reader: Mutex::default() }).collect()
    }

    /// The stacks of one role: `dark`, `flat`, `bead` or `scene`.
    fn stacks_of(&self, role: &str) -> PyResult<Vec<PyStack>> {
        if !["dark", "flat", "bead", "scene"].contains(&role) {
            return Err(PyValueError::new_err(format!("role: expected dark, flat, bead or scene, found {role}")));
        }
        Ok(self.stacks().into_iter().filter(|s| s.stack.role().name() == role).collect())
    }

    fn __repr__(&self) -> String {
        let stacks: Vec<String> =
            self.session.stacks().iter().map(|s| format!("{} {}", s.len(), s.role().name())).collect();
        format!("Session({:?}: {})", self.path.display().to_string(), stacks.join(", "))
    }

    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> PyResult<(Bound<'py, PyAny>, (PathBuf, u64))> {
        let open = slf.get_type().getattr("_reopen")?;
        Ok((open, (slf.get().path.clone(), slf.get().seed)))
    }

    #[staticmethod]
    fn _reopen(py: Python<'_>, path: PathBuf, seed: u64) -> PyResult<Self> {
        Self::open(py, path, seed)
    }
}

/// A column of a table: its name, and its value for a frame.
type Column = (&'static str, fn(&FrameInfo) -> f64);

/// One stack of a session: frames with the same role.
#[pyclass(frozen, module = "ommatidia", name = "Stack")]
pub struct PyStack {
    stack: Stack,
    /// Kept open from one frame to the next: to open a folder of compressed files takes longer than to read a frame.
    reader: Mutex<Option<FrameReader>>,
}

impl PyStack {
    /// Works with the open frames.
    fn with_frames<T: Send>(
        &self,
        py: Python<'_>,
        work: impl FnOnce(&mut FrameReader) -> anyhow::Result<T> + Send,
    ) -> PyResult<T> {
        work::short(py, || {
            // A reader that an error or a panic left is opened again.
            let mut kept = self.reader.lock().unwrap_or_else(PoisonError::into_inner);
            let mut reader = match kept.take() {
                Some(reader) => reader,
                None => self.stack.frames()?,
            };
            let result = work(&mut reader)?;
            *kept = Some(reader);
            Ok(result)
        })
    }
}

#[pymethods]
impl PyStack {
    /// What its frames show: `dark`, `flat`, `bead` or `scene`.
    #[getter]
    fn role(&self) -> &'static str {
        self.stack.role().name()
    }

    /// The file of its frames.
    #[getter]
    fn path(&self) -> PathBuf {
        self.stack.path()
    }

    /// Metadata of the frames: a column of the table by its name, one float64 a frame.
    #[getter]
    fn table<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let columns: [Column; 7] = [
            ("x_um", |f| f.x_um),
            ("y_um", |f| f.y_um),
            ("z_um", |f| f.z_um),
            ("exposure_ms", |f| f.exposure_ms),
            ("illumination", |f| f.illumination),
            ("time_s", |f| f.time_s),
            ("temperature_c", |f| f.temperature_c.unwrap_or(f64::NAN)),
        ];
        let table = PyDict::new(py);
        for (name, value) in columns {
            table.set_item(name, self.stack.info().iter().map(value).collect::<Array1<f64>>().into_pyarray(py))?;
        }
        Ok(table)
    }

    /// Frames, DN, float32 [n, sensor rows, sensor cols]: all, or those from `start` to before `stop`.
    #[pyo3(signature = (start = 0, stop = None))]
    fn frames<'py>(&self, py: Python<'py>, start: usize, stop: Option<usize>) -> PyResult<Bound<'py, PyAny>> {
        let stop = stop.unwrap_or(self.stack.len()).min(self.stack.len());
        if start >= stop {
            return Err(PyIndexError::new_err(format!("frames {start}..{stop}: the stack has {}", self.stack.len())));
        }
        let frames = self.with_frames(py, |reader| {
            let mut all = Array3::zeros((stop - start, reader.rows(), reader.cols()));
            for (i, mut to) in (start..stop).zip(all.axis_iter_mut(Axis(0))) {
                to.assign(&reader.read(i)?);
            }
            Ok(all)
        })?;
        Ok(given(py, frames))
    }

    /// The known object of a frame, float32 [object rows, object cols]; None if the stack has no truths.
    fn truth<'py>(&self, py: Python<'py>, frame: usize) -> PyResult<Option<Bound<'py, PyAny>>> {
        let read = || Ok(self.stack.truth()?.map(|mut truth| truth.read(frame)).transpose()?);
        Ok(work::short(py, read)?.map(|object| given(py, object)))
    }

    fn __len__(&self) -> usize {
        self.stack.len()
    }

    /// Frame `i`, DN, float32 [sensor rows, sensor cols]; negative numbers count from the end.
    fn __getitem__<'py>(&self, py: Python<'py>, i: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
        let given_i: isize = i.extract().map_err(|_| PyTypeError::new_err("frame: expected a whole number"))?;
        let len = self.stack.len();
        let i = if given_i < 0 { given_i + len as isize } else { given_i };
        let i = usize::try_from(i).ok().filter(|i| *i < len);
        let i = i.ok_or_else(|| PyIndexError::new_err(format!("frame {given_i}: the stack has {len}")))?;
        Ok(given(py, self.with_frames(py, |reader| Ok(reader.read(i)?))?))
    }

    fn __repr__(&self) -> String {
        format!("Stack({}, {} frames, {:?})", self.role(), self.stack.len(), self.stack.entry().file)
    }
}
