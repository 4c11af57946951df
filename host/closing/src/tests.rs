//! Fits to frames that the model itself drew recover the effects that were injected. (The study shows the same for
//! frames of the independent virtual instrument.)

#![allow(clippy::unwrap_used)]

use super::data::{Frame, Observations, Shown};
use super::evidence::maps::Beside;
use super::evidence::{Figures, Scores, figures, is_worse, maps};
use super::fit::{
    Column, Design, Errors, Expansion, Fitted, Model, Predicted, Scope, Term, fitted_columns, nuisances, refit,
    replicas,
};
use ndarray::Array2;
use ommatidia_model::instrument::Instrument;
use ommatidia_model::testing::{instrument, smooth};
use ommatidia_physics::effects::{Kind, find};
use ommatidia_session::rng::stream;
use ommatidia_session::{FrameInfo, Role};
use rand_distr::{Distribution, StandardNormal};
use std::sync::Arc;

const SENSOR: [usize; 2] = [48, 52];

fn term(id: &str, values: &[(&str, f64)], lenses: usize) -> Term {
    let effect = find(id).unwrap();
    let value = |name: &str, off: f64| values.iter().find(|(n, _)| *n == name).map_or(off, |(_, v)| *v);
    let params = effect.descriptor().expanded(lenses).iter().map(|(name, p)| value(name, p.off)).collect();
    Term { effect, params, table: None, table_error: 0.0 }
}

/// Six scenes, 20 ms apart, drawn from the instrument with `terms`.
fn observations(instrument: &Instrument, terms: &[Term]) -> Observations {
    let object = |k: usize| {
        Array2::from_shape_fn((20, 22), |(r, c)| {
            if (r * 31 + c * 17 + k * 53).is_multiple_of(29) { 3.0 + k as f32 } else { 0.0 }
        })
    };
    let frame = |k: usize| Frame {
        stack: 0,
        role: Role::Scene,
        info: FrameInfo { time_s: 0.02 * k as f64, ..FrameInfo::plain(k, 10.0) },
        measured: Array2::zeros((SENSOR[0], SENSOR[1])),
        cut: None,
        shown: Shown::Object(k),
        held_out: k == 5,
        previous: k.checked_sub(1),
    };
    let n = SENSOR[0] * SENSOR[1];
    let mut seen = Observations {
        frames: (0..6).map(frame).collect(),
        truths: (0..6).map(object).collect(),
        registrations: Vec::new(),
        pixels: (0..n as u32).collect(),
        blocks: (0..4).map(|b| b * n / 4..(b + 1) * n / 4).collect(),
        held_out_blocks: vec![false; 4],
        sensor: SENSOR,
        recorded: 0,
        not_estimated: None,
    };
    let made: Vec<Array2<f32>> = {
        let model = Model::new(instrument, &seen).unwrap();
        let mut state = model.state(instrument).unwrap();
        state.terms = terms.to_vec();
        let scenes = model.scenes(&state).unwrap();
        let predicted = model.predict(&state, &scenes);
        let draw = |(k, p): (usize, &Predicted)| {
            let mut rng = stream(3, "closing/tests", k as u64);
            let mut dn = p.dn.clone();
            dn.zip_mut_with(&p.light_e, |v, e| {
                let z: f64 = StandardNormal.sample(&mut rng);
                let noise = &instrument.noise;
                *v +=
                    (z * noise.variance_dn2(noise.black_level_dn + noise.gain_dn_per_e * f64::from(*e)).sqrt()) as f32;
            });
            dn
        };
        predicted.iter().enumerate().map(draw).collect()
    };
    seen.frames.iter_mut().zip(made).for_each(|(f, m)| f.measured = m);
    seen
}

/// A parameter of an injected effect, fitted from absence, and its standard error.
fn fitted(put_in: &Term, param: usize) -> (f64, f64) {
    let instrument = instrument([20, 22], SENSOR, 9, 3);
    let seen = observations(&instrument, std::slice::from_ref(put_in));
    let model = Model::new(&instrument, &seen).unwrap();
    let mut state = model.state(&instrument).unwrap();
    state.terms.push(put_in.switched_off(model.lenses()));
    let fit = refit(&model, state).unwrap();
    let columns: Vec<Column> = fitted_columns(&model, &fit.state);
    let design =
        Design::compute(&model, fit.expansion(&[]), columns.clone(), &Errors::default(), Scope::Whole).unwrap();
    let mine: Vec<usize> = (0..columns.len()).filter(|i| matches!(columns[*i], Column::Own { .. })).collect();
    let others = (0..columns.len()).filter(|i| !mine.contains(i)).collect();
    let test = Scores::new(&design, others).test(&mine).unwrap();
    let p = put_in.expanded(model.lenses())[param].1;
    let value = fit.state.terms.iter().find(|t| t.id() == put_in.id()).unwrap().params[param];
    (value, p.outer_sigma(p.inner(value), test.covariance[[param, param]].sqrt()))
}

