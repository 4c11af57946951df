//! Effects: what a real instrument does beyond the calibrated optics, one file for each effect.
//!
//! One definition serves three users: the forward model applies an effect, `close` fits it, and the virtual bench
//! injects it. An effect acts at one [`Stage`] between object and frame. The forward model calls the hooks in physical
//! order:
//!
//! ```text
//! object -> (geometry) -> each lens -> light on the sensor -> Poisson draw -> charge -> electronics
//! ```
//!
//! [`registry`] lists all effects, and `docs/effects.md` describes them. A [`Chain`] applies those that are switched
//! on:
//!
//! ```
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! use ndarray::Array2;
//! use ommatidia_physics::effects::{Chain, EffectSetting, FrameContext, Layout, Stage};
//! let layout = Layout { lenses: 9, sensor: [4, 6] };
//! // 5 % of the mean light is spread evenly over the sensor.
//! let chain = Chain::build(&[EffectSetting::new("veiling_glare", &[("beta", 0.05)])], layout)?;
//! assert!(chain.acts_at(Stage::Light));
//! let mut light_e = Array2::from_elem((4, 6), 200.0);
//! chain.on_light(&mut light_e, &FrameContext::default());
//! assert!((light_e[[0, 0]] - 210.0_f32).abs() < 1e-3);
//!
//! // An effect without strength is absent, and unknown names are errors.
//! assert!(Chain::build(&[EffectSetting::new("veiling_glare", &[])], layout)?.is_empty());
//! assert!(Chain::build(&[EffectSetting::new("veiling", &[])], layout).is_err());
//! # Ok(())
//! # }
//! ```

mod aberration_drift;
mod adc_nonlinearity;
mod array_jump;
mod array_rotation;
mod array_shift;
mod background;
mod black_level_drift;
mod brighter_fatter;
mod camera_gamma;
mod camera_processing;
mod chain;
mod charge_diffusion;
mod chief_ray_response;
mod column_pattern;
mod column_smear;
mod context;
mod dark_current;
mod defocus;
mod descriptor;
mod dsnu;
mod dust;
mod effect;
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
mod object_distortion;
mod parse;
mod photobleaching;
mod pixel_mosaic;
mod place;
mod prnu;
mod pupil_defocus;
mod radial_distortion;
mod rank_truncation;
mod readout_lag;
mod registry;
mod row_noise;
mod row_pattern;
mod saturation;
mod sensor_rotation;
mod smooth;
mod spectral_shift;
mod stage_backlash;
mod stage_scale;
mod table;
mod telegraph_pixels;
mod thermal_drift;
mod tilt;
mod truth_blur;
mod unknown_blur;
mod unknown_dark;
mod unknown_gradient;
mod unknown_light;
mod unknown_offset;
mod unknown_operator;
mod unknown_pattern;
mod unknown_profile;
mod unknown_scatter;
mod unknown_shading;
mod unknown_stray;
mod unknown_view;
mod unknown_warp;
mod veiling_glare;
mod vignetting;
mod wave;
mod wavefront_drift;

pub use array_jump::MOMENT;
pub use chain::{Chain, EffectError, Layout};
pub use context::{FrameContext, Previous, Ray, RayShift, Record};
pub use descriptor::{Descriptor, Kind, Lookalike, Param, Stage};
pub use effect::{Effect, EffectSetting};
pub use evidence::{Evidence, EvidenceFrame};
pub use parse::EffectParseError;
pub use place::displacement_px;
pub use registry::{find, ids, registry};
pub use smooth::blur_within;
pub use table::{Table, TableGroup, TableUse};
pub use unknown_operator::{OPERATORS, WEIGHTS};
pub use unknown_profile::{COVARIATES, KNOTS};
pub use wave::periods;

#[cfg(test)]
mod tests;
