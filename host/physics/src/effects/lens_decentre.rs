//! Decentred lenses: the chief rays of each lens are displaced by an amount of its own.
//!
//! `anchor_l -> anchor_l + (row_px_l, col_px_l)`.

use super::context::{FrameContext, Ray, RayShift};
use super::descriptor::{Descriptor, Lookalike, Param, Stage};
use super::effect::Effect;

/// The effect; its formula is in the documentation of the module.
pub(super) struct LensDecentre;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "lens_decentre",
    stage: Stage::Geometry,
    summary: "anchor_l + (row_px_l, col_px_l): each lens is displaced by itself",
    params: &[
        Param::strength("row_px", "px", 0.01, -50.0, 50.0).per_lens(),
        Param::strength("col_px", "px", 0.01, -50.0, 50.0).per_lens(),
    ],
    lookalikes: &[
        Lookalike {
            id: "array_shift",
            separate_by: "bead scan: a shifted array moves the images of all lenses equally",
        },
        Lookalike {
            id: "array_rotation",
            separate_by: "bead scan: a rotated array moves each lens in proportion to its distance from the centre",
        },
        Lookalike {
            id: "radial_distortion",
            separate_by: "bead scan over the field: distortion grows with the field angle",
        },
    ],
};

impl Effect for LensDecentre {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn shift_ray(&self, p: &[f64], ray: &Ray, _cx: &FrameContext<'_>) -> RayShift {
        // All rows come first, then all columns.
        let lenses = p.len() / 2;
        let of = |i: usize| if ray.lens < lenses { p[i] } else { 0.0 };
        RayShift::by_px([of(ray.lens), of(lenses + ray.lens)])
    }
}
