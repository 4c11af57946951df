//! What a depth or a wavefront means that pupils predict from a scan in one plane.

use super::result::Effect;
use ommatidia_model::instrument::Instrument;
use ommatidia_model::psf::pupils::WAVELENGTH_UM;

/// Effects that act by depth.
pub(super) const BY_DEPTH: [&str; 3] = ["defocus", "field_curvature", "tilt"];

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
