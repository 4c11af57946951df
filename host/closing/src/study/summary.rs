//! Figures of a study, computed from its outcomes.

use super::foreign;
use super::instruments::Kind;
use super::intervals::Share;
use super::ranks::Ranks;
use super::record::Outcome;
use super::sessions::Holds;
use super::size::Question;
use serde::Serialize;
use std::collections::BTreeMap;

/// Squared correlation from which two effects count as alike (|rho| = 0.7).
const ALIKE: f64 = 0.49;
/// Share of the excess that a closed instrument should remove: of an effect of the catalogue, and of a foreign one.
const REMOVED: [f64; 2] = [0.9, 0.7];

/// Sessions with one effect of the catalogue at one strength.
#[derive(Clone, Debug, Serialize)]
pub struct ByStrength {
    /// The strength, sigma.
    pub sigmas: f64,
    /// Sessions whose effect is capped at the end of its physical range, below this strength.
    pub capped: usize,
    /// Median excess of the effect, chi-squared per pixel on held-out scenes.
    pub excess: Option<f64>,
    /// Sessions in which anything was found.
    pub detected: Share,
    /// Sessions in which the true effect was found first.
    pub first: Share,
    /// As `first`, of the sessions whose found effect has no lookalike beyond |rho| = 0.7.
    pub first_where_alone: Share,
    /// Sessions in which the true effect was found or is in an ambiguity set.
    pub covered: Share,
    /// Sessions in which a name is not true, first or beside the true one, flagged or not.
    pub false_name: Share,
    /// Sessions in which the true effect was found and no other name.
    pub true_alone: Share,
    /// Mean number of false names a session.
    pub extra_names: f64,
    /// Mean number of terms without a name a session.
    pub unnamed: f64,
    /// Median share of the explainable excess that was removed, of the sessions that have an excess.
    pub explained: Option<f64>,
    /// Of those sessions: at least nine tenths were removed.
    pub removed: Share,
    /// Sessions whose held-out figures are worse after than before.
    pub worse: usize,
    /// Mean of (value - truth) / sigma.
    pub pull_mean: Option<f64>,
    /// Its root mean square.
    pub pull_rms: Option<f64>,
    /// Its median absolute value over that of a normal variable: an rms that is robust against outliers.
    pub pull_robust: Option<f64>,
    /// Number of pulls.
    pub pulls: usize,
    /// Histogram of the truths' ranks.
    pub ranks: Ranks,
}

/// A true effect and what was found first.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Confusion {
    /// The true effect.
    pub truth: String,
    /// What was found first; `nothing`, `unknown`.
    pub found: String,
    /// Sessions by strength.
    pub sessions: BTreeMap<String, usize>,
    /// Sessions in which the true effect was found later or is in an ambiguity set.
    pub covered: usize,
    /// Largest squared correlation that `close` reported between the found effect and a lookalike.
    pub overlap: f64,
}

/// Reports of `close` when the true effect is not among its candidates.
#[derive(Clone, Debug, Serialize)]
pub struct Outside {
    /// It found something, or reports that the catalogue is incomplete.
    pub noticed: Share,
    /// It reports that the catalogue is incomplete.
    pub abstains: Share,
    /// It names an effect of the catalogue, flagged or not.
    pub false_naming: Share,
    /// Median share of the explainable excess that was removed.
    pub explained: Option<f64>,
    /// Of the sessions with an excess: at least seven tenths were removed.
    pub removed: Share,
}

