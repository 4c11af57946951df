//! Hot pixels: a few pixels with a large dark current.
//!
//! `mu -> mu + u t` with the exposure t and a table u, e-/ms. In injected tables a `share` of the pixels has `rate`
//! times an exponentially distributed number of mean 1.

use super::descriptor::{Descriptor, Lookalike, Param, Stage};
use super::effect::Effect;
use super::table::{Table, TableGroup, TableUse};
use crate::rng;
use ndarray::Array2;
use rand::RngExt;
use rand_distr::{Distribution, Exp1};

/// The effect; its formula is in the documentation of the module.
pub(super) struct HotPixels;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "hot_pixels",
    stage: Stage::Light,
    summary: "mu + u t in a few pixels, which have a large dark current",
    params: &[
        Param::strength("rate_e_per_ms", "e-/px/ms", 2.0, 0.0, 1e6),
        Param::choice("share", "1", 0.001, [0.0, 1.0]),
        Param::choice("seed", "1", 1.0, [0.0, 1e9]),
    ],
    lookalikes: &[
        Lookalike { id: "dsnu", separate_by: "darks at several exposures: an offset does not grow with the exposure" },
        Lookalike { id: "prnu", separate_by: "darks: hot pixels are bright without light" },
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
