//! The state of a model: effects with their values, nuisance parameters, and the columns of the linearised fit.

use super::lamp::Lamp;
use super::projection::Specimens;
use super::truth::Registered;
use ndarray::Array2;
use ommatidia_model::bead::Slopes;
use ommatidia_physics::effects::{Effect, EffectSetting, Kind, Param};
use std::sync::Arc;

/// An effect with its parameter values.
#[derive(Clone)]
pub struct Term {
    /// The effect.
    pub effect: &'static dyn Effect,
    /// Parameters in the order of [`ommatidia_physics::effects::Descriptor::expanded`].
    pub params: Vec<f64>,
    /// Value of each pixel, [sensor rows, sensor cols], for effects with a table.
    pub table: Option<Array2<f32>>,
    /// Rms error of a table that was estimated from this session, in the unit of the table; it is the same in every
    /// frame.
    pub table_error: f64,
}

impl std::fmt::Debug for Term {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}{:?}", self.id(), self.params)
    }
}

impl Term {
    /// Id of the effect.
    pub fn id(&self) -> &'static str {
        self.effect.descriptor().id
    }

    /// Names and descriptions of its parameters, for an array of `lenses` lenses.
    pub fn expanded(&self, lenses: usize) -> Vec<(String, &'static Param)> {
        self.effect.descriptor().expanded(lenses)
    }

    /// Indices of the strengths: the effect is absent if all of them are at their `off` value.
    pub fn strengths(&self, lenses: usize) -> Vec<usize> {
        let all = self.expanded(lenses);
        (0..all.len()).filter(|i| all[*i].1.is_strength()).collect()
    }

    /// Whether its strengths are far from the values at which the effect is absent, as those of a far start are. A
    /// trial term of that kind has one column, the change of the frames when all its strengths go there together.
    pub fn is_far(&self, lenses: usize) -> bool {
        let expanded = self.expanded(lenses);
        self.strengths(lenses).into_iter().any(|i| self.params[i] != expanded[i].1.off)
    }

    /// Indices of the parameters that a trial term has columns of: its strengths, or the first for a far start.
    pub fn trial_columns(&self, lenses: usize) -> Vec<usize> {
        let mut strengths = self.strengths(lenses);
        strengths.truncate(if self.is_far(lenses) { 1 } else { strengths.len() });
        strengths
    }

    /// Moves its strengths from where the effect is absent by `theta`, inner values of [`Self::trial_columns`]; of a
    /// far start by that share of the way.
    pub fn moved(mut self, lenses: usize, theta: &[f64]) -> Self {
        let (far, expanded) = (self.is_far(lenses), self.expanded(lenses));
        for (n, i) in self.strengths(lenses).into_iter().enumerate() {
            let p = expanded[i].1;
            let off = p.inner(p.off);
            let by = match far {
                true => theta.first().map(|share| share * (p.inner(self.params[i]) - off)),
                false => theta.get(n).copied(),
            };
            self.params[i] = by.map_or(p.off, |by| p.outer(off + by));
        }
        self
    }

    /// Indices of the parameters that are fitted: all but choices.
    pub fn free(&self, lenses: usize) -> Vec<usize> {
        let all = self.expanded(lenses);
        (0..all.len()).filter(|i| all[*i].1.kind != Kind::Choice).collect()
    }

    /// The same term with all strengths at their `off` value and without a table.
    pub fn switched_off(&self, lenses: usize) -> Self {
        let mut off = Self { table: None, table_error: 0.0, ..self.clone() };
        for (value, (_, p)) in off.params.iter_mut().zip(self.expanded(lenses)).filter(|(_, (_, p))| p.is_strength()) {
            *value = p.off;
        }
        off
    }

    /// The term as an instrument file stores it.
    pub fn setting(&self, lenses: usize) -> EffectSetting {
        let names = self.expanded(lenses).into_iter().map(|(name, _)| name);
        EffectSetting {
            id: self.id().into(),
            params: names.zip(self.params.iter().copied()).collect(),
            table: self.table.clone(),
        }
    }
}