/// All figures of a study.
#[derive(Clone, Debug, Serialize)]
pub struct Summary {
    /// Sessions that were closed.
    pub sessions: usize,
    /// Sessions that failed.
    pub failed: usize,
    /// Instruments that sessions were closed of, by kind.
    pub instruments: BTreeMap<Kind, usize>,
    /// Null sessions in which an effect or a fault was found.
    pub null_found: Share,
    /// The same by what the session holds.
    pub null_by: Vec<(Holds, Share)>,
    /// The same by kind of instruments.
    pub null_by_kind: Vec<(Kind, Share)>,
    /// Null sessions that are called incomplete without anything found.
    pub null_incomplete: Share,
    /// What was found in null sessions.
    pub null_named: BTreeMap<String, usize>,
    /// Mean chi-squared per pixel of whole null sessions: of the calibrated model, and of the noise-free frames.
    pub null_chi2: [f64; 2],
    /// Single effects.
    pub single: Vec<ByStrength>,
    /// Single effects by kind of instruments.
    pub single_by_kind: Vec<(Kind, Vec<ByStrength>)>,
    /// What was found first for each effect.
    pub confusion: Vec<Confusion>,
    /// False names beside or in place of true single effects, and how often.
    pub false_names: BTreeMap<String, usize>,
    /// Pairs: both effects found or in an ambiguity set.
    pub pairs_both: Share,
    /// Pairs: at least one of them.
    pub pairs_one: Share,
    /// Pairs: a name that is not true.
    pub pairs_false: Share,
    /// The true effect not among the candidates, by strength in sigma.
    pub minus_one: Vec<(f64, Outside)>,
    /// Effects outside the catalogue, by strength in sigma.
    pub foreign: Vec<(f64, Outside)>,
    /// Effects outside the catalogue, by what they are like.
    pub foreign_like: Vec<(&'static str, Outside)>,
    /// Sessions that hold less, or whose truths are misplaced: the true effect named (of those with one), and a name
    /// that is not true.
    pub holds: Vec<(Holds, Share, Share)>,
    /// A gain stated wrongly: the gain is named.
    pub gain: Share,
    /// Faults of the records: found, in the right frame.
    pub records: Share,
    /// Keys of all sessions whose held-out figures are worse after than before.
    pub worse: Vec<String>,
    /// Time to close a session, s: median, mean, largest.
    pub seconds: [f64; 3],
}

impl Summary {
    /// Computes the figures.
    pub fn of(all: &[Outcome]) -> Self {
        let good: Vec<&Outcome> = all.iter().filter(|o| o.error.is_none()).collect();
        let asked = |q: Question| good.iter().copied().filter(move |o| o.case.question == q);
        // A study of unknown specimens asks both in one question.
        let of_unknown = |with: bool| asked(Question::Unknown).filter(move |o| o.case.injected.is_empty() != with);
        let nulls: Vec<&Outcome> = asked(Question::Null).chain(of_unknown(false)).collect();
        let mut null_named = BTreeMap::new();
        for f in nulls.iter().flat_map(|o| &o.found) {
            *null_named.entry(f.id.clone()).or_default() += 1;
        }
        let whole: Vec<&Outcome> = nulls.iter().copied().filter(|o| o.case.holds == Holds::Whole).collect();
        let mean = |of: &dyn Fn(&Outcome) -> f64| whole.iter().map(|o| of(o)).sum::<f64>() / whole.len().max(1) as f64;
        let of_pair = |o: &Outcome| o.case.injected.iter().filter(|i| o.covers(&i.id)).count();
        let mut seconds: Vec<f64> = good.iter().map(|o| o.seconds).collect();
        seconds.sort_by(f64::total_cmp);
        let single: Vec<&Outcome> = asked(Question::Single).chain(of_unknown(true)).collect();
        let mut false_names = BTreeMap::new();
        for id in single.iter().flat_map(|o| o.false_names()) {
            *false_names.entry(id.to_string()).or_default() += 1;
        }
        let beyond = |q: Question| {
            let of: Vec<&Outcome> = asked(q).collect();
            strengths(&of).into_iter().map(|(k, of)| (k, outside(&of))).collect::<Vec<_>>()
        };
        let like = |o: &Outcome| foreign::find(truth(o)).map_or("", |f| f.like().name());
        let parts: Vec<&Outcome> = asked(Question::Parts).chain(asked(Question::Registration)).collect();
        let part = |(holds, of): (Holds, Vec<&Outcome>)| {
            let with = of.iter().copied().filter(|o| !o.case.injected.is_empty());
            let named = Share::of(with, |o| o.found.iter().any(|f| f.id == truth(o)));
            (holds, named, Share::of(of.iter().copied(), Outcome::names_falsely))
        };
        let mut instruments: BTreeMap<Kind, std::collections::BTreeSet<u64>> = BTreeMap::new();
        for o in &good {
            instruments.entry(o.kind).or_default().insert(o.case.instrument);
        }
        Self {
            sessions: good.len(),
            failed: all.len() - good.len(),
            instruments: instruments.into_iter().map(|(kind, of)| (kind, of.len())).collect(),
            null_found: Share::of(nulls.iter().copied(), Outcome::detected),
            null_by: groups(&nulls, |o| o.case.holds)
                .into_iter()
                .map(|(holds, of)| (holds, Share::of(of, Outcome::detected)))
                .collect(),
            null_by_kind: groups(&nulls, |o| o.kind)
                .into_iter()
                .map(|(kind, of)| (kind, Share::of(of, Outcome::detected)))
                .collect(),
            null_incomplete: Share::of(nulls.iter().copied(), |o| !o.detected() && o.incomplete),
            null_named,
            null_chi2: [mean(&|o| o.held_out.before), mean(&|o| o.held_out.floor)],
            confusion: confusion(&single),
            false_names,
            single_by_kind: groups(&single, |o| o.kind)
                .into_iter()
                .map(|(kind, of)| (kind, by_strengths(&of)))
                .collect(),
            single: by_strengths(&single),
            pairs_both: Share::of(asked(Question::Pair), |o| of_pair(o) == 2),
            pairs_one: Share::of(asked(Question::Pair), |o| of_pair(o) >= 1),
            pairs_false: Share::of(asked(Question::Pair), Outcome::names_falsely),
            minus_one: beyond(Question::MinusOne),
            foreign: beyond(Question::Foreign),
            foreign_like: groups(&asked(Question::Foreign).collect::<Vec<_>>(), like)
                .into_iter()
                .map(|(like, of)| (like, outside(&of)))
                .collect(),
            holds: groups(&parts, |o| o.case.holds).into_iter().map(part).collect(),
            gain: Share::of(asked(Question::Gain), |o| o.covers("noise_scale")),
            records: Share::of(asked(Question::Records), fault_found),
            worse: good.iter().filter(|o| o.held_out.is_worse()).map(|o| o.case.key.clone()).collect(),
            seconds: [
                median(&seconds).unwrap_or(0.0),
                seconds.iter().sum::<f64>() / seconds.len().max(1) as f64,
                seconds.last().copied().unwrap_or(0.0),
            ],
        }
    }
}

/// Outcomes grouped by a property, ascending.
fn groups<'a, K: Ord>(outcomes: &[&'a Outcome], of: impl Fn(&Outcome) -> K) -> Vec<(K, Vec<&'a Outcome>)> {
    let mut out: BTreeMap<K, Vec<&Outcome>> = BTreeMap::new();
    for o in outcomes {
        out.entry(of(o)).or_default().push(o);
    }
    out.into_iter().collect()
}

