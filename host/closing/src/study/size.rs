//! How large a study is, and which questions it answers.

use ommatidia_bench::MeasuredPsfs;
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
    /// What does `close` report of sessions that hold less than darks, flats and known scenes?
    Parts,
    /// What does `close` report if the truths do not lie quite where the objects were?
    Registration,
    /// Are faults of the records (exchanged truths, wrong exposure) found?
    Records,
    /// Does fine-tuning on the closed instrument help a network as much as on the true one?
    Reconstruction,
    /// Is one undeclared effect found where nobody knows the specimens, and nothing where there is none?
    Unknown,
    /// Does a change that another specimen could make as well go without a name?
    Gauge,
}

impl Question {
    /// All of them.
    pub const ALL: [Self; 10] = [
        Self::Null,
        Self::Single,
        Self::Pair,
        Self::MinusOne,
        Self::Foreign,
        Self::Gain,
        Self::Parts,
        Self::Registration,
        Self::Records,
        Self::Reconstruction,
    ];
}

/// How large a study is, and which seeds it uses.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Size {
    /// Seed of all random draws.
    pub seed: u64,
    /// Whether instruments and sessions are the sealed ones, which no threshold may be set on.
    #[serde(default)]
    pub sealed: bool,
    /// Number of the sealed study, from 1: each draws instruments and sessions of its own. The study sets it when it
    /// begins. 0: not yet, or development seeds.
    #[serde(default)]
    pub opening: usize,
    /// Whether the only instruments are gentle ones, for a check that takes a minute.
    #[serde(default)]
    pub gentle: bool,
    /// Measured PSFs, as one more kind of instruments.
    #[serde(default)]
    pub measured: Option<MeasuredPsfs>,
    /// Number of instruments; the kinds take turns.
    pub instruments: u64,
    /// Sessions without an effect.
    pub nulls: usize,
    /// Repetitions of all other sessions, each with its own scenes and noise.
    pub seeds: u64,
    /// Strengths of single effects, in units of the session's sensitivity.
    pub strengths: Vec<f64>,
    /// Ids of the effects to inject; empty: all.
    pub only: Vec<String>,
    /// Questions to answer; empty: all but those of unknown specimens, which have a study of their own.
    pub questions: Vec<Question>,
    /// Largest number of sessions with one effect at one strength; other groups have a sixth of it. `None`: no limit.
    #[serde(default)]
    pub quota: Option<usize>,
}

impl Default for Size {
    fn default() -> Self {
        Self {
            seed: 1,
            sealed: false,
            opening: 0,
            gentle: false,
            measured: None,
            instruments: 42,
            nulls: 300,
            seeds: 1,
            strengths: vec![3.0, 10.0, 30.0, 100.0, 300.0, 1000.0],
            only: Vec::new(),
            questions: Vec::new(),
            quota: None,
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
            gentle: true,
            instruments: 1,
            nulls: 6,
            strengths: vec![20.0],
            only: only.map(Into::into).to_vec(),
            questions: vec![Question::Null, Question::Single, Question::Foreign, Question::Records],
            ..Self::default()
        }
    }

    /// A study of sessions whose specimens nobody knows: each effect in units of its own standard error there.
    pub fn of_unknown_specimens(seed: u64, sealed: bool) -> Self {
        Self {
            seed,
            sealed,
            instruments: 6,
            nulls: 18,
            strengths: vec![10.0, 30.0, 100.0],
            questions: vec![Question::Unknown, Question::Gauge],
            quota: Some(4),
            ..Self::default()
        }
    }

    /// Whether the study is one of sessions whose specimens nobody knows.
    pub fn is_of_unknown_specimens(&self) -> bool {
        self.questions.contains(&Question::Unknown)
    }

    /// A study over all kinds of instruments and strengths, for development, with at most `most` sessions with one
    /// effect at one strength; 6 make about 70 sessions.
    pub fn development(seed: u64, most: usize) -> Self {
        let questions = Question::ALL.into_iter().filter(|q| *q != Question::Reconstruction);
        let questions = questions.filter(|q| *q != Question::Gain && *q != Question::Records).collect();
        Self { seed, instruments: 4, nulls: 3 * most / 2, quota: Some(most), questions, ..Self::default() }
    }

    /// Whether an effect is injected.
    pub(super) fn wants(&self, id: &str) -> bool {
        self.only.is_empty() || self.only.iter().any(|o| o == id)
    }

    /// Whether a question is asked.
    pub fn asks(&self, question: Question) -> bool {
        match question {
            Question::Unknown | Question::Gauge => self.questions.contains(&question),
            _ => self.questions.is_empty() || self.questions.contains(&question),
        }
    }
}
