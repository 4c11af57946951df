//! Whether the account may name what was found, and how well the closed instrument describes the session.

use super::result::{Effect, Nearest, Verdict};
use crate::evidence::omnibus::significant;
use crate::evidence::{Constancy, Dependence, Figures};
use crate::search::{Found, Imitation, NEEDS_CALIBRATION, SHADOW, Shadowed};
use ommatidia_model::instrument::Quality;
use ommatidia_physics::effects::{Stage, find};

/// Names are earned if at most this share of the excess of chi-squared over the noise is left, on held-out data.
const LEFT: f64 = 0.05;
/// The same where the strength of an effect is shown to be one everywhere: what is left is of another kind then, such
/// as errors of the calibration.
const LEFT_OF_CONSTANT: f64 = 0.6;
/// A share of the excess counts as left only if it exceeds this many standard deviations of chi-squared.
const SIGMAS: f64 = 5.0;
/// The same where a test sees structure in it.
const SIGMAS_SEEN: f64 = 2.0;
/// A model whose chi-squared per pixel exceeds one by less is no other model, whatever its excess was before: errors of
/// a calibration reach that size.
const MUCH: f64 = 0.25;
/// Where many foci overlap, the errors of their PSFs cancel in part: this share of the error of one focus is left.
const OVERLAPPING: f64 = 0.5;
/// From this share on most of the excess is left.
const MOST: f64 = 0.5;

/// Smallest share of what the strongest effect explains that is listed of another one.
const LISTED: f64 = 1e-3;

/// What is left of the excess of chi-squared over the noise on held-out data.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Excess {
    /// Share of the first excess; 0 if what is left is noise.
    pub(crate) left: f64,
    /// What is left a pixel.
    pub(crate) per_pixel: f64,
}

impl Excess {
    /// Compares the last excess per pixel with the first ([`crate::evidence::excess`], with its standard deviation);
    /// less noise than expected is as wrong as more. Of `by_calibration`, the number of pixels and the excess that
    /// errors of the calibration make ([`crate::evidence::excess_by_calibration`]), the latter is explained by no
    /// effect.
    pub(crate) fn of(first: [f64; 2], last: [f64; 2], by_calibration: (usize, f64)) -> Self {
        Self::beyond(SIGMAS, first, last, by_calibration)
    }

    /// As [`Excess::of`], where a test sees structure in what is left: less of it is no noise.
    pub(crate) fn seen(first: [f64; 2], last: [f64; 2], by_calibration: (usize, f64)) -> Self {
        Self::beyond(SIGMAS_SEEN, first, last, by_calibration)
    }

    fn beyond(
        sigmas: f64,
        [first, _]: [f64; 2],
        [last, sigma]: [f64; 2],
        (pixels, by_calibration): (usize, f64),
    ) -> Self {
        let pixels = pixels as f64;
        let beyond = |excess: f64| {
            let all = excess * pixels;
            if all > 0.0 { (all - by_calibration).max(0.0) } else { -all }
        };
        let (first, last) = (beyond(first), beyond(last));
        let noise = sigmas * sigma * pixels;
        let left = if last > noise { last / first.max(last) } else { 0.0 };
        Self { left, per_pixel: last / pixels.max(1.0) }
    }

    /// Whether much is left: more than noise, calibration and the error between its positions make.
    pub(crate) fn is_much(self) -> bool {
        self.left > 0.0 && self.per_pixel > MUCH
    }

    /// The verdict. `structured`: a test sees structure in what is left, or a term without a name stands for it. Where
    /// one or two frames hold all of it, the scatter between frames hides it from the tests; its size does not.
    pub(crate) fn verdict(self, structured: bool) -> Verdict {
        match (structured, self.is_much()) {
            (false, false) => Verdict::Adequate,
            (true, true) if self.left > MOST => Verdict::NotThisModel,
            _ => Verdict::Incomplete,
        }
    }

    /// Nothing counts as left within the error of the calibration ([`within_calibration`]).
    pub(crate) fn beyond_calibration(self, within: bool) -> Self {
        if within { Self { left: 0.0, ..self } } else { self }
    }
}

