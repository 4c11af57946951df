//! Vignetting: light falls off from the centre of the sensor.
//!
//! `mu -> mu (1 - v r^2)`, where r is the distance from the centre of the sensor over half its diagonal. The effect is
//! fixed to the sensor and acts in frames of every role.

use super::context::FrameContext;
use super::descriptor::{Descriptor, Lookalike, Param, Stage};
use super::effect::Effect;
use ndarray::Array2;

/// The effect; its formula is in the documentation of the module.
pub(super) struct Vignetting;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "vignetting",
    stage: Stage::Light,
    summary: "mu (1 - v r^2): light falls off from the centre of the sensor",
    params: &[Param::strength("v", "1", 0.003, -1.0, 1.0)],
    lookalikes: &[
        Lookalike { id: "excitation_profile", separate_by: "move the specimen: vignetting does not move" },
        Lookalike { id: "lens_gain", separate_by: "flats: the gain of a lens changes in steps from image to image" },
        Lookalike { id: "prnu", separate_by: "flats: vignetting is smooth" },
    ],
};

impl Effect for Vignetting {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn is_as_smooth_as_a_lamp(&self) -> bool {
        true
    }

    fn on_light(&self, p: &[f64], light_e: &mut Array2<f32>, _cx: &FrameContext<'_>) {
        if p[0] == 0.0 {
            return;
        }
        let (rows, cols) = light_e.dim();
        let diagonal2 = (rows * rows + cols * cols) as f64 / 4.0;
        let square = |n: usize| -> Vec<f64> {
            (0..n).map(|i| (i as f64 - (n as f64 - 1.0) / 2.0).powi(2) / diagonal2).collect()
        };
        let (down, across) = (square(rows), square(cols));
        for (mut row, y2) in light_e.outer_iter_mut().zip(down) {
            row.iter_mut().zip(&across).for_each(|(v, x2)| *v *= (1.0 - p[0] * (y2 + x2)).max(0.0) as f32);
        }
    }
}
