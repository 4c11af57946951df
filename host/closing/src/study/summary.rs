//! Figures of a study, computed from its outcomes.

use super::plan::Question;
use super::record::Outcome;
use serde::Serialize;
use std::collections::BTreeMap;

/// Squared correlation from which two effects count as alike (|rho| = 0.7).
const ALIKE: f64 = 0.49;

/// `k` of `n`, with the 95 % interval of Wilson (J. Am. Stat. Assoc. 22, 209, 1927).
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Share {
    /// How many.
    pub k: usize,
    /// Of how many.
    pub n: usize,
    /// Lower end.
    pub low: f64,
    /// Upper end.
    pub high: f64,
}

impl Share {
    /// Counts the outcomes for which `holds` is true.
    pub fn of<'a>(outcomes: impl IntoIterator<Item = &'a Outcome>, holds: impl Fn(&Outcome) -> bool) -> Self {
        let (mut k, mut n) = (0, 0);
        for o in outcomes {
            n += 1;
            k += usize::from(holds(o));
        }
        Self::new(k, n)
    }

    /// `k` of `n`.
    pub fn new(k: usize, n: usize) -> Self {
        let (low, high) = wilson(k as f64, n as f64);
        Self { k, n, low, high }
    }

    /// k / n.
    pub fn share(&self) -> f64 {
        self.k as f64 / self.n.max(1) as f64
    }
}

fn wilson(k: f64, n: f64) -> (f64, f64) {
    if n == 0.0 {
        return (0.0, 1.0);
    }
    let (z, p) = (1.96f64, k / n);
    let middle = p + z * z / (2.0 * n);
    let half = z * (p * (1.0 - p) / n + z * z / (4.0 * n * n)).sqrt();
    let scale = 1.0 + z * z / n;
    (((middle - half) / scale).max(0.0), ((middle + half) / scale).min(1.0))
}

/// Sessions with one effect of the catalogue at one strength.
#[derive(Clone, Debug, Serialize)]
pub struct ByStrength {
    /// The strength, sigma.
    pub sigmas: f64,
    /// Sessions in which anything was found.
    pub detected: Share,
    /// Sessions in which the true effect was found first.
    pub first: Share,
    /// As `first`, of the sessions whose found effect has no lookalike beyond |rho| = 0.7.
    pub first_where_alone: Share,
    /// Sessions in which the true effect was found or is in an ambiguity set.
    pub covered: Share,
    /// Sessions in which another effect was found first.
    pub other_first: Share,
    /// Median share of the explainable excess that was removed, of the sessions that have an excess.
    pub explained: Option<f64>,
    /// Sessions with an explainable excess.
    pub with_excess: usize,
    /// Mean of (value - truth) / sigma.
    pub pull_mean: Option<f64>,
    /// Its root mean square.
    pub pull_rms: Option<f64>,
    /// Its median absolute value over that of a normal variable: an rms that is robust against outliers.
    pub pull_robust: Option<f64>,
    /// Number of pulls.
    pub pulls: usize,
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
    /// It names an effect of the catalogue and does not report that the catalogue is incomplete.
    pub false_naming: Share,
    /// As `false_naming`, of the sessions in `noticed`.
    pub false_naming_of_noticed: Share,
    /// Median share of the explainable excess that was removed.
    pub explained: Option<f64>,
}

/// All figures of a study.
#[derive(Clone, Debug, Serialize)]
pub struct Summary {
    /// Sessions that were closed.
    pub sessions: usize,
    /// Sessions that failed.
    pub failed: usize,
    /// Null sessions in which an effect or a fault was found.
    pub null_found: Share,
    /// Null sessions that are called incomplete without anything found.
    pub null_incomplete: Share,
    /// What was found in null sessions.
    pub null_named: BTreeMap<String, usize>,
    /// Mean chi-squared per pixel of null sessions: of the calibrated model, and of the noise-free frames.
    pub null_chi2: [f64; 2],
    /// Single effects.
    pub single: Vec<ByStrength>,
    /// What was found first for each effect.
    pub confusion: Vec<Confusion>,
    /// Pairs: both effects found or in an ambiguity set.
    pub pairs_both: Share,
    /// Pairs: at least one of them.
    pub pairs_one: Share,
    /// The true effect not among the candidates.
    pub minus_one: Outside,
    /// Effects outside the catalogue, by strength in sigma.
    pub foreign: Vec<(f64, Outside)>,
    /// A gain stated wrongly: the gain is named.
    pub gain: Share,
    /// Faults of the records: found, in the right frame.
    pub records: Share,
    /// Time to close a session, s: median, mean, largest.
    pub seconds: [f64; 3],
}

