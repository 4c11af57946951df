//! The explicit optics are those of the instrument, and no change of a specimen passes the projection.
#![allow(clippy::unwrap_used)]

use super::estimate_specimens;
use super::fitted::specimens;
use super::probe::probed;
use crate::data::{Frame, Observations, Shown};
use crate::evidence::Scores;
use crate::fit::derivative::Expansion;
use crate::fit::projection::{Footprint, Projector};
use crate::fit::{Column, Design, Errors, Fitted, Model, Predicted, Scope, Term, nuisances, refit};
use ndarray::Array2;
use ommatidia_model::instrument::Instrument;
use ommatidia_model::testing::{instrument, smooth};
use ommatidia_physics::effects::find;
use ommatidia_session::rng::stream;
use ommatidia_session::{FrameInfo, Role};
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};

const SENSOR: [usize; 2] = [48, 52];
const OBJECT: [usize; 2] = [20, 22];

fn specimen(seed: u64) -> Array2<f32> {
    let mut rng = stream(seed, "specimen/tests", 0);
    Array2::from_shape_fn((OBJECT[0], OBJECT[1]), |_| {
        if rng.random::<f32>() < 0.3 { 40.0 * rng.random::<f32>() } else { 1.0 }
    })
}

/// Four frames of unknown specimens under the terms, with the noise of the instrument.
fn unknown(instrument: &Instrument, terms: &[Term], noisy: bool) -> Observations {
    let n = SENSOR[0] * SENSOR[1];
    let side = 4;
    let block = |b: usize| {
        let (i, j) = (b / side, b % side);
        let rows = i * SENSOR[0] / side..(i + 1) * SENSOR[0] / side;
        let cols = j * SENSOR[1] / side..(j + 1) * SENSOR[1] / side;
        rows.flat_map(move |r| cols.clone().map(move |c| (r * SENSOR[1] + c) as u32)).collect::<Vec<_>>()
    };
    let blocks: Vec<Vec<u32>> = (0..side * side).map(block).collect();
    let frame = |k: usize| Frame {
        stack: 0,
        role: Role::Scene,
        info: FrameInfo { time_s: 0.02 * k as f64, ..FrameInfo::plain(k, 10.0) },
        measured: Array2::zeros((SENSOR[0], SENSOR[1])),
        cut: None,
        shown: Shown::Object(k),
        held_out: false,
        previous: None,
    };
    let mut seen = Observations {
        frames: (0..4).map(frame).collect(),
        truths: (0..4).map(specimen).collect(),
        registrations: Vec::new(),
        pixels: blocks.concat(),
        blocks: (0..side * side).map(|b| b * n / (side * side)..(b + 1) * n / (side * side)).collect(),
        held_out_blocks: (0..side * side).map(|b| b == 6).collect(),
        sensor: SENSOR,
        recorded: 4,
        not_estimated: None,
    };
    let made: Vec<Array2<f32>> = {
        let model = Model::new(instrument, &seen).unwrap();
        let mut state = model.state(instrument).unwrap();
        state.terms = terms.to_vec();
        let predicted = model.predict(&state, &model.scenes(&state).unwrap());
        let draw = |(k, p): (usize, &Predicted)| {
            let mut rng = stream(5, "specimen/noise", k as u64);
            let sigma = p.inverse_sigma.mapv(|w| if w > 0.0 && noisy { 1.0 / w } else { 0.0 });
            &p.dn
                + &sigma.mapv(|s| {
                    let v: f32 = StandardNormal.sample(&mut rng);
                    v * s
                })
        };
        predicted.iter().enumerate().map(draw).collect()
    };
    seen.frames.iter_mut().zip(made).for_each(|(f, dn)| f.measured = dn);
    seen.frames.iter_mut().for_each(|f| f.shown = Shown::Unknown);
    seen.truths.clear();
    estimate_specimens(instrument, &mut seen);
    assert!(seen.frames.iter().all(|f| f.shown == Shown::Estimated));
    seen
}

/// Sensor pixels that see a part of the object alone, [sensor rows, sensor cols].
fn region_of(instrument: &Instrument) -> Array2<bool> {
    let corner = |anchor: &[f64; 2]| [0, 1].map(|a| (anchor[a] - (OBJECT[a] as f64 - 1.0) / 2.0).round() as isize - 4);
    let corners = instrument.geometry.anchors_px.iter().map(corner).collect();
    let footprint = Footprint { object: OBJECT, sensor: SENSOR, side: 9, corners };
    footprint.alone(&Array2::from_shape_fn((OBJECT[0], OBJECT[1]), |(r, c)| r < 15 && c >= 4), 1)
}

