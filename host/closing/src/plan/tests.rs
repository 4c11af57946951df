//! Plans are kept to: sessions of the independent virtual instrument separate what the plan expects them to.

#![allow(clippy::unwrap_used)]

use super::{Found, Plan, plan};
use crate::fit::{Model, Replicas, State, Term, refit, replicas};
use crate::{Budget, Observations};
use ommatidia_bench::{ArrayConfig, BenchConfig, ScanConfig, VirtualInstrument};
use ommatidia_model::calibrate::{CalibrateConfig, calibrate};
use ommatidia_model::instrument::Instrument;
use ommatidia_physics::effects::{EffectSetting, find};
use ommatidia_session::{Role, Session};
use std::sync::OnceLock;

struct Subject {
    config: BenchConfig,
    bench: VirtualInstrument,
    instrument: Instrument,
}

fn subject() -> &'static Subject {
    static SUBJECT: OnceLock<Subject> = OnceLock::new();
    SUBJECT.get_or_init(|| {
        let mut config = BenchConfig::default();
        (config.sensor.rows, config.sensor.cols) = (90, 124);
        config.array = ArrayConfig { rows: 1, cols: 2, ..config.array };
        (config.object.rows, config.object.cols) = (40, 40);
        config.scan = ScanConfig { rows: 9, cols: 9, ..config.scan };
        config.stacks.scene_frames = 8;
        let bench = config.build(&[]).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let dir = folder.path().join("calibration");
        bench.measure(&dir, 1, |_| ()).unwrap();
        let rank = CalibrateConfig { rank: Some(8), ..CalibrateConfig::default() };
        let instrument = calibrate(&Session::open(&dir).unwrap(), &rank, || {}).unwrap().instrument;
        Subject { config, bench, instrument }
    })
}

/// Frames of a session of the virtual instrument with an effect.
fn measured(config: &BenchConfig, effect: &EffectSetting, roles: &[Role], seed: u64) -> Observations {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path().join("session");
    let bench = config.build_like(&subject().bench, std::slice::from_ref(effect)).unwrap();
    bench.measure_some(&dir, seed, roles, |_| ()).unwrap();
    Observations::read(&Session::open(&dir).unwrap(), &Budget::default()).unwrap()
}

/// The state of the instrument with one more effect at given values.
fn with(model: &Model<'_>, id: &str, values: &[(&str, f64)]) -> State {
    let effect = find(id).unwrap();
    let value = |name: &str, off: f64| values.iter().find(|(n, _)| *n == name).map_or(off, |(_, v)| *v);
    let params = effect.descriptor().expanded(model.lenses()).iter().map(|(n, p)| value(n, p.off)).collect();
    let mut state = model.state(&subject().instrument).unwrap();
    state.terms.push(Term { effect, params, table: None, table_error: 0.0 });
    state
}

/// The plan for a session whose effect may be another, by an instrument with or without replicates.
fn planned(seen: &Observations, effect: &EffectSetting, other: &str, instrument: &Instrument) -> Plan {
    let model = Model::new(instrument, seen).unwrap();
    let values: Vec<(&str, f64)> = effect.params.iter().map(|(n, v)| (n.as_str(), *v)).collect();
    let now = refit(&model, with(&model, &effect.id, &values)).unwrap();
    let replicas: Replicas = replicas(&model, instrument, &now.state).unwrap();
    let ambiguous = vec![(effect.id.clone(), vec![other.to_string()])];
    let found = Found { instrument, now: &now, replicas: &replicas, ambiguous, untestable: Vec::new() };
    plan(&model, &found).unwrap()
}

/// Standard deviations by which a session prefers its true effect to another: both are fitted to it.
fn preferred(seen: &Observations, effect: &EffectSetting, other: (&str, &str, f64)) -> f64 {
    let model = Model::new(&subject().instrument, seen).unwrap();
    let values: Vec<(&str, f64)> = effect.params.iter().map(|(n, v)| (n.as_str(), *v)).collect();
    let own = refit(&model, with(&model, &effect.id, &values)).unwrap().training.deviance;
    let (id, param, start) = other;
    let foreign = refit(&model, with(&model, id, &[(param, start)])).unwrap().training.deviance;
    (foreign - own).max(0.0).sqrt()
}

/// An effect of scenes alone, and another that it may be confused with.
struct Pair {
    effect: EffectSetting,
    /// Id, first strength, and a value to start from.
    other: (&'static str, &'static str, f64),
    /// Id of the measurement that is expected to separate them.
    by: &'static str,
    /// Role of its frames.
    role: Role,
    seed: u64,
}

/// Plans on scenes alone; then the virtual instrument measures the scenes again with what was advised. Two figures must
/// be as expected, within 30 %: chi-squared of the best fit with the other effect above that of the true one (noise
/// alone), and the separation that the errors of the longer session give (noise and calibration).
fn is_kept_to(pair: &Pair, advised: &BenchConfig) {
    let Subject { config, instrument, .. } = subject();
    let sharp = Instrument { replicates: Vec::new(), ..instrument.clone() };
    let scenes = measured(config, &pair.effect, &[Role::Scene], pair.seed);
    let both = measured(advised, &pair.effect, &[pair.role, Role::Scene], pair.seed);
    let got = preferred(&both, &pair.effect, pair.other);
    for (instrument, deviance) in [(&sharp, Some(got)), (instrument, None)] {
        let plan = planned(&scenes, &pair.effect, pair.other.0, instrument);
        assert!(plan.goals[0].sigmas_now < 5.0 && plan.measurements[0].id == pair.by, "{plan:#?}");
        let expected = plan.measurements[0].sigmas[0];
        let longer = planned(&both, &pair.effect, pair.other.0, instrument).goals[0].sigmas_now;
        let now = plan.goals[0].sigmas_now;
        eprintln!("{}: {now:.2} -> {expected:.2} expected, {longer:.2} by errors, {deviance:?} by fits", pair.by);
        for z in deviance.into_iter().chain([longer]) {
            assert!(z > super::ENOUGH && (z / expected - 1.0).abs() < 0.3, "{z} for {expected}");
        }
    }
}

#[test]
fn flats_separate_diffusion_from_capacitance_as_planned() {
    let effect = EffectSetting::new("charge_diffusion", &[("sigma_px", 0.2)]);
    let mut advised = subject().config.clone();
    (advised.stacks.flat_levels, advised.stacks.flat_frames) = (vec![0.15, 0.35, 0.6], 6);
    let other = ("interpixel_capacitance", "alpha", 0.01);
    is_kept_to(&Pair { effect, other, by: "flat_levels", role: Role::Flat, seed: 900 }, &advised);
}

#[test]
fn darks_separate_background_from_dark_current_as_planned() {
    let effect = EffectSetting::new("background", &[("rate_e_per_ms", 0.05)]);
    let mut advised = subject().config.clone();
    (advised.stacks.dark_exposures_ms, advised.stacks.dark_frames) = (vec![10.0, 40.0, 160.0], 4);
    let other = ("dark_current", "rate_e_per_ms", 0.02);
    is_kept_to(&Pair { effect, other, by: "darks", role: Role::Dark, seed: 910 }, &advised);
}