impl Summary {
    /// Computes the figures.
    pub fn of(all: &[Outcome]) -> Self {
        let good: Vec<&Outcome> = all.iter().filter(|o| o.error.is_none()).collect();
        let asked = |q: Question| good.iter().copied().filter(move |o| o.case.question == q);
        let nulls: Vec<&Outcome> = asked(Question::Null).collect();
        let mut null_named = BTreeMap::new();
        for o in &nulls {
            for f in &o.found {
                *null_named.entry(f.id.clone()).or_default() += 1;
            }
        }
        let mean = |of: &dyn Fn(&Outcome) -> f64| nulls.iter().map(|o| of(o)).sum::<f64>() / nulls.len().max(1) as f64;
        let of_pair = |o: &Outcome| o.case.injected.iter().filter(|i| o.covers(&i.id)).count();
        let mut seconds: Vec<f64> = good.iter().map(|o| o.seconds).collect();
        seconds.sort_by(f64::total_cmp);
        let single: Vec<&Outcome> = asked(Question::Single).collect();
        Self {
            sessions: good.len(),
            failed: all.len() - good.len(),
            null_found: Share::of(nulls.iter().copied(), Outcome::detected),
            null_incomplete: Share::of(nulls.iter().copied(), |o| !o.detected() && o.incomplete),
            null_named,
            null_chi2: [mean(&|o| o.held_out.before), mean(&|o| o.held_out.floor)],
            confusion: confusion(&single),
            single: strengths(&single).into_iter().map(|(k, of)| by_strength(k, &of)).collect(),
            pairs_both: Share::of(asked(Question::Pair), |o| of_pair(o) == 2),
            pairs_one: Share::of(asked(Question::Pair), |o| of_pair(o) >= 1),
            minus_one: outside(&asked(Question::MinusOne).collect::<Vec<_>>()),
            foreign: strengths(&asked(Question::Foreign).collect::<Vec<_>>())
                .into_iter()
                .map(|(k, of)| (k, outside(&of)))
                .collect(),
            gain: Share::of(asked(Question::Gain), |o| o.covers("noise_scale")),
            records: Share::of(asked(Question::Records), fault_found),
            seconds: [
                median(&seconds).unwrap_or(0.0),
                seconds.iter().sum::<f64>() / seconds.len().max(1) as f64,
                seconds.last().copied().unwrap_or(0.0),
            ],
        }
    }
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

fn by_strength(sigmas: f64, of: &[&Outcome]) -> ByStrength {
    let right = |o: &Outcome| o.first() == truth(o);
    let alone = of.iter().copied().filter(|o| o.found.first().is_none_or(|f| f.overlap < ALIKE));
    let mut explained: Vec<f64> = of.iter().filter_map(|o| o.held_out.explained()).collect();
    explained.sort_by(f64::total_cmp);
    let pulls: Vec<f64> = of.iter().filter_map(|o| o.pull(o.case.injected.first()?)).collect();
    let n = pulls.len() as f64;
    let mean = |of: &dyn Fn(f64) -> f64| (n > 0.0).then(|| pulls.iter().map(|p| of(*p)).sum::<f64>() / n);
    let mut sizes: Vec<f64> = pulls.iter().map(|p| p.abs()).collect();
    sizes.sort_by(f64::total_cmp);
    ByStrength {
        sigmas,
        detected: Share::of(of.iter().copied(), Outcome::detected),
        first: Share::of(of.iter().copied(), right),
        first_where_alone: Share::of(alone, right),
        covered: Share::of(of.iter().copied(), |o| o.covers(truth(o))),
        other_first: Share::of(of.iter().copied(), |o| o.detected() && !right(o)),
        explained: median(&explained),
        with_excess: explained.len(),
        pull_mean: mean(&|p| p),
        pull_rms: mean(&|p| p * p).map(f64::sqrt),
        pull_robust: median(&sizes).map(|m| m / 0.674_49),
        pulls: pulls.len(),
    }
}

fn outside(of: &[&Outcome]) -> Outside {
    let noticed = |o: &Outcome| o.detected() || o.incomplete;
    let mut explained: Vec<f64> = of.iter().filter_map(|o| o.held_out.explained()).collect();
    explained.sort_by(f64::total_cmp);
    Outside {
        noticed: Share::of(of.iter().copied(), noticed),
        abstains: Share::of(of.iter().copied(), |o| o.incomplete),
        false_naming: Share::of(of.iter().copied(), Outcome::names_confidently),
        false_naming_of_noticed: Share::of(of.iter().copied().filter(|o| noticed(o)), Outcome::names_confidently),
        explained: median(&explained),
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
