//! The cases of a study: which undeclared effect is injected into which session of which instrument.

use super::foreign::{self, FOREIGN};
use super::instruments::{is_wide, kinds};
use super::ranges;
use super::sensitivity::Sensitivities;
use super::sessions::Holds;
use super::size::{Question, Size};
use ommatidia_physics::effects::{Descriptor, Effect, Stage, find, registry};
use ommatidia_session::rng;
use rand::{Rng, RngExt};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// An injected effect.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Injected {
    /// Id of the effect.
    pub id: String,
    /// Name of its strength parameter.
    pub param: String,
    /// Strength that was asked for, in units of the sensitivity of the session.
    pub sigmas: f64,
    /// Strength, in the unit of the parameter.
    pub value: f64,
    /// Whether the strength is less than was asked for, because the effect leaves its physical range there.
    #[serde(default)]
    pub capped: bool,
    /// Other parameters: name and value.
    #[serde(default)]
    pub others: Vec<(String, f64)>,
}

/// One session.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Case {
    /// Unique name.
    pub key: String,
    /// Its question.
    pub question: Question,
    /// Number of the instrument, from 0.
    pub instrument: u64,
    /// Seed of noise and scenes.
    pub seed: u64,
    /// What the session holds.
    #[serde(default)]
    pub holds: Holds,
    /// Injected effects.
    pub injected: Vec<Injected>,
    /// Ids that are removed from the candidates.
    #[serde(default)]
    pub excluded: Vec<String>,
    /// Factor on the gain that the instrument states.
    #[serde(default = "one")]
    pub gain: f64,
}

fn one() -> f64 {
    1.0
}

/// Pairs of effects, easily confused ones first.
pub const PAIRS: [[&str; 2]; 10] = [
    ["charge_diffusion", "interpixel_capacitance"],
    ["background", "veiling_glare"],
    ["array_shift", "lens_decentre"],
    ["vignetting", "excitation_profile"],
    ["magnification", "stage_scale"],
    ["background", "dark_current"],
    ["nonlinearity", "exposure_offset"],
    ["array_shift", "vignetting"],
    ["halo", "readout_lag"],
    ["photobleaching", "interpixel_capacitance"],
];
/// Strengths of both effects of a pair.
const PAIR_SIGMAS: [f64; 3] = [10.0, 30.0, 300.0];
/// Strengths of an effect that is removed from the candidates.
const MINUS_ONE_SIGMAS: [f64; 3] = [30.0, 100.0, 300.0];
/// Strengths of foreign effects; their unit is the noise alone.
const FOREIGN_SIGMAS: [f64; 4] = [10.0, 30.0, 100.0, 300.0];
/// Strength of a foreign effect in a quick study.
const FOREIGN_QUICK: f64 = 100.0;
/// Strength of an effect that another specimen could make as well, in units of the sensitivity of a whole session.
const GAUGE_SIGMAS: f64 = 100.0;
/// Effects that are injected into sessions which hold less.
pub const OF_PARTS: [&str; 6] =
    ["array_shift", "interpixel_capacitance", "row_pattern", "vignetting", "motion_blur", "dsnu"];
/// Their strengths, in units of the sensitivity of a whole session.
const PARTS_SIGMAS: [f64; 2] = [30.0, 300.0];
/// Effects that a network is fine-tuned for, one of each kind.
pub const DOWNSTREAM: [&str; 6] =
    ["array_shift", "lens_gain", "defocus", "veiling_glare", "charge_diffusion", "vignetting"];
/// Their strength: ten standard errors of a session are invisible in a reconstruction.
const DOWNSTREAM_SIGMAS: f64 = 100.0;
/// Factor by which the stated gain is wrong.
const WRONG_GAIN: f64 = 1.05;

/// Ids of the effects that a study injects: all of the catalogue except faults of records and of truths, and unknown
/// patterns.
pub fn catalogue() -> Vec<&'static str> {
    let named = |e: &&&'static dyn Effect| {
        let d = e.descriptor();
        d.stage != Stage::Record && !e.is_of_truths() && !d.id.starts_with("unknown")
    };
    registry().iter().filter(named).map(|e| e.descriptor().id).collect()
}

/// Each effect of the catalogue with another one, drawn at random.
fn any_pairs(seed: u64, round: u64) -> Vec<[&'static str; 2]> {
    let all = catalogue();
    let mut rng = rng::stream(seed, "any pairs", round);
    let mut another = |a: usize| (a + rng.random_range(1..all.len())) % all.len();
    (0..all.len()).map(|a| [all[a], all[another(a)]]).collect()
}

/// A session that is wanted; whether its instrument can have it is not known yet.
struct Wish {
    round: u64,
    /// What a quota counts together.
    group: String,
    effects: Vec<(String, f64)>,
    case: Case,
}

