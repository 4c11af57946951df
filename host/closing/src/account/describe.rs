//! Describes the result of a search: each effect in numbers and words, detection limits of the others, and the
//! measurements that would distinguish similar effects.

use super::pupils::{BY_DEPTH, between_planes};
use super::result::{Effect, Rejected, Value};
use super::verdict::Left;
use crate::data::{Fault, FaultKind};
use crate::evidence::{JudgedOn, Test};
use crate::fit::{Fitted, Model, State, Term};
use crate::search::{Candidate, Found};
use ommatidia_physics::effects::{COVARIATES, KNOTS, MOMENT, OPERATORS, Param, Stage, WEIGHTS, find, registry};

/// The result of a search.
#[derive(Clone, Copy)]
pub(crate) struct Findings<'a> {
    /// The first fit.
    pub(crate) before: &'a Fitted,
    /// The last fit.
    pub(crate) now: &'a Fitted,
    /// Number of terms that the instrument had before; they come first in the state.
    pub(crate) own: usize,
    /// The added effects, in the order of the other terms.
    pub(crate) found: &'a [Found],
    /// The test of each term.
    pub(crate) tests: &'a [Option<Test>],
    /// Shares of the excess of chi-squared that are left with structure, beyond noise and calibration.
    pub(crate) left: Left,
}

/// Describes the faults of the records, then the added effects.
pub(crate) fn effects(model: &Model<'_>, findings: Findings<'_>, faults: &[Fault]) -> Vec<Effect> {
    let Findings { before, now, own, found, tests, left } = findings;
    let mut effects: Vec<Effect> = faults.iter().map(fault).collect();
    // The expectation of chi-squared by noise alone is one per pixel, less if the noise model overestimates the noise.
    let pixels = now.held_out.pixels;
    let excess = before.held_out.chi2 - pixels.min(now.held_out.chi2);
    let mut unknown = 0;
    for (i, f) in found.iter().enumerate() {
        let term = &now.state.terms[own + i];
        let d = term.effect.descriptor();
        let known = !f.id.starts_with("unknown");
        let id = if known {
            f.id.to_string()
        } else {
            unknown += 1;
            format!("unknown-{unknown}")
        };
        let test = tests.get(own + i).and_then(Option::as_ref);
        let mut params = values(model, term, test);
        if let (Some(sigma), Some(first)) = (f.table_sigma, params.first_mut()) {
            first.sigma = sigma;
        }
        // What flats and darks prove is not in doubt for what the scenes leave.
        by_law(&mut params, term, model.lenses(), if f.proved_by_even_light { 0.0 } else { left.of(f) });
        by_depth(model, f.id, &mut params);
        let undetermined =
            if f.table_sigma.is_none() { widen_undetermined(&mut params, term, model.lenses()) } else { false };
        let separate_by = f.ambiguity.first().map(|other| separate(f.id, other.id));
        let mut description = describe(term, &params);
        if undetermined {
            description += " (at the end of what the model can describe: the strength itself is not determined)";
        }
        effects.push(Effect {
            description,
            id,
            known,
            stage: d.stage.part().into(),
            added: true,
            changed: false,
            z: f.z,
            excess_explained: (JudgedOn::of(model.seen) != JudgedOn::Nothing && excess > 3.0 * (2.0 * pixels).sqrt())
                .then(|| (f.held_out_gain / excess).clamp(0.0, 1.0)),
            held_out_gain: f.held_out_gain,
            ambiguity: f.ambiguity.iter().map(|a| a.id.to_string()).collect(),
            overlap: f.ambiguity.iter().map(|a| a.overlap).fold(0.0, f64::max),
            separate_by,
            params,
        });
    }
    effects
}

/// Widens the errors of an effect that acts by depth by what the calibration does not know of depths.
pub(crate) fn by_depth(model: &Model<'_>, id: &str, params: &mut [Value]) {
    if BY_DEPTH.contains(&id) {
        let error = |v: f64| (model.forward.depth_error() * v).hypot(between_planes(model, id, v));
        params.iter_mut().filter(|v| v.sigma > 0.0).for_each(|v| v.sigma = v.sigma.hypot(error(v.value)));
    }
}

