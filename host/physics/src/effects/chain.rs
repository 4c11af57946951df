//! The effects that are switched on, resolved and in order.

use super::context::{FrameContext, Ray, RayShift, Record};
use super::descriptor::{Param, Stage};
use super::effect::{Effect, EffectSetting};
use super::registry::{find, ids};
use super::smooth::changed;
use super::table::TableUse;
use crate::noise::NoiseModel;
use crate::optics::Wavefront;
use ndarray::Array2;
use ommatidia_session::Manifest;
use thiserror::Error;

/// Why a list of effects cannot be applied.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum EffectError {
    /// There is no effect of this id.
    #[error("effect `{found}`: unknown; known are {known}")]
    Unknown {
        /// The requested id.
        found: String,
        /// All ids.
        known: String,
    },
    /// The effect has no parameter of this name.
    #[error("effect `{id}`: no parameter `{found}`; it has {known}")]
    Param {
        /// The effect.
        id: &'static str,
        /// The requested name.
        found: String,
        /// All names.
        known: String,
    },
    /// A parameter is outside its range.
    #[error("effect `{id}`: parameter `{name}`: expected {min} to {max} {unit}, found {found}")]
    Range {
        /// The effect.
        id: &'static str,
        /// The parameter.
        name: &'static str,
        /// Smallest allowed value.
        min: f64,
        /// Largest allowed value.
        max: f64,
        /// Unit of the parameter.
        unit: &'static str,
        /// The value.
        found: f64,
    },
    /// A table does not fit the sensor.
    #[error(
        "effect `{id}`: table: expected the shape {sensor:?} of the sensor, one row or one column, found {found:?}"
    )]
    Table {
        /// The effect.
        id: &'static str,
        /// Rows and columns of the sensor.
        sensor: [usize; 2],
        /// Rows and columns of the table.
        found: (usize, usize),
    },
}

/// Sizes on which the numbers of parameters and the shapes of tables depend.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Layout {
    /// Number of lenses of the array.
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

/// An effect with its parameters, in the order of [`super::Descriptor::expanded`].
#[derive(Clone)]
struct Active {
    effect: &'static dyn Effect,
    params: Vec<f64>,
    table: Option<(TableUse, Array2<f32>)>,
}

