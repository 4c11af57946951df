//! Effects: what a real instrument does beyond the calibrated optics, one file an effect.
//!
//! One definition serves three users: the forward model applies it, `close` fits it, and the virtual bench injects it.
//! An effect acts at one [`Stage`] of the way of the light; the forward model calls the hooks in physical order:
//!
//! ```text
//! object -> (geometry) -> each lens -> light on the sensor -> Poisson draw -> charge -> electronics
//! ```

mod array_shift;
mod background;
mod chain;
mod charge_diffusion;
mod excitation_profile;
mod halo;
mod interpixel_capacitance;
mod lens_gain;
mod nonlinearity;
mod pixel_mosaic;
mod row_pattern;
mod smooth;
mod veiling_glare;

pub use chain::{Chain, EffectError};

use crate::instrument::Geometry;
use ndarray::Array2;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Where on the way of the light an effect acts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Stage {
    /// Emitted light, on the object grid.
    Object,
    /// Chief rays.
    Geometry,
    /// The image of one lens, electrons.
    Lens,
    /// The light of all lenses on the sensor, expected electrons, before the Poisson draw.
    Light,
    /// Collected charge, electrons, after the Poisson draw.
    Charge,
    /// Digital numbers.
    Electronics,
}

/// One parameter of an effect.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Param {
    /// Name.
    pub name: &'static str,
    /// Unit, "1" where it has none.
    pub unit: &'static str,
    /// The value at which the effect is absent.
    pub off: f64,
    /// A step that changes the frame noticeably: the scale for derivatives and first guesses.
    pub step: f64,
    /// Smallest value with a meaning.
    pub min: f64,
    /// Largest value with a meaning.
    pub max: f64,
}

/// What an effect is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Descriptor {
    /// Name in tools, files and reports.
    pub id: &'static str,
    /// Where it acts.
    pub stage: Stage,
    /// One sentence with the formula.
    pub summary: &'static str,
    /// Its parameters; the first is its strength.
    pub params: &'static [Param],
}

/// What is known of the frame that is being formed.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FrameContext {
    /// Index in its stack.
    pub frame: usize,
    /// When the exposure began, s.
    pub time_s: f64,
    /// Exposure, ms.
    pub exposure_ms: f64,
    /// Relative light level.
    pub illumination: f64,
    /// Lens whose image is being formed (stage `Lens` only), counted row by row.
    pub lens: usize,
    /// Full scale of the converter above the black level, electrons.
    pub full_scale_e: f64,
    /// Mean signal without light, DN.
    pub black_level_dn: f64,
}

/// One effect. It overrides the hook of its stage; `p` holds its parameters in the order of the descriptor.
///
/// With every parameter at its `off` value a hook must leave its argument as it is, bit for bit.
pub trait Effect: Send + Sync {
    /// What it is.
    fn descriptor(&self) -> &'static Descriptor;
    /// Stage `Object`: emitted light, [object rows, object cols].
    fn on_object(&self, _p: &[f64], _object: &mut Array2<f32>, _cx: &FrameContext) {}
    /// Stage `Geometry`: chief rays.
    fn on_geometry(&self, _p: &[f64], _geometry: &mut Geometry, _cx: &FrameContext) {}
    /// Stage `Lens`: electrons from lens `cx.lens`, [sensor rows, sensor cols].
    fn on_lens(&self, _p: &[f64], _image_e: &mut Array2<f32>, _cx: &FrameContext) {}
    /// Stage `Light`: expected electrons from all lenses, [sensor rows, sensor cols].
    fn on_light(&self, _p: &[f64], _light_e: &mut Array2<f32>, _cx: &FrameContext) {}
    /// Stage `Charge`: electrons, [sensor rows, sensor cols].
    fn on_charge(&self, _p: &[f64], _charge_e: &mut Array2<f32>, _cx: &FrameContext) {}
    /// Stage `Electronics`: DN, black level included, [sensor rows, sensor cols].
    fn on_electronics(&self, _p: &[f64], _frame_dn: &mut Array2<f32>, _cx: &FrameContext) {}
}

/// An effect as it stands in an instrument file: its id and its parameters by name.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EffectSetting {
    /// Id of the effect.
    pub id: String,
    /// Parameters by name; those left out are at their `off` value.
    pub params: BTreeMap<String, f64>,
}

/// Every effect there is: a new one is a file of its own and a line here.
static REGISTRY: &[&dyn Effect] = &[
    &excitation_profile::ExcitationProfile,
    &array_shift::ArrayShift,
    &lens_gain::LensGain,
    &halo::Halo,
    &veiling_glare::VeilingGlare,
    &background::Background,
    &charge_diffusion::ChargeDiffusion,
    &interpixel_capacitance::InterpixelCapacitance,
    &nonlinearity::Nonlinearity,
    &pixel_mosaic::PixelMosaic,
    &row_pattern::RowPattern,
];

/// Every effect, in physical order of their stages.
pub fn registry() -> &'static [&'static dyn Effect] {
    REGISTRY
}

/// The effect of that id.
pub fn find(id: &str) -> Option<&'static dyn Effect> {
    REGISTRY.iter().copied().find(|e| e.descriptor().id == id)
}

/// The ids of all effects.
pub fn ids() -> Vec<&'static str> {
    REGISTRY.iter().map(|e| e.descriptor().id).collect()
}

#[cfg(test)]
mod tests;
