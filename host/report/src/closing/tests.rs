#![allow(clippy::unwrap_used)]
use super::super::page::Numbers;
use super::*;
use ndarray::Array3;
use ommatidia_closing::{
    Advice, Covariate, Effect, Fault, FaultKind, Figures, Goal, Nearest, Plan, Rejected, SpecimenMaps, Value,
};
use ommatidia_model::testing;

fn value(name: &str, value: f64, sigma: f64, unit: &str) -> Value {
    Value { name: name.into(), value, sigma, sigma_noise: sigma / 2.0, unit: unit.into() }
}

fn effect(id: &str, params: Vec<Value>) -> Effect {
    Effect {
        id: id.into(),
        known: !id.starts_with("unknown"),
        stage: "optics".into(),
        added: true,
        changed: false,
        z: 42.0,
        excess_explained: Some(0.93),
        held_out_gain: 1234.0,
        ambiguity: vec!["defocus".into()],
        overlap: 0.91,
        separate_by: Some("a bead scan at several depths".into()),
        params,
        description: format!("{id}: what it does"),
    }
}

fn dependence(covariate: Covariate, bins: usize, size: f64) -> Dependence {
    let mean: Vec<f64> = (0..bins).map(|i| size * (i as f64).sin()).collect();
    let (p, z) = if size > 0.05 { (1e-9, 60.0 * size) } else { (0.4, 0.2) };
    let at = (0..bins).map(|i| i as f64 * 9.0).collect();
    Dependence {
        covariate,
        at,
        mean,
        band: vec![0.01; bins],
        size: Some(size * size),
        chi2: 50.0,
        expected: bins as f64,
        p,
        z,
    }
}

/// An account in which diffusion was found.
fn account() -> Account {
    let closing = Closing {
        session: "Hidden".into(),
        before: Figures { chi2_ndf: 1.62, nrmse: 0.081, pcc: 0.993 },
        after: Figures { chi2_ndf: 1.004, nrmse: 0.052, pcc: 0.998 },
        held_out_frames: vec![3, 7],
        held_out_blocks: [8, 64],
        effects: vec![effect("charge_diffusion", vec![value("sigma_px", 0.4021, 0.0043, "px")])],
        rejected: vec![
            Rejected {
                id: "halo".into(),
                param: "weight".into(),
                upper_limit: Some(2.5e-4),
                sigma: Some(1.2e-4),
                unit: "1".into(),
                z: 0.7,
                needs: None,
            },
            Rejected {
                id: "lag".into(),
                param: "lambda".into(),
                upper_limit: None,
                sigma: None,
                unit: "1".into(),
                z: 0.0,
                needs: Some("scenes one after the other, dark after bright".into()),
            },
        ],
        dependences_before: vec![
            dependence(Covariate::RowParity, 2, 0.01),
            dependence(Covariate::Sharpness, 24, 0.3),
            dependence(Covariate::NextFrame, 1, 0.0),
        ],
        dependences_after: vec![
            dependence(Covariate::RowParity, 2, 0.01),
            dependence(Covariate::Sharpness, 24, 0.01),
            dependence(Covariate::NextFrame, 1, 0.0),
        ],
        ..Closing::default()
    };
    let stack = |gain: f32| Array3::from_shape_fn((2, 40, 60), |(k, r, c)| gain * ((k + r * c) as f32 * 0.3).sin());
    Account {
        closing,
        frames: vec![3, 5],
        measured_dn: stack(300.0),
        before: stack(3.0),
        after: stack(1.0),
        specimens: None,
    }
}

fn render(account: &Account, asked: Asked) -> String {
    let mut instrument = testing::instrument([24, 24], [40, 60], 5, 2);
    instrument.manifest.array.pitch_px = 20.0;
    let page = chapter(account, asked, Some(&instrument), &mut Numbers::default()).unwrap().into_string();
    assert!(!page.contains("NaN") && !page.contains("inf "), "a number is not finite");
    page.replace('\u{a0}', " ")
}

fn holds(page: &str, texts: &[&str]) {
    for text in texts {
        assert!(page.contains(text), "{text} is missing");
    }
}

