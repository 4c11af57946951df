//! Effects that were scored (candidates), and effects that were added (found).

use crate::evidence::{TableFit, Test};
use crate::fit::Term;
use ommatidia_physics::effects::{Kind, find};

/// Penalty of each additional parameter, in units of chi-squared.
pub(crate) const PENALTY: f64 = 6.0;

/// Effects within this chi-squared of the best are ambiguous with it.
pub(crate) const AMBIGUOUS: f64 = 10.8;

/// Fall of chi-squared per pixel from which a term without a name is worth adding whatever it stands beside.
const MUCH: f64 = 0.05;
/// Fall of chi-squared per pixel that a term with many free values must reach: it could take the errors of the
/// calibration for something of its own.
const ENOUGH: f64 = 0.02;

/// An effect with its score test.
#[derive(Clone, Debug)]
pub struct Candidate {
    /// The effect at the best of its starting values.
    pub term: Term,
    /// Columns of its strengths in the design matrix.
    pub columns: Vec<usize>,
    /// The test of its strengths; None: this session does not determine it.
    pub test: Option<Test>,
    /// Number of independent starting values that the best was selected from.
    pub chances: f64,
    /// Its estimated table, for an effect with a table instead of columns.
    pub table: Option<TableFit>,
    /// Whether flats and darks prove it: there its evidence is clear, and they hold most of what it explains.
    pub proved_by_even_light: bool,
}

impl Candidate {
    /// Probability of such evidence without the effect, corrected for the number of starting values (Bonferroni).
    pub fn p(&self) -> f64 {
        if let Some(table) = &self.table {
            return table.p;
        }
        self.test.as_ref().map_or(1.0, |t| (t.p * self.chances).min(1.0))
    }

    /// Number of values that its fit determines: its strengths, and the shapes that they have in common.
    pub(crate) fn values(&self) -> usize {
        let shapes = self.term.effect.descriptor().params.iter().filter(|p| matches!(p.kind, Kind::Shape(_)));
        self.columns.len() + shapes.count()
    }

    /// Estimate of its first strength. None: this session does not determine it.
    pub fn first(&self) -> Option<Estimate> {
        if let Some(table) = &self.table {
            return Some(Estimate { value: table.size, sigma: table.size_sigma });
        }
        let t = self.test.as_ref()?;
        // Of a far start the values are shares of the way.
        let p = self.term.effect.descriptor().params.first()?;
        let way = match p.inner(*self.term.params.first()?) - p.inner(p.off) {
            0.0 => 1.0,
            way => way,
        };
        Some(Estimate { value: way * t.theta.first()?, sigma: (way * t.covariance.get((0, 0))?.sqrt()).abs() })
    }

    /// Strength of the evidence, standard deviations.
    pub fn z(&self) -> f64 {
        self.table.as_ref().map(|t| t.z).or(self.test.as_ref().map(|t| t.z)).unwrap_or(0.0)
    }

    /// Whether an error in the law of another effect may look like this one. Tables are estimated from even light and
    /// darks alone, pixel by pixel: the optics cannot imitate them, nor what even light and darks prove otherwise. A
    /// term without a name claims no cause, so that it is added wherever much is left of the data of `pixels` pixels.
    pub(crate) fn can_be_shadowed(&self, pixels: f64) -> bool {
        let much = self.term.id().starts_with("unknown") && self.gain() > MUCH * pixels;
        let of_even_light = self.table.as_ref().is_some_and(|t| !t.of_scenes);
        !of_even_light && !much && !self.proved_by_even_light
    }

    /// Whether it explains enough for the many values that it is free to choose, in the data of `pixels` pixels.
    pub(crate) fn is_large_enough(&self, pixels: f64) -> bool {
        let many = self.table.as_ref().is_some_and(|t| t.of_scenes)
            || matches!(self.term.id(), "unknown_warp" | "unknown_blur" | "unknown_scatter");
        !many || self.gain() > ENOUGH * pixels
    }

    /// Fall of the training deviance that the score, linear in the strengths, announces.
    pub(crate) fn gain(&self) -> f64 {
        let of_table = self.table.as_ref().map(|t| t.gain);
        of_table.or(self.test.as_ref().map(|t| t.gain)).unwrap_or(0.0)
    }

