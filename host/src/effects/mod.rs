//! Effects: what a real instrument does beyond the calibrated optics, one file an effect.
//!
//! One definition serves three users: the forward model applies it, `close` fits it, and the virtual bench injects it.
//! An effect acts at one [`Stage`] of the way of the light; the forward model calls the hooks in physical order:
//!
//! ```text
//! object -> (geometry) -> each lens -> light on the sensor -> Poisson draw -> charge -> electronics
//! ```

mod adc_nonlinearity;
mod array_rotation;
mod array_shift;
mod background;
mod black_level_drift;
mod brighter_fatter;
mod chain;
mod charge_diffusion;
mod column_pattern;
mod context;
mod dark_current;
mod defocus;
mod descriptor;
mod dsnu;
mod dust;
mod evidence;
mod excitation_profile;
mod exposure_offset;
mod field_curvature;
mod flicker_banding;
mod ghost;
mod halo;
mod hot_pixels;
mod interpixel_capacitance;
mod lag;
mod lamp_drift;
mod lens_decentre;
mod lens_gain;
mod lens_leakage;
mod magnification;
mod metadata_fault;
mod motion_blur;
mod noise_scale;
mod nonlinearity;
mod parse;
mod photobleaching;
mod pixel_mosaic;
mod prnu;
mod radial_distortion;
mod rank_truncation;
mod readout_lag;
mod row_noise;
mod row_pattern;
mod saturation;
mod smooth;
mod stage_scale;
mod table;
mod thermal_drift;
mod unknown_operator;
mod unknown_pattern;
mod unknown_profile;
mod veiling_glare;
mod vignetting;
mod wave;

pub use chain::{Chain, EffectError, Layout};
pub use context::{FrameContext, Previous, Ray, RayShift, Record};
pub use descriptor::{Descriptor, Kind, Lookalike, Param, Stage};
pub use evidence::{Evidence, EvidenceFrame};
pub use parse::EffectParseError;
pub use smooth::blur_within;
pub use table::{Table, TableGroup, TableUse};
pub use unknown_operator::{OPERATORS, WEIGHTS};
pub use unknown_profile::{COVARIATES, KNOTS};
pub(crate) use wave::periods;

use crate::noise::NoiseModel;
use ndarray::Array2;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// One effect. It overrides the hook of its stage; `p` holds its parameters in the order of [`Descriptor::expanded`].
///
/// With every strength at its `off` value a hook must leave its argument as it is, bit for bit.
pub trait Effect: Send + Sync {
    /// What it is.
    fn descriptor(&self) -> &'static Descriptor;

