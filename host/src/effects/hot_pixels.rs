//! Hot pixels: few pixels with a large dark current.
//!
//! `mu -> mu + u t`, u = a table, e-/ms. Drawn: a `share` of the pixels, each with `rate` times a number from an exponential
//! distribution of mean 1. Catalogue 29.

use super::{Descriptor, Effect, Lookalike, Param, Stage, Table, TableGroup, TableUse};
use crate::rng;
use ndarray::Array2;
use rand::RngExt;
use rand_distr::{Distribution, Exp1};

/// See the module.
pub(super) struct HotPixels;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "hot_pixels",
    stage: Stage::Light,
    summary: "mu + u t in few pixels: they leak charge",
    params: &[
        Param::strength("rate_e_per_ms", "e-/px/ms", 2.0, 0.0, 1e6),
        Param::choice("share", "1", 0.001, [0.0, 1.0]),
        Param::choice("seed", "1", 1.0, [0.0, 1e9]),
    ],
    lookalikes: &[
        Lookalike { id: "dsnu", separate_by: "darks at several exposures: an offset does not grow with them" },
        Lookalike { id: "prnu", separate_by: "darks" },
    ],
};

impl Effect for HotPixels {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn table(&self) -> Option<Table> {
        Some(Table { acts: TableUse::DarkRate, group: TableGroup::SparsePixels })
    }

    fn draw_table(&self, p: &[f64], sensor: [usize; 2]) -> Array2<f32> {
        let mut table = Array2::zeros(sensor);
        let number = (p[1] * table.len() as f64).ceil() as usize;
        let mut rng = rng::stream(p[2] as u64, "effects/hot_pixels", 0);
        for _ in 0..number.min(table.len()) {
            let at = [rng.random_range(0..sensor[0]), rng.random_range(0..sensor[1])];
            let level: f64 = Exp1.sample(&mut rng);
            table[at] = (p[0] * level) as f32;
        }
        table
    }
}
