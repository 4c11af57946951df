//! Unnamed pattern: a factor on the light that is fixed to the sensor and that neither single pixels nor a curve over
//! any covariate explain. `close` measures it on even light.
//!
//! `mu -> mu (1 + u(pixel))`. Injected tables u are normal numbers blurred by [`GRAIN_PX`].

use super::descriptor::{Descriptor, Param, Stage};
use super::effect::Effect;
use super::table::{self, Table, TableGroup, TableUse};
use ndarray::Array2;

/// The effect; its formula is in the documentation of the module.
pub(super) struct UnknownPattern;

/// Standard deviation of the blur of injected patterns, pixels.
const GRAIN_PX: f64 = 3.0;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "unknown_pattern",
    stage: Stage::Light,
    summary: "mu (1 + u): an unnamed term, a map u of the sensor",
    params: &[Param::square("rms", "1", 0.002, 1.0), Param::choice("seed", "1", 1.0, [0.0, 1e9])],
    lookalikes: &[],
};

impl Effect for UnknownPattern {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn table(&self) -> Option<Table> {
        Some(Table { acts: TableUse::Response, group: TableGroup::Pattern })
    }

    fn draw_table(&self, p: &[f64], sensor: [usize; 2]) -> Array2<f32> {
        table::soft(sensor, p[0], p[1], "unknown_pattern", GRAIN_PX)
    }
}
