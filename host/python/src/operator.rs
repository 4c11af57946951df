//! The optics as a linear map: what `Instrument.as_linear_operator()` wraps for each library.

use crate::arrays::{Images, each};
use ommatidia_model::forward::Predictor;
use pyo3::prelude::*;

/// Light of objects on the sensor, DN above black at the exposure of the calibration, without effects, pixel response,
/// noise and clipping; and the exact transpose of that.
#[pyclass(frozen, module = "ommatidia", name = "Light")]
pub struct PyLight {
    pub predictor: Predictor,
}

#[pymethods]
impl PyLight {
    /// Rows and columns of an object.
    #[getter]
    fn object_shape(&self) -> (usize, usize) {
        self.predictor.forward().operator().object_shape().into()
    }

    /// Rows and columns of a frame.
    #[getter]
    fn sensor_shape(&self) -> (usize, usize) {
        self.predictor.forward().operator().sensor_shape().into()
    }

    /// Objects, of any sign, to light on the sensor.
    fn forward<'py>(&self, py: Python<'py>, objects: Images<'py>) -> PyResult<Bound<'py, PyAny>> {
        let operator = self.predictor.forward().operator();
        each(py, "object", &objects, None, |_, object| Ok(operator.apply(object)?))
    }

    /// Light on the sensor to the object grid, by the transpose.
    fn adjoint<'py>(&self, py: Python<'py>, frames: Images<'py>) -> PyResult<Bound<'py, PyAny>> {
        let operator = self.predictor.forward().operator();
        each(py, "frame", &frames, None, |_, frame| Ok(operator.adjoint(frame)?))
    }
}
