//! What a model is told of a session, what it predicts with it, and what of it can change.

use crate::effects::{Effect, EffectSetting, Kind, Param};
use ndarray::Array2;

/// An effect with its values.
#[derive(Clone)]
pub struct Term {
    /// The effect.
    pub effect: &'static dyn Effect,
    /// Its parameters in the order of [`crate::effects::Descriptor::expanded`].
    pub params: Vec<f64>,
    /// Its table, where it has one.
    pub table: Option<Array2<f32>>,
    /// Rms error of a table that was measured here, in its unit: the same in every frame.
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

    /// Names and descriptions of its parameters.
    pub fn expanded(&self, lenses: usize) -> Vec<(String, &'static Param)> {
        self.effect.descriptor().expanded(lenses)
    }

    /// Indices of the parameters that the effect is absent without.
    pub fn strengths(&self, lenses: usize) -> Vec<usize> {
        let all = self.expanded(lenses);
        (0..all.len()).filter(|i| all[*i].1.is_strength()).collect()
    }

    /// Indices of the parameters that are fitted: all that are not chosen.
    pub fn free(&self, lenses: usize) -> Vec<usize> {
        let all = self.expanded(lenses);
        (0..all.len()).filter(|i| all[*i].1.kind != Kind::Choice).collect()
    }

    /// The same with all its strengths at absence.
    pub fn switched_off(&self, lenses: usize) -> Self {
        let mut off = Self { table: None, table_error: 0.0, ..self.clone() };
        for (value, (_, p)) in off.params.iter_mut().zip(self.expanded(lenses)).filter(|(_, (_, p))| p.is_strength()) {
            *value = p.off;
        }
        off
    }

    /// As it stands in an instrument.
    pub fn setting(&self, lenses: usize) -> EffectSetting {
        let names = self.expanded(lenses).into_iter().map(|(name, _)| name);
        EffectSetting {
            id: self.id().into(),
            params: names.zip(self.params.iter().copied()).collect(),
            table: self.table.clone(),
        }
    }
}

/// Effects and nuisances.
#[derive(Clone, Debug)]
pub struct State {
    /// Effects, in the order in which they were found.
    pub terms: Vec<Term>,
    /// Light of each stack: of a scene stack, relative to the instrument's unit; of flats, electrons a unit of illumination.
    pub scale: Vec<f64>,
    /// Black level relative to the instrument's, DN.
    pub black_dn: f64,
}

/// What a state predicts of one frame.
#[derive(Clone, Debug)]
pub struct Predicted {
    /// Light of all lenses before what acts on it on the sensor, electrons.
    pub sum_e: Array2<f32>,
    /// Light on the sensor, electrons.
    pub light_e: Array2<f32>,
    /// The same without what is left of the frame before, where anything is.
    pub alone_e: Option<Array2<f32>>,
    /// Expected frame, DN.
    pub dn: Array2<f32>,
    /// One over the standard deviation of a pixel, DN; 0: not looked at.
    pub inverse_sigma: Array2<f32>,
    /// Measured minus expected, DN (of an unknown specimen: the part sharper than its smooth part).
    pub residual_dn: Array2<f32>,
    /// Light of the frame over the instrument's unit: that of its stack; of a bead its own, at its best.
    pub scale: f64,
}

impl Predicted {
    /// The light that the next frame can have something left of: what is left of what was left is another order smaller.
    pub fn alone_e(&self) -> &Array2<f32> {
        self.alone_e.as_ref().unwrap_or(&self.light_e)
    }
}

/// A column of the design: what a small change of one value does to the frames.
#[derive(Clone, Debug, PartialEq)]
pub enum Column {
    /// ln of the light of a stack.
    Scale(usize),
    /// Black level.
    Black,
    /// A parameter of a term that is tried beside the state's own.
    Trial {
        /// Index of the term among those tried.
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