fn term(id: &str, values: &[(&str, f64)], lenses: usize) -> Term {
    let effect = find(id).unwrap();
    let value = |name: &str, off: f64| values.iter().find(|(n, _)| *n == name).map_or(off, |(_, v)| *v);
    let params = effect.descriptor().expanded(lenses).iter().map(|(name, p)| value(name, p.off)).collect();
    Term { effect, params, table: None, table_error: 0.0 }
}

#[test]
fn the_explicit_optics_are_those_of_the_instrument() {
    // PSFs that differ from pixel to pixel at random cannot be moved by a part of a pixel.
    let instrument = smooth(instrument(OBJECT, SENSOR, 9, 3));
    let seen = unknown(&instrument, &[], false);
    let model = Model::new(&instrument, &seen).unwrap();
    let moved = [term("array_shift", &[("row_px", 1.3)], 2)];
    // What the sensor does to each pixel or its neighbours belongs to the optics, what comes from afar does not.
    let sensor = [
        term("charge_diffusion", &[("sigma_px", 0.6)], 2),
        term("vignetting", &[("v", 0.2)], 2),
        term("halo", &[("weight", 0.05)], 2),
        term("background", &[("rate_e_per_ms", 3.0)], 2),
    ];
    // So does what it makes of the charge, unless it bends the response.
    let reading = [
        term("interpixel_capacitance", &[("alpha", 0.02)], 2),
        term("readout_lag", &[("share", 0.04)], 2),
        term("nonlinearity", &[("beta", 0.1)], 2),
        term("row_pattern", &[("amplitude_dn", 5.0)], 2),
    ];
    let cases = [(&[][..], &[][..]), (&moved, &moved), (&sensor, &sensor[..2]), (&reading, &reading[..2])];
    for (terms, near) in cases {
        let chain = model.chain(near);
        let views = probed(&model, terms, &[0, 1], model.window_px).unwrap();
        let object = specimen(9);
        let cx = model.context(0, None);
        let scene = model.forward.scene(object.view(), &chain, &cx).unwrap();
        let read = |light_e: Array2<f32>| model.forward.frame_dn(light_e, &chain, &cx);
        let dark = read(Array2::zeros((SENSOR[0], SENSOR[1])));
        let expected =
            (read(model.forward.light_e(&scene, &chain, &cx)) - dark) / model.forward.noise().gain_dn_per_e as f32;
        let x: Vec<[f32; 1]> = object.iter().map(|v| [*v]).collect();
        let found = views.forward(&x);
        let norm = expected.iter().map(|v| v * v).sum::<f32>().sqrt();
        let error = expected.iter().zip(&found).map(|(a, b)| (a - b[0]).powi(2)).sum::<f32>().sqrt();
        assert!(error < 2e-3 * norm, "{error} of {norm}");
        // The adjoint is the transpose.
        let y: Vec<[f32; 1]> = (0..found.len()).map(|i| [((i * 37) % 101) as f32 / 50.0 - 1.0]).collect();
        let dot = |a: &[[f32; 1]], b: &[[f32; 1]]| a.iter().zip(b).map(|(a, b)| f64::from(a[0] * b[0])).sum::<f64>();
        let (left, right) = (dot(&found, &y), dot(&x, &views.adjoint(&y)));
        assert!((left - right).abs() < 1e-4 * left.abs().max(right.abs()), "{left} {right}");
    }
}

#[test]
fn no_specimen_passes_and_noise_loses_what_the_specimen_takes_up() {
    let instrument = instrument(OBJECT, SENSOR, 9, 3);
    let seen = unknown(&instrument, &[], false);
    let model = Model::new(&instrument, &seen).unwrap();
    let views = probed(&model, &[], &[0], model.window_px).unwrap();
    let x: Vec<[f32; 1]> = specimen(11).iter().map(|v| [*v]).collect();
    let light = views.forward(&x);
    let mut image = Array2::from_shape_fn((SENSOR[0], SENSOR[1]), |(r, c)| light[r * SENSOR[1] + c][0]);
    let norm = |image: &Array2<f32>| image.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>().sqrt();
    let before = norm(&image);
    let projector = Projector::of(views, vec![1.0; SENSOR[0] * SENSOR[1]]).unwrap();
    projector.remove(&mut [&mut image]);
    assert!(norm(&image) < 2e-3 * before, "{} of {before}", norm(&image));
    // A projection: noise keeps a share between 1 - unknowns/pixels and 1, and a second one changes nothing more.
    let mut rng = stream(1, "projection", 0);
    let mut noise = Array2::from_shape_fn((SENSOR[0], SENSOR[1]), |_| {
        let v: f32 = StandardNormal.sample(&mut rng);
        v
    });
    let all = norm(&noise).powi(2);
    projector.remove(&mut [&mut noise]);
    let once = norm(&noise).powi(2);
    let least = 1.0 - (OBJECT[0] * OBJECT[1]) as f64 / (SENSOR[0] * SENSOR[1]) as f64;
    assert!(once / all > least - 0.05 && once / all < 0.99, "{} {least}", once / all);
    projector.remove(&mut [&mut noise]);
    assert!((norm(&noise).powi(2) / once - 1.0).abs() < 0.03);
}