/// Effects in the order of their settings; each acts at its own stage.
///
/// An effect with all strengths `off` is left out: switched off and absent give the same bits.
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
    /// Resolves settings for an instrument of this layout.
    ///
    /// # Errors
    /// An effect or parameter is unknown, a value is out of range, or a table has the wrong shape.
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

    /// Adds an effect with its parameters in the order of [`super::Descriptor::expanded`]. Without `table`, an effect
    /// that has one draws it from its parameters.
    ///
    /// # Errors
    /// The table has the wrong shape.
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

    /// Adds an effect whose hooks are called even if it is off.
    #[cfg(test)]
    pub(super) fn push_even_if_off(&mut self, effect: &'static dyn Effect, params: Vec<f64>) {
        self.active.push(Active { effect, params, table: None });
    }

    /// Whether the chain has no effect.
    pub fn is_empty(&self) -> bool {
        self.active.is_empty()
    }

    /// Whether any effect acts at `stage`.
    pub fn acts_at(&self, stage: Stage) -> bool {
        self.at(stage).next().is_some()
    }

    /// Whether any effect depends on the previous frame.
    pub fn needs_previous(&self) -> bool {
        self.active.iter().any(|a| a.effect.needs_previous())
    }

    fn at(&self, stage: Stage) -> impl Iterator<Item = &Active> {
        self.active.iter().filter(move |a| a.effect.descriptor().stage == stage)
    }

    /// Stage `Object`: changes the emitted light, [object rows, object cols].
    pub fn on_object(&self, object: &mut Array2<f32>, cx: &FrameContext<'_>) {
        self.at(Stage::Object).for_each(|a| a.effect.on_object(&a.params, object, cx));
    }

    /// Stage `Geometry`: displacement of a focus and its source from the calibrated positions, summed over the effects.
    pub fn shift_ray(&self, ray: &Ray, cx: &FrameContext<'_>) -> RayShift {
        let mut sum = RayShift::default();
        self.at(Stage::Geometry).for_each(|a| sum += a.effect.shift_ray(&a.params, ray, cx));
        sum
    }

    /// Stage `Geometry`: what is added to the wavefront in the pupil of a lens, waves rms, summed over the effects.
    pub fn wavefront(&self, ray: &Ray, cx: &FrameContext<'_>) -> Wavefront {
        let mut sum = Wavefront::default();
        for a in self.at(Stage::Geometry) {
            let added = a.effect.wavefront(&a.params, ray, cx);
            sum.coefficient.iter_mut().zip(added.coefficient).for_each(|(s, v)| *s += v);
        }
        sum
    }

    /// Stage `Geometry`: defocus that the pupil of lens `cx.lens` has beyond what was fitted to its PSFs, waves rms,
    /// summed over the effects.
    pub fn misjudged_defocus(&self, cx: &FrameContext<'_>) -> f64 {
        self.at(Stage::Geometry).map(|a| a.effect.misjudged_defocus(&a.params, cx)).sum()
    }

    /// Stage `Lens`: changes the light through lens `cx.lens`, [sensor rows, sensor cols], expected electrons.
    pub fn on_lens(&self, image_e: &mut Array2<f32>, cx: &FrameContext<'_>) {
        for a in self.at(Stage::Lens) {
            match &a.table {
                Some((TableUse::SceneView, u)) => {
                    if cx.shows_specimen() && a.params.get(1) == Some(&(cx.lens as f64)) {
                        image_e.zip_mut_with(u, |v, u| *v *= (1.0 + u).max(0.0));
                    }
                }
                _ => a.effect.on_lens(&a.params, image_e, cx),
            }
        }
    }

    /// Stage `Light`: changes the light through all lenses, [sensor rows, sensor cols], expected electrons.
    pub fn on_light(&self, light_e: &mut Array2<f32>, cx: &FrameContext<'_>) {
        for a in self.at(Stage::Light) {
            match &a.table {
                Some((kind, _)) if kind.of_scenes() && !cx.shows_specimen() => {}
                Some((TableUse::SceneResponse, u)) => {
                    light_e.zip_mut_with(u, |v, u| *v *= (1.0 + u).max(0.0));
                }
                Some((TableUse::SceneRate, u)) => {
                    light_e.zip_mut_with(u, |v, u| *v = changed(*v, u * cx.exposure_ms as f32));
                }
                Some((TableUse::Response, u)) => *light_e *= &u.mapv(|u| 1.0 + u),
                Some((TableUse::DarkRate, u)) => *light_e += &u.mapv(|u| u * cx.exposure_ms as f32),
                Some((TableUse::SceneStray, u)) => {
                    let mean = light_e.mean().unwrap_or(0.0);
                    light_e.zip_mut_with(u, |v, u| *v = changed(*v, u * mean));
                }
                _ => a.effect.on_light(&a.params, light_e, cx),
            }
        }
    }

    /// Stage `Charge`: changes the collected charge, [sensor rows, sensor cols], electrons.
    pub fn on_charge(&self, charge_e: &mut Array2<f32>, cx: &FrameContext<'_>) {
        self.at(Stage::Charge).for_each(|a| a.effect.on_charge(&a.params, charge_e, cx));
    }

    /// Stage `Electronics`: changes the frame, [sensor rows, sensor cols], DN with black level.
    pub fn on_electronics(&self, frame_dn: &mut Array2<f32>, cx: &FrameContext<'_>) {
        for a in self.at(Stage::Electronics) {
            match &a.table {
                Some((kind, _)) if kind.of_scenes() && !cx.shows_specimen() => {}
                Some((TableUse::Offset | TableUse::SceneOffset, u)) => *frame_dn += u,
                _ => a.effect.on_electronics(&a.params, frame_dn, cx),
            }
        }
    }

    /// Stage `Electronics`, in noisy frames only: adds noise of the readout, [sensor rows, sensor cols], DN.
    pub fn on_reading(&self, frame_dn: &mut Array2<f32>, cx: &FrameContext<'_>, rng: &mut dyn rand::Rng) {
        self.active.iter().for_each(|a| a.effect.on_reading(&a.params, frame_dn, cx, rng));
    }

    /// Any stage: changes the noise model of the sensor.
    pub fn on_noise(&self, noise: &mut NoiseModel) {
        self.active.iter().for_each(|a| a.effect.on_noise(&a.params, noise));
    }

    /// Stage `Record`: changes the session's record of a frame.
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
    let value = |(name, p): &(String, &'static Param)| {
        let found = setting.params.get(name).copied().unwrap_or(p.off);
        if (p.min..=p.max).contains(&found) {
            return Ok(found);
        }
        Err(EffectError::Range { id: d.id, name: p.name, min: p.min, max: p.max, unit: p.unit, found })
    };
    expanded.iter().map(value).collect()
}