/// Whether figures are within the error that the calibration showed at bead positions that it had left out, noise
/// deducted: no effect can predict better than the PSFs are known. Where the noise of the scenes exceeds that error, it
/// is deducted from their figure too. `alone`: how far the foci of the scenes stand alone
/// ([`crate::evidence::standing_alone`]); so far they have the error of a bead frame.
pub(crate) fn within_calibration(now: Figures, quality: &Quality, alone: f64) -> bool {
    let alone = alone.min(1.0);
    let relative2 = quality.off_grid_excess().powi(2);
    let share = (1.0 - 1.0 / now.chi2_ndf).max(0.0);
    let without_noise2 = now.nrmse.powi(2) * share;
    let known2 = (OVERLAPPING.powi(2) * relative2).max(alone * quality.bead_error().powi(2));
    now.nrmse.powi(2) < relative2 || without_noise2 < known2
}

/// Share of the excess that is left where structure is left, apart for the data that the figures judge and for even
/// light and the dark.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Left {
    pub(crate) judged: f64,
    pub(crate) even: f64,
    /// Whether that is more than errors of a calibration reach ([`Excess::is_much`]).
    pub(crate) much: bool,
}

impl Left {
    /// What is left of the excess that an effect explains: in flats and darks for what it gained there. A curve of the
    /// camera that its flats prove is not in doubt because the PSFs of the scenes are known badly.
    pub(crate) fn of(self, effect: &Found) -> f64 {
        effect.of_even_light * self.even + (1.0 - effect.of_even_light) * self.judged
    }

    /// Whether the effect explains enough for its name to stand as a cause: nearly all, or a large part of it with a
    /// strength that is shown to be the same everywhere. A calibration that errs leaves structure beside a true effect
    /// too, but not more than calibrations err by. What flats and darks prove, with one strength, needs no more: what
    /// is left of them may be the error of the gain, which a bent response itself makes.
    pub(crate) fn earns(self, effect: &Found, constancy: Constancy) -> bool {
        let left = self.of(effect);
        let much = self.much && effect.of_even_light <= 0.5;
        let proved = effect.proved_by_even_light && constancy.is_even();
        left <= LEFT || proved || !much && left <= LEFT_OF_CONSTANT && constancy.is_shown()
    }
}

/// Says that structure may be the calibration's own: where it is `within` what the calibration itself errs by, or where
/// nothing explains it and the PSFs are known worse than the noise of the bead frames allows.
pub(crate) fn calibration_note(
    (structured, within): (bool, bool),
    verdict: Verdict,
    effects: &[Effect],
    (quality, of_beads): (&Quality, bool),
) -> Option<String> {
    let unexplained = verdict != Verdict::Adequate && effects.is_empty();
    let distinguishes = "A finer bead scan, or a higher rank where `calibrate` says so, distinguishes the two";
    if structured && within && of_beads {
        return Some(format!(
            "a test sees structure in what is left. It is no larger than what the calibration itself errs by in the \
             frame of a bead ({:.1} %, noise deducted), so it counts as the calibration's own",
            100.0 * quality.bead_error()
        ));
    }
    let errs = 100.0 * quality.off_grid_excess();
    if structured && within {
        return Some(format!(
            "a test sees structure in what is left. It is no larger than what the calibration itself errs by between \
             its bead positions ({errs:.1} %, noise deducted), so it counts as the calibration's own. {distinguishes}"
        ));
    }
    (unexplained && quality.is_coarse()).then(|| {
        format!(
            "nothing was found for the structure that is left, and the calibration itself errs by {errs:.1} % between \
             its bead positions, noise deducted: the structure may be the calibration's own. {distinguishes}"
        )
    })
}

/// Says how large what is left is, and what it shows itself against, where nothing was found for it and it is no more
/// than errors of a calibration reach.
pub(crate) fn small_note(
    dependences: &[Dependence],
    verdict: Verdict,
    effects: &[Effect],
    now: Figures,
) -> Option<String> {
    let small = now.chi2_ndf > 1.0 && now.chi2_ndf < 1.0 + MUCH;
    let strongest = significant(dependences).max_by(|a, b| a.z.total_cmp(&b.z))?;
    (verdict == Verdict::Incomplete && effects.is_empty() && small).then(|| {
        format!(
            "nothing was found for the structure that is left, which is small: {:.2} % of the light, noise deducted, \
             and seen best against {} (z = {:.1}). PSFs that err by so much leave as much. A new bead scan with more \
             light, calibrated again, shows whether it is the calibration's own",
            100.0 * now.nrmse * (1.0 - 1.0 / now.chi2_ndf).sqrt(),
            strongest.covariate.words(),
            strongest.z
        )
    })
}

