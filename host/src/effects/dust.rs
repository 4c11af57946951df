//! Dust on the sensor's window: dark spots of several pixels.
//!
//! `mu -> mu (1 + u)` with a table u. Injected tables have `number` discs at random places, with the value `-depth`
//! inside `radius_px` and an edge of one pixel; where discs overlap, the darker one counts.

use super::descriptor::{Descriptor, Lookalike, Param, Stage};
use super::effect::Effect;
use super::table::{Table, TableGroup, TableUse};
use crate::rng;
use ndarray::Array2;
use rand::RngExt;

/// The effect; its formula is in the documentation of the module.
pub(super) struct Dust;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "dust",
    stage: Stage::Light,
    summary: "mu (1 + u) in spots: dust casts shadows",
    params: &[
        Param::strength("depth", "1", 0.02, 0.0, 1.0),
        Param::choice("number", "1", 8.0, [0.0, 1e4]),
        Param::shape("radius_px", "px", 3.0, 0.5, [0.0, 1e3], &[]),
        Param::choice("seed", "1", 1.0, [0.0, 1e9]),
    ],
    lookalikes: &[
        Lookalike { id: "prnu", separate_by: "flats: dust makes dark spots of several pixels" },
        Lookalike { id: "vignetting", separate_by: "flats: vignetting is smooth over the whole sensor" },
        Lookalike { id: "lens_gain", separate_by: "flats: dust on the sensor is the same for every lens" },
    ],
};

impl Effect for Dust {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn table(&self) -> Option<Table> {
        Some(Table { acts: TableUse::Response, group: TableGroup::Spots })
    }

    fn draw_table(&self, p: &[f64], sensor: [usize; 2]) -> Array2<f32> {
        let mut table = Array2::zeros(sensor);
        let mut rng = rng::stream(p[3] as u64, "effects/dust", 0);
        for _ in 0..p[1] as usize {
            let at = sensor.map(|n| rng.random_range(0.0..n.max(1) as f64) - 0.5);
            // A spot covers only a few pixels of a large sensor.
            let near = |a: usize| {
                let (low, high) = (at[a] - p[2] - 1.0, at[a] + p[2] + 1.0);
                (low.max(0.0) as usize).min(sensor[a])..(high.ceil().max(0.0) as usize).min(sensor[a])
            };
            for r in near(0) {
                for c in near(1) {
                    let distance = (r as f64 - at[0]).hypot(c as f64 - at[1]);
                    let covered = (p[2] + 0.5 - distance).clamp(0.0, 1.0);
                    let shade = (-p[0] * covered) as f32;
                    if shade < table[[r, c]] {
                        table[[r, c]] = shade;
                    }
                }
            }
        }
        table
    }
}
