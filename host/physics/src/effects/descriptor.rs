//! Description of an effect: its name, its stage, its parameters, and the effects that look similar.

use serde::{Deserialize, Serialize};

/// Stage between object and frame at which an effect acts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Stage {
    /// Emitted light, on the object grid.
    Object,
    /// Chief rays and depth of the sources.
    Geometry,
    /// The light through one lens on the sensor, expected electrons.
    Lens,
    /// The light through all lenses on the sensor, expected electrons, before the Poisson draw.
    Light,
    /// Collected charge, electrons, after the Poisson draw.
    Charge,
    /// The frame, DN.
    Electronics,
    /// The session's record of its frames, not the frames themselves.
    Record,
}

impl Stage {
    /// Every stage, in physical order.
    pub const ALL: [Self; 7] =
        [Self::Object, Self::Geometry, Self::Lens, Self::Light, Self::Charge, Self::Electronics, Self::Record];

    /// Part of the instrument, as named in output for other programs. Everything before the Poisson draw is `optics`.
    pub fn part(self) -> &'static str {
        match self {
            Self::Object | Self::Geometry | Self::Lens | Self::Light => "optics",
            Self::Charge => "charge",
            Self::Electronics => "electronics",
            Self::Record => "record",
        }
    }
}

/// How a frame depends on a parameter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Kind {
    /// A strength: the frame is linear in it to first order, even where the effect is absent, so a score test can
    /// detect it.
    Strength,
    /// A strength that enters by its square, like a standard deviation: the frame is linear in the square to first
    /// order. The effect is absent at 0; negative values are not allowed.
    Square,
    /// A shape (a width, a period, a position), which has no meaning while the effect is absent. Holds the values to
    /// try first.
    Shape(&'static [f64]),
    /// A choice without intermediate values (an index, a seed, a range). It is set, never fitted.
    Choice,
}

/// One parameter of an effect.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Param {
    /// Name of the parameter.
    pub name: &'static str,
    /// Unit; "1" for parameters without one.
    pub unit: &'static str,
    /// For strengths, the value at which the effect is absent; for shapes and choices, the default.
    pub off: f64,
    /// A step that changes a typical frame noticeably; the scale of derivatives and first guesses.
    pub step: f64,
    /// Smallest allowed value.
    pub min: f64,
    /// Largest allowed value.
    pub max: f64,
    /// How the frame depends on the parameter.
    pub kind: Kind,
    /// Whether each lens has its own value, named `name_0`, `name_1`, ... in the order of the lenses.
    pub per_lens: bool,
    /// Of a strength, values far from `off` that a search starts from as well: for effects whose frames are so far from
    /// linear in it that the first small change says little of a large one.
    pub far: &'static [f64],
}

impl Param {
    /// A strength; the effect is absent at 0.
    pub const fn strength(name: &'static str, unit: &'static str, step: f64, min: f64, max: f64) -> Self {
        Self { name, unit, off: 0.0, step, min, max, kind: Kind::Strength, per_lens: false, far: &[] }
    }

    /// A strength that enters by its square; the effect is absent at 0.
    pub const fn square(name: &'static str, unit: &'static str, step: f64, max: f64) -> Self {
        Self { kind: Kind::Square, ..Self::strength(name, unit, step, 0.0, max) }
    }

    /// A choice, which is never fitted; `off` is its default.
    pub const fn choice(name: &'static str, unit: &'static str, off: f64, [min, max]: [f64; 2]) -> Self {
        Self { name, unit, off, step: 1.0, min, max, kind: Kind::Choice, per_lens: false, far: &[] }
    }

    /// A shape; `off` is its default, and `tried` are the values from which fits start (empty: `off` alone, or the
    /// guess of the effect).
    pub const fn shape(
        name: &'static str,
        unit: &'static str,
        off: f64,
        step: f64,
        [min, max]: [f64; 2],
        tried: &'static [f64],
    ) -> Self {
        Self { name, unit, off, step, min, max, kind: Kind::Shape(tried), per_lens: false, far: &[] }
    }

    /// Turns the parameter into one value for each lens.
    pub const fn per_lens(self) -> Self {
        Self { per_lens: true, ..self }
    }

    /// Sets the values far from `off` that a search starts from as well.
    pub const fn far(self, far: &'static [f64]) -> Self {
        Self { far, ..self }
    }

    /// Sets the value at which the effect is absent, if it is not 0.
    pub const fn off_at(self, off: f64) -> Self {
        Self { off, ..self }
    }

    /// Whether the effect is absent if this parameter is `off`.
    pub fn is_strength(&self) -> bool {
        matches!(self.kind, Kind::Strength | Kind::Square)
    }

    /// The quantity in which the frame is linear to first order: the value itself, or its square. Fits and tests use
    /// it.
    pub fn inner(&self, value: f64) -> f64 {
        if self.kind == Kind::Square { value * value } else { value }
    }

    /// Inverse of [`inner`](Self::inner), clamped to the range of the parameter.
    pub fn outer(&self, inner: f64) -> f64 {
        let value = if self.kind == Kind::Square { inner.max(0.0).sqrt() } else { inner };
        value.clamp(self.min, self.max)
    }

    /// Standard error of the value, from the inner quantity and its standard error `sigma`. For squares, it is the
    /// change of the value by one `sigma` upwards.
    pub fn outer_sigma(&self, inner: f64, sigma: f64) -> f64 {
        match self.kind {
            Kind::Square => (inner.max(0.0) + sigma).sqrt() - inner.max(0.0).sqrt(),
            _ => sigma,
        }
    }

    /// Side of `off` on which no values are allowed: -1 below, 1 above, 0 neither (or both).
    pub fn forbidden_side(&self) -> f64 {
        f64::from(i8::from(self.max == self.off) - i8::from(self.min == self.off))
    }
}

/// Another effect with a similar signature, and the measurement that distinguishes the two.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Lookalike {
    /// Id of the other effect.
    pub id: &'static str,
    /// The distinguishing measurement, and what it shows.
    pub separate_by: &'static str,
}

/// Description of an effect.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Descriptor {
    /// Name in commands, files and reports.
    pub id: &'static str,
    /// Stage at which it acts.
    pub stage: Stage,
    /// Formula and meaning in one line.
    pub summary: &'static str,
    /// Parameters; the first is a strength.
    pub params: &'static [Param],
    /// Effects with a similar signature.
    pub lookalikes: &'static [Lookalike],
}

impl Descriptor {
    /// Names and parameters in the order in which hooks receive their values: a parameter that is per lens appears once
    /// for each of `lenses`.
    pub fn expanded(&self, lenses: usize) -> Vec<(String, &'static Param)> {
        let names = |p: &'static Param| {
            let each = if p.per_lens { lenses } else { 1 };
            (0..each).map(move |l| (if p.per_lens { format!("{}_{l}", p.name) } else { p.name.into() }, p))
        };
        self.params.iter().flat_map(names).collect()
    }
}