#[test]
fn the_chapter_reports_what_was_found_what_not_and_what_remains() {
    let page = render(&account(), Asked::Close);
    holds(
        &page,
        &["1.620 → 1.004", "2 held-out frames", "18.0 σ → 0.2 σ", "<b>charge diffusion</b>", "93 % of the excess"],
    );
    holds(&page, &["sigma = 0.4021 ± 0.0043 px", "distinguishes it from defocus", "a bead scan at several depths"]);
    holds(
        &page,
        &["Frame 3, held out of every fit.", "Frame 5.", "Residual before", "Residual after", "Lens by lens."],
    );
    holds(
        &page,
        &["2.5 × 10⁻⁴", "Scenes one after the other, dark after bright", "depends on none of the tested covariates"],
    );
    assert_eq!(page.matches("<img").count(), 2 * 5 + 2 * 2);
    // The most significant covariate first.
    assert!(page.find("Expected light relative to") < page.find("Row parity"));
}

#[test]
fn what_is_significant_and_small_is_a_trace_and_no_completeness() {
    let mut a = account();
    assert!(render(&a, Asked::Close).contains("complete") && !render(&a, Asked::Close).contains("trace"));
    // Significant at 6 sigma, and less than the search counts as structure.
    let trace = Dependence { size: Some(2e-4), p: 1e-9, z: 6.0, ..dependence(Covariate::RowParity, 2, 0.01) };
    a.closing.dependences_after[0] = trace.clone();
    let page = render(&a, Asked::Close);
    holds(&page, &["nearly complete", "row parity, 6.0 σ", "A trace of structure is left", "0.02 % of the variance"]);
    for text in ["consistent with noise", "no test finds structure"] {
        assert!(!page.contains(text), "{text}");
    }
    a.closing.dependences_before = vec![trace];
    let page = render(&a, Asked::Residual);
    assert!(page.contains("A trace of structure") && !page.contains("within its noise"));
}

#[test]
fn a_residual_has_no_after() {
    let mut a = account();
    a.closing.effects.clear();
    a.closing.after = a.closing.before;
    a.closing.dependences_after = a.closing.dependences_before.clone();
    a.closing.catalogue_incomplete = true;
    let page = render(&a, Asked::Residual);
    holds(&page, &["1.620", "18.0 σ", "ommatidia close", "incomplete"]);
    for text in ["Residual after", ">after<", "→", "Effects found", "Not found"] {
        assert!(!page.contains(text), "{text}");
    }
}

#[test]
fn an_effect_that_the_instrument_had_was_not_lacking() {
    let mut a = account();
    assert!(render(&a, Asked::Close).contains("The model lacked"));
    a.closing.effects[0].changed = true;
    let page = render(&a, Asked::Close);
    holds(&page, &["The instrument had this effect already, with another strength:"]);
    assert!(!page.contains("The model lacked"));
}

#[test]
fn what_only_imitates_is_no_effect_and_an_unknown_specimen_has_no_figures() {
    let mut a = account();
    let z = 8.3;
    a.closing.nearest = vec![Nearest { id: "radial_distortion".into(), z, why: "63 % of the excess is left".into() }];
    a.closing.effects.clear();
    a.closing.verdict = Verdict::NotThisModel;
    let page = render(&a, Asked::Close);
    holds(&page, &["Not shown as a cause:", "radial distortion", "63 % of the excess is left", "not this one"]);
    assert!(!page.contains("The model lacked"));
    a.closing.judged_on = JudgedOn::Nothing;
    let none = Figures { chi2_ndf: f64::NAN, nrmse: f64::NAN, pcc: f64::NAN };
    (a.closing.before, a.closing.after) = (none, none);
    let page = render(&a, Asked::Close);
    holds(&page, &["not judged", "Nobody knows the specimens"]);
    assert!(!page.contains("NaN"));
}

#[test]
fn an_account_may_hold_next_to_nothing() {
    let empty = Account {
        closing: Closing::default(),
        frames: Vec::new(),
        measured_dn: Array3::zeros((0, 40, 60)),
        before: Array3::zeros((0, 40, 60)),
        after: Array3::zeros((0, 40, 60)),
        specimens: None,
    };
    for asked in [Asked::Close, Asked::Residual] {
        let page = render(&empty, asked);
        assert!(!page.contains("<img") && !page.contains("Lens by lens"));
    }
    holds(&render(&empty, Asked::Close), &["No effect was added"]);
}

