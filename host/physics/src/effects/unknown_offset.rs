//! Unnamed offset: a level added in frames of specimens, fixed to the sensor. `close` measures it on scenes.
//!
//! `y -> y + u(pixel)` in frames of specimens and beads. Injected tables u are normal numbers blurred by [`GRAIN_PX`].

use super::descriptor::{Descriptor, Param, Stage};
use super::effect::Effect;
use super::table::{self, Table, TableGroup, TableUse};
use ndarray::Array2;

/// The effect; its formula is in the documentation of the module.
pub(super) struct UnknownOffset;

/// Standard deviation of the blur of injected maps, pixels.
const GRAIN_PX: f64 = 6.0;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "unknown_offset",
    stage: Stage::Electronics,
    summary: "y + u in scenes: an unnamed term, a level u that is fixed to the sensor",
    params: &[Param::square("rms_dn", "DN", 0.5, 1e5), Param::choice("seed", "1", 1.0, [0.0, 1e9])],
    lookalikes: &[],
};

impl Effect for UnknownOffset {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn table(&self) -> Option<Table> {
        Some(Table { acts: TableUse::SceneOffset, group: TableGroup::Scales })
    }

    fn draw_table(&self, p: &[f64], sensor: [usize; 2]) -> Array2<f32> {
        table::soft(sensor, p[0], p[1], "unknown_offset", GRAIN_PX)
    }
}