/// A region sees a part of an object, and what it sees of it by tails alone is merged: what the whole object makes of
/// the pixels of the region is taken out all the same.
#[test]
fn no_specimen_passes_in_a_region() {
    let instrument = smooth(instrument(OBJECT, SENSOR, 9, 3));
    let mut seen = unknown(&instrument, &[], false);
    let region = region_of(&instrument);
    seen.use_pixels(|r, c| region[[r, c]], 4);
    assert!(seen.pixels.len() > 100, "{}", seen.pixels.len());
    let model = Model::new(&instrument, &seen).unwrap();
    let views = probed(&model, &[], &[0], model.window_px).unwrap();
    assert!(views.pixels().len() < OBJECT[0] * OBJECT[1], "{}", views.pixels().len());
    let object = specimen(11);
    let cx = model.context(0, None);
    let scene = model.forward.scene(object.view(), &model.chain(&[]), &cx).unwrap();
    let mut image = model.forward.light_e(&scene, &model.chain(&[]), &cx) * &seen.used();
    let norm = |image: &Array2<f32>| image.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>().sqrt();
    let before = norm(&image);
    let projector = Projector::of(views, seen.used().iter().copied().collect()).unwrap();
    projector.remove(&mut [&mut image]);
    let left = norm(&(&image * &seen.used()));
    assert!(left < 5e-3 * before, "{left} of {before}");
}

#[test]
fn states_with_the_same_optics_share_what_takes_specimens_out() {
    let instrument = instrument(OBJECT, SENSOR, 9, 3);
    let seen = unknown(&instrument, &[], false);
    let model = Model::new(&instrument, &seen).unwrap();
    let of = |terms: &[Term]| {
        let views = probed(&model, terms, &[0], model.window_px).unwrap();
        model.projectors.of(views, vec![1.0; SENSOR[0] * SENSOR[1]]).unwrap()
    };
    let [plain, bent] = [of(&[]), of(&[term("nonlinearity", &[("beta", 0.01)], 3)])];
    assert!(std::sync::Arc::ptr_eq(&plain, &bent));
    let moved = of(&[term("array_shift", &[("row_px", 0.3)], 3)]);
    assert!(!std::sync::Arc::ptr_eq(&plain, &moved));
    // Nothing stays that no state uses.
    let before = std::sync::Arc::downgrade(&moved);
    drop(moved);
    assert!(before.upgrade().is_none());
}

#[test]
fn what_a_wider_choice_of_specimens_takes_of_the_noise_is_no_evidence() {
    let instrument = instrument(OBJECT, SENSOR, 9, 3);
    let mut seen = unknown(&instrument, &[], true);
    // Of dark specimens every optics is right: what differs is the share of the noise that they take up.
    let noise = &Model::new(&instrument, &seen).unwrap().forward.noise().clone();
    for (k, f) in seen.frames.iter_mut().enumerate() {
        let mut rng = stream(6, "specimen/dark", k as u64);
        f.measured.mapv_inplace(|_| {
            let v: f64 = StandardNormal.sample(&mut rng);
            (noise.black_level_dn + v * noise.variance_dn2(noise.black_level_dn).sqrt()) as f32
        });
    }
    let model = Model::new(&instrument, &seen).unwrap();
    let under = |terms: &[Term]| {
        let mut state = model.state(&instrument).unwrap();
        state.terms = terms.to_vec();
        state.specimens = specimens(&model, &state).unwrap();
        let predicted = model.predict(&state, &model.scenes(&state).unwrap());
        let at = Expansion { state: &state, trials: &[], predicted: &predicted, scenes: &[] };
        Design::compute(&model, at, Vec::new(), &Errors::default(), Scope::Training).unwrap().training().misfit()
    };
    let (plain, wider) = (under(&[]), under(&[term("charge_diffusion", &[("sigma_px", 1.5)], 2)]));
    // A wider PSF resolves less, and the specimens take up less of the noise; chi-squared alone would see a worse fit.
    assert!(wider.chi2 - plain.chi2 > 500.0, "{plain:?} {wider:?}");
    assert!((wider.deviance - plain.deviance).abs() < 0.2 * (wider.chi2 - plain.chi2), "{plain:?} {wider:?}");
}

