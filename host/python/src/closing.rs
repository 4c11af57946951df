//! Closing the loop: the residual of a session, and the effects that an instrument lacks.

use crate::arrays::given;
use crate::error::raised;
use crate::instrument::PyInstrument;
use crate::session::SessionPlace;
use crate::{json, work};
use anyhow::Context;
use ommatidia_closing::{CloseRequest, Progress, ResidualRequest, account_path, close_session, residual_session};
use ommatidia_model::calibrate::CalibrateConfig;
use ommatidia_network::methods::frame_range;
use ommatidia_physics::sensor::odd_scenes;
use ommatidia_session::Session;
use ommatidia_session::artifact::temporary_folder_beside;
use ommatidia_session::files::{Content, Files};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// An instrument, or its file.
#[derive(FromPyObject)]
pub enum InstrumentPlace<'py> {
    /// One that is in memory.
    Open(Bound<'py, PyInstrument>),
    /// Its file.
    Path(PathBuf),
}

impl InstrumentPlace<'_> {
    /// A file of the instrument, which may be one in the folder `scratch`.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn filed(&self, scratch: &Path) -> anyhow::Result<PathBuf> {
        match self {
            Self::Open(instrument) => instrument.get().filed(scratch),
            Self::Path(path) => Ok(path.clone()),
        }
    }
}

/// Compares an instrument with a session: what `residual --json` prints, and the maps where `maps` asks for them.
#[pyfunction]
#[pyo3(signature = (session, instrument, *, maps = false, seed = 1))]
pub fn residual<'py>(
    py: Python<'py>,
    session: SessionPlace<'py>,
    instrument: InstrumentPlace<'py>,
    maps: bool,
    seed: u64,
) -> PyResult<Bound<'py, PyAny>> {
    let scratch = tempfile::tempdir().map_err(raised)?;
    let (session, file) = (session.path(), instrument.filed(scratch.path()).map_err(raised)?);
    let (account, warnings) = work::long(py, None, move |_| {
        let _scratch = scratch;
        let warnings = warnings_of(&session, &file)?;
        let request = ResidualRequest { session: &session, instrument: &file, seed };
        Ok((residual_session(&request)?.account, warnings))
    })?;
    let mut figures = account.closing.residual_figures();
    figures["warnings"] = warnings.into();
    let result = json::object(py, &figures)?;
    if maps {
        let arrays = PyDict::new(py);
        arrays.set_item("frames", &account.frames)?;
        arrays.set_item("measured_dn", given(py, account.measured_dn))?;
        arrays.set_item("residual_sigma", given(py, account.before))?;
        if let Some(specimens) = account.specimens {
            arrays.set_item("specimen_frames", &specimens.frames)?;
            arrays.set_item("specimen", given(py, specimens.before))?;
        }
        result.set_item("maps", arrays)?;
    }
    Ok(result)
}

/// Warnings about the frames of a session before it is compared with an instrument.
fn warnings_of(session: &Path, instrument: &Path) -> anyhow::Result<Vec<String>> {
    let range = frame_range(instrument)?;
    let odd = range.map(|range| odd_scenes(&Session::open(session)?, range)).transpose()?;
    Ok(odd.unwrap_or_default().into_iter().chain(left_out(session)?).collect())
}

/// Frames that are left out since the session marks them as damaged, as the program words it.
fn left_out(session: &Path) -> anyhow::Result<Vec<String>> {
    let session = Session::open(session)?;
    Ok(session.stacks().iter().filter_map(|stack| stack.damaged_note("they are left out")).collect())
}

/// Finds what an instrument lacks, writes the closed instrument and the account beside it, and gives what
/// `close --json` prints.
#[pyfunction]
#[pyo3(signature = (session, instrument, output, *, plan = false, normalise_beads = None, force = false, seed = 1,
                    progress = None))]
#[expect(clippy::too_many_arguments, reason = "keyword arguments of Python")]
pub fn close<'py>(
    py: Python<'py>,
    session: SessionPlace<'py>,
    instrument: InstrumentPlace<'py>,
    output: PathBuf,
    plan: bool,
    normalise_beads: Option<bool>,
    force: bool,
    seed: u64,
    progress: Option<Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    let started = Instant::now();
    let scratch = tempfile::tempdir().map_err(raised)?;
    let (session, file) = (session.path(), instrument.filed(scratch.path()).map_err(raised)?);
    let files = Files::reading([&session, &file])
        .writing([&output], Content::artifact("instrument"))
        .writing([account_path(&output)], Content::artifact("closing"));
    let locks = files.hold(force).map_err(raised)?;
    // The work writes here; what was stopped never reaches the output.
    let made = temporary_folder_beside(&output).map_err(raised)?;
    let (closing, warnings, made) = work::long(py, progress, move |steps| {
        let _scratch = scratch;
        let warnings = warnings_of(&session, &file)?;
        let request = CloseRequest {
            session: &session,
            instrument: &file,
            output: &made.path().join("closed.instrument"),
            calibration: CalibrateConfig { normalise_beads, ..CalibrateConfig::default() },
            plan,
            fine_tuning: None,
            seed,
        };
        let mut step = 0;
        let outcome = close_session(&request, &mut |progress| {
            if let Progress::Step(name) = progress {
                step += 1;
                steps.at(name, step, None);
            }
        })?;
        Ok((outcome.closed.account.closing, warnings, made))
    })?;
    let account = account_path(&output);
    for (name, to) in [("closed.instrument", &output), ("closed.closing", &account)] {
        let moved = std::fs::rename(made.path().join(name), to);
        moved.with_context(|| to.display().to_string()).map_err(raised)?;
    }
    drop(locks);
    let mut json = serde_json::to_value(&closing).map_err(raised)?;
    json["seconds"] = started.elapsed().as_secs_f64().into();
    json["warnings"] = warnings.into();
    json["account"] = account.display().to_string().into();
    json::object(py, &json)
}
