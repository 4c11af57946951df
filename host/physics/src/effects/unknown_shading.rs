//! Unnamed shading: a factor on the light of specimens that is fixed to the sensor and that flats do not show. `close`
//! measures it on scenes.
//!
//! `mu -> mu (1 + u(pixel))` in frames of specimens and beads. Injected tables u are normal numbers blurred by
//! [`GRAIN_PX`].

use super::descriptor::{Descriptor, Param, Stage};
use super::effect::Effect;
use super::table::{self, Table, TableGroup, TableUse};
use ndarray::Array2;

/// The effect; its formula is in the documentation of the module.
pub(super) struct UnknownShading;

/// Standard deviation of the blur of injected maps, pixels.
const GRAIN_PX: f64 = 6.0;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "unknown_shading",
    stage: Stage::Light,
    summary: "mu (1 + u) in scenes: an unnamed term, a map u of the sensor that flats do not show",
    params: &[Param::square("rms", "1", 0.01, 1.0), Param::choice("seed", "1", 1.0, [0.0, 1e9])],
    lookalikes: &[],
};

impl Effect for UnknownShading {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn table(&self) -> Option<Table> {
        Some(Table { acts: TableUse::SceneResponse, group: TableGroup::Scales })
    }

    fn draw_table(&self, p: &[f64], sensor: [usize; 2]) -> Array2<f32> {
        table::soft(sensor, p[0], p[1], "unknown_shading", GRAIN_PX)
    }
}