/// All cases, shuffled within each round, so that an unfinished study covers every question. `sensitivities`: one entry
/// per instrument; those of an instrument that is `None` are left out.
///
/// The kinds of instruments take turns: every effect meets every kind at every strength, each time another instrument.
pub fn cases(size: &Size, sensitivities: &[Option<Sensitivities>]) -> Vec<Case> {
    let known_of = |w: &Wish| sensitivities.get(w.case.instrument as usize)?.as_ref();
    // What such a session cannot determine.
    let is_gauge = |w: &Wish| {
        let cannot = &known_of(w)?.of_kinds.get(&w.case.holds)?.cannot;
        Some(cannot.contains(&w.effects.first()?.0))
    };
    let wishes = chosen(size, |w| w.case.question != Question::Gauge || is_gauge(w) == Some(true));
    let possible = |w: Wish| {
        let whole = known_of(&w)?;
        let known = if w.case.question == Question::Unknown { whole.of_kinds.get(&w.case.holds)? } else { whole };
        let given = w.effects.iter().map(|(id, k)| injected(known, id, *k)).collect::<Option<Vec<_>>>()?;
        Some(Case { injected: if given.is_empty() { w.case.injected.clone() } else { given }, ..w.case })
    };
    let mut cases: Vec<Case> = wishes.into_iter().filter_map(possible).collect();
    drop_repeated_caps(&mut cases);
    cases
}

/// Whether any session that may be drawn has a key that holds a text.
pub(super) fn has_key(size: &Size, keys: &str) -> bool {
    wishes(size).iter().any(|w| w.case.key.contains(keys))
}

/// Numbers of the instruments that sessions need whose keys hold a text. The sensitivities of all instruments decide
/// which effects another specimen could make, so that sessions with those need every instrument that may have one.
pub(super) fn instruments_of(size: &Size, keys: &str) -> BTreeSet<u64> {
    let is_gauge = |w: &Wish| w.case.question == Question::Gauge;
    let gauges = wishes(size).into_iter().filter(is_gauge);
    let all = chosen(size, |w| !is_gauge(w)).into_iter().chain(gauges);
    all.filter(|w| w.case.key.contains(keys)).map(|w| w.case.instrument).collect()
}

/// The sessions that are wanted and may be: as many of each group as the size allows.
fn chosen(size: &Size, may_be: impl Fn(&Wish) -> bool) -> Vec<Wish> {
    let mut wishes = wishes(size);
    wishes.retain(may_be);
    wishes.sort_by_cached_key(|w| (w.round, w.case.seed));
    if let Some(quota) = size.quota {
        let mut counts: BTreeMap<String, usize> = BTreeMap::new();
        wishes.retain(|w| {
            let most = match w.case.question {
                Question::Null => usize::MAX,
                Question::Unknown if w.effects.is_empty() => usize::MAX,
                Question::Single | Question::Unknown | Question::Gauge => quota,
                _ => (quota / 6).max(1),
            };
            let n = counts.entry(w.group.clone()).or_default();
            *n += 1;
            *n <= most
        });
    }
    wishes
}

/// Of the strengths at which an effect is capped in one instrument, only the lowest is kept: the others are the same.
fn drop_repeated_caps(cases: &mut Vec<Case>) {
    let lowest = |cases: &[Case], c: &Case| {
        let same = |o: &&Case| {
            let ids = |c: &Case| c.injected.iter().map(|i| i.id.clone()).collect::<Vec<_>>();
            (o.question, o.instrument, o.holds) == (c.question, c.instrument, c.holds) && ids(o) == ids(c)
        };
        let capped = cases.iter().filter(same).filter(|o| o.injected.iter().all(|i| i.capped));
        capped.filter_map(|o| Some(o.injected.first()?.sigmas)).fold(f64::MAX, f64::min)
    };
    let all = cases.clone();
    cases.retain(|c| {
        let capped = !c.injected.is_empty() && c.injected.iter().all(|i| i.capped);
        !capped || c.injected.first().is_some_and(|i| i.sigmas <= lowest(&all, c))
    });
}