#[test]
fn terms_without_a_name_are_drawn_and_called_that() {
    let mut a = account();
    let mut knots: Vec<Value> = (0..ommatidia_physics::effects::KNOTS)
        .map(|i| value(&format!("knot_{i:02}"), 0.01 * i as f64, 0.003, "1 or e-/ms"))
        .collect();
    for (name, v) in [("covariate", 6.0), ("additive", 0.0), ("low", 0.0), ("high", 17.0)] {
        knots.push(value(name, v, 0.0, "index"));
    }
    let lenses = (0..9).map(|l| value(&format!("change_{l}"), 0.01 * f64::from(l), 0.002, "1")).collect();
    a.closing.effects = vec![effect("unknown-1", knots), effect("lens_gain", lenses)];
    a.closing.catalogue_incomplete = true;
    let page = render(&a, Asked::Close);
    holds(&page, &["a term without a name (unknown-1)", "The catalogue is incomplete", "row within the period (px)"]);
    holds(&page, &["Unknown-1: factor on the light, per cent.", "Lens gain: change.", "16 values, plotted below"]);
}

#[test]
fn faults_of_the_record_come_first() {
    let mut a = account();
    let fault = |frame, kind| Fault { frame, kind, z: 321.0, correlation_before: 0.2, correlation_after: 0.99 };
    a.closing.faults = vec![fault(4, FaultKind::Shows { truth_of: 6 }), fault(9, FaultKind::Exposure { factor: 1.25 })];
    let mut record = effect("metadata_fault", vec![value("frame", 4.0, 0.0, "index")]);
    record.stage = "record".into();
    a.closing.effects.insert(0, record);
    let page = render(&a, Asked::Close);
    assert!(page.starts_with("<aside class=\"warn\">"));
    holds(&page, &["Scene frame 4 shows the object that is recorded for frame 6", "1.2500 times", "321 σ"]);
    assert!(!page.contains("metadata fault"), "faults are reported once");
    a.closing.faults = (0..12).map(|frame| fault(frame, FaultKind::Unit { factor: 1.01 })).collect();
    let page = render(&a, Asked::Close);
    holds(&page, &["8 more frames", "Scene frame 0 has 1.0100 times", "Scene frame 11 has 1.0100 times"]);
    a.closing.effects.truncate(1);
    a.closing.faults = vec![fault(0, FaultKind::MisplacedOneByOne { rms_px: 0.7 })];
    let page = render(&a, Asked::Close);
    holds(&page, &["each elsewhere: 0.70 object pixels", "No effect was searched for"]);
    assert!(!page.contains("were corrected before the fit") && !page.contains("none of the catalogue"));
}

#[test]
fn a_report_takes_the_file_and_the_verb_names_the_chapter() {
    let folder = tempfile::tempdir().unwrap();
    for (verb, title) in [("close", "Closing the loop"), ("residual", "Residual")] {
        let path = folder.path().join(format!("{verb}.closing"));
        account().write(&path, ommatidia_session::artifact::Provenance::new(verb, 1, &())).unwrap();
        let page = crate::render(&[path]).unwrap();
        holds(&page, &[&format!("<h2>{title}</h2>"), "<title>Hidden</title>", &format!(" {verb}, seed 1")]);
    }
}

#[test]
fn a_plan_lists_what_each_measurement_separates() {
    let mut account = account();
    assert!(!render(&account, Asked::Close).contains("Measure next"));
    let goal = |id: &str, other: Option<&str>, sigmas_now| Goal {
        id: id.into(),
        other: other.map(Into::into),
        param: "rate".into(),
        strength: 0.25,
        unit: "1".into(),
        sigmas_now,
    };
    account.closing.plan = Some(Plan {
        enough_sigma: 5.0,
        goals: vec![goal("background", Some("dark_current"), 0.2), goal("lag", None, 0.0)],
        measurements: vec![Advice { id: "darks".into(), words: "darks, four".into(), sigmas: vec![31.5, 0.0] }],
        assumptions: vec!["all is linear".into()],
    });
    let page = render(&account, Asked::Close);
    holds(&page, &["Measure next", "Darks, four", "background or dark current", "31.5 σ", "lag", "All is linear"]);
}

#[test]
fn estimated_specimens_are_shown_before_and_after() {
    let mut a = account();
    let object = |v: f32| {
        let mut all = Array3::from_elem((1, 6, 8), v);
        all[[0, 2, 3]] = 4.0 * v;
        all
    };
    a.specimens = Some(SpecimenMaps { frames: vec![11], before: object(1.0), after: object(1.2) });
    let page = render(&a, Asked::Close);
    holds(&page, &["Specimens as the instrument shows them", "After, frame 11", "Difference, frame 11"]);
    assert!(!page.contains("NaN"));
    let page = render(&a, Asked::Residual);
    holds(&page, &["Specimen, frame 11"]);
    assert!(!page.contains("Difference, frame 11"));
}
