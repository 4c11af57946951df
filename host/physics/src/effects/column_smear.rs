//! Smear along the columns: while charge is shifted out, or a shutter is closed, each pixel collects light of its
//! column.
//!
//! `mu -> mu + share mean(mu over the column)`, before the Poisson draw.

use super::context::FrameContext;
use super::descriptor::{Descriptor, Lookalike, Param, Stage};
use super::effect::Effect;
use super::smooth::changed;
use ndarray::{Array2, Axis};

/// The effect; its formula is in the documentation of the module.
pub(super) struct ColumnSmear;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "column_smear",
    stage: Stage::Light,
    summary: "mu + share mean(mu of the column): light is collected while charge moves along the columns",
    params: &[Param::strength("share", "1", 0.0005, 0.0, 10.0)],
    lookalikes: &[
        Lookalike { id: "veiling_glare", separate_by: "a single bright bead: a smear lights its columns alone" },
        Lookalike { id: "column_pattern", separate_by: "darks: a smear needs light" },
        Lookalike { id: "background", separate_by: "two light levels of the specimen: a smear follows its light" },
    ],
};

impl Effect for ColumnSmear {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn on_light(&self, p: &[f64], light_e: &mut Array2<f32>, _cx: &FrameContext<'_>) {
        let Some(mean) = light_e.mean_axis(Axis(0)).filter(|_| p[0] != 0.0) else { return };
        let share = p[0] as f32;
        for mut row in light_e.outer_iter_mut() {
            row.zip_mut_with(&mean, |v, m| *v = changed(*v, share * m));
        }
    }
}
