//! Telegraph pixels: a few pixels jump between two levels from frame to frame (random telegraph noise).
//!
//! In a `share` of the pixels `y -> y + amplitude_dn (b - 1/2)` with b = 0 or 1, each with probability 1/2 in every
//! frame: the traps of these pixels change their state faster than frames follow each other. The expected frame does
//! not change. Source: Janesick et al., Proc. SPIE 6276, 62760M, 2006. Pixels with such noise show in repeats: a few
//! differences are much larger than the noise, and the fourth moment of all differences exceeds that of normal noise.

use super::context::FrameContext;
use super::descriptor::{Descriptor, Lookalike, Param, Stage};
use super::effect::Effect;
use ndarray::Array2;
use ommatidia_session::rng;
use rand::{Rng, RngExt};

/// The effect; its formula is in the documentation of the module.
pub(super) struct TelegraphPixels;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "telegraph_pixels",
    stage: Stage::Electronics,
    summary: "y + amplitude (b - 1/2) in a share of the pixels, b a random bit of each frame: they jump between \
              two levels",
    params: &[
        // A trap holds one electron near the gate of the amplifier: hundreds of DN are another fault.
        Param::square("amplitude_dn", "DN", 4.0, 1000.0),
        Param::shape("share", "1", 0.003, 0.001, [1e-5, 0.1], &[0.0003, 0.001, 0.003, 0.01]),
        Param::choice("seed", "1", 1.0, [0.0, 1e9]),
    ],
    lookalikes: &[
        Lookalike {
            id: "noise_scale",
            separate_by: "histogram of differences of two darks: a wrong gain or read noise has no wings",
        },
        Lookalike { id: "hot_pixels", separate_by: "many darks at one exposure: hot pixels keep their level" },
        Lookalike { id: "dsnu", separate_by: "many darks: an offset is the same in every one of them" },
    ],
};

impl Effect for TelegraphPixels {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn on_reading(&self, p: &[f64], frame_dn: &mut Array2<f32>, _cx: &FrameContext<'_>, rng: &mut dyn Rng) {
        if p[0] == 0.0 || frame_dn.is_empty() {
            return;
        }
        let (rows, cols) = frame_dn.dim();
        // The same pixels in every frame.
        let mut places = rng::stream(p[2].max(0.0) as u64, "effects/telegraph_pixels", 0);
        let number = (p[1] * frame_dn.len() as f64).ceil() as usize;
        for _ in 0..number.min(frame_dn.len()) {
            let at = [places.random_range(0..rows), places.random_range(0..cols)];
            let sign = if rng.next_u32() & 1 == 0 { -0.5 } else { 0.5 };
            frame_dn[at] += (p[0] * sign) as f32;
        }
    }

    fn makes_wings(&self) -> bool {
        true
    }

    fn noise_only(&self) -> bool {
        true
    }
}
