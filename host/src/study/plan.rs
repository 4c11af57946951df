//! The cases of a study: which undeclared effect is injected into which session.

use super::foreign::FOREIGN;
use super::sensitivity::Sensitivities;
use crate::effects::{Effect, Stage, find, registry};
use crate::rng;
use rand::Rng;
use serde::{Deserialize, Serialize};

/// The question that a case answers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Question {
    /// Is nothing found in a session without an effect?
    #[default]
    Null,
    /// Is one undeclared effect of the catalogue found?
    Single,
    /// Are two undeclared effects of the catalogue found?
    Pair,
    /// What does `close` report if the true effect is not among the candidates?
    MinusOne,
    /// What does `close` report of an effect outside the catalogue?
    Foreign,
    /// Is a wrongly calibrated gain found?
    Gain,
    /// Are faults of the records (exchanged truths, wrong exposure) found?
    Records,
    /// Does fine-tuning on the closed instrument help a network as much as on the true one?
    Reconstruction,
}

impl Question {
    /// All of them.
    pub const ALL: [Self; 8] = [
        Self::Null,
        Self::Single,
        Self::Pair,
        Self::MinusOne,
        Self::Foreign,
        Self::Gain,
        Self::Records,
        Self::Reconstruction,
    ];
}

/// An injected effect.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Injected {
    /// Id of the effect.
    pub id: String,
    /// Name of its strength parameter.
    pub param: String,
    /// Strength in units of the sensitivity of the session.
    pub sigmas: f64,
    /// Strength, in the unit of the parameter.
    pub value: f64,
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

/// How large a study is.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Size {
    /// Seed of all random draws.
    pub seed: u64,
    /// Number of instruments.
    pub instruments: u64,
    /// Sessions without an effect.
    pub nulls: usize,
    /// Repetitions of all other sessions, each with its own scenes and noise.
    pub seeds: u64,
    /// Strengths of single effects, in units of the session's sensitivity.
    pub strengths: Vec<f64>,
    /// Ids of the effects to inject; empty: all.
    pub only: Vec<String>,
    /// Questions to answer; empty: all.
    pub questions: Vec<Question>,
}

impl Default for Size {
    fn default() -> Self {
        Self {
            seed: 1,
            instruments: 3,
            nulls: 300,
            seeds: 1,
            strengths: vec![3.0, 5.0, 10.0, 30.0],
            only: Vec::new(),
            questions: Vec::new(),
        }
    }
}

impl Size {
    /// A study of a minute or two, which checks that `close` and the study work but measures neither.
    pub fn quick(seed: u64) -> Self {
        let only =
            ["vignetting", "array_shift", "interpixel_capacitance", "background", "half_step", "alternating_gain"];
        Self {
            seed,
            instruments: 1,
            nulls: 6,
            strengths: vec![20.0],
            only: only.map(Into::into).to_vec(),
            questions: vec![Question::Null, Question::Single, Question::Foreign, Question::Records],
            ..Self::default()
        }
    }

    fn wants(&self, id: &str) -> bool {
        self.only.is_empty() || self.only.iter().any(|o| o == id)
    }

    /// Whether a question is asked.
    pub fn asks(&self, question: Question) -> bool {
        self.questions.is_empty() || self.questions.contains(&question)
    }
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
const PAIR_SIGMAS: [f64; 2] = [10.0, 30.0];
/// Strength of an effect that is removed from the candidates.
const MINUS_ONE_SIGMAS: f64 = 30.0;
/// Strengths of foreign effects; their unit is the noise alone.
const FOREIGN_SIGMAS: [f64; 3] = [10.0, 30.0, 100.0];
/// Effects that a network is fine-tuned for, one of each kind.
pub const DOWNSTREAM: [&str; 6] =
    ["array_shift", "lens_gain", "defocus", "veiling_glare", "charge_diffusion", "vignetting"];
/// Their strength: ten standard errors of a session are invisible in a reconstruction.
const DOWNSTREAM_SIGMAS: f64 = 100.0;
/// Factor by which the stated gain is wrong.
const WRONG_GAIN: f64 = 1.05;

/// Ids of the effects that a study injects: all of the catalogue except faults of records and unknown patterns.
pub fn catalogue() -> Vec<&'static str> {
    let named = |e: &&&'static dyn Effect| {
        let d = e.descriptor();
        d.stage != Stage::Record && !d.id.starts_with("unknown")
    };
    registry().iter().filter(named).map(|e| e.descriptor().id).collect()
}