/// Whether the fault was found in the frame that has it.
fn fault_found(o: &Outcome) -> bool {
    let frame = o.case.injected.first().and_then(|i| i.others.iter().find(|(n, _)| n == "frame")).map(|(_, v)| *v);
    let found = o.found.iter().filter(|f| f.id == "metadata_fault");
    found.filter_map(|f| f.params.get("frame")).any(|[v, _]| Some(*v) == frame)
}

/// Outcomes grouped by the strength of the first injected effect, ascending.
fn strengths<'a>(outcomes: &[&'a Outcome]) -> Vec<(f64, Vec<&'a Outcome>)> {
    let mut out: Vec<(f64, Vec<&Outcome>)> = Vec::new();
    for o in outcomes {
        let k = o.case.injected.first().map_or(0.0, |i| i.sigmas);
        match out.iter_mut().find(|(s, _)| *s == k) {
            Some((_, of)) => of.push(o),
            None => out.push((k, vec![o])),
        }
    }
    out.sort_by(|a, b| a.0.total_cmp(&b.0));
    out
}

fn truth(o: &Outcome) -> &str {
    o.case.injected.first().map_or("", |i| i.id.as_str())
}

/// Figures of sessions with one effect, by its strength.
pub(super) fn by_strengths(of: &[&Outcome]) -> Vec<ByStrength> {
    strengths(of).into_iter().map(|(k, of)| by_strength(k, &of)).collect()
}

