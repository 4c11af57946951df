//! Drift of the wavefront: a lens element is decentred, tilted or under stress since the calibration.
//!
//! `W -> W + sum_k c_k Z_k` in the pupil of each lens, with Noll's Z_5 and Z_6 (astigmatism), Z_7 and Z_8 (coma) and
//! Z_11 (spherical aberration), equal over the field and for all lenses, waves rms. Defocus (Z_4) is an effect of its
//! own. A focus keeps its centroid, but for (row_px, col_px): an element that is decentred displaces foci as well, by
//! its power, which its coma does not say. A coefficient belongs to the rim of the pupils: where that is soft, another
//! radius is another coefficient of coma, by the cube of their ratio. The pupils are those that explain the calibrated
//! PSFs (`ommatidia_model::psf::pupils`); the effect has no influence where no pupil explains them. Source: Noll, J.
//! Opt. Soc. Am. 66, 207 (1976); Born & Wolf, Principles of Optics, section 9.2.

use super::context::{FrameContext, Ray, RayShift};
use super::descriptor::{Descriptor, Lookalike, Param, Stage};
use super::effect::Effect;
use crate::optics::Wavefront;

/// The effect; its formula is in the documentation of the module.
pub(super) struct WavefrontDrift;

/// Index of each parameter's polynomial in [`Wavefront::coefficient`].
const TERMS: [usize; 5] = [6, 7, 5, 4, 10];

/// Beyond a third of a wave rms a focus has fallen apart, and no calibration says how.
const fn waves(name: &'static str) -> Param {
    Param::strength(name, "waves", 0.001, -0.35, 0.35)
}

static DESCRIPTOR: Descriptor = Descriptor {
    id: "wavefront_drift",
    stage: Stage::Geometry,
    summary: "W + sum c_k Z_k in the pupil of each lens: coma, astigmatism and spherical aberration, rms, equal over \
              the field, and a displacement (row_px, col_px) of all foci",
    params: &[
        waves("coma_row_waves"),
        waves("coma_col_waves"),
        waves("astigmatism_waves"),
        waves("astigmatism_45_waves"),
        waves("spherical_waves"),
        Param::strength("row_px", "px", 0.005, -50.0, 50.0),
        Param::strength("col_px", "px", 0.005, -50.0, 50.0),
    ],
    lookalikes: &[
        Lookalike {
            id: "aberration_drift",
            separate_by: "bead scan: coma and astigmatism of a decentred element are equal over the field",
        },
        Lookalike {
            id: "array_shift",
            separate_by: "the shape of foci: what displaces an array does not make comets of them",
        },
        Lookalike { id: "defocus", separate_by: "depth scan: out of focus on one side, the foci shrink on the other" },
        Lookalike {
            id: "motion_blur",
            separate_by: "a specimen at rest, or a shorter exposure: motion blur disappears",
        },
        Lookalike { id: "rank_truncation", separate_by: "a model of higher rank: it removes a truncation" },
    ],
};

impl Effect for WavefrontDrift {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn shift_ray(&self, p: &[f64], _ray: &Ray, _cx: &FrameContext<'_>) -> RayShift {
        RayShift::by_px([p[5], p[6]])
    }

    fn wavefront(&self, p: &[f64], _ray: &Ray, _cx: &FrameContext<'_>) -> Wavefront {
        let mut added = Wavefront::default();
        for (value, k) in p.iter().zip(TERMS) {
            added.coefficient[k] = *value;
        }
        added
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::noll;

    #[test]
    fn parameters_are_nolls_polynomials() {
        // Radial degree and azimuthal degree; coma along the rows is the sine.
        let degrees = TERMS.map(|k| noll(k + 1));
        assert_eq!(degrees, [(3, -1), (3, 1), (2, 2), (2, -2), (4, 0)]);
        let added =
            WavefrontDrift.wavefront(&[0.1, 0.0, -0.2, 0.0, 0.05, 1.0, 0.0], &Ray::default(), &FrameContext::default());
        assert_eq!([added.coefficient[6], added.coefficient[5], added.coefficient[10]], [0.1, -0.2, 0.05]);
    }
}