    /// Stage `Object`: emitted light, [object rows, object cols].
    fn on_object(&self, _p: &[f64], _object: &mut Array2<f32>, _cx: &FrameContext<'_>) {}
    /// Stage `Geometry`: how far the focus of a source, or the source itself, is from where the calibration has it.
    fn shift_ray(&self, _p: &[f64], _ray: &Ray, _cx: &FrameContext<'_>) -> RayShift {
        RayShift::default()
    }
    /// Stage `Lens`: electrons from lens `cx.lens`, [sensor rows, sensor cols].
    fn on_lens(&self, _p: &[f64], _image_e: &mut Array2<f32>, _cx: &FrameContext<'_>) {}
    /// Stage `Light`: expected electrons from all lenses, [sensor rows, sensor cols].
    fn on_light(&self, _p: &[f64], _light_e: &mut Array2<f32>, _cx: &FrameContext<'_>) {}
    /// Stage `Charge`: electrons, [sensor rows, sensor cols].
    fn on_charge(&self, _p: &[f64], _charge_e: &mut Array2<f32>, _cx: &FrameContext<'_>) {}
    /// Stage `Electronics`: DN, black level included, [sensor rows, sensor cols].
    fn on_electronics(&self, _p: &[f64], _frame_dn: &mut Array2<f32>, _cx: &FrameContext<'_>) {}
    /// Stage `Electronics`, drawn frames only: noise that the noise model does not know, added in place. The expected frame
    /// does not change.
    fn on_reading(&self, _p: &[f64], _frame_dn: &mut Array2<f32>, _cx: &FrameContext<'_>, _rng: &mut dyn rand::Rng) {}
    /// Any stage: how the noise of the sensor differs from the calibrated one.
    fn on_noise(&self, _p: &[f64], _noise: &mut NoiseModel) {}
    /// Stage `Record`: what the session says of a frame and should not.
    fn on_record(&self, _p: &[f64], _record: &mut Record, _cx: &FrameContext<'_>) {}

    /// The table, for effects that differ from pixel to pixel without a law; the chain applies it.
    fn table(&self) -> Option<Table> {
        None
    }
    /// Draws the table for injection, [sensor rows, sensor cols], [rows, 1] or [1, cols].
    fn draw_table(&self, _p: &[f64], _sensor: [usize; 2]) -> Array2<f32> {
        Array2::zeros((1, 1))
    }
    /// Whether it needs the frame before.
    fn needs_previous(&self) -> bool {
        false
    }
    /// Whether it follows the grid of the pixels, as no specimen does: then even a specimen that nobody knows shows it.
    fn is_of_the_grid(&self) -> bool {
        false
    }
    /// Whether its strengths act on the noise alone, never on the expected frame.
    fn noise_only(&self) -> bool {
        false
    }
    /// Values of all parameters to start a fit from, shapes set as the residuals suggest, strengths at `off`; empty: the
    /// grid of the values that the shapes' [`Kind::Shape`] lists.
    fn guess(&self, _evidence: &Evidence<'_>) -> Vec<Vec<f64>> {
        Vec::new()
    }
    /// Chooses among values that a session cannot tell apart, since its own light takes up the difference: changes them, and gives the factor on
    /// the light that makes up for it.
    fn gauge(&self, _p: &mut [f64]) -> f64 {
        1.0
    }
    /// From how many independent values a [`guess`](Effect::guess) takes the best on a sensor of [rows, cols], over `frames`: with so many
    /// chances noise alone makes one that looks good.
    fn chances(&self, _sensor: [usize; 2], _frames: usize) -> f64 {
        1.0
    }
}

/// An effect as it stands in an instrument file: its id and its parameters by name.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EffectSetting {
    /// Id of the effect.
    pub id: String,
    /// Parameters by name; those left out are at their `off` value.
    pub params: BTreeMap<String, f64>,
    /// Its table, where one was estimated: a tensor of the instrument file. None: drawn from the parameters.
    #[serde(skip)]
    pub table: Option<Array2<f32>>,
}

impl EffectSetting {
    /// A setting without a table.
    pub fn new(id: &str, params: &[(&str, f64)]) -> Self {
        Self { id: id.into(), params: params.iter().map(|(n, v)| ((*n).into(), *v)).collect(), table: None }
    }
}

/// Every effect there is: a new one is a file of its own and a line here.
static REGISTRY: &[&dyn Effect] = &[
    &excitation_profile::ExcitationProfile,
    &photobleaching::Photobleaching,
    &array_shift::ArrayShift,
    &array_rotation::ArrayRotation,
    &lens_decentre::LensDecentre,
    &stage_scale::StageScale,
    &thermal_drift::ThermalDrift,
    &magnification::Magnification,
    &radial_distortion::RadialDistortion,
    &defocus::Defocus,
    &field_curvature::FieldCurvature,
    &lens_gain::LensGain,
    &lens_leakage::LensLeakage,
    &rank_truncation::RankTruncation,
    &motion_blur::MotionBlur,
    &halo::Halo,
    &veiling_glare::VeilingGlare,
    &ghost::Ghost,
    &background::Background,
    &lamp_drift::LampDrift,
    &flicker_banding::FlickerBanding,
    &exposure_offset::ExposureOffset,
    &vignetting::Vignetting,
    &dust::Dust,
    &prnu::Prnu,
    &lag::Lag,
    &dark_current::DarkCurrent,
    &hot_pixels::HotPixels,
    &charge_diffusion::ChargeDiffusion,
    &brighter_fatter::BrighterFatter,
    &saturation::Saturation,
    &interpixel_capacitance::InterpixelCapacitance,
    &nonlinearity::Nonlinearity,
    &readout_lag::ReadoutLag,
    &pixel_mosaic::PixelMosaic,
    &row_pattern::RowPattern,
    &column_pattern::ColumnPattern,
    &dsnu::Dsnu,
    &black_level_drift::BlackLevelDrift,
    &adc_nonlinearity::AdcNonlinearity,
    &row_noise::RowNoise,
    &noise_scale::NoiseScale,
    &metadata_fault::MetadataFault,
    &unknown_operator::UnknownOperator,
    &unknown_profile::UnknownProfile,
    &unknown_pattern::UnknownPattern,
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
