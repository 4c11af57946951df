//! The list of all effects.

use super::aberration_drift::AberrationDrift;
use super::adc_nonlinearity::AdcNonlinearity;
use super::array_jump::ArrayJump;
use super::array_rotation::ArrayRotation;
use super::array_shift::ArrayShift;
use super::background::Background;
use super::black_level_drift::BlackLevelDrift;
use super::brighter_fatter::BrighterFatter;
use super::camera_gamma::CameraGamma;
use super::camera_processing::CameraProcessing;
use super::charge_diffusion::ChargeDiffusion;
use super::chief_ray_response::ChiefRayResponse;
use super::column_pattern::ColumnPattern;
use super::column_smear::ColumnSmear;
use super::dark_current::DarkCurrent;
use super::defocus::Defocus;
use super::dsnu::Dsnu;
use super::dust::Dust;
use super::effect::Effect;
use super::excitation_profile::ExcitationProfile;
use super::exposure_offset::ExposureOffset;
use super::field_curvature::FieldCurvature;
use super::flicker_banding::FlickerBanding;
use super::ghost::Ghost;
use super::halo::Halo;
use super::hot_pixels::HotPixels;
use super::interpixel_capacitance::InterpixelCapacitance;
use super::lag::Lag;
use super::lamp_drift::LampDrift;
use super::lens_decentre::LensDecentre;
use super::lens_gain::LensGain;
use super::lens_leakage::LensLeakage;
use super::magnification::Magnification;
use super::metadata_fault::MetadataFault;
use super::motion_blur::MotionBlur;
use super::noise_scale::NoiseScale;
use super::nonlinearity::Nonlinearity;
use super::object_distortion::ObjectDistortion;
use super::photobleaching::Photobleaching;
use super::pixel_mosaic::PixelMosaic;
use super::prnu::Prnu;
use super::pupil_defocus::PupilDefocus;
use super::radial_distortion::RadialDistortion;
use super::rank_truncation::RankTruncation;
use super::readout_lag::ReadoutLag;
use super::row_noise::RowNoise;
use super::row_pattern::RowPattern;
use super::saturation::Saturation;
use super::sensor_rotation::SensorRotation;
use super::spectral_shift::SpectralShift;
use super::stage_backlash::StageBacklash;
use super::stage_scale::StageScale;
use super::telegraph_pixels::TelegraphPixels;
use super::thermal_drift::ThermalDrift;
use super::tilt::Tilt;
use super::truth_blur::TruthBlur;
use super::unknown_blur::UnknownBlur;
use super::unknown_dark::UnknownDark;
use super::unknown_gradient::UnknownGradient;
use super::unknown_light::UnknownLight;
use super::unknown_offset::UnknownOffset;
use super::unknown_operator::UnknownOperator;
use super::unknown_pattern::UnknownPattern;
use super::unknown_profile::UnknownProfile;
use super::unknown_scatter::UnknownScatter;
use super::unknown_shading::UnknownShading;
use super::unknown_stray::UnknownStray;
use super::unknown_view::UnknownView;
use super::unknown_warp::UnknownWarp;
use super::veiling_glare::VeilingGlare;
use super::vignetting::Vignetting;
use super::wavefront_drift::WavefrontDrift;

/// Every effect. A new effect needs a file of its own and a line here.
static REGISTRY: &[&dyn Effect] = &[
    &ExcitationProfile,
    &Photobleaching,
    &ArrayShift,
    &ArrayRotation,
    &SensorRotation,
    &LensDecentre,
    &StageScale,
    &StageBacklash,
    &ThermalDrift,
    &ArrayJump,
    &Magnification,
    &RadialDistortion,
    &ObjectDistortion,
    &Defocus,
    &FieldCurvature,
    &Tilt,
    &SpectralShift,
    &WavefrontDrift,
    &LensGain,
    &ChiefRayResponse,
    &LensLeakage,
    &AberrationDrift,
    &RankTruncation,
    &MotionBlur,
    &Halo,
    &VeilingGlare,
    &Ghost,
    &ColumnSmear,
    &Background,
    &LampDrift,
    &FlickerBanding,
    &ExposureOffset,
    &Vignetting,
    &Dust,
    &Prnu,
    &Lag,
    &DarkCurrent,
    &HotPixels,
    &ChargeDiffusion,
    &BrighterFatter,
    &Saturation,
    &InterpixelCapacitance,
    &Nonlinearity,
    &CameraGamma,
    &ReadoutLag,
    &PixelMosaic,
    &RowPattern,
    &ColumnPattern,
    &Dsnu,
    &BlackLevelDrift,
    &AdcNonlinearity,
    &CameraProcessing,
    &RowNoise,
    &TelegraphPixels,
    &NoiseScale,
    &TruthBlur,
    &MetadataFault,
    &UnknownOperator,
    &UnknownProfile,
    &UnknownPattern,
    &UnknownDark,
    &UnknownGradient,
    &UnknownShading,
    &UnknownLight,
    &UnknownStray,
    &UnknownOffset,
    &UnknownView,
    &UnknownWarp,
    &UnknownBlur,
    &UnknownScatter,
];

/// What is fitted beside effects and kept in an instrument, but is no cause: no search tries it.
static BESIDE: &[&dyn Effect] = &[&PupilDefocus];

/// All effects, in the physical order of their stages.
pub fn registry() -> &'static [&'static dyn Effect] {
    REGISTRY
}

/// The effect with this id, if there is one; of those that [`registry`] lists, or `pupil_defocus`, which an instrument
/// may hold beside them.
pub fn find(id: &str) -> Option<&'static dyn Effect> {
    REGISTRY.iter().chain(BESIDE).copied().find(|e| e.descriptor().id == id)
}

/// The ids of all effects.
pub fn ids() -> Vec<&'static str> {
    REGISTRY.iter().map(|e| e.descriptor().id).collect()
}
