//! Derivatives of the expected frames with respect to the values of a state, by finite differences.

use super::lamp;
use super::model::Model;
use super::state::{Column, Predicted, State, Term};
use super::truth::STEP_PX;
use super::wings;
use crate::data::Shown;
use ndarray::Array2;
use ommatidia_model::forward::{ForwardError, SceneLight};
use ommatidia_physics::effects::{Chain, Stage};
use std::collections::BTreeMap;

/// The point around which a model is linearised.
#[derive(Clone, Copy)]
pub struct Expansion<'a> {
    /// The state.
    pub state: &'a State,
    /// Trial terms beside those of the state.
    pub trials: &'a [Term],
    /// The frames that the state predicts ([`Model::predict`]).
    pub predicted: &'a [Predicted],
    /// The light behind the optics under the state ([`Model::scenes`]).
    pub scenes: &'a [Option<SceneLight>],
}

/// The terms of a state, or of a state with one trial term, with the parameter that a column varies.
pub(super) struct Varied {
    pub(super) terms: Vec<Term>,
    /// Index of the varied term.
    pub(super) which: usize,
    /// Index of its varied parameter.
    pub(super) param: usize,
}

impl Expansion<'_> {
    /// What a column varies. None: a nuisance parameter.
    pub(super) fn varied(&self, column: &Column) -> Option<Varied> {
        match column {
            Column::Scale(_)
            | Column::Black
            | Column::Background(..)
            | Column::Lamp(_)
            | Column::Wing(_)
            | Column::Registration(..) => None,
            Column::Trial { term, param } => {
                let terms = self.state.terms.iter().chain([&self.trials[*term]]).cloned().collect();
                Some(Varied { terms, which: self.state.terms.len(), param: *param })
            }
            Column::Own { term, param } => {
                Some(Varied { terms: self.state.terms.clone(), which: *term, param: *param })
            }
        }
    }
}

/// What columns of one frame share, [sensor rows, sensor cols]: computed when the first of them needs it. The images of
/// single lenses under a state are in electrons.
#[derive(Default)]
pub struct LensImages {
    of: BTreeMap<usize, Array2<f32>>,
    /// Derivative with respect to ln of the light of the frame, over the shape of its lamp: the columns of the lamp
    /// share it.
    by_lamp: Option<Array2<f32>>,
    /// The stated light outside the windows, electrons: the slopes of it share it.
    outside: Option<Array2<f32>>,
}

/// A chain of effects that differs from that of the state.
struct Change<'a> {
    chain: &'a Chain,
    /// The first stage where it differs.
    stage: Stage,
    /// The only lens for which it differs; None: all lenses.
    lens: Option<usize>,
}

