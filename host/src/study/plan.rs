//! The cases of a study: what is put into which session, and what the loop is not told.

use super::foreign::FOREIGN;
use super::sensitivity::Sensitivities;
use crate::effects::{Effect, Stage, find, registry};
use crate::rng;
use rand::Rng;
use serde::{Deserialize, Serialize};

/// What a case asks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Question {
    /// Is nothing found where nothing is?
    #[default]
    Null,
    /// Is one undeclared effect of the catalogue found?
    Single,
    /// Are two?
    Pair,
    /// What is said where the true effect is not among the candidates?
    MinusOne,
    /// What is said of an effect that no catalogue holds?
    Foreign,
    /// Is a gain found that the calibration states wrongly?
    Gain,
    /// Are faults of the records found?
    Records,
    /// Does a network gain as much from the closed instrument as from the true one?
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

/// What is put in.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Injected {
    /// Id of the effect.
    pub id: String,
    /// Its strength by name.
    pub param: String,
    /// The strength in units of the session's own sensitivity.
    pub sigmas: f64,
    /// The strength.
    pub value: f64,
    /// Other parameters.
    #[serde(default)]
    pub others: Vec<(String, f64)>,
}

/// One session.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Case {
    /// Names it.
    pub key: String,
    /// What it asks.
    pub question: Question,
    /// Which instrument.
    pub instrument: u64,
    /// Makes noise and scenes.
    pub seed: u64,
    /// What is put in.
    pub injected: Vec<Injected>,
    /// Ids that the loop may not name.
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
    /// Seed of everything.
    pub seed: u64,
    /// Instruments.
    pub instruments: u64,
    /// Sessions with nothing in them.
    pub nulls: usize,
    /// Repetitions of everything else, each with its own scenes and noise.
    pub seeds: u64,
    /// Strengths of single effects, in units of the session's sensitivity.
    pub strengths: Vec<f64>,
    /// Effects that are looked at; empty: all.
    pub only: Vec<String>,
    /// Questions that are asked; empty: all.
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
    /// A minute or two: enough to see that loop and study work, not to measure either.
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

/// Pairs of effects, those easily taken for one another first.
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
/// Strengths of the two of a pair.
const PAIR_SIGMAS: [f64; 2] = [10.0, 30.0];
/// Strength of what the loop may not name.
const MINUS_ONE_SIGMAS: f64 = 30.0;
/// Strengths of foreign effects; their unit is the noise alone.
const FOREIGN_SIGMAS: [f64; 3] = [10.0, 30.0, 100.0];
/// Effects that a network is fine-tuned for, one of each kind.
pub const DOWNSTREAM: [&str; 6] =
    ["array_shift", "lens_gain", "defocus", "veiling_glare", "charge_diffusion", "vignetting"];
/// Their strength: a picture does not show what is ten standard errors of a session.
const DOWNSTREAM_SIGMAS: f64 = 100.0;
/// By how much the gain is stated wrongly.
const WRONG_GAIN: f64 = 1.05;

/// Ids of the effects that a study puts in: those with a law that a session of frames can show.
pub fn catalogue() -> Vec<&'static str> {
    let named = |e: &&&'static dyn Effect| {
        let d = e.descriptor();
        d.stage != Stage::Record && !d.id.starts_with("unknown")
    };
    registry().iter().filter(named).map(|e| e.descriptor().id).collect()
}

/// All cases in an order that has something of everything early on, so that half a study says something of all.
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

/// An effect at a strength of so many standard errors. None: the session cannot tell it, or it cannot be that strong.
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
