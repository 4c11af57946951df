//! The effects that are on, resolved and in order.

use super::{Effect, EffectSetting, FrameContext, Ray, RayShift, Record, Stage, TableUse, find, ids};
use crate::noise::NoiseModel;
use crate::session::Manifest;
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
    /// A table that does not fit the sensor.
    #[error("effect `{id}`: table: expected {sensor:?} or one row or column of it, found {found:?}")]
    Table {
        /// The effect.
        id: &'static str,
        /// Rows and columns of the sensor.
        sensor: [usize; 2],
        /// Rows and columns of the table.
        found: (usize, usize),
    },
}

/// What parameters and tables are sized by.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Layout {
    /// Lenses of the array.
    pub lenses: usize,
    /// Rows and columns of the sensor.
    pub sensor: [usize; 2],
}

impl Layout {
    /// The layout of a session or an instrument.
    pub fn of(manifest: &Manifest) -> Self {
        Self { lenses: manifest.array.lenses(), sensor: [manifest.sensor.rows, manifest.sensor.cols] }
    }
}

/// An effect with its parameters in the order of its descriptor.
#[derive(Clone)]
struct Active {
    effect: &'static dyn Effect,
    params: Vec<f64>,
    table: Option<(TableUse, Array2<f32>)>,
}

/// Effects in the order in which they were given; each acts at its own stage.
///
/// An effect whose strengths are all `off` is left out: switched off and absent are the same bits.
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
    /// An effect or parameter is unknown, a value out of range, or a table of the wrong shape.
    pub fn build(settings: &[EffectSetting], layout: Layout) -> Result<Self, EffectError> {
        let mut chain = Self::default();
        for setting in settings {
            let effect = find(&setting.id)
                .ok_or_else(|| EffectError::Unknown { found: setting.id.clone(), known: ids().join(", ") })?;
            let params = params_of(effect, setting, layout.lenses)?;
            chain.push(effect, params, setting.table.as_ref(), layout)?;
        }
        Ok(chain)
    }

    /// One effect with its parameters in the order of [`super::Descriptor::expanded`].
    ///
    /// # Errors
    /// A table of the wrong shape.
    pub fn push(
        &mut self,
        effect: &'static dyn Effect,
        params: Vec<f64>,
        table: Option<&Array2<f32>>,
        layout: Layout,
    ) -> Result<(), EffectError> {
        let d = effect.descriptor();
        let on = d.expanded(layout.lenses).iter().zip(&params).any(|((_, p), v)| p.is_strength() && p.off != *v);
        if !on && table.is_none() {
            return Ok(());
        }
        let table = match (effect.table(), table) {
            (None, _) => None,
            (Some(kind), Some(table)) => Some((kind.acts, table.clone())),
            (Some(kind), None) => Some((kind.acts, effect.draw_table(&params, layout.sensor))),
        };
        if let Some((_, t)) = &table
            && t.broadcast((layout.sensor[0], layout.sensor[1])).is_none()
        {
            return Err(EffectError::Table { id: d.id, sensor: layout.sensor, found: t.dim() });
        }
        self.active.push(Active { effect, params, table });
        Ok(())
    }

    /// An effect whose hooks are called whether it is on or not.
    #[cfg(test)]
    pub(super) fn push_even_if_off(&mut self, effect: &'static dyn Effect, params: Vec<f64>) {
        self.active.push(Active { effect, params, table: None });
    }

    /// Whether there is no effect at all.
    pub fn is_empty(&self) -> bool {
        self.active.is_empty()
    }

    /// Whether any effect acts at `stage`.
    pub fn acts_at(&self, stage: Stage) -> bool {
        self.at(stage).next().is_some()
    }

    /// Whether any effect needs the frame before.
    pub fn needs_previous(&self) -> bool {
        self.active.iter().any(|a| a.effect.needs_previous())
    }

    fn at(&self, stage: Stage) -> impl Iterator<Item = &Active> {
        self.active.iter().filter(move |a| a.effect.descriptor().stage == stage)
    }

    /// Stage `Object`: emitted light, [object rows, object cols].
    pub fn on_object(&self, object: &mut Array2<f32>, cx: &FrameContext<'_>) {
        self.at(Stage::Object).for_each(|a| a.effect.on_object(&a.params, object, cx));
    }

    /// Stage `Geometry`: how far a focus and its source are from where the calibration has them.
    pub fn shift_ray(&self, ray: &Ray, cx: &FrameContext<'_>) -> RayShift {
        let mut sum = RayShift::default();
        self.at(Stage::Geometry).for_each(|a| sum += a.effect.shift_ray(&a.params, ray, cx));
        sum
    }

    /// Stage `Lens`: electrons from lens `cx.lens`, [sensor rows, sensor cols].
    pub fn on_lens(&self, image_e: &mut Array2<f32>, cx: &FrameContext<'_>) {
        self.at(Stage::Lens).for_each(|a| a.effect.on_lens(&a.params, image_e, cx));
    }

    /// Stage `Light`: expected electrons from all lenses, [sensor rows, sensor cols].
    pub fn on_light(&self, light_e: &mut Array2<f32>, cx: &FrameContext<'_>) {
        for a in self.at(Stage::Light) {
            match &a.table {
                Some((TableUse::Response, u)) => *light_e *= &u.mapv(|u| 1.0 + u),
                Some((TableUse::DarkRate, u)) => *light_e += &u.mapv(|u| u * cx.exposure_ms as f32),
                _ => a.effect.on_light(&a.params, light_e, cx),
            }
        }
    }

    /// Stage `Charge`: electrons, [sensor rows, sensor cols].
    pub fn on_charge(&self, charge_e: &mut Array2<f32>, cx: &FrameContext<'_>) {
        self.at(Stage::Charge).for_each(|a| a.effect.on_charge(&a.params, charge_e, cx));
    }

    /// Stage `Electronics`: DN, black level included, [sensor rows, sensor cols].
    pub fn on_electronics(&self, frame_dn: &mut Array2<f32>, cx: &FrameContext<'_>) {
        for a in self.at(Stage::Electronics) {
            match &a.table {
                Some((TableUse::Offset, u)) => *frame_dn += u,
                _ => a.effect.on_electronics(&a.params, frame_dn, cx),
            }
        }
    }

    /// Stage `Electronics`, drawn frames only: noise of the readout.
    pub fn on_reading(&self, frame_dn: &mut Array2<f32>, cx: &FrameContext<'_>, rng: &mut dyn rand::Rng) {
        self.active.iter().for_each(|a| a.effect.on_reading(&a.params, frame_dn, cx, rng));
    }

    /// How the noise differs from the calibrated one.
    pub fn on_noise(&self, noise: &mut NoiseModel) {
        self.active.iter().for_each(|a| a.effect.on_noise(&a.params, noise));
    }

    /// Stage `Record`: what the session says of a frame.
    pub fn on_record(&self, record: &mut Record, cx: &FrameContext<'_>) {
        self.active.iter().for_each(|a| a.effect.on_record(&a.params, record, cx));
    }
}

fn params_of(effect: &'static dyn Effect, setting: &EffectSetting, lenses: usize) -> Result<Vec<f64>, EffectError> {
    let d = effect.descriptor();
    let expanded = d.expanded(lenses);
    if let Some(found) = setting.params.keys().find(|name| expanded.iter().all(|(n, _)| n != *name)) {
        let known = expanded.iter().map(|(n, _)| n.as_str()).collect::<Vec<_>>().join(", ");
        return Err(EffectError::Param { id: d.id, found: found.clone(), known });
    }
    let value = |(name, p): &(String, &'static super::Param)| {
        let found = setting.params.get(name).copied().unwrap_or(p.off);
        if (p.min..=p.max).contains(&found) {
            return Ok(found);
        }
        Err(EffectError::Range { id: d.id, name: p.name, min: p.min, max: p.max, unit: p.unit, found })
    };
    expanded.iter().map(value).collect()
}
