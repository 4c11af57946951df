//! The quick study, and its parts.

#![allow(clippy::unwrap_used)]

use super::foreign::FOREIGN;
use super::networks::{FirstTraining, TrainRequest};
use super::plan::{Case, Injected, PAIRS, Question, Size, cases, catalogue};
use super::record::{FoundEffect, HeldOut, Ledger, Outcome, read_all};
use super::run::{JSON, PAGE, StudyRequest, run};
use super::sensitivity::{Sensitivities, Sensitivity};
use super::shard::Shard;
use super::summary::{Share, Summary};
use crate::{Retrain, RetrainRequest, Retrained};
use ndarray::Array2;
use ommatidia_physics::effects::{Effect, FrameContext, find};

/// Networks where none is asked for.
struct Untrained;

impl FirstTraining for Untrained {
    fn train(&self, _: &TrainRequest<'_>) -> anyhow::Result<()> {
        anyhow::bail!("this study trains no network")
    }
}

impl Retrain for Untrained {
    fn retrain(&self, _: &RetrainRequest<'_>, _: &mut dyn FnMut(u64)) -> anyhow::Result<Retrained> {
        anyhow::bail!("this study trains no network")
    }
}

fn outcome(key: &str, question: Question, truth: &str, found: &[(&str, f64)]) -> Outcome {
    let injected = Injected { id: truth.into(), param: "p".into(), sigmas: 10.0, value: 1.0, ..Injected::default() };
    let found = found.iter().map(|(id, value)| FoundEffect {
        id: (*id).into(),
        known: !id.starts_with("unknown"),
        z: 9.0,
        ambiguity: vec!["c".into()],
        overlap: 0.8,
        excess_explained: None,
        params: [("p".to_string(), [*value, 0.1])].into(),
        description: String::new(),
    });
    Outcome {
        case: Case { key: key.into(), question, injected: vec![injected], ..Case::default() },
        found: found.collect(),
        held_out: HeldOut { before: 2.0, after: 1.1, floor: 1.0, truth: Some(1.0), pixels: 10_000 },
        ..Outcome::default()
    }
}

#[test]
fn figures_are_of_what_was_found() {
    let all = [
        outcome("1", Question::Single, "a", &[("a", 1.2)]),
        outcome("2", Question::Single, "a", &[("b", 1.0)]),
        outcome("3", Question::Single, "c", &[("b", 1.0)]),
        outcome("4", Question::Single, "a", &[]),
        outcome("5", Question::Null, "", &[]),
        outcome("6", Question::MinusOne, "a", &[("b", 1.0)]),
    ];
    let s = Summary::of(&all);
    let b = &s.single[0];
    assert_eq!((b.first.k, b.covered.k, b.detected.k, b.first.n), (1, 2, 3, 4));
    assert!((b.pull_mean.unwrap() - 2.0).abs() < 1e-9 && (b.explained.unwrap() - 0.9).abs() < 1e-9);
    assert_eq!((s.null_found.k, s.null_found.n, s.minus_one.false_naming.k), (0, 1, 1));
    assert_eq!(s.confusion.iter().filter(|c| c.truth == "a").count(), 3);
}

#[test]
fn intervals_are_those_of_wilson() {
    // Brown, Cai and DasGupta, Stat. Sci. 16, 101 (2001): 0 of 50 and 10 of 50.
    let (none, some) = (Share::new(0, 50), Share::new(10, 50));
    assert!(none.low == 0.0 && (none.high - 0.0713).abs() < 1e-3);
    assert!((some.low - 0.1124).abs() < 1e-3 && (some.high - 0.3304).abs() < 1e-3);
}

#[test]
fn a_torn_ledger_goes_on() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("sessions.jsonl");
    let whole = serde_json::to_string(&outcome("1", Question::Null, "", &[])).unwrap();
    std::fs::write(&path, format!("{whole}\n{}", &whole[..40])).unwrap();
    Ledger::open(dir.path(), Shard::default()).unwrap().push(&outcome("2", Question::Null, "", &[])).unwrap();
    let keys: Vec<String> = read_all(dir.path()).unwrap().into_iter().map(|o| o.case.key).collect();
    assert_eq!(keys, ["1", "2"]);
}

#[test]
fn cases_are_named_once_and_foreign_effects_are_foreign() {
    let sensitivity = Sensitivity { param: "p".into(), unit: "1".into(), sigma: 1e-9 };
    let ids = catalogue().into_iter().chain(FOREIGN.iter().map(|f| f.descriptor().id));
    let known = Sensitivities { of: ids.map(|id| (id.into(), sensitivity.clone())).collect(), cannot: Vec::new() };
    let all = cases(&Size { instruments: 1, ..Size::default() }, &[known]);
    let mut keys: Vec<&str> = all.iter().map(|c| c.key.as_str()).collect();
    keys.sort_unstable();
    keys.dedup();
    assert!(keys.len() == all.len() && all.iter().filter(|c| c.question == Question::Null).count() == 300);
    assert!(Question::ALL.iter().all(|q| all.iter().any(|c| c.question == *q)));
    assert!(FOREIGN.len() >= 6 && FOREIGN.iter().all(|f| find(f.descriptor().id).is_none()));
    assert!(PAIRS.iter().flatten().all(|id| find(id).is_some()));
}

#[test]
fn foreign_effects_do_something_and_nothing_when_off() {
    let light = Array2::from_shape_fn((20, 24), |(r, c)| 100.0 + (7 * r + 3 * c) as f32);
    let cx = FrameContext { full_scale_e: 1000.0, ..FrameContext::default() };
    let ray = ommatidia_physics::effects::Ray { field_px: [3.0, 4.0], ..Default::default() };
    for f in &FOREIGN {
        let changed = |a: f64| {
            let mut v = light.clone();
            f.on_light(&[a], &mut v, &cx);
            f.on_charge(&[a], &mut v, &cx);
            v != light || f.shift_ray(&[a], &ray, &cx) != ommatidia_physics::effects::RayShift::default()
        };
        assert!(changed(0.1) && !changed(0.0), "{}", f.descriptor().id);
    }
}

/// A handful of sessions from end to end. Seeds are fixed, so that what it finds does not change from run to run; the
/// bounds leave room for a loop that becomes better or a little worse.
#[test]
fn the_quick_study_finds_what_is_there() {
    let dir = tempfile::tempdir().unwrap();
    let request = StudyRequest { dir: dir.path(), size: &Size::quick(1), shard: Shard::default() };
    let study = run(&request, &Untrained, |_| {}).unwrap();
    let seen: Vec<String> = study
        .outcomes
        .iter()
        .map(|o| format!("{}: {} {:?} {:?}", o.case.key, o.first(), o.held_out, o.error))
        .collect();
    let seen = seen.join("\n");
    let s = &study.summary;
    assert_eq!(s.failed, 0, "{seen}");
    assert!(s.null_found.k <= 2 && s.null_found.n == 6, "{seen}");
    assert!(s.null_chi2[0] < 1.15 && (s.null_chi2[1] - 1.0).abs() < 0.05, "{seen}");
    let b = &s.single[0];
    assert!(b.covered.k >= 3 && b.covered.n == 4, "{seen}");
    assert!(s.records.k >= 3 && s.records.n == 4, "{seen}");
    assert!(s.foreign[0].1.noticed.k >= 1, "{seen}");
    // A study that is whole is not run again.
    let again = run(&request, &Untrained, |_| panic!("run again")).unwrap();
    assert_eq!(again.outcomes, study.outcomes);
    assert!(dir.path().join(JSON).is_file() && dir.path().join(PAGE).is_file());
}