/// The parameters of a term with their errors by its test.
pub(crate) fn values(model: &Model<'_>, term: &Term, test: Option<&Test>) -> Vec<Value> {
    let free = term.free(model.lenses());
    let value = |(j, (name, p)): (usize, (String, &Param))| {
        // Parameters that are not fitted have no error; the others are in the order of their columns.
        let column = free.iter().position(|i| *i == j);
        let error = |c: &ndarray::Array2<f64>| {
            let variance = column.and_then(|i| c.get((i, i)).copied()).unwrap_or(0.0);
            p.outer_sigma(p.inner(term.params[j]), variance.max(0.0).sqrt())
        };
        let [sigma, sigma_noise] = test.map_or([0.0; 2], |t| [error(&t.covariance), error(&t.noise)]);
        Value { name, value: term.params[j], sigma, sigma_noise, unit: p.unit.into() }
    };
    term.expanded(model.lenses()).into_iter().enumerate().map(value).collect()
}

/// Widens the errors of an effect's strengths by what its law does not describe. `left` is the share of the excess of
/// chi-squared that the effects leave, beyond noise and calibration: residuals of the size sqrt(left) times those that
/// the effect had made. Laws that differ by so much may differ in their strengths by as much, and in the same direction
/// everywhere, so that no number of pixels averages it.
fn by_law(params: &mut [Value], term: &Term, lenses: usize, left: f64) {
    let expanded = term.expanded(lenses);
    let strengths: Vec<(usize, f64)> = expanded
        .iter()
        .enumerate()
        .filter(|(_, (_, p))| p.is_strength())
        .map(|(i, (_, p))| (i, (term.params[i] - p.off).abs()))
        .collect();
    // A direction in which a displacement is zero is as uncertain as the others.
    let size = |unit: &str| strengths.iter().filter(|(i, _)| params[*i].unit == unit).map(|s| s.1).fold(0.0, f64::max);
    let sizes: Vec<f64> = strengths.iter().map(|(i, _)| size(&params[*i].unit)).collect();
    for ((i, _), size) in strengths.iter().zip(sizes) {
        let v = &mut params[*i];
        if v.sigma > 0.0 {
            v.sigma = v.sigma.hypot(left.sqrt() * size);
        }
    }
}

/// Widens errors of nothing: the frames do not change with a strength at the end of its range, so that they say nothing
/// of how large it is. Returns whether there is such a strength.
fn widen_undetermined(params: &mut [Value], term: &Term, lenses: usize) -> bool {
    let expanded = term.expanded(lenses);
    let mut found = false;
    for (v, (_, p)) in params.iter_mut().zip(&expanded).filter(|(_, (_, p))| p.is_strength()) {
        if v.sigma == 0.0 && v.value != p.off {
            v.sigma = (v.value - p.off).abs();
            found = true;
        }
    }
    found
}

/// A fault of a record in the form of an effect.
pub(crate) fn fault(fault: &Fault) -> Effect {
    let flips = |rows, cols| f64::from(u8::from(rows) + 2 * u8::from(cols));
    let values = match fault.kind {
        FaultKind::Shows { truth_of } => vec![("truth_of", truth_of as f64, "index")],
        FaultKind::Unlike => vec![("unlike", 1.0, "1")],
        FaultKind::Flipped { rows, cols } => vec![("flipped", flips(rows, cols), "1 rows, 2 cols")],
        FaultKind::Exchanged { rows, cols } => vec![("exchanged_and_flipped", flips(rows, cols), "1 rows, 2 cols")],
        FaultKind::Pedestal { level } => vec![("pedestal", level, "unit of the objects")],
        FaultKind::Unit { factor } => vec![("unit_factor", factor, "1")],
        FaultKind::Exposure { factor } => vec![("exposure_factor", factor, "1")],
        FaultKind::Misplaced { row_px, col_px, turn_mrad, scale, .. } => vec![
            ("row_px", row_px, "object px"),
            ("col_px", col_px, "object px"),
            ("turn_mrad", turn_mrad, "mrad"),
            ("scale", scale, "1"),
        ],
        FaultKind::MisplacedOneByOne { rms_px } => vec![("rms_px", rms_px, "object px")],
    };
    let known = |name: &str, value: f64, unit: &str| Value {
        name: name.into(),
        value,
        sigma: 0.0,
        sigma_noise: 0.0,
        unit: unit.into(),
    };
    Effect {
        id: "metadata_fault".into(),
        known: true,
        stage: Stage::Record.part().into(),
        added: true,
        changed: false,
        z: fault.z,
        excess_explained: None,
        held_out_gain: 0.0,
        ambiguity: Vec::new(),
        overlap: 0.0,
        separate_by: None,
        params: std::iter::once(("frame", fault.frame as f64, "index"))
            .chain(values)
            .map(|(name, value, unit)| known(name, value, unit))
            .collect(),
        description: fault.words(),
    }
}