    /// Whether the estimate is of the size of the strength that it started from, where that is far from the value at
    /// which the effect is absent: a secant says nothing of changes much smaller or larger than itself, and where the
    /// effect is absent its limit is that of small strengths.
    pub(crate) fn is_near_its_start(&self, lenses: usize) -> bool {
        let of_size = |t: &Test| t.theta.first().is_some_and(|share| (0.5..2.0).contains(share));
        !self.term.is_far(lenses) || self.worth() > 0.0 && self.test.as_ref().is_some_and(of_size)
    }

    /// Whether the effect starts better from here than from `other`. Where both are evident, the scatter between
    /// clusters that a strong effect makes itself says nothing, and the fall of the deviance does.
    pub(crate) fn is_better_start(&self, other: &Self) -> bool {
        match self.worth() > 0.0 && other.worth() > 0.0 {
            true => self.gain() > other.gain(),
            false => self.worth() > other.worth(),
        }
    }

    /// Test statistic less the penalties for its parameters and starting values. Candidates are ranked by it.
    pub(crate) fn worth(&self) -> f64 {
        if let Some(table) = &self.table {
            return table.z * table.z.abs() - PENALTY;
        }
        self.test.as_ref().map_or(f64::NEG_INFINITY, |t| t.t - PENALTY * t.dof - 2.0 * self.chances.ln())
    }
}

/// An estimated strength in the unit of [`ommatidia_physics::effects::Param::inner`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// Distance from the value at which the effect is absent.
    pub value: f64,
    /// Standard error.
    pub sigma: f64,
}

/// An effect that would explain the data nearly as well as another.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Alternative {
    /// Its id.
    pub id: &'static str,
    /// Squared correlation of the signatures of the two effects, with everything fitted projected out; 0 where the
    /// session cannot test the other.
    pub overlap: f64,
}

/// An effect that would improve the fit, by less than what the law of a stronger effect may leave.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shadowed {
    /// Its id.
    pub id: &'static str,
    /// Strength of the evidence for it, standard deviations.
    pub z: f64,
    /// What it would explain, relative to the stronger one.
    pub share: f64,
}

/// An effect that was added.
#[derive(Clone, Debug)]
pub struct Found {
    /// Its id.
    pub id: &'static str,
    /// Strength of the evidence when it was added, standard deviations.
    pub z: f64,
    /// Fall of the deviance of held-out data when it was added.
    pub held_out_gain: f64,
    /// Share of that fall that flats and darks have.
    pub of_even_light: f64,
    /// Whether flats and darks proved it when it was added ([`Candidate::proved_by_even_light`]).
    pub proved_by_even_light: bool,
    /// Effects that would explain the data nearly as well, most similar first, then similar ones that cannot be tested.
    pub ambiguity: Vec<Alternative>,
    /// Standard error of the size of its table, for an effect with a table.
    pub table_sigma: Option<f64>,
}

impl Found {
    /// What another one explains of held-out data over what this one does: in flats and darks or in the other frames,
    /// whichever shows this one more. What scenes show is no reason to doubt what flats prove.
    pub(crate) fn share_of(&self, other: &Self) -> f64 {
        let of_even = self.of_even_light > 0.5;
        let part = |f: &Self| f.held_out_gain * if of_even { f.of_even_light } else { 1.0 - f.of_even_light };
        part(other) / part(self).max(f64::MIN_POSITIVE)
    }

    /// Adds the effects that the catalogue lists as similar and that this session cannot test: of the candidates
    /// `rest`, those without a test. What cannot be tested still exists.
    pub(crate) fn or_untested(&mut self, rest: &[Candidate]) {
        let untested = |id: &str| {
            rest.iter().any(|c| {
                c.term.id() == id && c.test.is_none() && c.table.is_none() && !c.term.effect.is_of_bead_scans()
            })
        };
        let lookalikes = find(self.id).map_or(&[][..], |effect| effect.descriptor().lookalikes);
        for id in lookalikes.iter().map(|l| l.id).filter(|id| untested(id)) {
            if !self.ambiguity.iter().any(|a| a.id == id) {
                self.ambiguity.push(Alternative { id, overlap: 0.0 });
            }
        }
    }
}
