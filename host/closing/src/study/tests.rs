//! The quick study, and its parts.

#![allow(clippy::unwrap_used)]

use super::foreign::FOREIGN;
use super::instruments::{self, Kind};
use super::networks::{FirstTraining, TrainRequest};
use super::plan::{Case, Injected, PAIRS, cases, catalogue, instruments_of};
use super::record::{FoundEffect, HeldOut, Ledger, Outcome, read_all};
use super::run::{JSON, PAGE, StudyRequest, begin, run};
use super::sealed::Sealed;
use super::sensitivity::{Sensitivities, Sensitivity};
use super::sessions::Holds;
use super::shard::Shard;
use super::size::{Question, Size};
use super::summary::Summary;
use super::text::{Plan, page};
use super::unknown;
use crate::{Retrain, RetrainRequest, Retrained};
use ndarray::Array2;
use ommatidia_physics::effects::{Effect, FrameContext, find};
use std::collections::BTreeSet;

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
        held_out: HeldOut {
            before: 2.0,
            after: 1.05,
            floor: 1.0,
            truth: Some(1.0),
            pixels: 10_000,
            ..HeldOut::default()
        },
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
    assert!((b.pull_mean.unwrap() - 2.0).abs() < 1e-9 && (b.explained.unwrap() - 0.95).abs() < 1e-9);
    assert_eq!((s.null_found.k, s.null_found.n, s.minus_one[0].1.false_naming.k), (0, 1, 1));
    // Two of the four have a false name, and one of them the true one alone.
    assert_eq!((b.false_name.k, b.true_alone.k, s.false_names["b"]), (2, 1, 2));
    assert!((b.extra_names - 0.5).abs() < 1e-12 && b.unnamed == 0.0 && b.removed.k == 4);
    assert_eq!(s.confusion.iter().filter(|c| c.truth == "a").count(), 3);
}

