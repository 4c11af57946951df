//! Unnamed light: light added in frames of specimens, fixed to the sensor. `close` measures it on scenes.
//!
//! `mu -> mu + u(pixel) t` with the exposure t, in frames of specimens and beads. Injected tables u are normal numbers
//! blurred by [`GRAIN_PX`].

use super::descriptor::{Descriptor, Param, Stage};
use super::effect::Effect;
use super::table::{self, Table, TableGroup, TableUse};
use ndarray::Array2;

/// The effect; its formula is in the documentation of the module.
pub(super) struct UnknownLight;

/// Standard deviation of the blur of injected maps, pixels.
const GRAIN_PX: f64 = 6.0;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "unknown_light",
    stage: Stage::Light,
    summary: "mu + u t in scenes: an unnamed term, light u that is fixed to the sensor",
    params: &[Param::square("rms_e_per_ms", "e-/px/ms", 0.5, 1e6), Param::choice("seed", "1", 1.0, [0.0, 1e9])],
    lookalikes: &[],
};

impl Effect for UnknownLight {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn table(&self) -> Option<Table> {
        Some(Table { acts: TableUse::SceneRate, group: TableGroup::Scales })
    }

    fn draw_table(&self, p: &[f64], sensor: [usize; 2]) -> Array2<f32> {
        table::soft(sensor, p[0], p[1], "unknown_light", GRAIN_PX)
    }
}