#[test]
fn a_remainder_of_the_preceding_frame_is_found() {
    let (value, sigma) = fitted(&term("lag", &[("share", 0.05)], 2), 0);
    assert!(sigma > 0.0 && sigma < 0.01 && (value - 0.05).abs() < 4.0 * sigma, "{value} +- {sigma}");
}

#[test]
fn a_standard_deviation_is_found_from_where_it_has_no_slope() {
    let (value, sigma) = fitted(&term("charge_diffusion", &[("sigma_px", 0.4)], 2), 0);
    assert!(sigma > 0.0 && sigma < 0.02 && (value - 0.4).abs() < 4.0 * sigma, "{value} +- {sigma}");
    // Where it is absent its square is uncertain by sigma^2, itself by sigma.
    let p = &find("charge_diffusion").unwrap().descriptor().params[0];
    assert!((p.outer_sigma(0.0, 0.01) - 0.1).abs() < 1e-12 && (p.outer_sigma(0.16, 0.008) - 0.0099).abs() < 1e-3);
    assert!(p.outer(-0.3) == 0.0 && p.kind == Kind::Square && p.forbidden_side() < 0.0);
}

#[test]
fn states_share_the_light_behind_the_optics_where_they_emit_the_same() {
    let instrument = instrument([20, 22], SENSOR, 9, 3);
    let seen = observations(&instrument, &[]);
    let model = Model::new(&instrument, &seen).unwrap();
    let state = model.state(&instrument).unwrap();
    let with = |effect: Term| {
        let mut state = state.clone();
        state.terms.push(effect);
        model.scenes(&state).unwrap()
    };
    let scenes = model.scenes(&state).unwrap();
    assert!(Arc::ptr_eq(&scenes, &with(term("array_shift", &[("row_px", 0.3)], 2))));
    let [faded, other] = [0.5, 0.6].map(|rate| with(term("photobleaching", &[("rate_per_s", rate)], 2)));
    assert!(!Arc::ptr_eq(&scenes, &faded) && !Arc::ptr_eq(&faded, &other));
    // Nothing outlives the states that use it.
    let weak = Arc::downgrade(&faded);
    drop(faded);
    assert!(weak.upgrade().is_none());
}

/// Two replicates that differ by 2 % of the light at the second depth, and not at the first.
#[test]
fn replicates_err_at_the_depth_at_which_they_differ() {
    let mut instrument = instrument([20, 22], SENSOR, 9, 3);
    let psf = &mut instrument.psf;
    psf.coefficients = ndarray::concatenate![ndarray::Axis(2), psf.coefficients, psf.coefficients];
    psf.node_depths_um = vec![0.0, 50.0];
    instrument.replicates = [0.98, 1.02]
        .map(|factor| {
            let mut psf = instrument.psf.clone();
            psf.coefficients.index_axis_mut(ndarray::Axis(2), 1).mapv_inplace(|v| factor * v);
            psf
        })
        .to_vec();
    let mut seen = observations(&instrument, &[]);
    seen.frames.iter_mut().skip(3).for_each(|f| f.info.z_um = 50.0);
    let model = Model::new(&instrument, &seen).unwrap();
    let fit = refit(&model, model.state(&instrument).unwrap()).unwrap();
    let errors = replicas(&model, &instrument, &fit.state).unwrap().of(&model, &fit).unwrap();
    assert_eq!(errors.scattered, 2);
    for (k, change) in errors.changes[1].iter().enumerate() {
        let light = fit.predicted[k].dn.sum() - instrument.noise.black_level_dn as f32 * (SENSOR[0] * SENSOR[1]) as f32;
        let found = change.as_ref().unwrap().sum() / light;
        let expected = if k < 3 { 0.0 } else { 0.02 };
        assert!((found - expected).abs() < 1e-3, "{k}: {found}");
    }
}