/// The verdict where the frames have much less noise than the calibration: that of another mode of the camera, which no
/// structure shows; and the sentence that says so. Effects of the noise that were found say it themselves.
pub(crate) fn quiet(verdict: Verdict, after: Figures, effects: &[Effect]) -> (Verdict, Option<String>) {
    let is_said = effects.iter().any(|e| find(&e.id).is_some_and(|effect| effect.noise_only()));
    let is_quiet = after.chi2_ndf < 1.0 - MUCH;
    if verdict != Verdict::Adequate || is_said || !is_quiet {
        return (verdict, None);
    }
    let note = format!(
        "the frames scatter less about the model than the noise of the calibration allows (chi-squared per pixel \
         {:.3}): another gain or bit depth of the camera, frames that were averaged or smoothed, or a gain of the \
         calibration that is too large",
        after.chi2_ndf
    );
    (Verdict::Incomplete, Some(note))
}

/// Whether an entry of the account claims a cause in the instrument. With `recalibrated` the PSFs are calibrated again,
/// and the entry that stands for it claims no more than that.
pub(crate) fn claims_a_cause(effect: &Effect, recalibrated: bool) -> bool {
    let new_calibration = recalibrated && effect.id == NEEDS_CALIBRATION;
    effect.known && !new_calibration && effect.stage != Stage::Record.part()
}

/// Effects in the shadow of a stronger one.
pub(crate) fn shadowed(all: &[Shadowed], of: Option<&str>) -> Vec<Nearest> {
    let strongest = match of {
        Some(id) => format!("`{id}`, the strongest effect,"),
        None => "the strongest effect, which was taken back,".into(),
    };
    let one = |s: &Shadowed| {
        let why = if s.share < SHADOW {
            format!(
                "it explains {:.1} % of what {strongest} explains, no more than a small error in the law of that one \
                 would leave",
                100.0 * s.share
            )
        } else {
            format!(
                "it explains less than {:.0} % of what nothing explains: an error of the calibration may look like it",
                100.0 * SHADOW
            )
        };
        Nearest { id: s.id.into(), z: s.z, why }
    };
    all.iter().filter(|s| !s.id.starts_with("unknown") && s.share >= LISTED).map(one).collect()
}

/// Effects that made the prediction of held-out data worse.
pub(crate) fn harmful(all: &[Found]) -> Vec<Nearest> {
    let why = "with it, held-out data were predicted worse than without";
    let named = all.iter().filter(|f| !f.id.starts_with("unknown"));
    named.map(|f| Nearest { id: f.id.into(), z: f.z, why: why.into() }).collect()
}