fn by_strength(sigmas: f64, of: &[&Outcome]) -> ByStrength {
    let right = |o: &Outcome| o.first() == truth(o);
    let all = || of.iter().copied();
    let alone = all().filter(|o| o.found.first().is_none_or(|f| f.overlap < ALIKE));
    let sorted = |mut values: Vec<f64>| {
        values.sort_by(f64::total_cmp);
        values
    };
    let explained = sorted(all().filter_map(|o| o.held_out.explained()).collect());
    let excess = sorted(all().filter_map(|o| Some(o.held_out.before - o.held_out.truth?)).collect());
    let pulls: Vec<f64> = all().filter_map(|o| o.pull(o.case.injected.first()?)).collect();
    let n = pulls.len() as f64;
    let mean = |of: &dyn Fn(f64) -> f64| (n > 0.0).then(|| pulls.iter().map(|p| of(*p)).sum::<f64>() / n);
    let sizes = sorted(pulls.iter().map(|p| p.abs()).collect());
    let a_session = |sum: usize| sum as f64 / of.len().max(1) as f64;
    ByStrength {
        sigmas,
        capped: all().filter(|o| o.case.injected.iter().any(|i| i.capped)).count(),
        excess: median(&excess),
        detected: Share::of(all(), Outcome::detected),
        first: Share::of(all(), right),
        first_where_alone: Share::of(alone, right),
        covered: Share::of(all(), |o| o.covers(truth(o))),
        false_name: Share::of(all(), Outcome::names_falsely),
        true_alone: Share::of(all(), |o| o.found.iter().any(|f| f.id == truth(o)) && !o.names_falsely()),
        extra_names: a_session(all().map(|o| o.false_names().len()).sum()),
        unnamed: a_session(all().map(|o| o.found.iter().filter(|f| !f.known).count()).sum()),
        explained: median(&explained),
        removed: removed(of, REMOVED[0]),
        worse: all().filter(|o| o.held_out.is_worse()).count(),
        pull_mean: mean(&|p| p),
        pull_rms: mean(&|p| p * p).map(f64::sqrt),
        pull_robust: median(&sizes).map(|m| m / 0.674_49),
        pulls: pulls.len(),
        ranks: Ranks::of(&pulls),
    }
}

/// Of the sessions with an excess, those in which at least a share was removed.
fn removed(of: &[&Outcome], share: f64) -> Share {
    let with = of.iter().copied().filter(|o| o.held_out.explained().is_some());
    Share::of(with, |o| o.held_out.explained().is_some_and(|f| f >= share))
}

fn outside(of: &[&Outcome]) -> Outside {
    let mut explained: Vec<f64> = of.iter().filter_map(|o| o.held_out.explained()).collect();
    explained.sort_by(f64::total_cmp);
    Outside {
        noticed: Share::of(of.iter().copied(), |o| o.detected() || o.incomplete),
        abstains: Share::of(of.iter().copied(), |o| o.incomplete),
        false_naming: Share::of(of.iter().copied(), Outcome::names_falsely),
        explained: median(&explained),
        removed: removed(of, REMOVED[1]),
    }
}

fn confusion(single: &[&Outcome]) -> Vec<Confusion> {
    let mut table: BTreeMap<(String, String), Confusion> = BTreeMap::new();
    for o in single {
        let (truth, found) = (truth(o).to_string(), o.first().to_string());
        let entry = table.entry((truth.clone(), found.clone())).or_insert_with(|| Confusion {
            truth,
            found,
            sessions: BTreeMap::new(),
            covered: 0,
            overlap: 0.0,
        });
        let k = o.case.injected.first().map_or(0.0, |i| i.sigmas);
        *entry.sessions.entry(k.to_string()).or_default() += 1;
        entry.covered += usize::from(o.covers(&entry.truth));
        entry.overlap = entry.overlap.max(o.found.first().map_or(0.0, |f| f.overlap));
    }
    table.into_values().collect()
}

/// Of sorted values.
fn median(sorted: &[f64]) -> Option<f64> {
    let n = sorted.len();
    (n > 0).then(|| 0.5 * (sorted[(n - 1) / 2] + sorted[n / 2]))
}
