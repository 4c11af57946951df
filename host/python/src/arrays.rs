//! NumPy arrays in and out: float32 without copies, other types converted.

use crate::work;
use anyhow::Context;
use ndarray::{Array2, ArrayD, ArrayView2, ArrayViewD, Axis, Ix2};
use numpy::{AllowTypeChange, IntoPyArray, PyArray3, PyArrayLikeDyn, PyArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// Frames or objects that Python gives: one, [rows, cols], or a stack, [n, rows, cols].
pub type Images<'py> = PyArrayLikeDyn<'py, f32, AllowTypeChange>;

/// Computes an image from each image of `input`: one from one, or a stack from a stack. Between images it calls
/// `progress(what, done, total)` and looks for signals.
///
/// # Errors
/// The input has neither two nor three axes, or no image; an image is refused; or an exception was raised meanwhile.
pub fn each<'py>(
    py: Python<'py>,
    what: &str,
    input: &Images<'py>,
    progress: Option<Bound<'py, PyAny>>,
    mut apply: impl FnMut(usize, ArrayView2<'_, f32>) -> anyhow::Result<Array2<f32>> + Send,
) -> PyResult<Bound<'py, PyAny>> {
    let input: ArrayViewD<'_, f32> = input.as_array();
    if let Ok(one) = input.view().into_dimensionality::<Ix2>() {
        // The packages below expect images whose rows follow each other; others are copied.
        let one = one.as_standard_layout();
        return Ok(work::short(py, || apply(0, one.view()))?.into_pyarray(py).into_any());
    }
    if input.ndim() != 3 || input.shape()[0] == 0 {
        let found = input.shape();
        return Err(PyValueError::new_err(format!(
            "{what}: expected [rows, cols] or [n, rows, cols], found {found:?}"
        )));
    }
    let n = input.shape()[0];
    let mut all: Option<Bound<'py, PyArray3<f32>>> = None;
    for (i, image) in input.axis_iter(Axis(0)).enumerate() {
        let image = image.into_dimensionality::<Ix2>().map_err(|e| PyValueError::new_err(e.to_string()))?;
        let image = image.as_standard_layout();
        let made = work::short(py, || apply(i, image.view()).with_context(|| format!("{what} {i}")))?;
        let all = all.get_or_insert_with(|| PyArray3::zeros(py, [n, made.nrows(), made.ncols()], false));
        all.readwrite().as_array_mut().index_axis_mut(Axis(0), i).assign(&made);
        py.check_signals()?;
        if let Some(progress) = &progress {
            progress.call1((what, i + 1, n))?;
        }
    }
    match all {
        Some(all) => Ok(all.into_any()),
        None => Err(PyValueError::new_err(format!("{what}: expected one or more"))),
    }
}

/// An array of any number of axes as NumPy's, without a copy.
pub fn given<'py, D: ndarray::Dimension>(py: Python<'py>, array: ndarray::Array<f32, D>) -> Bound<'py, PyAny> {
    let array: ArrayD<f32> = array.into_dyn();
    array.into_pyarray(py).into_any()
}