/// All cases, shuffled within each round, so that an unfinished study covers every question. `sensitivities`: one entry
/// per instrument.
pub fn cases(size: &Size, sensitivities: &[Sensitivities]) -> Vec<Case> {
    let mut cases: Vec<(u64, Case)> = Vec::new();
    let mut push = |round: u64, key: String, question: Question, instrument: u64, case: Case| {
        let seed = rng::stream(size.seed, &format!("study/{key}"), 0).next_u64() >> 16;
        cases.push((
            round,
            Case { key, question, instrument, seed, gain: if case.gain == 0.0 { 1.0 } else { case.gain }, ..case },
        ));
    };
    for i in 0..size.nulls as u64 * u64::from(size.asks(Question::Null)) {
        let round = i * size.seeds / size.nulls.max(1) as u64;
        push(round, format!("null/{i}"), Question::Null, i % size.instruments, Case::default());
    }
    for round in 0..size.seeds {
        let instrument = round % size.instruments;
        let Some(known) = sensitivities.get(instrument as usize) else { continue };
        let one = |id: &str, sigmas: f64| injected(known, id, sigmas);
        for id in catalogue().into_iter().filter(|id| size.wants(id)) {
            for k in size.strengths.iter().filter(|_| size.asks(Question::Single)) {
                if let Some(it) = one(id, *k) {
                    let case = Case { injected: vec![it], ..Case::default() };
                    push(round, format!("single/{id}/{k}/{round}"), Question::Single, instrument, case);
                }
            }
            if let Some(it) = one(id, MINUS_ONE_SIGMAS).filter(|_| size.asks(Question::MinusOne)) {
                let case = Case { injected: vec![it], excluded: vec![id.into()], ..Case::default() };
                push(round, format!("minus-one/{id}/{round}"), Question::MinusOne, instrument, case);
            }
        }
        for [a, b] in PAIRS.into_iter().filter(|p| size.asks(Question::Pair) && p.iter().all(|id| size.wants(id))) {
            for k in PAIR_SIGMAS {
                if let (Some(a_in), Some(b_in)) = (one(a, k), one(b, k)) {
                    let case = Case { injected: vec![a_in, b_in], ..Case::default() };
                    push(round, format!("pair/{a}+{b}/{k}/{round}"), Question::Pair, instrument, case);
                }
            }
        }
        for id in
            DOWNSTREAM.into_iter().filter(|id| round == 0 && size.asks(Question::Reconstruction) && size.wants(id))
        {
            if let Some(it) = one(id, DOWNSTREAM_SIGMAS) {
                let case = Case { injected: vec![it], ..Case::default() };
                push(round, format!("reconstruction/{id}"), Question::Reconstruction, instrument, case);
            }
        }
        for f in FOREIGN.iter().filter(|f| size.asks(Question::Foreign) && size.wants(f.descriptor().id)) {
            let id = f.descriptor().id;
            let strong = if size.questions.is_empty() { &FOREIGN_SIGMAS[..] } else { &FOREIGN_SIGMAS[2..] };
            for k in strong {
                if let Some(it) = one(id, *k) {
                    let case = Case { injected: vec![it], ..Case::default() };
                    push(round, format!("foreign/{id}/{k}/{round}"), Question::Foreign, instrument, case);
                }
            }
        }
        if size.asks(Question::Gain) && size.wants("noise_scale") {
            let case = Case { gain: WRONG_GAIN, ..Case::default() };
            push(round, format!("gain/{WRONG_GAIN}/{round}"), Question::Gain, instrument, case);
        }
        if size.asks(Question::Records) {
            for (name, value) in
                [("swapped_with_next", 1.0), ("flip_rows", 1.0), ("flip_cols", 1.0), ("exposure_factor", 1.25)]
            {
                let it = Injected {
                    id: "metadata_fault".into(),
                    param: name.into(),
                    sigmas: 0.0,
                    value,
                    others: vec![("frame".into(), 4.0)],
                };
                let case = Case { injected: vec![it], ..Case::default() };
                push(round, format!("records/{name}/{round}"), Question::Records, instrument, case);
            }
        }
    }
    cases.sort_by_cached_key(|(round, c)| (*round, c.seed));
    cases.into_iter().map(|(_, c)| c).collect()
}

/// An effect with a strength of `sigmas` standard errors. None: the session cannot determine the effect, or the
/// strength is out of range.
fn injected(known: &Sensitivities, id: &str, sigmas: f64) -> Option<Injected> {
    let s = known.of.get(id)?;
    // A standard error where the effect is absent is one of the number that the frame is linear in.
    let (value, possible) = match find(id) {
        Some(effect) => {
            let p = effect.descriptor().params.first()?;
            let inner = p.inner(p.off) + sigmas * p.inner(s.sigma);
            (p.outer(inner), inner <= p.inner(p.max))
        }
        None => (sigmas * s.sigma, true),
    };
    possible.then(|| Injected { id: id.into(), param: s.param.clone(), sigmas, value, others: Vec::new() })
}
