//! Photo-response non-uniformity: the response to light differs from pixel to pixel.
//!
//! `mu -> mu (1 + u)` with a table u. Injected tables are normal with standard deviation `rms`.

use super::descriptor::{Descriptor, Lookalike, Param, Stage};
use super::effect::Effect;
use super::table::{self, Table, TableGroup, TableUse};
use ndarray::Array2;

/// The effect; its formula is in the documentation of the module.
pub(super) struct Prnu;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "prnu",
    stage: Stage::Light,
    summary: "mu (1 + u): a response for each pixel",
    params: &[Param::square("rms", "1", 0.002, 1.0), Param::choice("seed", "1", 1.0, [0.0, 1e9])],
    lookalikes: &[
        Lookalike { id: "vignetting", separate_by: "flats: vignetting is smooth" },
        Lookalike { id: "dust", separate_by: "flats: dust makes dark spots of several pixels" },
        Lookalike { id: "dsnu", separate_by: "flats at two light levels: an offset does not grow with the light" },
    ],
};

impl Effect for Prnu {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn table(&self) -> Option<Table> {
        Some(Table { acts: TableUse::Response, group: TableGroup::Pixel })
    }

    fn draw_table(&self, p: &[f64], sensor: [usize; 2]) -> Array2<f32> {
        table::normal(sensor, p[0], p[1], "effects/prnu").mapv(|u| u.max(-1.0))
    }
}
