//! Unnamed stray light: light added in frames of specimens in proportion to all of their light, fixed to the sensor.
//! `close` measures it on scenes.
//!
//! `mu -> mu + u(pixel) mean(mu)` in frames of specimens and beads. Injected tables u are normal numbers
//! blurred by [`GRAIN_PX`].

use super::descriptor::{Descriptor, Param, Stage};
use super::effect::Effect;
use super::table::{self, Table, TableGroup, TableUse};
use ndarray::Array2;

/// The effect; its formula is in the documentation of the module.
pub(super) struct UnknownStray;

/// Standard deviation of the blur of injected maps, pixels.
const GRAIN_PX: f64 = 6.0;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "unknown_stray",
    stage: Stage::Light,
    summary: "mu + u mean(mu) in scenes: an unnamed term, stray light u that is fixed to the sensor",
    params: &[Param::square("rms", "1", 0.02, 1e3), Param::choice("seed", "1", 1.0, [0.0, 1e9])],
    lookalikes: &[],
};

impl Effect for UnknownStray {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn table(&self) -> Option<Table> {
        Some(Table { acts: TableUse::SceneStray, group: TableGroup::Scales })
    }

    fn draw_table(&self, p: &[f64], sensor: [usize; 2]) -> Array2<f32> {
        table::soft(sensor, p[0], p[1], "unknown_stray", GRAIN_PX)
    }
}
