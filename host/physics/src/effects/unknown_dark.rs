//! Unnamed dark signal: electrons that each pixel collects without light, from a map that is fixed to the sensor and
//! that neither single hot pixels nor independent offsets explain. The glow of a readout amplifier in one corner is the
//! most frequent cause. `close` measures it on darks.
//!
//! `mu -> mu + u(pixel) t` with the exposure t. Injected tables u are normal numbers blurred by [`GRAIN_PX`].

use super::descriptor::{Descriptor, Param, Stage};
use super::effect::Effect;
use super::table::{self, Table, TableGroup, TableUse};
use ndarray::Array2;

/// The effect; its formula is in the documentation of the module.
pub(super) struct UnknownDark;

/// Standard deviation of the blur of injected maps, pixels.
const GRAIN_PX: f64 = 6.0;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "unknown_dark",
    stage: Stage::Light,
    summary: "mu + u t: an unnamed term, a dark signal u that is fixed to the sensor",
    params: &[Param::square("rms_e_per_ms", "e-/px/ms", 0.5, 1e6), Param::choice("seed", "1", 1.0, [0.0, 1e9])],
    lookalikes: &[],
};

impl Effect for UnknownDark {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn table(&self) -> Option<Table> {
        Some(Table { acts: TableUse::DarkRate, group: TableGroup::Pattern })
    }

    fn draw_table(&self, p: &[f64], sensor: [usize; 2]) -> Array2<f32> {
        table::soft(sensor, p[0], p[1], "unknown_dark", GRAIN_PX)
    }
}
