//! What a depth or a wavefront means that pupils predict from a scan in one plane.

use super::result::Effect;
use crate::fit::Model;
use ommatidia_model::instrument::Instrument;
use ommatidia_model::psf::pupils::WAVELENGTH_UM;

/// Effects that act by depth.
pub(super) const BY_DEPTH: [&str; 3] = ["defocus", "field_curvature", "tilt"];

/// Error of a depth between two planes of a scan, relative to its distance from the nearer one: on other simulators, 7
/// to 10 % in three of four cases and 2 % in one. The PSFs there are those of no scan, but of interpolation.
const BETWEEN: f64 = 0.08;

/// Standard error of a strength that acts by depth, in its unit, by the depths between the planes of the calibration;
/// beyond the last plane, that of half a gap. 0: the beads were scanned in one plane.
pub(super) fn between_planes(model: &Model<'_>, id: &str, value: f64) -> f64 {
    let planes = model.forward.calibrated_depths_um();
    let gap = planes.windows(2).map(|w| w[1] - w[0]).fold(0.0, f64::max);
    if gap <= 0.0 {
        return 0.0;
    }
    if id == "defocus" {
        return BETWEEN * from_plane_um(planes, model.forward.depth_um() + value).min(gap / 2.0);
    }
    // The specimen has all depths from none to the largest.
    let largest_um = match id {
        "tilt" => value.abs() * model.half_side_mm()[0],
        _ => value.abs() * model.half_side_mm()[1].powi(2),
    };
    BETWEEN * value.abs() * (gap / (2.0 * largest_um.max(f64::MIN_POSITIVE))).min(1.0)
}

/// Distance of a depth from the nearest plane, um.
fn from_plane_um(planes: &[f64], z_um: f64) -> f64 {
    planes.iter().map(|p| (p - z_um).abs()).fold(f64::INFINITY, f64::min)
}

/// The note on effects that pupils predict; None: there are none.
///
/// `misjudged_waves` is the defocus of each lens beyond that of its pupil, as fitted beside these effects, and
/// `depth_error` the relative error of depths that is included in theirs.
pub(crate) fn pupil_note(
    instrument: &Instrument,
    effects: &[Effect],
    misjudged_waves: &[f64],
    depth_error: f64,
) -> Option<String> {
    let by_depth = effects.iter().find(|e| BY_DEPTH.contains(&e.id.as_str()));
    let effect = by_depth.or_else(|| effects.iter().find(|e| e.id == "wavefront_drift"))?;
    let error = 100.0 * instrument.pupil_model()?.misfit;
    let stated = instrument.manifest.optics.wavelength_um;
    let unknown = match by_depth {
        Some(_) => format!(
            "one plane does not show on which side of the focus the specimen lies, so that the sign is unknown; the \
             error includes {:.0} % for the radius of the pupils and the wavelength, which {}",
            100.0 * depth_error,
            match stated {
                Some(um) => format!("the session of the calibration states as {um} um"),
                None => format!(
                    "is taken to be {WAVELENGTH_UM} um (state `wavelength_um` under `[optics]` in the session of the \
                     calibration)"
                ),
            }
        ),
        None => "one plane does not show the sign of astigmatism and spherical aberration, and coefficients \
                      belong to hard rims (a soft one that ends farther out has larger ones)"
            .into(),
    };
    let most = misjudged_waves.iter().fold(0.0f64, |m, v| m.max(v.abs()));
    let misjudged = match most > 0.0 {
        true => format!(
            ". PSFs hardly show how far a lens is out of focus that is nearly in it, so that the defocus of each lens \
             was fitted beside the effect: it differs by up to {most:.3} waves rms from that of its pupil"
        ),
        false => String::new(),
    };
    Some(format!(
        "`{}` is that of round pupils, which explain the PSFs of the calibration with an error of {error:.1} %: the \
         beads were scanned in one plane. {unknown}; a bead scan at several depths decides it{misjudged}",
        effect.id
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn depths_are_exact_in_the_planes_and_least_known_between_them() {
        let planes = [-350.0, 0.0, 250.0];
        let off = |z_um| from_plane_um(&planes, z_um);
        assert_eq!([off(0.0), off(-115.0), off(-175.0), off(200.0), off(400.0)], [0.0, 115.0, 175.0, 50.0, 150.0]);
    }
}