#[test]
fn a_factor_common_to_all_lenses_is_light() {
    let instrument = instrument([20, 22], SENSOR, 9, 3);
    let seen = observations(&instrument, &[]);
    let model = Model::new(&instrument, &seen).unwrap();
    let mut state = model.state(&instrument).unwrap();
    state.terms.push(term("lens_gain", &[("change_0", 0.21), ("change_1", 0.1)], 2));
    let scenes = model.scenes(&state).unwrap();
    let before = model.predict(&state, &scenes);
    let state = model.gauged(state);
    let gains = state.terms.iter().find(|t| t.id() == "lens_gain").unwrap();
    assert!(gains.params.contains(&0.0) && state.scale[0] != 1.0);
    for (a, b) in before.iter().zip(model.predict(&state, &scenes)) {
        assert!(a.dn.iter().zip(&b.dn).all(|(a, b)| (a - b).abs() < 1e-3 * a.abs()));
    }
}

#[test]
fn light_that_only_widens_the_errors_is_no_better_fit() {
    let instrument = instrument([20, 22], SENSOR, 9, 3);
    let seen = observations(&instrument, &[]);
    let model = Model::new(&instrument, &seen).unwrap();
    let plain = refit(&model, model.state(&instrument).unwrap()).unwrap();
    let mut state = plain.state.clone();
    // A uniform background that the black level compensates: the same expected frame with more noise.
    state.terms.push(term("background", &[("rate_e_per_ms", 5.0)], 2));
    state.black_dn -= 5.0 * 10.0 * 0.5;
    let predicted = model.predict(&state, &plain.scenes);
    let at = Expansion { state: &state, trials: &[], predicted: &predicted, scenes: &plain.scenes };
    let design = Design::compute(&model, at, nuisances(&model), &Errors::default(), Scope::Whole).unwrap();
    let wide = design.training().misfit();
    assert!(wide.chi2 < 0.9 * plain.training.chi2 && wide.deviance > plain.training.deviance + 100.0, "{wide:?}");
}

#[test]
fn a_residual_with_structure_is_no_adequate_model() {
    let instrument = instrument([20, 22], SENSOR, 9, 2);
    let verdict = |terms: &[Term]| {
        let mut seen = observations(&instrument, terms);
        let account = super::residual(&instrument, &mut seen, &super::CloseOptions::default()).unwrap();
        (account.closing.verdict, account.closing.catalogue_incomplete)
    };
    assert_eq!(verdict(&[]), (super::Verdict::Adequate, false));
    let shifted = term("array_shift", &[("row_px", 0.6)], instrument.geometry.anchors_px.len());
    assert_eq!(verdict(&[shifted]), (super::Verdict::Incomplete, true));
}

/// A shadow of 40 % on a part of the sensor that scenes alone show.
fn shadow() -> Term {
    let deep = |(r, c): (usize, usize)| -0.4 * (-((r as f32 - 20.0).powi(2) + (c as f32 - 30.0).powi(2)) / 60.0).exp();
    Term { table: Some(Array2::from_shape_fn((SENSOR[0], SENSOR[1]), deep)), ..term("unknown_shading", &[], 2) }
}

#[test]
fn a_shadow_that_scenes_alone_show_is_mapped_and_noise_is_not() {
    let instrument = instrument([20, 22], SENSOR, 9, 2);
    let fits = |terms: &[Term]| {
        let seen = observations(&instrument, terms);
        let model = Model::new(&instrument, &seen).unwrap();
        let fit = refit(&model, model.state(&instrument).unwrap()).unwrap();
        let light = fit.predicted.iter().fold(Array2::<f32>::zeros((SENSOR[0], SENSOR[1])), |sum, p| sum + &p.light_e);
        (maps::fit(&model, Beside::of(&fit)), light)
    };
    // Five maps are tried.
    assert!(fits(&[]).0.iter().all(|f| f.p > 0.01 / 5.0), "a map of noise");
    let (found, light) = fits(&[shadow()]);
    let shading = found.iter().find(|f| f.term.id() == "unknown_shading").expect("the shadow");
    assert!(shading.p < 1e-3 && shading.gain > 100.0, "z {}, gain {}", shading.z, shading.gain);
    let (map, truth) = (shading.term.table.clone().unwrap(), shadow().table.unwrap());
    // A factor shows where there is light, and the light of the stack takes its mean.
    let power = |map: &Array2<f32>| {
        let mean = (map * &light).sum() / light.sum();
        (map.mapv(|v| (v - mean).powi(2)) * &light).sum()
    };
    let left = power(&(&map - &truth)) / power(&truth);
    assert!(left < 0.3, "{left} of the shadow's square is not in the map");
}

