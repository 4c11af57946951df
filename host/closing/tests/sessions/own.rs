//! Sessions of instruments that have effects already: a response that flats showed at the calibration, or what `close`
//! found before.

use super::{accounted_by, measured, names, subject};
use ommatidia_closing::study::sessions::Holds;
use ommatidia_closing::{Closing, Dependence};
use ommatidia_model::instrument::Instrument;
use ommatidia_physics::effects::EffectSetting;

/// Closes the loop on a session with `now`, by an instrument that has `before`.
fn closed(before: &EffectSetting, now: &EffectSetting, seed: u64) -> Closing {
    let folder = tempfile::tempdir().unwrap();
    let session = measured(Holds::Whole, std::slice::from_ref(now), &folder.path().join("session"), seed);
    let instrument = Instrument { effects: vec![before.clone()], ..subject().instrument.clone() };
    accounted_by(&instrument, &session).closing
}

#[test]
fn effects_that_the_instrument_has_are_named_where_they_have_changed_and_only_there() {
    let bent = |beta| EffectSetting::new("nonlinearity", &[("beta", beta)]);
    let moved = |row_px| EffectSetting::new("array_shift", &[("row_px", row_px), ("col_px", -0.2)]);
    let cases = [(bent(0.02), bent(0.05), "beta", 0.05), (moved(0.3), moved(0.5), "row_px", 0.5)];
    for (seed, (before, now, param, value)) in (71..).zip(cases) {
        let same = closed(&before, &before, seed);
        assert!(same.effects.is_empty() && same.after.chi2_ndf < same.before.chi2_ndf + 1e-3, "{:?}", same.effects);
        let changed = closed(&before, &now, seed);
        assert_eq!(names(&changed), [now.id.as_str()]);
        let found = changed.effects[0].params.iter().find(|v| v.name == param).unwrap();
        assert!((found.value - value).abs() < 5.0 * found.sigma, "{found:?}");
        assert!(changed.effects[0].description.contains("has changed"), "{}", changed.effects[0].description);
        assert!(changed.after.chi2_ndf < changed.before.chi2_ndf);
        // What stands before is of the instrument as it is in its file, the structure too.
        let seen = |all: &[Dependence]| all.iter().map(|d| d.z).fold(0.0, f64::max);
        let [was, is] = [&changed.dependences_before, &changed.dependences_after].map(|all| seen(all));
        assert!(param == "beta" || was > 2.0 * is, "{was} {is}");
    }
}
