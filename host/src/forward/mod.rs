//! Scene -> frame: the optics of an instrument, then what else it does, in physical order.
//!
//! ```text
//! object -> chief rays -> each lens -> light on the sensor -> (Poisson) -> charge -> (reading) -> DN
//! ```
//! Without the two draws in brackets the result is the expected frame. [`Forward`] is planned once and used for many frames.

use crate::effects::{Chain, EffectError, FrameContext, Stage};
use crate::instrument::{Geometry, Instrument};
use crate::noise::{NoiseModel, draw_electrons};
use crate::psf::{LowRankOperator, OperatorConfig, OperatorError};
use ndarray::{Array2, ArrayView2, Zip};
use rand::Rng;
use std::borrow::Cow;
use thiserror::Error;

/// Why a frame could not be computed.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum ForwardError {
    /// The optics.
    #[error(transparent)]
    Operator(#[from] OperatorError),
    /// The effects.
    #[error(transparent)]
    Effect(#[from] EffectError),
    /// An object holds a value that is no number or below zero.
    #[error("object pixel ({row}, {col}): expected a finite value >= 0, found {found}")]
    Object {
        /// Row.
        row: usize,
        /// Column.
        col: usize,
        /// What was found.
        found: f32,
    },
}

/// The forward model of one instrument at one depth.
#[derive(Clone, Debug)]
pub struct Forward {
    operator: LowRankOperator,
    /// What moves chief rays needs the instrument again.
    moving: Option<Box<Instrument>>,
    config: OperatorConfig,
    effects: Chain,
    noise: NoiseModel,
    offset_dn: Option<Array2<f32>>,
    exposure_ms: f64,
}

impl Forward {
    /// Plans the model at the first depth.
    ///
    /// # Errors
    /// The tables of the instrument disagree, or it names an effect that does not exist.
    pub fn new(instrument: &Instrument) -> Result<Self, ForwardError> {
        Self::with_config(instrument, OperatorConfig::default())
    }

    /// Plans the model.
    ///
    /// # Errors
    /// As [`Forward::new`]; also if the depth does not exist.
    pub fn with_config(instrument: &Instrument, config: OperatorConfig) -> Result<Self, ForwardError> {
        let effects = Chain::build(&instrument.effects)?;
        Ok(Self {
            operator: LowRankOperator::plan(instrument, &instrument.geometry, config)?,
            moving: effects.acts_at(Stage::Geometry).then(|| Box::new(instrument.clone())),
            config,
            effects,
            noise: instrument.noise,
            offset_dn: instrument.offset_dn.clone(),
            exposure_ms: instrument.psf.exposure_ms,
        })
    }

    /// The optics alone, without effects: light in DN above black at the exposure of the calibration.
    pub fn operator(&self) -> &LowRankOperator {
        &self.operator
    }

    /// The noise model.
    pub fn noise(&self) -> &NoiseModel {
        &self.noise
    }

    /// A frame as in the calibration: its exposure, illumination 1, time 0.
    pub fn context(&self) -> FrameContext {
        FrameContext {
            exposure_ms: self.exposure_ms,
            illumination: 1.0,
            full_scale_e: self.noise.full_scale_e(),
            black_level_dn: self.noise.black_level_dn,
            ..FrameContext::default()
        }
    }

    /// Expected photo-electrons before the Poisson draw, [sensor rows, sensor cols], for an object
    /// [object rows, object cols] in the session's light unit.
    ///
    /// # Errors
    /// The object has the wrong shape or a value that is no light.
    pub fn expected_e(&self, object: ArrayView2<'_, f32>, cx: &FrameContext) -> Result<Array2<f32>, ForwardError> {
        if let Some(((row, col), found)) = object.indexed_iter().find(|(_, v)| !(v.is_finite() && **v >= 0.0)) {
            return Err(ForwardError::Object { row, col, found: *found });
        }
        let mut emitted = object.to_owned();
        self.effects.on_object(&mut emitted, cx);
        let operator = self.operator_at(cx)?;
        let electrons = (cx.exposure_ms / self.exposure_ms * cx.illumination / self.noise.gain_dn_per_e) as f32;
        let mut light = Array2::zeros(self.operator.sensor_shape());
        let per_lens = self.effects.acts_at(Stage::Lens);
        operator.each_lens(emitted.view(), |lens, mut image| {
            image.light.mapv_inplace(|v| v * electrons);
            if per_lens {
                let mut whole = Array2::zeros(light.dim());
                image.add_to(&mut whole);
                self.effects.on_lens(&mut whole, &FrameContext { lens, ..*cx });
                light += &whole;
            } else {
                image.add_to(&mut light);
            }
        })?;
        self.effects.on_light(&mut light, cx);
        Ok(light)
    }

    /// The expected frame, DN, [sensor rows, sensor cols]: no noise, no rounding; clipped at saturation.
    ///
    /// # Errors
    /// As [`Forward::expected_e`].
    pub fn expected_dn(&self, object: ArrayView2<'_, f32>, cx: &FrameContext) -> Result<Array2<f32>, ForwardError> {
        let mut charge = self.expected_e(object, cx)?;
        self.effects.on_charge(&mut charge, cx);
        let mut frame = self.to_dn(charge, cx);
        let top = self.noise.saturation_dn as f32;
        frame.mapv_inplace(|v| v.min(top));
        Ok(frame)
    }

    /// One drawn frame for expected electrons `light_e` (of [`Forward::expected_e`]): whole DN, 0 to saturation.
    pub fn draw_dn(&self, mut light_e: Array2<f32>, cx: &FrameContext, rng: &mut impl Rng) -> Array2<f32> {
        let read = self.noise.read_noise_e as f32;
        if self.effects.acts_at(Stage::Charge) {
            draw_in_place(&mut light_e, 0.0, rng);
            self.effects.on_charge(&mut light_e, cx);
            let mut reading = Array2::zeros(light_e.dim());
            draw_in_place(&mut reading, read, rng);
            light_e += &reading;
        } else {
            draw_in_place(&mut light_e, read, rng);
        }
        let mut frame = self.to_dn(light_e, cx);
        let top = self.noise.saturation_dn as f32;
        frame.mapv_inplace(|v| v.round().clamp(0.0, top));
        frame
    }

    /// Charge, electrons -> DN.
    fn to_dn(&self, mut charge_e: Array2<f32>, cx: &FrameContext) -> Array2<f32> {
        let (gain, black) = (self.noise.gain_dn_per_e as f32, self.noise.black_level_dn as f32);
        charge_e.mapv_inplace(|q| black + gain * q);
        if let Some(offset) = &self.offset_dn {
            Zip::from(&mut charge_e).and(offset).for_each(|v, o| *v += o);
        }
        self.effects.on_electronics(&mut charge_e, cx);
        charge_e
    }

    /// The planned operator, or one for chief rays that an effect has moved in this frame.
    fn operator_at(&self, cx: &FrameContext) -> Result<Cow<'_, LowRankOperator>, ForwardError> {
        let Some(instrument) = &self.moving else {
            return Ok(Cow::Borrowed(&self.operator));
        };
        let mut geometry: Geometry = instrument.geometry.clone();
        self.effects.on_geometry(&mut geometry, cx);
        Ok(Cow::Owned(LowRankOperator::plan(instrument, &geometry, self.config)?))
    }
}

fn draw_in_place(values: &mut Array2<f32>, read_noise_e: f32, rng: &mut impl Rng) {
    if let Some(values) = values.as_slice_mut() {
        draw_electrons(values, read_noise_e, rng);
    }
}

#[cfg(test)]
mod tests;