/// Effects and nuisance parameters.
#[derive(Clone, Debug)]
pub struct State {
    /// Effects: those of the instrument, then those that were added, in order.
    pub terms: Vec<Term>,
    /// Light of each stack: of scenes, relative to the light unit of the instrument; of flats, electrons per unit of
    /// illumination.
    pub scale: Vec<f64>,
    /// Black level minus that of the instrument, DN.
    pub black_dn: f64,
    /// Background of each stack: level and slopes ([`ommatidia_model::bead::slope_terms`]), e- a pixel at the exposure
    /// of the calibration. It grows with the exposure of a frame.
    pub background_e: Vec<Slopes>,
    /// The light of the flats' lamp over the sensor.
    pub lamp: Lamp,
    /// Light in the rings outside the windows of the calibration, and its slopes over the sensor (`wings`), each in
    /// units of its standard uncertainty; they are fitted where objects are known, within their ranges.
    pub wings: Vec<f64>,
    /// Where the truths lie, for each of [`crate::Observations::registrations`]; all zero: as recorded.
    pub registration: Vec<Registered>,
    /// The specimens of frames of [`crate::data::Shown::Estimated`]; None: not estimated yet, or there are none.
    pub specimens: Option<Arc<Specimens>>,
    /// Ids of effects of the instrument that stay as they are.
    pub held: Vec<String>,
}

impl State {
    /// Mean square that noise alone leaves of a pixel of a block of frame `k`, in units of its variance: one, unless
    /// the specimen is estimated. It takes up a part of the noise of the pixels that it is estimated from, and brings
    /// noise to those that are held out.
    pub(crate) fn share(&self, k: usize, block: usize) -> f64 {
        self.specimens.as_ref().map_or(1.0, |s| s.expected(k, block))
    }
}

/// What a state predicts for one frame. All images are [sensor rows, sensor cols].
#[derive(Clone, Debug)]
pub struct Predicted {
    /// Light of all lenses before the effects on the sensor, without the background, electrons.
    pub sum_e: Array2<f32>,
    /// Light outside the windows of the calibration, electrons, which `light_e` holds too. None: there is none.
    pub wings_e: Option<Array2<f32>>,
    /// Light on the sensor, electrons.
    pub light_e: Array2<f32>,
    /// The same without the remainder of the preceding frame, if an effect leaves one.
    pub alone_e: Option<Array2<f32>>,
    /// Expected frame, DN.
    pub dn: Array2<f32>,
    /// One over the standard deviation of a pixel, 1/DN; 0: not used.
    pub inverse_sigma: Array2<f32>,
    /// Measured minus expected, DN (for an unknown specimen: minus its smooth part).
    pub residual_dn: Array2<f32>,
    /// Light of the frame relative to the light unit of the instrument: that of its stack; for a bead, its own
    /// least-squares value.
    pub scale: f64,
}

impl Predicted {
    /// The light of which the next frame may hold a remainder. Remainders of remainders are neglected.
    pub fn alone_e(&self) -> &Array2<f32> {
        self.alone_e.as_ref().unwrap_or(&self.light_e)
    }
}

/// A column of the design matrix: the change of the frames with one value.
#[derive(Clone, Debug, PartialEq)]
pub enum Column {
    /// ln of the light of a stack, by its index.
    Scale(usize),
    /// Black level.
    Black,
    /// Background of a stack, by its index: level, slope along the rows, or along the columns (0 to 2).
    Background(usize, usize),
    /// Shape of the lamp, by the index of its value ([`super::lamp`]).
    Lamp(usize),
    /// Light of a ring outside the windows of the calibration, or a slope of it, by its index.
    Wing(usize),
    /// Registration of truths, by its index: one of the four values of [`Registered`].
    Registration(usize, usize),
    /// A parameter of a trial term beside those of the state.
    Trial {
        /// Index of the term among the trial terms.
        term: usize,
        /// Index of the parameter.
        param: usize,
    },
    /// A parameter of a term of the state.
    Own {
        /// Index of the term.
        term: usize,
        /// Index of the parameter.
        param: usize,
    },
}
