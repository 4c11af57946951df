//! Unnamed shade of one view: a factor on the light of specimens through a single lens that is fixed to the sensor,
//! e.g. by a droplet or a hair near the array. `close` measures it on scenes.
//!
//! `mu_l -> mu_l (1 + u(pixel))` of lens l in frames of specimens and beads. Injected tables u are normal numbers
//! blurred by [`GRAIN_PX`].

use super::descriptor::{Descriptor, Param, Stage};
use super::effect::Effect;
use super::table::{self, Table, TableGroup, TableUse};
use ndarray::Array2;

/// The effect; its formula is in the documentation of the module.
pub(super) struct UnknownView;

/// Standard deviation of the blur of injected maps, pixels.
const GRAIN_PX: f64 = 6.0;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "unknown_view",
    stage: Stage::Lens,
    summary: "mu_l (1 + u) in scenes: an unnamed term, a map u of the sensor that one lens alone has",
    params: &[
        Param::square("rms", "1", 0.01, 1.0),
        Param::choice("lens", "index", 0.0, [0.0, 1e4]),
        Param::choice("seed", "1", 1.0, [0.0, 1e9]),
    ],
    lookalikes: &[],
};

impl Effect for UnknownView {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn table(&self) -> Option<Table> {
        Some(Table { acts: TableUse::SceneView, group: TableGroup::Scales })
    }

    fn draw_table(&self, p: &[f64], sensor: [usize; 2]) -> Array2<f32> {
        table::soft(sensor, p[0], p[2], "unknown_view", GRAIN_PX)
    }
}
