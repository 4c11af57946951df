//! Whether a session is of the instrument that it is compared with, by what its manifest states.

use super::options::CloseError;
use ommatidia_session::Manifest;

/// Sizes that are stated differ if they do so by more than this, relative: they are often rounded.
const SIZE: f64 = 0.01;
/// Nominal foci differ if one lies elsewhere by more than this share of the pitch.
const PLACE: f64 = 0.25;

/// Checks that a session has the layout that an instrument was calibrated for: array, sensor and object grid.
///
/// # Errors
/// [`CloseError::Layout`] if they differ.
pub fn check_layout(instrument: &Manifest, session: &Manifest) -> Result<(), CloseError> {
    let words = |m: &Manifest| {
        format!(
            "{}, a sensor of {} x {} and objects of {} x {} pixels",
            m.array.words(),
            m.sensor.rows,
            m.sensor.cols,
            m.object.rows,
            m.object.cols
        )
    };
    let (expected, found) = (words(instrument), words(session));
    if expected == found { Ok(()) } else { Err(CloseError::Layout { expected, found }) }
}

/// What a session of the same layout states otherwise than the calibration of an instrument did, as a note. The optics
/// that are fitted are those of the calibration; where the beads of the session lie follows from its own object pixels.
/// A session that states other values is of another instrument, or its frames are in another unit, or one of the two
/// files has a mistake. None: nothing.
pub(crate) fn contradiction(instrument: &Manifest, session: &Manifest) -> Option<String> {
    let differ = |a: f64, b: f64| (a - b).abs() > SIZE * a.abs().max(b.abs());
    let mut stated: Vec<String> = Vec::new();
    let sizes = |m: &Manifest| {
        [
            ("a pixel pitch", m.sensor.pixel_pitch_um, " um"),
            ("a magnification", m.optics.magnification, ""),
            ("object pixels", m.object.pixel_um, " um"),
            ("an array pitch", m.array.pitch_px, " px"),
        ]
    };
    for ((what, now, unit), (_, before, _)) in sizes(session).into_iter().zip(sizes(instrument)) {
        if differ(now, before) {
            stated.push(format!("{what} of {now}{unit} (calibration: {before}{unit})"));
        }
    }
    if let (Some(now), Some(before)) = (session.optics.wavelength_um, instrument.optics.wavelength_um)
        && differ(now, before)
    {
        stated.push(format!("a wavelength of {now} um (calibration: {before} um)"));
    }
    if session.sensor.bit_depth != instrument.sensor.bit_depth {
        let [now, before] = [session, instrument].map(|m| m.sensor.bit_depth);
        stated.push(format!("a converter of {now} bits (calibration: {before} bits)"));
    }
    let [now, before] = [session, instrument].map(|m| m.array.places_px(&m.sensor));
    let far = |l: &usize| {
        let off = (now[*l][0] - before[*l][0]).hypot(now[*l][1] - before[*l][1]);
        off > PLACE * instrument.array.pitch_px
    };
    let elsewhere: Vec<String> =
        (0..now.len().min(before.len())).filter(far).map(|l| session.array.lens_name(l)).collect();
    if !elsewhere.is_empty() && !differ(session.array.pitch_px, instrument.array.pitch_px) {
        stated.push(format!("other places of the lenses {}", elsewhere.join("; ")));
    }
    (!stated.is_empty()).then(|| {
        format!(
            "session.toml states {}. Check that this is a session of the same instrument, and correct the file that is \
             wrong",
            stated.join(", ")
        )
    })
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn what_a_session_states_otherwise_is_listed_and_roundings_are_not() {
        let before = ommatidia_model::testing::instrument([9, 11], [30, 33], 5, 3).manifest;
        assert_eq!(contradiction(&before, &before), None);
        let mut now = before.clone();
        now.optics.magnification *= 1.004;
        now.optics.wavelength_um = Some(0.5);
        assert_eq!(contradiction(&before, &now), None);
        now.sensor.bit_depth = 10;
        now.object.pixel_um = 2.5;
        let note = contradiction(&before, &now).unwrap();
        assert!(note.contains("object pixels of 2.5 um (calibration: 1 um), a converter of 10 bits"), "{note}");
        let mut places = before.array.places_px(&before.sensor);
        places[1][0] += 0.3 * before.array.pitch_px;
        let mut moved = before.clone();
        moved.array.lenses_px = Some(places);
        let note = contradiction(&before, &moved).unwrap();
        assert!(note.contains("other places of the lenses 2."), "{note}");
    }
}