/// Effects that a term without a name makes unnecessary.
pub(crate) fn imitated(all: &[Imitation]) -> Vec<Nearest> {
    let one = |it: &Imitation| Nearest {
        id: it.found.id.into(),
        z: it.found.z,
        why: format!(
            "a term without a name explains the data as well: without this effect {:.1} % of the improvement is lost",
            100.0 * it.lost
        ),
    };
    all.iter().filter(|it| !it.found.id.starts_with("unknown")).map(one).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evidence::{Covariate, Spread};

    #[test]
    fn frames_with_less_noise_than_the_calibration_are_not_described_by_it() {
        let of = |chi2_ndf| quiet(Verdict::Adequate, Figures { chi2_ndf, nrmse: 0.02, pcc: 0.99 }, &[]);
        assert_eq!(of(0.9), (Verdict::Adequate, None));
        assert_eq!(of(f64::NAN), (Verdict::Adequate, None));
        let (verdict, note) = of(0.68);
        assert!(verdict == Verdict::Incomplete && note.is_some_and(|note| note.contains("0.680")));
    }

    #[test]
    fn nothing_is_left_within_the_error_of_the_calibration() {
        let quality = Quality { off_grid_error: 0.05, noise_floor: 0.04, ..Quality::default() };
        let left_of = |chi2_ndf, nrmse, alone| {
            let now = Figures { chi2_ndf, nrmse, pcc: 0.99 };
            Excess { left: 0.25, per_pixel: 0.6 }.beyond_calibration(within_calibration(now, &quality, alone)).left
        };
        let left = |chi2_ndf, nrmse| left_of(chi2_ndf, nrmse, 0.1);
        assert_eq!([left(1.6, 0.029), left(1.6, 0.031)], [0.0, 0.25]);
        // A twentieth of the squared residual is no noise: 0.22 of 0.066 is below half of 0.03, of 0.068 above.
        assert_eq!([left(1.0 / 0.95, 0.066), left(1.0 / 0.95, 0.068)], [0.0, 0.25]);
        // Foci that stand alone err in full: 0.8 of the squared 0.03, of which 0.22 of 0.119 is inside.
        assert_eq!([left_of(1.0 / 0.95, 0.119, 0.8), left_of(1.0 / 0.95, 0.121, 0.8)], [0.0, 0.25]);
    }

    #[test]
    fn a_name_needs_most_of_the_excess_where_its_evidence_lies() {
        let found = |of_even_light| Found {
            id: "camera_gamma",
            z: 9.0,
            held_out_gain: 1e3,
            of_even_light,
            proved_by_even_light: false,
            ambiguity: Vec::new(),
            table_sigma: None,
        };
        let earns = |judged, even, share| Left { judged, even, much: false }.earns(&found(share), Constancy::default());
        assert!(earns(0.04, 0.3, 0.0) && !earns(0.3, 0.0, 0.0) && !earns(0.1, 0.0, 0.4));
        assert!(earns(0.3, 0.01, 1.0) && earns(0.3, 0.0, 0.9) && !earns(0.0, 0.3, 1.0));
        let even = Spread { tau: 0.0, z: 0.5, resolution: 0.03 };
        let constant = Constancy { frames: even, blocks: even, light: 0.0 };
        let of_constant = |left, much| Left { judged: left, even: 0.0, much }.earns(&found(0.0), constant);
        assert!(of_constant(0.5, false) && !of_constant(0.7, false));
        // Errors of a calibration do not reach that far.
        assert!(!of_constant(0.5, true) && of_constant(0.04, true));
        let proved = Found { proved_by_even_light: true, ..found(0.9) };
        let all_left = Left { judged: 1.0, even: 1.0, much: true };
        assert!(all_left.earns(&proved, constant) && !all_left.earns(&proved, Constancy::default()));
        let of = |left| Excess { left, per_pixel: 1.0 };
        let verdicts = [of(0.0).verdict(false), of(0.9).verdict(false), of(0.1).verdict(true), of(0.9).verdict(true)];
        let incomplete = Verdict::Incomplete;
        assert_eq!(verdicts, [Verdict::Adequate, incomplete, incomplete, Verdict::NotThisModel]);
        let little = Excess { left: 0.9, per_pixel: 0.1 };
        assert_eq!([little.verdict(true), little.verdict(false)], [Verdict::Incomplete, Verdict::Adequate]);
    }

    #[test]
    fn what_is_small_and_unexplained_is_said_with_its_size() {
        let shown = |z| Dependence {
            covariate: Covariate::Sharpness,
            chi2: 81.0,
            expected: 15.0,
            z,
            p: 1e-18,
            size: Some(2e-3),
            at: Vec::new(),
            mean: Vec::new(),
            band: Vec::new(),
        };
        let now = |chi2_ndf| Figures { chi2_ndf, nrmse: 0.05, pcc: 0.99 };
        let note = |chi2_ndf, verdict| small_note(&[shown(8.7)], verdict, &[], now(chi2_ndf));
        // A twentieth of the squared residual is no noise: 0.22 of 5 %.
        let text = note(1.0 / 0.95, Verdict::Incomplete);
        assert!(text.as_ref().is_some_and(|t| t.contains("1.12 % of the light") && t.contains("z = 8.7")), "{text:?}");
        assert_eq!([note(1.5, Verdict::Incomplete), note(1.05, Verdict::Adequate)], [None, None]);
        assert_eq!(small_note(&[], Verdict::Incomplete, &[], now(1.05)), None);
    }

    #[test]
    fn a_coarse_calibration_is_named_where_nothing_explains_the_structure() {
        let coarse = Quality { off_grid_error: 0.05, noise_floor: 0.03, ..Quality::default() };
        let note = |verdict, quality| calibration_note((true, false), verdict, &[], (quality, false));
        assert!(note(Verdict::Incomplete, &coarse).is_some_and(|text| text.contains("errs by 4.0 %")));
        assert_eq!(note(Verdict::Adequate, &coarse), None);
        let fine = Quality { off_grid_error: 0.035, ..coarse };
        assert_eq!(note(Verdict::Incomplete, &fine), None);
        let within = calibration_note((true, true), Verdict::Adequate, &[], (&fine, false));
        assert!(within.is_some_and(|text| text.contains("1.8 %")));
        let sharp = Quality { frame_error: 0.023, ..fine.clone() };
        let of_beads = calibration_note((true, true), Verdict::Adequate, &[], (&sharp, true));
        assert!(of_beads.is_some_and(|text| text.contains("in the frame of a bead (2.3 %")));
        assert_eq!(calibration_note((false, true), Verdict::Adequate, &[], (&fine, false)), None);
    }
}
