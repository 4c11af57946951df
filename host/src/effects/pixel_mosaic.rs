//! Pixel mosaic: the four pixels of each 2 x 2 cell differ in gain, e.g. because of a colour mosaic or a shared
//! readout.
//!
//! `y -> black + (y - black) (1 + checker (-1)^(r+c) + rows (-1)^r + cols (-1)^c)`: three orthogonal contrasts.

use super::context::FrameContext;
use super::descriptor::{Descriptor, Lookalike, Param, Stage};
use super::effect::Effect;
use ndarray::Array2;

/// The effect; its formula is in the documentation of the module.
pub(super) struct PixelMosaic;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "pixel_mosaic",
    stage: Stage::Electronics,
    summary: "gain 1 + checker (-1)^(r+c) + rows (-1)^r + cols (-1)^c: the pixels of 2 x 2 cells differ",
    params: &[
        Param::strength("checker", "1", 0.005, -0.5, 0.5),
        Param::strength("rows", "1", 0.005, -0.5, 0.5),
        Param::strength("cols", "1", 0.005, -0.5, 0.5),
    ],
    lookalikes: &[
        Lookalike { id: "row_pattern", separate_by: "darks: an alternating gain has no effect without light" },
        Lookalike { id: "column_pattern", separate_by: "darks: an alternating gain has no effect without light" },
        Lookalike { id: "prnu", separate_by: "flats: a mosaic repeats every two pixels" },
    ],
};

impl Effect for PixelMosaic {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn on_electronics(&self, p: &[f64], frame_dn: &mut Array2<f32>, cx: &FrameContext<'_>) {
        if p.iter().all(|v| *v == 0.0) {
            return;
        }
        let black = cx.black_level_dn as f32;
        let sign = |n: usize| if n.is_multiple_of(2) { 1.0 } else { -1.0 };
        for ((r, c), v) in frame_dn.indexed_iter_mut() {
            let gain = 1.0 + p[0] * sign(r + c) + p[1] * sign(r) + p[2] * sign(c);
            *v = black + (*v - black) * gain as f32;
        }
    }

    fn is_of_the_grid(&self) -> bool {
        true
    }
}
