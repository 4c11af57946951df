//! Dark-signal non-uniformity: each pixel has its own offset.
//!
//! `y -> y + u` with a table u, DN. Injected tables are normal with standard deviation `rms_dn`.

use super::descriptor::{Descriptor, Lookalike, Param, Stage};
use super::effect::Effect;
use super::table::{self, Table, TableGroup, TableUse};
use ndarray::Array2;

/// The effect; its formula is in the documentation of the module.
pub(super) struct Dsnu;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "dsnu",
    stage: Stage::Electronics,
    summary: "y + u: an offset for each pixel",
    params: &[Param::square("rms_dn", "DN", 0.3, 1e4), Param::choice("seed", "1", 1.0, [0.0, 1e9])],
    lookalikes: &[
        Lookalike { id: "prnu", separate_by: "flats at two light levels: an offset does not grow with the light" },
        Lookalike { id: "hot_pixels", separate_by: "darks at several exposures: hot pixels grow with the exposure" },
    ],
};

impl Effect for Dsnu {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn table(&self) -> Option<Table> {
        Some(Table { acts: TableUse::Offset, group: TableGroup::Pixel })
    }

    fn draw_table(&self, p: &[f64], sensor: [usize; 2]) -> Array2<f32> {
        table::normal(sensor, p[0], p[1], "effects/dsnu")
    }
}