#[test]
fn only_what_follows_the_pixel_grid_acts_on_frames_whose_specimens_are_not_estimated() {
    let instrument = instrument(OBJECT, SENSOR, 9, 3);
    let mut seen = unknown(&instrument, &[], true);
    seen.frames[1].shown = Shown::Unknown;
    let model = Model::new(&instrument, &seen).unwrap();
    let of = |terms: &[Term]| {
        let mut state = model.state(&instrument).unwrap();
        state.terms = terms.to_vec();
        model.predict(&state, &model.scenes(&state).unwrap()).swap_remove(1).dn
    };
    let plain = of(&[]);
    let optics = [term("charge_diffusion", &[("sigma_px", 0.8)], 2), term("vignetting", &[("v", 0.2)], 2)];
    assert_eq!(of(&optics), plain);
    assert_ne!(of(&[term("row_pattern", &[("amplitude_dn", 2.0)], 2)]), plain);
}

#[test]
fn a_change_of_the_specimen_is_not_testable_and_a_lens_is() {
    let instrument = instrument(OBJECT, SENSOR, 9, 3);
    let seen = unknown(&instrument, &[], true);
    let model = Model::new(&instrument, &seen).unwrap();
    let fit = refit(&model, model.state(&instrument).unwrap()).unwrap();
    let of = |id: &str| {
        let trial = term(id, &[], model.lenses());
        let mut columns: Vec<Column> = nuisances(&model);
        let given: Vec<usize> = (0..columns.len()).collect();
        columns.extend(trial.strengths(model.lenses()).into_iter().map(|param| Column::Trial { term: 0, param }));
        let tested: Vec<usize> = (given.len()..columns.len()).collect();
        let trials = [trial];
        let design =
            Design::compute(&model, fit.expansion(&trials), columns, &Errors::default(), Scope::Training).unwrap();
        Scores::new(&design, given).test(&tested).is_some()
    };
    // Shading of the excitation is a change of the object; the light of one lens beside the other is none.
    assert!(!of("excitation_profile") && of("lens_gain"));
}

/// Fits without and with the gains of the lenses, and the gain of the first lens over that of the second.
fn fitted_gain(instrument: &Instrument, seen: &Observations) -> ([Fitted; 2], f64) {
    let model = Model::new(instrument, seen).unwrap();
    let before = refit(&model, model.state(instrument).unwrap()).unwrap();
    let mut state = before.state.clone();
    state.terms.push(term("lens_gain", &[], 2));
    let after = refit(&model, state).unwrap();
    let [a, b] = [after.state.terms[0].params[0], after.state.terms[0].params[1]];
    ([before, after], (1.0 + a) / (1.0 + b))
}

#[test]
fn the_gain_of_a_lens_is_found_in_frames_of_the_unknown() {
    let instrument = instrument(OBJECT, SENSOR, 9, 3);
    let seen = unknown(&instrument, &[term("lens_gain", &[("change_0", 0.1)], 2)], true);
    let ([before, after], ratio) = fitted_gain(&instrument, &seen);
    assert!((ratio - 1.1).abs() < 0.02, "{ratio}");
    assert!(before.held_out.deviance - after.held_out.deviance > 10.0);
}

#[test]
fn the_gain_of_a_lens_is_found_in_a_region() {
    let instrument = instrument(OBJECT, SENSOR, 9, 3);
    let mut seen = unknown(&instrument, &[term("lens_gain", &[("change_0", 0.2)], 2)], true);
    let region = region_of(&instrument);
    seen.use_pixels(|r, c| region[[r, c]], 4);
    // Outside of the region frames may hold anything.
    for f in &mut seen.frames {
        f.measured.indexed_iter_mut().filter(|(at, _)| !region[*at]).for_each(|(_, v)| *v = 900.0);
    }
    let ([_, after], ratio) = fitted_gain(&instrument, &seen);
    assert!((ratio - 1.2).abs() < 0.04, "{ratio}");
    let left = &after.predicted[0].residual_dn;
    assert!(left.indexed_iter().all(|(at, v)| region[at] || *v == 0.0));
}

#[test]
fn no_fit_moves_along_what_a_change_of_the_specimen_makes() {
    let instrument = instrument(OBJECT, SENSOR, 9, 3);
    let seen = unknown(&instrument, &[term("lens_gain", &[("change_0", 0.1)], 2)], true);
    let model = Model::new(&instrument, &seen).unwrap();
    let start = |change: f64| {
        let mut state = model.state(&instrument).unwrap();
        state.terms.push(term("lens_gain", &[("change_0", change), ("change_1", change)], 2));
        refit(&model, state).unwrap()
    };
    // The light of both lenses together is that of the specimen: it stays where it was, and the lenses part.
    for change in [0.0, 0.3] {
        let fit = start(change);
        assert_eq!(fit.gauges.iter().map(|g| g.directions.ncols()).collect::<Vec<_>>(), [1]);
        let [a, b] = [fit.state.terms[0].params[0], fit.state.terms[0].params[1]];
        assert!(((1.0 + a) / (1.0 + b) - 1.1).abs() < 0.02, "{a} {b}");
        assert!(a > change && b < change + 0.01, "{a} {b} from {change}");
    }
}