#[test]
fn a_session_in_which_nothing_is_known_is_kept() {
    let dir = tempfile::tempdir().unwrap();
    let held_out = HeldOut { before: f64::NAN, after: f64::NAN, ..HeldOut::default() };
    assert!(!held_out.is_worse() && held_out.explained().is_none());
    let video = Outcome { held_out, ..outcome("video", Question::Parts, "", &[]) };
    Ledger::open(dir.path(), Shard::default()).unwrap().push(&video).unwrap();
    assert_eq!(read_all(dir.path()).unwrap().len(), 1);
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
fn names_beside_the_true_one_are_false_and_terms_without_a_name_are_not() {
    let of = |question, truth, found: &[(&str, f64)]| {
        outcome("k", question, truth, found).false_names().iter().map(|n| n.to_string()).collect::<Vec<_>>()
    };
    assert_eq!(of(Question::Single, "a", &[("a", 1.0), ("b", 1.0), ("unknown-1", 1.0)]), ["b"]);
    assert_eq!(of(Question::Foreign, "f", &[("unknown-1", 1.0)]), Vec::<String>::new());
    // Flagged or not.
    let mut flagged = outcome("k", Question::Foreign, "f", &[("halo", 1.0)]);
    flagged.incomplete = true;
    assert!(flagged.names_falsely());
    // A true effect that is no candidate cannot be named; what has its name is not it.
    let mut excluded = outcome("k", Question::MinusOne, "a", &[("a", 1.0)]);
    excluded.case.excluded = vec!["a".into()];
    assert!(excluded.names_falsely());
}

#[test]
fn a_session_is_worse_if_either_figure_is() {
    let of = |own: [[f64; 2]; 2]| HeldOut { own: own.map(|f| f.map(Some)), ..HeldOut::default() }.is_worse();
    assert!(!of([[2.0, 0.1], [1.5, 0.1]]) && !of([[2.0, 0.1], [2.0, 0.1]]));
    assert!(of([[2.0, 0.1], [1.5, 0.11]]) && of([[2.0, 0.1], [2.01, 0.09]]));
}

/// Instruments whose sessions determine everything well.
fn known(instruments: u64) -> Vec<Option<Sensitivities>> {
    let sensitivity = Sensitivity { param: "p".into(), unit: "1".into(), sigma: 1e-9 };
    let ids = catalogue().into_iter().chain(FOREIGN.iter().map(|f| f.descriptor().id));
    let known =
        Sensitivities { of: ids.map(|id| (id.into(), sensitivity.clone())).collect(), ..Sensitivities::default() };
    vec![Some(known); instruments as usize]
}

#[test]
fn cases_are_named_once_and_spread_over_instruments_and_foreign_effects_are_foreign() {
    let size = Size::default();
    let all = cases(&size, &known(size.instruments));
    let mut keys: Vec<&str> = all.iter().map(|c| c.key.as_str()).collect();
    keys.sort_unstable();
    keys.dedup();
    assert!(keys.len() == all.len() && all.iter().filter(|c| c.question == Question::Null).count() == 300);
    assert!(Question::ALL.iter().all(|q| all.iter().any(|c| c.question == *q)));
    assert!(Holds::PARTS.iter().chain(&Holds::MISREGISTERED).all(|h| all.iter().any(|c| c.holds == *h)));
    // Every effect meets every kind at every strength.
    let single: Vec<_> = all.iter().filter(|c| c.question == Question::Single).collect();
    for kind in instruments::kinds(&size) {
        let of = single.iter().filter(|c| instruments::kind(&size, c.instrument) == kind);
        assert_eq!(of.count(), single.len() / 3, "{kind:?}");
    }
    let used: BTreeSet<u64> = single.iter().map(|c| c.instrument).collect();
    assert!(used.len() as u64 == size.instruments && size.instruments >= 40);
    // Twenty thousand electrons only where the sensor can hold them.
    assert!(all.iter().filter(|c| c.holds == Holds::Bright).all(|c| instruments::is_wide(c.instrument)));
    let likes: BTreeSet<_> = FOREIGN.iter().map(|f| f.like()).collect();
    assert!(FOREIGN.len() >= 10 && likes.len() == 7 && FOREIGN.iter().all(|f| find(f.descriptor().id).is_none()));
    assert!(PAIRS.iter().flatten().all(|id| find(id).is_some()));
}

#[test]
fn a_development_study_is_small_and_covers_everything_that_counts() {
    let size = Size::development(1, 6);
    let all = cases(&size, &known(size.instruments));
    assert!((50..=80).contains(&all.len()), "{}", all.len());
    for k in &size.strengths {
        let of: Vec<_> = all.iter().filter(|c| c.injected.first().is_some_and(|i| i.sigmas == *k)).collect();
        let kinds: BTreeSet<Kind> = of.iter().map(|c| instruments::kind(&size, c.instrument)).collect();
        assert!(kinds.len() >= 2, "{k}");
    }
    for question in &size.questions {
        assert!(all.iter().any(|c| c.question == *question), "{question:?}");
    }
}

#[test]
fn sealed_seeds_share_no_instrument_and_no_session_with_those_for_development() {
    let open = Size::default();
    let first = Size { sealed: true, opening: 1, ..Size::default() };
    let second = Size { opening: 2, ..first.clone() };
    let numbers = |size: &Size| (0..size.instruments).map(|n| instruments::number(size, n)).collect::<BTreeSet<_>>();
    let seeds = |size: &Size| cases(size, &known(42)).iter().map(|c| c.seed).collect::<BTreeSet<_>>();
    for (one, other) in [(&open, &first), (&open, &second), (&first, &second)] {
        assert!(numbers(one).is_disjoint(&numbers(other)));
        assert!(seeds(one).is_disjoint(&seeds(other)));
    }
}

#[test]
fn sessions_with_some_keys_need_their_own_instruments_only() {
    let size = Size { quota: Some(24), ..Size::default() };
    for keys in ["foreign/", "records/", ""] {
        let of = |known: &[Option<Sensitivities>]| {
            let mut all = cases(&size, known);
            all.retain(|c| c.key.contains(keys));
            all
        };
        let (all, needed) = (known(size.instruments), instruments_of(&size, keys));
        let mut some = all.clone();
        some.iter_mut().enumerate().filter(|(n, _)| !needed.contains(&(*n as u64))).for_each(|(_, s)| *s = None);
        assert!(!needed.is_empty() && of(&some) == of(&all), "{keys}");
        // One that no session was drawn for is not needed either.
        let few = (needed.len() as u64) < size.instruments / 2;
        assert!(few != keys.is_empty() && (few || needed.len() >= 40), "{keys}: {needed:?}");
    }
}

#[test]
fn openings_of_the_sealed_seeds_are_counted() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("sealed.json");
    assert_eq!(Sealed::read(&file).unwrap().opened, 0);
    assert_eq!(Sealed::open(&file).unwrap().opened, 1);
    assert_eq!(Sealed::open(&file).unwrap().opened, 2);
    assert_eq!(Sealed::read(&file).unwrap().programs.len(), 2);
    std::fs::write(&file, r#"{"what":"","opened":0,"programs":["x"]}"#).unwrap();
    assert!(Sealed::open(&file).is_err());
    // The committed counter can be read.
    let committed = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/sealed.json");
    Sealed::read(&committed).unwrap();
}

#[test]
fn a_capped_strength_is_there_once() {
    let mut known = known(1);
    for s in known[0].as_mut().unwrap().of.values_mut() {
        s.sigma = 0.01;
    }
    let size =
        Size { instruments: 1, questions: vec![Question::Single], only: vec!["array_shift".into()], ..Size::default() };
    let all = cases(&size, &known);
    // 0.03, 0.1, 0.3, 1 and 3 px; 10 px is more than 7.
    let values: Vec<(f64, bool)> = {
        let mut of: Vec<_> = all.iter().map(|c| (c.injected[0].value, c.injected[0].capped)).collect();
        of.sort_by(|a, b| a.0.total_cmp(&b.0));
        of
    };
    assert_eq!(values.last(), Some(&(7.0, true)));
    assert_eq!(values.iter().filter(|(_, capped)| *capped).count(), 1);
    known[0].as_mut().unwrap().of.values_mut().for_each(|s| s.sigma = 1.0);
    // 3 sigma are 3 px, all others are beyond.
    let values: Vec<f64> = cases(&size, &known).iter().map(|c| c.injected[0].sigmas).collect();
    assert_eq!(values.len(), 2, "{values:?}");
    assert!(values.contains(&3.0) && values.contains(&10.0));
}

/// The headings of a page.
fn headings(page: &str) -> Vec<&str> {
    page.lines().filter(|l| l.starts_with('#')).collect()
}

/// The committed page is one that this program writes: from development seeds until the sealed ones are opened.
#[test]
fn the_committed_page_has_the_structure_of_the_generator() {
    let docs = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs");
    let committed = std::fs::read_to_string(docs.join("study.md")).unwrap();
    let sealed = Sealed::read(&docs.join("sealed.json")).unwrap();
    let mut all = vec![outcome("1", Question::Single, "a", &[("a", 1.2)])];
    if committed.contains("## Effect on reconstructions") {
        let scored = Some(Default::default());
        all.push(Outcome { reconstruction: scored, ..outcome("2", Question::Reconstruction, "a", &[]) });
    }
    let plan = Plan { planned: all.len(), opened: (sealed.opened > 0).then_some(sealed.opened), refused: 0 };
    let written = page(&Size::default(), plan, &[], &all, &Summary::of(&all));
    assert_eq!(headings(&committed), headings(&written));
    let seeds = if sealed.opened > 0 { "**sealed seeds" } else { "**development seeds**" };
    assert!(committed.contains(seeds) && written.contains(seeds));
}

#[test]
fn the_committed_page_of_unknown_specimens_has_the_structure_of_the_generator() {
    let docs = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs");
    let committed = std::fs::read_to_string(docs.join("study-unknown.md")).unwrap();
    let opened = Sealed::read(&docs.join("sealed-unknown.json")).unwrap().opened;
    let plan = Plan { planned: 0, opened: Some(opened), refused: 0 };
    let written = unknown::page(plan, &[], &[], &Summary::of(&[]));
    assert_eq!(headings(&committed), headings(&written));
    let seeds = |page: &str| page.split("**").find(|bold| bold.starts_with("sealed seeds")).map(String::from);
    assert!(seeds(&written).is_some() && seeds(&committed) == seeds(&written));
}

#[test]
fn foreign_effects_do_something_and_nothing_when_off() {
    let light = Array2::from_shape_fn((20, 24), |(r, c)| 100.0 + (7 * r + 3 * c) as f32);
    let cx = FrameContext { full_scale_e: 1000.0, frame: 2, ..FrameContext::default() };
    let ray = ommatidia_physics::effects::Ray { field_px: [3.0, 4.0], ..Default::default() };
    for f in &FOREIGN {
        let changed = |a: f64| {
            let mut v = light.clone();
            f.on_light(&[a], &mut v, &cx);
            f.on_charge(&[a], &mut v, &cx);
            f.on_object(&[a], &mut v, &cx);
            f.on_reading(&[a], &mut v, &cx, &mut ommatidia_session::rng::stream(1, "foreign", 0));
            v != light || f.shift_ray(&[a], &ray, &cx) != ommatidia_physics::effects::RayShift::default()
        };
        assert!(changed(0.1) && !changed(0.0), "{}", f.descriptor().id);
    }
}

/// The variance of noise that is foreign is the one that the sensitivity assumes.
#[test]
fn foreign_noise_has_the_variance_that_it_states() {
    let light_dn = 400.0;
    let cx = FrameContext { black_level_dn: 64.0, ..FrameContext::default() };
    for f in FOREIGN.iter().filter(|f| f.noise_only()) {
        let (mut sum, mut n) = (0.0, 0.0);
        for frame in 0..200 {
            let mut v = Array2::from_elem((28, 28), 64.0 + light_dn as f32);
            f.on_reading(&[0.1], &mut v, &cx, &mut ommatidia_session::rng::stream(7, "variance", frame));
            sum += v.iter().map(|v| (f64::from(*v) - 64.0 - light_dn).powi(2)).sum::<f64>();
            n += v.len() as f64;
        }
        let stated = 0.01 * f.added_variance_dn2(light_dn).unwrap();
        // Blocks of 49 pixels are one draw: 3200 draws, 2.5 % each way.
        assert!((sum / n / stated - 1.0).abs() < 0.1, "{}: {} {stated}", f.descriptor().id, sum / n);
    }
}

/// A handful of sessions from end to end. Seeds are fixed, so that what it finds does not change from run to run; the
/// bounds leave room for a loop that becomes better or a little worse.
#[test]
fn the_quick_study_finds_what_is_there() {
    let dir = tempfile::tempdir().unwrap();
    let request =
        StudyRequest { dir: dir.path(), size: &Size::quick(1), shard: Shard::default(), sealed: None, keys: "" };
    let study = run(&request, &Untrained, |_| {}).unwrap();
    let seen: Vec<String> = study
        .outcomes
        .iter()
        .map(|o| format!("{}: {} {:?} {:?} {:?}", o.case.key, o.first(), o.nearest, o.held_out, o.error))
        .collect();
    let seen = seen.join("\n");
    let s = &study.summary;
    assert_eq!(s.failed, 0, "{seen}");
    assert!(s.null_found.k <= 2 && s.null_found.n == 6, "{seen}");
    assert!(s.null_chi2[0] < 1.15 && (s.null_chi2[1] - 1.0).abs() < 0.05, "{seen}");
    let b = &s.single[0];
    let covered = b.covered.k;
    assert!(covered >= 3 && b.first.n == 4 && b.false_name.k <= 1, "{seen}");
    assert!(s.records.k >= 3 && s.records.n == 4, "{seen}");
    assert!(s.foreign[0].1.noticed.k >= 1, "{seen}");
    // A study that is whole is not run again.
    let again = run(&request, &Untrained, |_| panic!("run again")).unwrap();
    assert_eq!(again.outcomes, study.outcomes);
    assert!(dir.path().join(JSON).is_file() && dir.path().join(PAGE).is_file());
    // Another study does not go on in this folder, and sealed seeds are not opened without their counter.
    let other = StudyRequest { size: &Size::quick(2), ..request };
    assert!(run(&other, &Untrained, |_| {}).is_err());
    let sealed = Size { sealed: true, ..Size::quick(1) };
    let fresh = tempfile::tempdir().unwrap();
    let unsealed = StudyRequest { dir: fresh.path(), size: &sealed, shard: Shard::default(), sealed: None, keys: "" };
    assert!(run(&unsealed, &Untrained, |_| {}).is_err());
    // A sealed study keeps its number while it goes on, and the next one gets another.
    let counter = fresh.path().join("sealed.json");
    let none = StudyRequest { sealed: Some(&counter), keys: "no such session", ..unsealed };
    assert!(run(&none, &Untrained, |_| {}).is_err_and(|e| e.to_string().contains("no such session")));
    assert!(!counter.exists(), "nothing was opened");
    let opening = |dir: &str| {
        let dir = fresh.path().join(dir);
        std::fs::create_dir_all(&dir).unwrap();
        begin(&dir, &sealed, Shard::default(), Some(&counter)).unwrap().opening
    };
    assert_eq!([opening("first"), opening("first"), opening("second")], [1, 1, 2]);
}

/// Instruments that determine one effect with known specimens four times as well as with unknown ones, and another not
/// at all with the latter.
fn known_with_unknown(instruments: u64) -> Vec<Option<Sensitivities>> {
    let sensitivity = |sigma| Sensitivity { param: "p".into(), unit: "1".into(), sigma };
    let of_kind = Sensitivities {
        of: [("vignetting".to_string(), sensitivity(0.004))].into(),
        cannot: vec!["excitation_profile".into()],
        ..Sensitivities::default()
    };
    let of = ["vignetting", "excitation_profile"].map(|id| (id.to_string(), sensitivity(0.001)));
    let of_kinds = Holds::UNKNOWN.map(|h| (h, of_kind.clone())).into();
    vec![Some(Sensitivities { of: of.into(), of_kinds, ..Sensitivities::default() }); instruments as usize]
}

#[test]
fn unknown_specimens_have_a_study_of_their_own_in_units_of_their_own_errors() {
    let size =
        Size { strengths: vec![10.0], nulls: 3, instruments: 3, quota: None, ..Size::of_unknown_specimens(1, false) };
    let all = cases(&size, &known_with_unknown(3));
    assert!(all.iter().all(|c| matches!(c.question, Question::Unknown | Question::Gauge)));
    for holds in Holds::UNKNOWN {
        let of: Vec<&Case> = all.iter().filter(|c| c.holds == holds).collect();
        assert_eq!(of.iter().filter(|c| c.injected.is_empty()).count(), 1);
        let single: Vec<&&Case> =
            of.iter().filter(|c| c.question == Question::Unknown && !c.injected.is_empty()).collect();
        assert_eq!(single.len(), 1);
        assert!(single[0].injected[0].id == "vignetting" && (single[0].injected[0].value - 0.04).abs() < 1e-12);
        // What another specimen could make has the strength that known specimens would show.
        let gauges = of.iter().filter(|c| c.question == Question::Gauge);
        assert!(gauges.clone().all(|c| c.injected[0].id == "excitation_profile"));
        assert!(gauges.clone().count() >= 1 && gauges.clone().all(|c| (c.injected[0].value - 0.1).abs() < 1e-12));
    }
    assert!((0..3).all(|n| instruments::number(&size, n) != instruments::number(&Size::default(), n)));
    assert!(cases(&Size::default(), &known(42)).iter().all(|c| c.question != Question::Unknown));
}

#[test]
fn the_page_of_unknown_specimens_says_what_the_truths_say() {
    let with = |key: &str, truth: &str, found: &[(&str, f64)], after: f64| {
        let mut o = outcome(key, Question::Unknown, truth, found);
        o.case.holds = Holds::Unknown;
        o.held_out.after = after;
        o
    };
    let mut nothing = with("unknown/null/0", "", &[], 2.0);
    nothing.case.injected.clear();
    let gauge =
        Outcome { case: Case { question: Question::Gauge, ..with("g", "a", &[], 2.0).case }, ..nothing.clone() };
    let all = [with("1", "a", &[("a", 1.0)], 1.05), with("2", "a", &[("b", 1.0)], 2.5), nothing, gauge];
    let plan = Plan { planned: 4, opened: None, refused: 1 };
    let text =
        unknown::page(plan, &known_with_unknown(1).into_iter().flatten().collect::<Vec<_>>(), &all, &Summary::of(&all));
    assert!(text.starts_with(unknown::TITLE) && text.contains("`calibrate` refused 1, which is left out"));
    assert!(text.contains("| 8 | 0 of 1 (0 %, "), "{text}");
    assert!(text.contains("| 8 | 10 | 1 of 2 (50 %, "), "{text}");
    assert!(text.contains("Worse with the truths: `2` 2.0000 -> 2.5000."), "{text}");
    assert!(text.contains("named 0 of 1 (0 %, "), "{text}");
    assert!(
        text.contains("| `excitation_profile` | p |  | 1.0e-3 | not testable | not testable | not testable |"),
        "{text}"
    );
}