fn wishes(size: &Size) -> Vec<Wish> {
    let mut wishes = Vec::new();
    let seeds = match (size.sealed, size.opening) {
        (false, _) => "study".to_string(),
        (true, 0 | 1) => "sealed".to_string(),
        (true, n) => format!("sealed-{n}"),
    };
    let kinds = kinds(size).len() as u64;
    let mut push = |round: u64, group: &str, key: String, effects: Vec<(String, f64)>, case: Case| {
        let seed = rng::stream(size.seed, &format!("{seeds}/{key}"), 0).next_u64() >> 16;
        let gain = if case.gain == 0.0 { 1.0 } else { case.gain };
        wishes.push(Wish { round, group: group.into(), effects, case: Case { key, seed, gain, ..case } });
    };
    // Instrument of the i-th session of a series: kinds take turns, and each kind's instruments too.
    let instrument = |i: u64| i % size.instruments;
    let wide = |i: u64| {
        let all: Vec<u64> = (0..size.instruments).filter(|n| is_wide(*n)).collect();
        all.get(i as usize % all.len().max(1)).copied()
    };
    if size.asks(Question::Null) {
        for i in 0..size.nulls as u64 {
            let round = i * size.seeds / size.nulls.max(1) as u64;
            // One in six is bright, one in six long.
            let (holds, n) = match (size.gentle, i % 6, wide(i / 6)) {
                (false, 4, Some(n)) => (Holds::Bright, n),
                (false, 5, _) => (Holds::ManyFrames, instrument(i)),
                _ => (Holds::Whole, instrument(i)),
            };
            let case = Case { question: Question::Null, instrument: n, holds, ..Case::default() };
            push(round, "null", format!("null/{}/{i}", holds.name()), vec![], case);
        }
    }
    for round in 0..size.seeds {
        // One session for each kind; the instruments of a kind are used in an order that differs by effect and
        // strength.
        let turn = |kind: u64, a: usize, b: usize| {
            let of_kind = (size.instruments + kinds - 1 - kind) / kinds;
            kind + kinds * ((a as u64 * 5 + b as u64 * 3 + round * 7) % of_kind.max(1))
        };
        let each_kind = (0..kinds.min(size.instruments)).collect::<Vec<u64>>();
        for (a, holds) in Holds::UNKNOWN.into_iter().enumerate().filter(|_| size.asks(Question::Unknown)) {
            let name = holds.name();
            for i in 0..size.nulls as u64 / Holds::UNKNOWN.len() as u64 {
                let n = instrument(i * Holds::UNKNOWN.len() as u64 + a as u64);
                let case = Case { question: Question::Unknown, instrument: n, holds, ..Case::default() };
                push(round, &format!("{name}/0"), format!("{name}/null/{i}/{round}"), vec![], case);
            }
            for (b, id) in catalogue().into_iter().enumerate().filter(|(_, id)| size.wants(id)) {
                let case = |question, n| Case { question, instrument: n, holds, ..Case::default() };
                for (c, k) in size.strengths.iter().enumerate() {
                    let n = turn((a + b + c) as u64 % kinds, b, a + c);
                    let key = format!("{name}/{id}/{k}/{round}");
                    push(round, &format!("{name}/{k}"), key, vec![(id.into(), *k)], case(Question::Unknown, n));
                }
                for kind in &each_kind {
                    let (n, k) = (turn(*kind, b, a), GAUGE_SIGMAS);
                    let key = format!("{name}/gauge/{id}/{kind}/{round}");
                    push(round, &format!("{name}/gauge"), key, vec![(id.into(), k)], case(Question::Gauge, n));
                }
            }
        }
        let of_catalogue = catalogue().into_iter().enumerate().filter(|_| !size.is_of_unknown_specimens());
        for (a, id) in of_catalogue.filter(|(_, id)| size.wants(id)) {
            for (b, k) in size.strengths.iter().enumerate().filter(|_| size.asks(Question::Single)) {
                for kind in &each_kind {
                    let case = Case { question: Question::Single, instrument: turn(*kind, a, b), ..Case::default() };
                    let key = format!("single/{id}/{k}/{kind}/{round}");
                    push(round, &format!("single/{k}"), key, vec![(id.into(), *k)], case);
                }
            }
            for (b, k) in MINUS_ONE_SIGMAS.iter().enumerate().filter(|_| size.asks(Question::MinusOne)) {
                let n = turn((a + b) as u64 % kinds, a, b);
                let excluded = vec![id.into()];
                let case = Case { question: Question::MinusOne, instrument: n, excluded, ..Case::default() };
                push(
                    round,
                    &format!("minus-one/{k}"),
                    format!("minus-one/{id}/{k}/{round}"),
                    vec![(id.into(), *k)],
                    case,
                );
            }
        }
        for (a, [x, y]) in PAIRS.into_iter().enumerate().filter(|(_, p)| p.iter().all(|id| size.wants(id))) {
            for (b, k) in PAIR_SIGMAS.iter().enumerate().filter(|_| size.asks(Question::Pair)) {
                let n = turn((a + b) as u64 % kinds, a, b);
                let case = Case { question: Question::Pair, instrument: n, ..Case::default() };
                let effects = vec![(x.into(), *k), (y.into(), *k)];
                push(round, &format!("pair/{k}"), format!("pair/{x}+{y}/{k}/{round}"), effects, case);
            }
        }
        // Any two effects: each of the catalogue with another one, drawn once for a round.
        for (a, [x, y]) in any_pairs(size.seed, round).into_iter().enumerate() {
            if !size.asks(Question::Pair) || ![x, y].iter().all(|id| size.wants(id)) {
                continue;
            }
            let k = PAIR_SIGMAS[a % PAIR_SIGMAS.len()];
            let case = Case { question: Question::Pair, instrument: turn(a as u64 % kinds, a, 0), ..Case::default() };
            let effects = vec![(x.into(), k), (y.into(), k)];
            push(round, &format!("pair-any/{k}"), format!("pair-any/{x}+{y}/{k}/{round}"), effects, case);
        }
        let foreign = if size.gentle { &[FOREIGN_QUICK][..] } else { &FOREIGN_SIGMAS[..] };
        for (a, f) in FOREIGN.iter().enumerate().filter(|(_, f)| size.wants(f.descriptor().id)) {
            let id = f.descriptor().id;
            for (b, k) in foreign.iter().enumerate().filter(|_| size.asks(Question::Foreign)) {
                let n = turn((a + b) as u64 % kinds, a, b);
                let case = Case { question: Question::Foreign, instrument: n, ..Case::default() };
                push(round, &format!("foreign/{k}"), format!("foreign/{id}/{k}/{round}"), vec![(id.into(), *k)], case);
            }
        }
        for (a, holds) in Holds::PARTS.into_iter().enumerate().filter(|_| size.asks(Question::Parts)) {
            let name = holds.name();
            for (b, id) in OF_PARTS.into_iter().enumerate().filter(|(_, id)| size.wants(id)) {
                let n = turn((a + b) as u64 % kinds, a, b);
                let case = Case { question: Question::Parts, instrument: n, holds, ..Case::default() };
                push(round, &format!("parts/{name}/0"), format!("parts/{name}/null-{b}/{round}"), vec![], case.clone());
                for k in PARTS_SIGMAS {
                    let key = format!("parts/{name}/{id}/{k}/{round}");
                    push(round, &format!("parts/{name}/{k}"), key, vec![(id.into(), k)], case.clone());
                }
            }
        }
        for (a, holds) in Holds::MISREGISTERED.into_iter().enumerate().filter(|_| size.asks(Question::Registration)) {
            for kind in &each_kind {
                let n = turn(*kind, a, 0);
                let case = Case { question: Question::Registration, instrument: n, holds, ..Case::default() };
                let key = format!("registration/{}/{kind}/{round}", holds.name());
                push(round, &format!("registration/{}", holds.name()), key, vec![], case);
            }
        }
        for id in
            DOWNSTREAM.into_iter().filter(|id| round == 0 && size.asks(Question::Reconstruction) && size.wants(id))
        {
            let case = Case { question: Question::Reconstruction, ..Case::default() };
            push(round, "reconstruction", format!("reconstruction/{id}"), vec![(id.into(), DOWNSTREAM_SIGMAS)], case);
        }
        for kind in &each_kind {
            let n = turn(*kind, 0, 0);
            if size.asks(Question::Gain) && size.wants("noise_scale") {
                let case = Case { question: Question::Gain, instrument: n, gain: WRONG_GAIN, ..Case::default() };
                push(round, "gain", format!("gain/{WRONG_GAIN}/{kind}/{round}"), vec![], case);
            }
            if size.asks(Question::Records) {
                for (name, value) in
                    [("swapped_with_next", 1.0), ("flip_rows", 1.0), ("flip_cols", 1.0), ("exposure_factor", 1.25)]
                {
                    let it = Injected {
                        id: "metadata_fault".into(),
                        param: name.into(),
                        value,
                        others: vec![("frame".into(), 4.0)],
                        ..Injected::default()
                    };
                    let case =
                        Case { question: Question::Records, instrument: n, injected: vec![it], ..Case::default() };
                    push(round, "records", format!("records/{name}/{kind}/{round}"), vec![], case);
                }
            }
        }
    }
    wishes
}

/// Description of an effect of the catalogue, or of a foreign one.
fn described(id: &str) -> Option<&'static Descriptor> {
    find(id).map(|e| e.descriptor()).or_else(|| foreign::find(id).map(|f| f.descriptor()))
}

/// An effect with a strength of `sigmas` standard errors, or at the end of its range. None: the session cannot
/// determine
/// the effect.
fn injected(known: &Sensitivities, id: &str, sigmas: f64) -> Option<Injected> {
    let s = known.of.get(id)?;
    let p = described(id)?.params.first()?;
    // A standard error where the effect is absent is one of the number that the frame is linear in.
    let inner = p.inner(p.off) + sigmas * p.inner(s.sigma);
    let most = p.inner(ranges::largest(id).map_or(p.max, |v| (p.off + v).min(p.max)));
    let capped = inner > most;
    let value = p.outer(inner.min(most));
    Some(Injected { id: id.into(), param: s.param.clone(), sigmas, value, capped, others: Vec::new() })
}
