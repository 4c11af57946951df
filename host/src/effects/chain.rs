//! The effects that are on, resolved and in order.

use super::{Effect, EffectSetting, FrameContext, Stage, find, ids};
use crate::instrument::Geometry;
use ndarray::Array2;
use thiserror::Error;

/// Why a list of effects makes no sense.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum EffectError {
    /// No such effect.
    #[error("effect `{found}`: unknown; known are {known}")]
    Unknown {
        /// The id that was asked for.
        found: String,
        /// The ids there are.
        known: String,
    },
    /// No such parameter.
    #[error("effect `{id}`: no parameter `{found}`; it has {known}")]
    Param {
        /// The effect.
        id: &'static str,
        /// The name that was asked for.
        found: String,
        /// The names there are.
        known: String,
    },
    /// A parameter out of its range.
    #[error("effect `{id}`: parameter `{name}`: expected {min} to {max} {unit}, found {found}")]
    Range {
        /// The effect.
        id: &'static str,
        /// The parameter.
        name: &'static str,
        /// Smallest value with a meaning.
        min: f64,
        /// Largest value with a meaning.
        max: f64,
        /// Its unit.
        unit: &'static str,
        /// What was given.
        found: f64,
    },
}

/// An effect with its parameters in the order of its descriptor.
#[derive(Clone)]
struct Active {
    effect: &'static dyn Effect,
    params: Vec<f64>,
}

/// Effects in the order in which they were given; each acts at its own stage.
///
/// An effect whose parameters are all `off` is left out: switched off and absent are the same bits.
#[derive(Clone, Default)]
pub struct Chain {
    active: Vec<Active>,
}

impl std::fmt::Debug for Chain {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_list().entries(self.active.iter().map(|a| (a.effect.descriptor().id, &a.params))).finish()
    }
}

impl Chain {
    /// Resolves settings.
    ///
    /// # Errors
    /// An effect or parameter is unknown, or a value out of range.
    pub fn build(settings: &[EffectSetting]) -> Result<Self, EffectError> {
        let mut active = Vec::new();
        for setting in settings {
            let effect = find(&setting.id)
                .ok_or_else(|| EffectError::Unknown { found: setting.id.clone(), known: ids().join(", ") })?;
            let params = params_of(effect, setting)?;
            if effect.descriptor().params.iter().zip(&params).any(|(p, v)| p.off != *v) {
                active.push(Active { effect, params });
            }
        }
        Ok(Self { active })
    }

    /// Whether any effect acts at `stage`.
    pub fn acts_at(&self, stage: Stage) -> bool {
        self.at(stage).next().is_some()
    }

    fn at(&self, stage: Stage) -> impl Iterator<Item = &Active> {
        self.active.iter().filter(move |a| a.effect.descriptor().stage == stage)
    }

    /// Stage `Object`: emitted light, [object rows, object cols].
    pub fn on_object(&self, object: &mut Array2<f32>, cx: &FrameContext) {
        self.at(Stage::Object).for_each(|a| a.effect.on_object(&a.params, object, cx));
    }

    /// Stage `Geometry`: chief rays.
    pub fn on_geometry(&self, geometry: &mut Geometry, cx: &FrameContext) {
        self.at(Stage::Geometry).for_each(|a| a.effect.on_geometry(&a.params, geometry, cx));
    }

    /// Stage `Lens`: electrons from lens `cx.lens`, [sensor rows, sensor cols].
    pub fn on_lens(&self, image_e: &mut Array2<f32>, cx: &FrameContext) {
        self.at(Stage::Lens).for_each(|a| a.effect.on_lens(&a.params, image_e, cx));
    }

    /// Stage `Light`: expected electrons from all lenses, [sensor rows, sensor cols].
    pub fn on_light(&self, light_e: &mut Array2<f32>, cx: &FrameContext) {
        self.at(Stage::Light).for_each(|a| a.effect.on_light(&a.params, light_e, cx));
    }

    /// Stage `Charge`: electrons, [sensor rows, sensor cols].
    pub fn on_charge(&self, charge_e: &mut Array2<f32>, cx: &FrameContext) {
        self.at(Stage::Charge).for_each(|a| a.effect.on_charge(&a.params, charge_e, cx));
    }

    /// Stage `Electronics`: DN, black level included, [sensor rows, sensor cols].
    pub fn on_electronics(&self, frame_dn: &mut Array2<f32>, cx: &FrameContext) {
        self.at(Stage::Electronics).for_each(|a| a.effect.on_electronics(&a.params, frame_dn, cx));
    }
}

fn params_of(effect: &'static dyn Effect, setting: &EffectSetting) -> Result<Vec<f64>, EffectError> {
    let d = effect.descriptor();
    if let Some(found) = setting.params.keys().find(|name| d.params.iter().all(|p| p.name != name.as_str())) {
        let known = d.params.iter().map(|p| p.name).collect::<Vec<_>>().join(", ");
        return Err(EffectError::Param { id: d.id, found: found.clone(), known });
    }
    let value = |p: &super::Param| {
        let found = setting.params.get(p.name).copied().unwrap_or(p.off);
        if (p.min..=p.max).contains(&found) {
            return Ok(found);
        }
        Err(EffectError::Range { id: d.id, name: p.name, min: p.min, max: p.max, unit: p.unit, found })
    };
    d.params.iter().map(value).collect()
}
