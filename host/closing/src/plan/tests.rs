//! Plans are kept to: sessions of the independent virtual instrument separate what the plan expects them to.

#![allow(clippy::unwrap_used)]

use super::{Found, Plan, goals, of_session, plan};
use crate::data::Frame;
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

/// The frames of one session with the scenes of another, which holds the same stacks.
fn with_scenes_of(seen: Observations, other: &Observations) -> Observations {
    let mut it = Observations { truths: other.truths.clone(), ..seen };
    let scene = |f: &&Frame| f.role == Role::Scene;
    it.frames.retain(|f| f.role != Role::Scene);
    it.frames.extend(other.frames.iter().filter(scene).cloned());
    it
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

/// Error of an effect beside another, inner units, as far as the noise of the frames of a role makes it: those of the
/// others stay the same. With the information `I = A + B` of the others and of these, the estimate moves with the noise
/// of these alone by `I^-1 B I^-1`, which is the change of `-I^-1` where `B` grows by its share.
fn error_by(role: Role, seen: &Observations, effect: &EffectSetting, other: &str, instrument: &Instrument) -> f64 {
    let part = |these: bool| {
        let mut part = seen.clone();
        // A frame knows the one before it by its place, and those of a role follow one another.
        let first = part.frames.iter().position(|f| (f.role == role) == these).unwrap();
        part.frames.retain(|f| (f.role == role) == these);
        part.frames.iter_mut().for_each(|f| f.previous = f.previous.map(|p| p - first));
        let model = Model::new(instrument, &part).unwrap();
        let values: Vec<(&str, f64)> = effect.params.iter().map(|(n, v)| (n.as_str(), *v)).collect();
        let now = refit(&model, with(&model, &effect.id, &values)).unwrap();
        let replicas: Replicas = replicas(&model, instrument, &now.state).unwrap();
        let ambiguous = vec![(effect.id.clone(), vec![other.to_string()])];
        let found = Found { instrument, now: &now, replicas: &replicas, ambiguous, untestable: Vec::new() };
        let (mut questions, trials) = goals::questions(&model, &found);
        (of_session(&model, &found, &trials).unwrap(), questions.remove(0))
    };
    let ((others, question), (these, _)) = (part(false), part(true));
    let error2 = |count: usize| {
        let parts: Vec<_> =
            std::iter::repeat_n(&others, 10).chain(std::iter::repeat_n(&these, count)).cloned().collect();
        10.0 * (1.0 / question.sigmas(&parts)).powi(2)
    };
    let effect = find(&effect.id).unwrap().descriptor();
    ((error2(9) - error2(11)) / 0.2).sqrt() * effect.params[0].inner(question.goal(0.0).strength)
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
    /// Whether these frames alone decide. Then the scenes are the same in all sessions: others would meet other errors
    /// of the calibration, which are larger here than those of the noise.
    decides: bool,
    seed: u64,
}

/// Number of sessions whose estimates scatter: their standard deviation is known to 13 %.
const SESSIONS: u64 = 32;

/// Plans on scenes alone; then the virtual instrument measures scenes with what was advised. The error of the effect
/// beside the other (its strength over the separation) must be as expected, within 30 %: that of the longer session
/// (noise and calibration). So must be the scatter of the estimates of many sessions, both effects fitted, by an
/// instrument without errors: its calibration is the same in all of them, and where the frames of the pair decide, so
/// are the scenes, whose noise is no part of the scatter then.
fn is_kept_to(pair: &Pair, advised: &BenchConfig) {
    let Subject { config, instrument, .. } = subject();
    let mut sharp = Instrument { replicates: Vec::new(), ..instrument.clone() };
    (sharp.noise.gain_sigma, sharp.noise.read_noise_sigma) = (0.0, 0.0);
    let scenes = measured(config, &pair.effect, &[Role::Scene], pair.seed);
    let (param, injected) = pair.effect.params.iter().next().unwrap();
    let p = *find(&pair.effect.id).unwrap().descriptor().params.iter().find(|p| p.name == param.as_str()).unwrap();
    let mut errors = [instrument, &sharp].map(|instrument| {
        let plan = planned(&scenes, &pair.effect, pair.other.0, instrument);
        let (goal, advice) = (&plan.goals[0], &plan.measurements[0]);
        assert!(goal.sigmas_now < 5.0 && advice.id == pair.by && advice.sigmas[0] > 5.0, "{plan:#?}");
        p.inner(goal.strength) / advice.sigmas[0]
    });
    let first = measured(advised, &pair.effect, &[pair.role, Role::Scene], pair.seed);
    let estimates: Vec<f64> = (0..SESSIONS)
        .map(|n| {
            let both = measured(advised, &pair.effect, &[pair.role, Role::Scene], pair.seed + n);
            let both = if pair.decides { with_scenes_of(both, &first) } else { both };
            if n == 0 {
                let longer = planned(&both, &pair.effect, pair.other.0, instrument).goals.remove(0);
                let error = p.inner(longer.strength) / longer.sigmas_now;
                eprintln!("{}: error {:.2e} expected, {error:.2e} in the longer session", pair.by, errors[0]);
                assert!((error / errors[0] - 1.0).abs() < 0.3, "{error} for {}", errors[0]);
                if pair.decides {
                    errors[1] = error_by(pair.role, &both, &pair.effect, pair.other.0, &sharp);
                }
            }
            let model = Model::new(&sharp, &both).unwrap();
            let mut state = with(&model, &pair.effect.id, &[(param, *injected)]);
            state.terms.extend(with(&model, pair.other.0, &[(pair.other.1, pair.other.2)]).terms);
            let fit = refit(&model, state).unwrap();
            p.inner(fit.state.terms.iter().find(|t| t.id() == pair.effect.id).unwrap().params[0])
        })
        .collect();
    let n = SESSIONS as f64;
    let mean = estimates.iter().sum::<f64>() / n;
    let scatter = (estimates.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0)).sqrt();
    eprintln!("{}: scatter {:.2e} expected, {scatter:.2e} found about {mean:.2e}", pair.by, errors[1]);
    assert!((scatter / errors[1] - 1.0).abs() < 0.3, "{scatter} for {}", errors[1]);
}

#[test]
fn flats_separate_diffusion_from_capacitance_as_planned() {
    let effect = EffectSetting::new("charge_diffusion", &[("sigma_px", 0.2)]);
    let mut advised = subject().config.clone();
    (advised.stacks.flat_levels, advised.stacks.flat_frames) = (vec![0.15, 0.35, 0.6], 6);
    let other = ("interpixel_capacitance", "alpha", 0.01);
    is_kept_to(&Pair { effect, other, by: "flat_levels", role: Role::Flat, decides: true, seed: 900 }, &advised);
}

#[test]
fn darks_separate_background_from_dark_current_as_planned() {
    let effect = EffectSetting::new("background", &[("rate_e_per_ms", 0.02)]);
    let mut advised = subject().config.clone();
    (advised.stacks.dark_exposures_ms, advised.stacks.dark_frames) = (vec![10.0, 40.0, 160.0], 4);
    let other = ("dark_current", "rate_e_per_ms", 0.02);
    is_kept_to(&Pair { effect, other, by: "darks", role: Role::Dark, decides: false, seed: 910 }, &advised);
}