impl Model<'_> {
    /// Derivative of the expected frame `k` with respect to a column's value
    /// ([`ommatidia_physics::effects::Param::inner`] of a parameter), DN, [sensor rows, sensor cols]. None: the frame
    /// does not depend on it. `images` are those of this frame.
    ///
    /// # Errors
    /// An object holds negative or non-finite light.
    pub fn derivative(
        &self,
        k: usize,
        column: &Column,
        at: Expansion<'_>,
        images: &mut LensImages,
    ) -> Result<Option<Array2<f32>>, ForwardError> {
        let (f, here) = (&self.seen.frames[k], &at.predicted[k]);
        let Some(Varied { mut terms, which, param }) = at.varied(column) else {
            return Ok(match column {
                Column::Scale(stack) => self.scale_derivative(k, *stack, at),
                Column::Registration(group, part) => self.registration_derivative(k, [*group, *part], at),
                Column::Background(stack, part) => self.background_derivative(k, [*stack, *part], at),
                Column::Lamp(term) => self.lamp_derivative(k, *term, at, images),
                Column::Wing(ring) => self.wing_derivative(k, *ring, at, images),
                _ => (f.shown != Shown::Unknown).then(|| Array2::ones(here.dn.dim())),
            });
        };
        let effect = terms[which].effect;
        if f.shown == Shown::Unknown && !effect.is_of_the_grid() {
            // The specimen may have any detail but that of the pixel grid.
            return Ok(None);
        }
        if f.shown == Shown::Even && effect.is_as_smooth_as_a_lamp() {
            return Ok(None);
        }
        let expanded = terms[which].expanded(self.lenses());
        let p = expanded[param].1;
        let value = p.inner(terms[which].params[param]);
        let mut step = 0.5 * p.inner(p.step);
        if value + step > p.inner(p.max) {
            step = -step;
        }
        let far = matches!(column, Column::Trial { .. }) && terms[which].is_far(self.lenses());
        if far {
            // The secant to the far start, whose strengths the term holds.
            step = 1.0;
        } else {
            terms[which].params[param] = p.outer(value + step);
        }
        let chain = self.chain_of(k, &terms);
        let lens = (p.per_lens && !far).then(|| {
            let first = expanded.iter().position(|(_, q)| std::ptr::eq(*q, p)).unwrap_or(param);
            param - first
        });
        let change = Change { chain: &chain, stage: effect.descriptor().stage, lens };
        let Some(moved) = self.moved(k, &change, at, images)? else {
            return Ok(None);
        };
        Ok(Some((moved - &here.dn) / step as f32))
    }

    /// Derivative with respect to ln of the light of a stack.
    fn scale_derivative(&self, k: usize, stack: usize, at: Expansion<'_>) -> Option<Array2<f32>> {
        let (f, here) = (&self.seen.frames[k], &at.predicted[k]);
        if stack != f.stack || matches!(f.shown, Shown::Dark | Shown::Unknown) {
            return None;
        }
        // About a tenth of the noise of a bright pixel, far above rounding errors.
        let step = 1e-3;
        let chain = self.chain_of(k, &at.state.terms);
        let more = 1.0 + step as f32;
        let previous = f.previous.map(|p| at.predicted[p].alone_e());
        let before = previous.filter(|_| chain.needs_previous()).map(|p| p * more);
        let wings_e = here.wings_e.as_ref().map(|w| w * more);
        let sum = (&here.sum_e * more, wings_e.as_ref());
        let light = self.lit_with(k, sum, at.state, (&chain, before.as_ref()));
        let moved = self.dn(k, light, &chain, before.as_ref(), at.state.black_dn);
        Some((moved - &here.dn) / step as f32)
    }

    /// Derivative with respect to a value of the lamp's shape, DN. Effects that move light on the sensor move it much
    /// less far than the shape changes: it is that of the light, times the shape.
    fn lamp_derivative(
        &self,
        k: usize,
        term: usize,
        at: Expansion<'_>,
        images: &mut LensImages,
    ) -> Option<Array2<f32>> {
        let f = &self.seen.frames[k];
        if f.shown != Shown::Even {
            return None;
        }
        if images.by_lamp.is_none() {
            let mut by_lamp = self.scale_derivative(k, f.stack, at)?;
            by_lamp /= &lamp::light(by_lamp.dim(), &at.state.lamp).mapv(|v| v.max(1e-3));
            images.by_lamp = Some(by_lamp);
        }
        let by_lamp = images.by_lamp.as_ref()?;
        Some(by_lamp * lamp::shape(by_lamp.dim(), term))
    }

    /// Derivative with respect to level or slope (part 0 to 2) of the background of a stack, DN per electron.
    fn background_derivative(&self, k: usize, [stack, part]: [usize; 2], at: Expansion<'_>) -> Option<Array2<f32>> {
        let (f, here) = (&self.seen.frames[k], &at.predicted[k]);
        if stack != f.stack {
            return None;
        }
        // The frames are nearly linear in it: far above rounding errors, and small against any saturation.
        let step = 1.0;
        let mut state = at.state.clone();
        state.background_e[stack][part] += step;
        let chain = self.chain_of(k, &state.terms);
        let previous = f.previous.map(|p| at.predicted[p].alone_e()).filter(|_| chain.needs_previous());
        let sum = (here.sum_e.clone(), here.wings_e.as_ref());
        let light = self.lit_with(k, sum, &state, (&chain, previous));
        Some((self.dn(k, light, &chain, previous, state.black_dn) - &here.dn) / step as f32)
    }

    /// Derivative with respect to the light of a ring outside the windows, or to a slope of it, DN per unit of its
    /// standard uncertainty.
    fn wing_derivative(
        &self,
        k: usize,
        ring: usize,
        at: Expansion<'_>,
        images: &mut LensImages,
    ) -> Option<Array2<f32>> {
        let (f, here) = (&self.seen.frames[k], &at.predicted[k]);
        if !matches!(f.shown, Shown::Object(_)) {
            return None;
        }
        // A hundredth of the light, far above rounding errors: the frames are nearly linear in it.
        let step = 0.01 / self.rings.get(ring).or(self.rings.first())?.2.max(f64::MIN_POSITIVE);
        let mut wings_e = wings::piece(&here.sum_e, &self.rings, ring, &mut images.outside)? * step as f32;
        here.wings_e.iter().for_each(|now| wings_e += now);
        let (state, chain) = (at.state, self.chain_of(k, &at.state.terms));
        let previous = f.previous.map(|p| at.predicted[p].alone_e()).filter(|_| chain.needs_previous());
        let light = self.lit_with(k, (here.sum_e.clone(), Some(&wings_e)), state, (&chain, previous));
        Some((self.dn(k, light, &chain, previous, state.black_dn) - &here.dn) / step as f32)
    }

    /// Derivative with respect to a part of a registration, DN per object pixel.
    fn registration_derivative(&self, k: usize, [group, part]: [usize; 2], at: Expansion<'_>) -> Option<Array2<f32>> {
        let scene = at.scenes[k].as_ref().filter(|_| self.seen.registration_of(k) == Some(group))?;
        let (here, mut state) = (&at.predicted[k], at.state.clone());
        state.registration[group][part] += STEP_PX;
        let chain = self.chain_of(k, &state.terms);
        let previous = self.seen.frames[k].previous.map(|p| at.predicted[p].alone_e());
        let sum = self.sum_e(k, Some(scene), (&chain, &state), here.scale);
        let light = self.lit_with(k, (sum, here.wings_e.as_ref()), &state, (&chain, previous));
        Some((self.dn(k, light, &chain, previous, state.black_dn) - &here.dn) / STEP_PX as f32)
    }

    /// The expected frame `k` under another chain, DN. None: it is the same.
    fn moved(
        &self,
        k: usize,
        change: &Change<'_>,
        at: Expansion<'_>,
        images: &mut LensImages,
    ) -> Result<Option<Array2<f32>>, ForwardError> {
        let Change { chain, stage, lens } = *change;
        let here = &at.predicted[k];
        let previous = self.seen.frames[k].previous.map(|p| at.predicted[p].alone_e());
        let (scale, black_dn) = (here.scale, at.state.black_dn);
        let sum = match (stage, &at.scenes[k]) {
            (Stage::Record, _) => return Ok(None),
            (Stage::Object | Stage::Geometry | Stage::Lens, None) => return Ok(None),
            (Stage::Object, Some(_)) => {
                let scene = self.scene(k, at.state, chain)?;
                self.sum_e(k, scene.as_ref(), (chain, at.state), scale)
            }
            (Stage::Geometry | Stage::Lens, Some(scene)) => match lens {
                None => self.sum_e(k, Some(scene), (chain, at.state), scale),
                Some(l) => {
                    let now = || self.lens_e(k, scene, l, &self.chain_of(k, &at.state.terms), at.state);
                    let change = self.lens_e(k, scene, l, chain, at.state) - &*images.of.entry(l).or_insert_with(now);
                    &here.sum_e + &(change * scale as f32)
                }
            },
            (Stage::Light, _) => here.sum_e.clone(),
            (Stage::Charge | Stage::Electronics, _) => {
                return Ok(Some(self.dn(k, here.light_e.clone(), chain, previous, black_dn)));
            }
        };
        // The light outside the windows changes by what these move of it: the product of two small changes.
        let light = self.lit_with(k, (sum, here.wings_e.as_ref()), at.state, (chain, previous));
        Ok(Some(self.dn(k, light, chain, previous, black_dn)))
    }
}
