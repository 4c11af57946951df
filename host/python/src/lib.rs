//! The Python package, as the module `ommatidia._core`: every name of it is wrapped or passed on by `python/ommatidia`.
//!
//! Each file gives Python one part of the packages below. Nothing is computed here.
//!
//! | module | contents |
//! |---|---|
//! | `session` | sessions, their stacks, and the virtual instrument |
//! | `instrument` | calibration, files, predictions, PSFs |
//! | `operator` | the optics as a linear map |
//! | `network` | reconstruction, quantization |
//! | `simulate` | training pairs |
//! | `closing` | residual, close |
//! | `work` | threads, progress, Ctrl-C |
//! | `arrays`, `json`, `error` | what crosses the border |

mod arrays;
mod closing;
mod error;
mod instrument;
mod json;
mod network;
mod operator;
mod session;
mod simulate;
mod work;

use pyo3::prelude::*;

/// The compiled part of the package.
#[pymodule]
fn _core(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add("OmmatidiaError", module.py().get_type::<error::OmmatidiaError>())?;
    module.add_class::<session::PySession>()?;
    module.add_class::<session::PyStack>()?;
    module.add_class::<instrument::PyInstrument>()?;
    module.add_class::<operator::PyLight>()?;
    module.add_class::<network::PyNetwork>()?;
    module.add_class::<simulate::PySimulation>()?;
    module.add_function(wrap_pyfunction!(closing::residual, module)?)?;
    module.add_function(wrap_pyfunction!(closing::close, module)?)?;
    module.add_function(wrap_pyfunction!(simulate::simulate, module)?)?;
    module.add_function(wrap_pyfunction!(network::quantize, module)?)?;
    module.add_function(wrap_pyfunction!(work::set_threads, module)?)?;
    Ok(())
}
