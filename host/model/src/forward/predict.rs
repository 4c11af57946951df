//! Frames predicted for given objects, and the transpose of the optics for solvers.

use super::{Forward, ForwardError};
use crate::instrument::Instrument;
use crate::psf::OperatorConfig;
use crate::slopes::{Slopes, slope_value};
use ndarray::{Array2, ArrayView2};
use ommatidia_physics::effects::FrameContext;
use ommatidia_session::rng;
use std::sync::Arc;
use thiserror::Error;

/// What to predict.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PredictRequest {
    /// Output of each call.
    pub output: Predicted,
    /// Depth of the objects.
    pub depth: Depth,
    /// Exposure, ms; None: that of the calibration.
    pub exposure_ms: Option<f64>,
    /// Light level relative to the calibration.
    pub illumination: f64,
    /// Light that does not come from the object: level and slopes, e- a pixel at the exposure of the calibration.
    pub background_e: Slopes,
    /// Seed of the noise.
    pub seed: u64,
}

impl Default for PredictRequest {
    fn default() -> Self {
        Self {
            output: Predicted::Expected,
            depth: Depth::Focus,
            exposure_ms: None,
            illumination: 1.0,
            background_e: [0.0; 3],
            seed: 1,
        }
    }
}

/// Output of a prediction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Predicted {
    /// Expected frames, DN.
    Expected,
    /// Frames with noise, whole DN.
    Noisy,
    /// Objects: frames, DN above black, back-projected by the exact transpose of the optics, without effects and pixel
    /// response.
    Adjoint,
}

/// Depth of objects.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Depth {
    /// The calibrated depth nearest to 0 um.
    Focus,
    /// A calibrated depth, by its index.
    Index(usize),
    /// A depth, um, interpolated between calibrated ones.
    Um(f64),
}

/// Errors of predictions.
#[derive(Debug, Error)]
pub enum PredictError {
    /// The depth is outside the calibrated range.
    #[error("--z-um: expected a depth within those calibrated, {calibrated_um:?} um, found {found_um}")]
    Depth {
        /// Calibrated depths.
        calibrated_um: Vec<f64>,
        /// The requested one.
        found_um: f64,
    },
    /// Exposure or illumination is not a finite value, zero or more.
    #[error("{option}: expected a finite value, zero or more, found {found}")]
    Level {
        /// The option.
        option: &'static str,
        /// Its value.
        found: f64,
    },
    /// The forward model fails.
    #[error(transparent)]
    Forward(#[from] ForwardError),
}

/// A planned prediction, for any number of inputs.
///
/// ```
/// use ndarray::Array2;
/// use ommatidia_model::forward::{Predictor, PredictRequest};
///
/// let instrument = ommatidia_model::testing::instrument([9, 11], [30, 33], 5, 3);
/// let predictor = Predictor::new(instrument, PredictRequest::default())?;
/// assert_eq!((predictor.input_shape(), predictor.output_shape()), ([9, 11], [30, 33]));
/// let frame = predictor.apply(0, Array2::zeros((9, 11)).view())?;
/// assert!(frame.iter().all(|dn| *dn == 64.0)); // the black level
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct Predictor {
    forward: Arc<Forward>,
    request: PredictRequest,
}

impl Predictor {
    /// Plans predictions with an instrument.
    ///
    /// # Errors
    /// The depth is not calibrated, exposure or illumination is invalid, or the instrument's parts disagree.
    pub fn new(mut instrument: Instrument, request: PredictRequest) -> Result<Self, PredictError> {
        if let Depth::Um(z_um) = request.depth {
            let depths = &instrument.psf.node_depths_um;
            if !depths.first().zip(depths.last()).is_some_and(|(low, high)| (*low..=*high).contains(&z_um)) {
                return Err(PredictError::Depth { calibrated_um: depths.clone(), found_um: z_um });
            }
            instrument.psf = instrument.psf.at_depth(z_um);
        }
        let depth = match request.depth {
            Depth::Index(index) => index,
            Depth::Focus | Depth::Um(_) => instrument.psf.depth_nearest(0.0),
        };
        let forward = Forward::with_config(&instrument, OperatorConfig { depth, ..OperatorConfig::default() })?;
        Self { forward: Arc::new(forward), request }.with(request)
    }

