//! What an effect is: its name, its place on the way of the light, its parameters, and what it is easily taken for.

use serde::{Deserialize, Serialize};

/// Where on the way of the light an effect acts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Stage {
    /// Emitted light, on the object grid.
    Object,
    /// Chief rays and depth.
    Geometry,
    /// The image of one lens, electrons.
    Lens,
    /// The light of all lenses on the sensor, expected electrons, before the Poisson draw.
    Light,
    /// Collected charge, electrons, after the Poisson draw.
    Charge,
    /// Digital numbers.
    Electronics,
    /// What the session says of its frames, not what they show.
    Record,
}

impl Stage {
    /// Every stage, in physical order.
    pub const ALL: [Self; 7] =
        [Self::Object, Self::Geometry, Self::Lens, Self::Light, Self::Charge, Self::Electronics, Self::Record];

    /// The part of the instrument that other programs are told: before the Poisson draw all is optics.
    pub fn part(self) -> &'static str {
        match self {
            Self::Object | Self::Geometry | Self::Lens | Self::Light => "optics",
            Self::Charge => "charge",
            Self::Electronics => "electronics",
            Self::Record => "record",
        }
    }
}

/// How a parameter enters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Kind {
    /// The frame changes with it to first order even where the effect is absent: a score test finds it.
    Strength,
    /// A strength that enters by its square, as standard deviations do: the frame changes with the square to first order, and not at all
    /// with itself where the effect is absent. Absent at 0, never negative.
    Square,
    /// It has no meaning while the effect is absent (a width, a period, a place): the values to try first.
    Shape(&'static [f64]),
    /// It chooses among things that have nothing in between (an index, a seed, a range): given, never fitted.
    Choice,
}

/// One parameter of an effect.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Param {
    /// Name.
    pub name: &'static str,
    /// Unit, "1" where it has none.
    pub unit: &'static str,
    /// The value at which the effect is absent; for a shape, the value where none is given.
    pub off: f64,
    /// A step that changes the frame noticeably: the scale for derivatives and first guesses.
    pub step: f64,
    /// Smallest value with a meaning.
    pub min: f64,
    /// Largest value with a meaning.
    pub max: f64,
    /// How it enters.
    pub kind: Kind,
    /// There is one of it for each lens, named `name_0`, `name_1`, .. in the order of the lenses.
    pub per_lens: bool,
}

impl Param {
    /// A strength that is 0 where the effect is absent.
    pub const fn strength(name: &'static str, unit: &'static str, step: f64, min: f64, max: f64) -> Self {
        Self { name, unit, off: 0.0, step, min, max, kind: Kind::Strength, per_lens: false }
    }

    /// A strength that enters by its square.
    pub const fn square(name: &'static str, unit: &'static str, step: f64, max: f64) -> Self {
        Self { kind: Kind::Square, ..Self::strength(name, unit, step, 0.0, max) }
    }

    /// What is chosen and never fitted.
    pub const fn choice(name: &'static str, unit: &'static str, off: f64, [min, max]: [f64; 2]) -> Self {
        Self { name, unit, off, step: 1.0, min, max, kind: Kind::Choice, per_lens: false }
    }

    /// A shape; `tried` are the values that screening starts from (empty: `off` alone, or what the data suggest).
    pub const fn shape(
        name: &'static str,
        unit: &'static str,
        off: f64,
        step: f64,
        [min, max]: [f64; 2],
        tried: &'static [f64],
    ) -> Self {
        Self { name, unit, off, step, min, max, kind: Kind::Shape(tried), per_lens: false }
    }

    /// The same, once for each lens.
    pub const fn per_lens(self) -> Self {
        Self { per_lens: true, ..self }
    }

    /// The same, absent at another value than 0.
    pub const fn off_at(self, off: f64) -> Self {
        Self { off, ..self }
    }

    /// Whether the effect is absent where this is `off`.
    pub fn is_strength(&self) -> bool {
        matches!(self.kind, Kind::Strength | Kind::Square)
    }

    /// The number that the frame is linear in to first order: the value itself, or its square. Fits and tests work in it.
    pub fn inner(&self, value: f64) -> f64 {
        if self.kind == Kind::Square { value * value } else { value }
    }

    /// The value of an [`inner`](Self::inner) number, within its range.
    pub fn outer(&self, inner: f64) -> f64 {
        let value = if self.kind == Kind::Square { inner.max(0.0).sqrt() } else { inner };
        value.clamp(self.min, self.max)
    }

    /// Standard error of the value, from that of the inner number: what one of those adds to it.
    pub fn outer_sigma(&self, inner: f64, sigma: f64) -> f64 {
        match self.kind {
            Kind::Square => (inner.max(0.0) + sigma).sqrt() - inner.max(0.0).sqrt(),
            _ => sigma,
        }
    }

    /// Whether values on one side of `off` mean nothing: -1 below, 1 above, 0 neither.
    pub fn forbidden_side(&self) -> f64 {
        f64::from(i8::from(self.max == self.off) - i8::from(self.min == self.off))
    }
}

/// Another effect with nearly the same signature, and the measurement that tells the two apart.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Lookalike {
    /// Id of the other effect.
    pub id: &'static str,
    /// What to measure.
    pub separate_by: &'static str,
}

/// What an effect is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Descriptor {
    /// Name in tools, files and reports.
    pub id: &'static str,
    /// Where it acts.
    pub stage: Stage,
    /// One sentence with the formula.
    pub summary: &'static str,
    /// Its parameters; the first is its strength.
    pub params: &'static [Param],
    /// What it is easily taken for.
    pub lookalikes: &'static [Lookalike],
}

impl Descriptor {
    /// Names, and parameters, one after the other as hooks see them: those that are per lens once for each of `lenses`.
    pub fn expanded(&self, lenses: usize) -> Vec<(String, &'static Param)> {
        let names = |p: &'static Param| {
            let each = if p.per_lens { lenses } else { 1 };
            (0..each).map(move |l| (if p.per_lens { format!("{}_{l}", p.name) } else { p.name.into() }, p))
        };
        self.params.iter().flat_map(names).collect()
    }
}
