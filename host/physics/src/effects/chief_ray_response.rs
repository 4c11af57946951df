//! Response over the chief-ray angle: pixels collect less of the light that arrives at an angle.
//!
//! `mu_l -> mu_l (1 - c r^2)`, r the distance of a pixel from the point where the axis of lens l meets the sensor, mm.
//! The light of lens l reaches that pixel at the angle theta with `tan theta = r / gap` to the axis, gap the distance
//! from array to sensor: `c = c_theta / gap^2` for a response `1 - c_theta tan^2 theta`. The array's even light arrives
//! at all angles, so flats do not show it. Source: Catrysse, Wandell, J. Opt. Soc. Am. A 19, 1610, 2002 (pixel
//! vignetting); the even function of the angle to second order.

use super::context::FrameContext;
use super::descriptor::{Descriptor, Lookalike, Param, Stage};
use super::effect::Effect;
use ndarray::Array2;

/// The effect; its formula is in the documentation of the module.
pub(super) struct ChiefRayResponse;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "chief_ray_response",
    stage: Stage::Lens,
    summary: "mu_l (1 - c r^2) about the axis of each lens: the response falls with the angle of the light",
    // The field of a lens of a miniature array reaches 0.05 mm from its axis or more, where 400 / mm^2 take all light.
    params: &[Param::strength("c_per_mm2", "mm^-2", 0.3, -400.0, 400.0)],
    lookalikes: &[
        Lookalike {
            id: "vignetting",
            separate_by: "light all over the field: the response falls about each lens, vignetting about the sensor",
        },
        Lookalike {
            id: "excitation_profile",
            separate_by: "move the specimen: an excitation profile moves with it, the response does not",
        },
        Lookalike {
            id: "lens_gain",
            separate_by: "a bead from the middle to the edge: the gain of a lens is the same over its field",
        },
    ],
};

impl Effect for ChiefRayResponse {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn on_lens(&self, p: &[f64], image_e: &mut Array2<f32>, cx: &FrameContext<'_>) {
        let Some([row, col]) = cx.axes_px.get(cx.lens) else { return };
        if p[0] == 0.0 {
            return;
        }
        let mm = cx.pixel_pitch_um * 1e-3;
        let (rows, cols) = image_e.dim();
        let squares = |n: usize, at: f64| -> Vec<f64> { (0..n).map(|i| ((i as f64 - at) * mm).powi(2)).collect() };
        let (down, across) = (squares(rows, *row), squares(cols, *col));
        for (mut line, y2) in image_e.outer_iter_mut().zip(down) {
            line.iter_mut().zip(&across).for_each(|(v, x2)| *v *= (1.0 - p[0] * (y2 + x2)).max(0.0) as f32);
        }
    }
}