    /// Predictions with other settings, at the same depth whatever the request says: the plan is shared.
    ///
    /// # Errors
    /// Exposure or illumination is invalid.
    pub fn with(&self, request: PredictRequest) -> Result<Self, PredictError> {
        let exposure_ms = request.exposure_ms.unwrap_or(self.forward.context().exposure_ms);
        for (option, found) in [("--exposure-ms", exposure_ms), ("--illumination", request.illumination)] {
            if !(found.is_finite() && found >= 0.0) {
                return Err(PredictError::Level { option, found });
            }
        }
        let request = PredictRequest { depth: self.request.depth, ..request };
        Ok(Self { forward: Arc::clone(&self.forward), request })
    }

    /// The forward model that is planned.
    pub fn forward(&self) -> &Forward {
        &self.forward
    }

    /// Rows and columns of each input: objects, or frames for the transpose.
    pub fn input_shape(&self) -> [usize; 2] {
        match self.request.output {
            Predicted::Adjoint => self.forward.operator().sensor_shape(),
            Predicted::Expected | Predicted::Noisy => self.forward.operator().object_shape(),
        }
    }

    /// Rows and columns of each output: frames, or objects for the transpose.
    pub fn output_shape(&self) -> [usize; 2] {
        match self.request.output {
            Predicted::Adjoint => self.forward.operator().object_shape(),
            Predicted::Expected | Predicted::Noisy => self.forward.operator().sensor_shape(),
        }
    }

    /// Number of pixels of a predicted frame, DN, that are at full scale; 0 for the transpose.
    pub fn clipped_px(&self, frame: ArrayView2<'_, f32>) -> usize {
        let top = self.forward.noise().saturation_dn as f32 - 0.5;
        match self.request.output {
            Predicted::Adjoint => 0,
            Predicted::Expected | Predicted::Noisy => frame.iter().filter(|dn| **dn >= top).count(),
        }
    }

    /// Output number `frame` for an input of [`Self::input_shape`]. The number selects the random draws of the noise.
    ///
    /// # Errors
    /// The input has another shape, or an object holds a non-finite or negative value.
    pub fn apply(&self, frame: usize, input: ArrayView2<'_, f32>) -> Result<Array2<f32>, ForwardError> {
        let mut cx = self.forward.context();
        cx.exposure_ms = self.request.exposure_ms.unwrap_or(cx.exposure_ms);
        cx.illumination = self.request.illumination;
        cx.frame = frame;
        match self.request.output {
            Predicted::Adjoint => Ok(self.forward.operator().adjoint(input)?),
            Predicted::Expected => {
                let light = self.light_e(input, &cx)?;
                Ok(self.forward.frame_dn(light, &self.forward.effects, &cx))
            }
            Predicted::Noisy => {
                let light = self.light_e(input, &cx)?;
                Ok(self.forward.draw_dn(light, &cx, &mut rng::stream(self.request.seed, "predict", frame as u64)))
            }
        }
    }
    /// Expected electrons of an object and of the background.
    fn light_e(&self, object: ArrayView2<'_, f32>, cx: &FrameContext<'_>) -> Result<Array2<f32>, ForwardError> {
        let mut light_e = self.forward.expected_e(object, cx)?;
        let plane = self.request.background_e.map(|e| e * cx.exposure_ms / self.forward.exposure_ms);
        if plane != [0.0; 3] {
            let dim = light_e.dim();
            for ((r, c), v) in light_e.indexed_iter_mut() {
                let response = self.forward.response.as_ref().map_or(1.0, |map| map[[r, c]]);
                *v += response * slope_value(&plane, dim, [r, c]).max(0.0) as f32;
            }
        }
        Ok(light_e)
    }
}
