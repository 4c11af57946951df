//! Errors of the packages below as one Python exception, with the text that the program prints.

use ommatidia_session::causes;
use pyo3::exceptions::PyException;
use pyo3::{PyErr, create_exception};

create_exception!(
    ommatidia,
    OmmatidiaError,
    PyException,
    "What the program would print as an error: what is wrong, where, and what to do."
);

/// The exception for an error: its text and its causes, as the program prints them.
pub fn raised(error: impl Into<anyhow::Error>) -> PyErr {
    let error: anyhow::Error = error.into();
    // An exception that Python raised itself, such as one of a callback, stays what it is.
    match error.downcast::<PyErr>() {
        Ok(raised) => raised,
        Err(error) => OmmatidiaError::new_err(causes(error.as_ref()).join("\n  because: ")),
    }
}