/// Detection limits of all effects of the catalogue that were not added.
/// With `own_beads`, the known frames are the bead frames of the calibration: the PSFs have absorbed what they show, so
/// that they cannot limit what has changed since.
pub(crate) fn rejected(model: &Model<'_>, rest: &[Candidate], now: &Accepted<'_>, own_beads: bool) -> Vec<Rejected> {
    let Accepted { state, found, lost } = now;
    let lenses = model.lenses();
    let mut out = Vec::new();
    for effect in registry() {
        let d = effect.descriptor();
        let added = found.iter().any(|f| f.id == d.id) || state.terms.iter().any(|t| t.id() == d.id);
        if added || d.id.starts_with("unknown") || d.stage == Stage::Record {
            continue;
        }
        let expanded = d.expanded(lenses);
        let Some((name, p)) = expanded.iter().find(|(_, p)| p.is_strength()) else { continue };
        let candidate = rest.iter().find(|c| c.term.id() == d.id);
        // Nobody measures more to learn of truths that are not there.
        if effect.is_of_truths() && candidate.is_none() {
            continue;
        }
        let test = candidate.and_then(|c| c.test.as_ref());
        let first = candidate.and_then(Candidate::first);
        // 95 % of a normal variable lie below 1.645 standard deviations; an estimate with the forbidden sign counts as
        // zero.
        let size = |value: f64| if p.forbidden_side() * value > 0.0 { 0.0 } else { value.abs() };
        let limit = first.map(|f| size(f.value) + 1.645 * f.sigma);
        let [low, off, high] = [p.min, p.off, p.max].map(|v| p.inner(v));
        let absorbed = own_beads && matches!(d.stage, Stage::Object | Stage::Geometry | Stage::Lens);
        let misplaced = lost.contains(&d.id);
        let testable = !absorbed
            && !misplaced
            && limit.is_some_and(|u| u.is_finite() && u < (high - off).abs().max((off - low).abs()));
        // In the unit of the parameter.
        let upper_limit = limit.filter(|_| testable).map(|u| p.outer_sigma(0.0, u));
        out.push(Rejected {
            id: d.id.into(),
            param: name.clone(),
            upper_limit,
            sigma: first.map(|f| p.outer_sigma(0.0, f.sigma)).filter(|_| testable),
            unit: p.unit.into(),
            z: test.map_or(0.0, |t| t.z),
            needs: (!testable).then(|| match found.iter().find(|f| f.ambiguity.iter().any(|a| a.id == d.id)) {
                _ if absorbed => OWN_BEADS.into(),
                _ if misplaced => MISPLACED.into(),
                Some(f) => format!("`{}`, which was found, explains the same; {}", f.id, separate(f.id, d.id)),
                None => needs(d.stage, d.id).into(),
            }),
        });
    }
    out
}

/// What makes an effect of the optics testable where the only known frames are those of the calibration.
const OWN_BEADS: &str = "scenes of known objects, or a bead scan of today: the instrument was calibrated on these bead \
                         frames, so they cannot show what has changed since";

/// What makes an effect testable that a misplaced truth imitates.
const MISPLACED: &str = "a bead scan in a session without truths, or truths of certain place: this session states that \
                         its truths may be misplaced, and a misplaced truth moves the images just as this effect does";

/// The state that was accepted, and the effects in it.
pub(crate) struct Accepted<'a> {
    /// The state.
    pub state: &'a State,
    /// The effects that were added.
    pub found: &'a [Found],
    /// Ids of effects that cannot be tested beside truths of uncertain place.
    pub lost: &'a [&'static str],
}