#[test]
fn a_cause_outside_the_catalogue_is_given_no_name_and_its_excess_is_removed() {
    let instrument = instrument([20, 22], SENSOR, 9, 2);
    let mut seen = observations(&instrument, &[shadow()]);
    let closed = super::close(&instrument, &mut seen, &super::CloseOptions::default(), |_| ()).unwrap();
    let closing = closed.account.closing;
    assert!(closing.effects.iter().all(|e| !e.known), "{:?}", closing.effects);
    let [before, after] = [closing.before, closing.after].map(|f| f.chi2_ndf - 1.0);
    assert!(after < 0.3 * before, "{before} {after}");
    // The same cause in the catalogue: a shift has its name, and no map beside it. PSFs that differ from pixel to pixel
    // at random, as those above, cannot be moved by a part of a pixel: optics make smoother ones.
    let shifted = term("array_shift", &[("row_px", 0.6)], 2);
    let instrument = smooth(instrument);
    let mut seen = observations(&instrument, &[shifted]);
    let closed = super::close(&instrument, &mut seen, &super::CloseOptions::default(), |_| ()).unwrap();
    let ids: Vec<String> = closed.account.closing.effects.iter().map(|e| e.id.clone()).collect();
    assert_eq!(ids, ["array_shift"]);
}

#[test]
fn a_shade_of_one_view_alone_is_mapped_for_its_lens() {
    let instrument = instrument([20, 22], SENSOR, 9, 2);
    let deep = |(r, c): (usize, usize)| -0.5 * (-((r as f32 - 20.0).powi(2) + (c as f32 - 30.0).powi(2)) / 90.0).exp();
    let table = Some(Array2::from_shape_fn((SENSOR[0], SENSOR[1]), deep));
    let shade = Term { table, ..term("unknown_view", &[("lens", 1.0)], 2) };
    let seen = observations(&instrument, &[shade]);
    let model = Model::new(&instrument, &seen).unwrap();
    let fit = refit(&model, model.state(&instrument).unwrap()).unwrap();
    let found = maps::fit(&model, Beside::of(&fit)).into_iter().find(|f| f.term.id() == "unknown_view").unwrap();
    assert!(found.term.params[1] == 1.0 && found.p < 1e-3 && found.gain > 100.0, "{:?}, {}", found.term, found.gain);
    // With the map in the model little is left.
    let mut state = fit.state.clone();
    state.terms.push(found.term);
    let [before, after] = [&fit, &refit(&model, state).unwrap()].map(|f| f.held_out.chi2 / f.held_out.pixels - 1.0);
    assert!(after < 0.3 * before, "{before} {after}");
}

#[test]
fn a_rise_of_either_figure_is_worse() {
    let instrument = instrument([20, 22], SENSOR, 9, 2);
    let seen = observations(&instrument, &[]);
    let model = Model::new(&instrument, &seen).unwrap();
    let plain = refit(&model, model.state(&instrument).unwrap()).unwrap();
    let with = |ratio: f64| {
        let mut state = plain.state.clone();
        state.terms.push(term("ghost", &[("ratio", ratio)], 2));
        let predicted = model.predict(&state, &plain.scenes);
        figures(&model, &Fitted { state, predicted, ..plain.clone() })
    };
    // A tenth of all light at a wrong place.
    assert!(is_worse(with(0.0), with(0.1)) && !is_worse(with(0.1), with(0.0)));
    assert!(!is_worse(with(0.0), with(1e-6)));
    let of = |chi2_ndf, nrmse| Figures { chi2_ndf, nrmse, pcc: 0.99 };
    assert!(is_worse(of(1.0, 0.05), of(1.0003, 0.04)) && is_worse(of(1.1, 0.05), of(1.0, 0.0503)));
    assert!(!is_worse(of(1.0, 0.05), of(1.00005, 0.050004)));
    // From a tenth too little scatter to a twentieth too much.
    assert!(!is_worse(of(0.9, 0.05), of(1.05, 0.04)) && is_worse(of(0.9, 0.05), of(1.12, 0.04)));
    // Nothing is judged where no frame is known.
    assert!(!is_worse(of(f64::NAN, f64::NAN), of(f64::NAN, f64::NAN)));
}
