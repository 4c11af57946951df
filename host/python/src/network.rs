//! Reconstruction with networks and the methods beside them, and quantization.

use crate::arrays::{Images, each};
use crate::error::raised;
use crate::instrument::warn;
use crate::{json, work};
use clap::ValueEnum;
use ommatidia_network::methods::{MethodKind, Reconstruct, frame_range};
use ommatidia_network::quantize::{Numbers, QuantizeConfig, quantize as quantized};
use ommatidia_network::train::Checkpoint;
use ommatidia_physics::sensor::{FrameRange, FrameWatch};
use ommatidia_session::artifact::{file_hash, write_whole};
use ommatidia_session::files::{Content, Files};
use ommatidia_session::kind::FileKind;
use pyo3::prelude::*;
use std::path::{Path, PathBuf};

/// A trained network, or another method of reconstruction, from a file.
#[pyclass(frozen, module = "ommatidia", name = "Network")]
pub struct PyNetwork {
    method: Box<dyn Reconstruct>,
    range: Option<FrameRange>,
    made_from: Made,
}

/// What a network was made from: file, method, seed.
type Made = (PathBuf, Option<String>, u64);

/// The method of a name of the command line.
fn kind(name: &str) -> PyResult<MethodKind> {
    MethodKind::from_str(name, false).map_err(|_| {
        let names: Vec<&str> = MethodKind::value_variants().iter().map(|kind| kind.name()).collect();
        raised(anyhow::anyhow!("method: expected one of {}, found `{name}`", names.join(", ")))
    })
}

#[pymethods]
impl PyNetwork {
    /// Opens what `reconstruct --with` takes: a checkpoint, a network file, or an instrument.
    #[staticmethod]
    #[pyo3(signature = (path, method = None, seed = 1))]
    fn load(py: Python<'_>, path: PathBuf, method: Option<String>, seed: u64) -> PyResult<Self> {
        let named = method.as_deref().map(kind).transpose()?;
        let made_from = (path.clone(), method, seed);
        let (method, range) = work::long(py, None, move |_| {
            let kind = named.map_or_else(|| MethodKind::default_for(&path), Ok)?;
            Ok((kind.open(&path, seed)?, frame_range(&path)?))
        })?;
        Ok(Self { method, range, made_from })
    }

    /// Name of the method on the command line; a network file is `svfouriernet-blob`.
    #[getter]
    fn method(&self) -> &str {
        self.method.name()
    }

    /// The file that it was made from.
    #[getter]
    fn path(&self) -> PathBuf {
        self.made_from.0.clone()
    }

    /// Objects from raw frames, DN.
    #[pyo3(signature = (frames, *, progress = None))]
    fn reconstruct<'py>(
        &self,
        py: Python<'py>,
        frames: Images<'py>,
        progress: Option<Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let mut watch = self.range.map(FrameWatch::new);
        let objects = each(py, "frame", &frames, progress, |i, frame| {
            if let Some(watch) = &mut watch {
                watch.see(i, frame);
            }
            self.method.reconstruct(frame)
        })?;
        if let Some(text) = watch.and_then(|watch| watch.warning(Path::new("frames"))) {
            warn(py, &text)?;
        }
        Ok(objects)
    }

    fn __repr__(&self) -> String {
        format!("Network({}, {:?})", self.method(), self.made_from.0.display().to_string())
    }

    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> PyResult<(Bound<'py, PyAny>, Made)> {
        Ok((slf.get_type().getattr("load")?, slf.get().made_from.clone()))
    }
}

/// Converts a checkpoint into the network file of a device; gives what `quantize --json` prints.
#[pyfunction]
#[pyo3(signature = (checkpoint, output, *, name = None, flash_bytes = None, ram_bytes = None, prune = None, tile = None,
                    energy = None, integers = false, force = false))]
#[expect(clippy::too_many_arguments, reason = "keyword arguments of Python")]
pub fn quantize<'py>(
    py: Python<'py>,
    checkpoint: PathBuf,
    output: PathBuf,
    name: Option<String>,
    flash_bytes: Option<u64>,
    ram_bytes: Option<u64>,
    prune: Option<f64>,
    tile: Option<usize>,
    energy: Option<f64>,
    integers: bool,
    force: bool,
) -> PyResult<Bound<'py, PyAny>> {
    let to = output.clone();
    let numbers = if integers { Numbers::Integers } else { Numbers::Halves };
    let (made, locks) = work::long(py, None, move |_| {
        let locks = Files::reading([&checkpoint]).writing([&to], Content::File(FileKind::Blob)).hold(force)?;
        let stem = checkpoint.file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default();
        let name = name.unwrap_or(stem);
        let config = QuantizeConfig { name, flash_bytes, ram_bytes, tile, energy, prune, numbers, watch: None };
        Ok((quantized(&Checkpoint::read(&checkpoint)?, &file_hash(&checkpoint)?, &config)?, locks))
    })?;
    // Here, and not in the work: a run that was stopped writes nothing.
    write_whole(&output, &made.bytes).map_err(raised)?;
    drop(locks);
    let mut report = serde_json::to_value(&made.report).map_err(raised)?;
    report["blob"] = output.display().to_string().into();
    json::object(py, &report)
}