/// The measurement that makes an effect testable.
fn needs(stage: Stage, id: &str) -> &'static str {
    match (stage, id) {
        (_, id) if BY_DEPTH.contains(&id) => "a bead scan at several depths",
        (_, "stage_backlash") => "a bead scan that turns at the end of each row, in a session without truths",
        (_, "exposure_offset") => "flats at several exposures",
        (_, "dark_current" | "hot_pixels") => "darks at several exposures",
        (_, "prnu" | "dust") => "flats",
        (_, "lag") => "scenes in quick succession, dark after bright",
        (_, "lamp_drift" | "photobleaching" | "black_level_drift") => {
            "frames over a longer time, with time_s in their tables"
        }
        (Stage::Object | Stage::Geometry | Stage::Lens, _) => "scenes of known objects",
        (Stage::Charge | Stage::Electronics, _) => "repeats of darks and flats at several levels",
        _ => "scenes of known objects, and flats",
    }
}

/// The measurement that distinguishes two effects.
fn separate(id: &str, other: &str) -> String {
    let says = |a: &str, b: &str| {
        let d = find(a)?.descriptor();
        d.lookalikes.iter().find(|l| l.id == b).map(|l| l.separate_by.to_string())
    };
    says(id, other).or_else(|| says(other, id)).unwrap_or_else(|| {
        let stage = |id: &str| find(id).map(|e| e.descriptor().stage);
        let hint = match (stage(id), stage(other)) {
            (Some(Stage::Charge | Stage::Electronics), _) | (_, Some(Stage::Charge | Stage::Electronics)) => {
                "repeated flats: effects after the Poisson draw correlate the noise"
            }
            (Some(Stage::Object), _) | (_, Some(Stage::Object)) => {
                "the same specimen at another position: effects of the specimen move with it"
            }
            _ => "more scenes, brighter and of other kinds",
        };
        hint.into()
    })
}

/// Description of an effect with values and errors.
fn describe(term: &Term, params: &[Value]) -> String {
    let d = term.effect.descriptor();
    let index = |i: usize| term.params.get(i).map_or(0, |v| *v as usize);
    match d.id {
        "unknown_operator" => format!(
            "unknown: {} +- {} of {}, {}; acts on light before the Poisson draw; 1 degree of freedom; cause not \
             identified; valid in the measured range of light",
            short(params[0].value),
            short(params[0].sigma),
            OPERATORS.get(index(1)).unwrap_or(&"?"),
            WEIGHTS.get(index(2)).unwrap_or(&"?")
        ),
        "unknown_pattern" => format!(
            "unknown: a factor on the light that is fixed to the sensor, rms {} +- {}, neither smooth over the sensor \
             nor independent from pixel to pixel; measured pixel by pixel; cause not identified; valid for this sensor",
            short(params[0].value),
            short(params[0].sigma)
        ),
        "unknown_dark" => format!(
            "unknown: a dark signal, e-/px/ms, that is fixed to the sensor, rms {} +- {}, the same in darks and in the \
             light; measured pixel by pixel; cause not identified: the glow of the readout amplifier is smooth and \
             brightest at an edge or in a corner; valid for this sensor at this temperature",
            short(params[0].value),
            short(params[0].sigma)
        ),
        "unknown_shading" | "unknown_light" | "unknown_stray" | "unknown_offset" => {
            let what = match d.id {
                "unknown_shading" => "a factor on the light",
                "unknown_light" => "light added, e-/px/ms,",
                "unknown_stray" => "stray light in proportion to the mean light of the frame",
                _ => "an offset, DN,",
            };
            format!(
                "unknown: {what} that is fixed to the sensor and that scenes show, rms {} +- {}; measured on scenes, \
                 smoothed as far as half of them predicts the other half; cause not identified; valid for this sensor \
                 and for specimens",
                short(params[0].value),
                short(params[0].sigma)
            )
        }
        "unknown_view" => format!(
            "unknown: a factor on the light through lens {} alone (the first is 0) that is fixed to the sensor and \
             that scenes show, rms {} +- {}; measured on scenes, smoothed as far as half of them predicts the other \
             half; cause not identified: a droplet, a hair or a scratch near that lens; valid for specimens",
            index(1),
            short(params[0].value),
            short(params[0].sigma)
        ),
        "unknown_gradient" => {
            let of = |y: f64, x: f64| {
                let terms = [y, x, y * y, x * x, y * x];
                params.iter().zip(terms).map(|(v, term)| v.value * term).sum::<f64>()
            };
            let corners = [(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)].map(|(y, x)| short(of(y, x)));
            format!(
                "unknown: a factor on the light that changes slowly over the sensor, by {}, {}, {} and {} in its \
                 corners (first and last column of the first and the last row) relative to its middle; {} degrees of \
                 freedom; cause not identified: a filter, a window or a response that changes over the sensor",
                corners[0],
                corners[1],
                corners[2],
                corners[3],
                params.len()
            )
        }
        "unknown_warp" => {
            let most = params.iter().map(|v| v.value.abs()).fold(0.0, f64::max);
            format!(
                "unknown: the image of each lens is displaced, turned, stretched and sheared by itself, by up to {} px \
                 (at 100 px from its anchor); {} degrees of freedom; cause not identified",
                short(most),
                params.len()
            )
        }
        "unknown_blur" => {
            let (low, high) = params.iter().fold((f64::MAX, f64::MIN), |r, v| (r.0.min(v.value), r.1.max(v.value)));
            format!(
                "unknown: the image of each lens is wider or narrower than in the calibration, variances from {} to {} \
                 px^2; {} degrees of freedom; cause not identified; a defocus or a curved field looks like this, and a \
                 bead scan at several depths distinguishes them from other causes",
                short(low),
                short(high),
                params.len()
            )
        }
        "unknown_scatter" => {
            let all: f64 = params.iter().map(|v| v.value).sum();
            format!(
                "unknown: {} of the light of each point is scattered to places round it, by a law of any form from 3 \
                 to 48 px; {} degrees of freedom; cause not identified; a halo or glare of another law than those of \
                 the catalogue looks like this, and one bright bead, long exposed, shows its law",
                short(all),
                params.len()
            )
        }
        "unknown_profile" => {
            let knots = &params[..KNOTS];
            let (low, high) = knots.iter().fold((f64::MAX, f64::MIN), |r, v| (r.0.min(v.value), r.1.max(v.value)));
            let sigma = knots.iter().map(|v| v.sigma).sum::<f64>() / knots.len() as f64;
            let at = KNOTS;
            let kind = if index(at + 1) == 0 { "a factor on the light" } else { "light added, e-/ms" };
            let periodic = if index(at) == 6 {
                format!(", period {:.2} px", term.params[at + 3] - term.params[at + 2])
            } else {
                String::new()
            };
            format!(
                "unknown: {kind} over {}{periodic}, from {} to {} (each +- {}); {} degrees of freedom; cause not \
                 identified; valid from {} to {} of that quantity only",
                COVARIATES.get(index(at)).unwrap_or(&"?"),
                short(low),
                short(high),
                short(sigma),
                at,
                short(term.params[at + 2]),
                short(term.params[at + 3])
            )
        }
        _ => {
            let values: Vec<String> = params
                .iter()
                .filter(|v| v.sigma > 0.0 && (v.value / v.sigma).abs() > 2.0 || params.len() == 1)
                .take(6)
                .map(|v| format!("{} = {} +- {} {}", v.name, short(v.value), short(v.sigma), v.unit))
                .chain(params.iter().filter(|v| is_moment(v)).map(|v| format!("{} = {} s", v.name, short(v.value))))
                .collect();
            format!("{}: {}", d.summary, values.join(", "))
        }
    }
}

/// Whether a value is a moment in a session, which the search chooses and no fit determines.
fn is_moment(v: &Value) -> bool {
    v.name == MOMENT
}

/// A number with three significant digits.
fn short(v: f64) -> String {
    let size = v.abs();
    if size == 0.0 {
        "0".into()
    } else if (1e-3..1e5).contains(&size) {
        let digits = (2 - size.log10().floor() as i32).max(0) as usize;
        format!("{v:.digits$}")
    } else {
        format!("{v:.2e}")
    }
}
