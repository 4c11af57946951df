//! Whether the account may name what was found, and how well the closed instrument describes the session.

use super::result::{Effect, Nearest, Verdict};
use crate::evidence::Figures;
use crate::search::{Found, Imitation, NEEDS_CALIBRATION, Shadowed};
use ommatidia_model::instrument::Quality;
use ommatidia_physics::effects::Stage;

/// Names are earned if at most this share of the excess of chi-squared over the noise is left, on held-out data.
const LEFT: f64 = 0.05;
/// A share of the excess counts as left only if it exceeds this many standard deviations of chi-squared.
const SIGMAS: f64 = 5.0;
/// A model whose chi-squared per pixel exceeds one by less is no other model, whatever its excess was before: errors of
/// a calibration reach that size.
const MUCH: f64 = 0.25;
/// Where many foci overlap, the errors of their PSFs cancel in part: this share of the error of one focus is left.
const OVERLAPPING: f64 = 0.5;
/// From this share on most of the excess is left.
const MOST: f64 = 0.5;

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
    pub(crate) fn of([first, _]: [f64; 2], [last, sigma]: [f64; 2], (pixels, by_calibration): (usize, f64)) -> Self {
        let pixels = pixels as f64;
        let beyond = |excess: f64| {
            let all = excess * pixels;
            if all > 0.0 { (all - by_calibration).max(0.0) } else { -all }
        };
        let (first, last) = (beyond(first), beyond(last));
        let noise = SIGMAS * sigma * pixels;
        let left = if last > noise { last / first.max(last) } else { 0.0 };
        Self { left, per_pixel: last / pixels.max(1.0) }
    }

    /// The verdict. `incomplete`: a test sees structure in what is left, or a term without a name stands for it.
    pub(crate) fn verdict(self, incomplete: bool) -> Verdict {
        match (incomplete, self.left > MOST && self.per_pixel > MUCH) {
            (false, _) => Verdict::Adequate,
            (true, false) => Verdict::Incomplete,
            (true, true) => Verdict::NotThisModel,
        }
    }

    /// Nothing counts as left if the last figures are within the error that the calibration showed at bead positions
    /// that it had left out, noise deducted: no effect can predict better than the PSFs are known. Where the noise of
    /// the scenes exceeds that error, it is deducted from their figure too. `alone`: how far the foci of the scenes
    /// stand alone ([`crate::evidence::standing_alone`]).
    pub(crate) fn within_calibration(self, now: Figures, quality: &Quality, alone: f64) -> Self {
        let relative2 = quality.off_grid_excess().powi(2);
        let share = (1.0 - 1.0 / now.chi2_ndf).max(0.0);
        let without_noise2 = now.nrmse.powi(2) * share;
        let within =
            now.nrmse.powi(2) < relative2 || without_noise2 < OVERLAPPING.powi(2).max(alone.min(1.0)) * relative2;
        if within { Self { left: 0.0, ..self } } else { self }
    }

    /// Whether what was found explains enough for its names to stand as causes.
    pub(crate) fn names_are_earned(self, structured: bool) -> bool {
        !(structured && self.left > LEFT)
    }
}

/// Says that the structure which no effect explains may be the calibration's own, where its PSFs are known worse than
/// the noise of its bead frames allows.
pub(crate) fn coarse_calibration(verdict: Verdict, effects: &[Effect], quality: &Quality) -> Option<String> {
    let unexplained = verdict != Verdict::Adequate && effects.is_empty();
    (unexplained && quality.is_coarse()).then(|| {
        format!(
            "nothing was found for the structure that is left, and the calibration itself errs by {:.1} % between its \
             bead positions, noise deducted: the structure may be the calibration's own. A finer bead scan, or a \
             higher rank where `calibrate` says so, distinguishes the two",
            100.0 * quality.off_grid_excess()
        )
    })
}

/// Whether an entry of the account claims a cause in the instrument. With `recalibrated` the PSFs are calibrated again,
/// and the entry that stands for it claims no more than that.
pub(crate) fn claims_a_cause(effect: &Effect, recalibrated: bool) -> bool {
    let new_calibration = recalibrated && effect.id == NEEDS_CALIBRATION;
    effect.known && !new_calibration && effect.stage != Stage::Record.part()
}

/// Effects whose names are not earned, for a reason.
pub(crate) fn unearned(effects: &[Effect], why: &str) -> Vec<Nearest> {
    effects.iter().map(|e| Nearest { id: e.id.clone(), z: e.z, why: why.into() }).collect()
}

/// Effects in the shadow of a stronger one.
pub(crate) fn shadowed(all: &[Shadowed], of: Option<&str>) -> Vec<Nearest> {
    let strongest = match of {
        Some(id) => format!("`{id}`, the strongest effect,"),
        None => "the strongest effect, which was taken back,".into(),
    };
    let one = |s: &Shadowed| Nearest {
        id: s.id.into(),
        z: s.z,
        why: format!(
            "it explains {:.1} % of what {strongest} explains, no more than a small error in the law of that one would \
             leave",
            100.0 * s.share
        ),
    };
    all.iter().filter(|s| !s.id.starts_with("unknown")).map(one).collect()
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

    #[test]
    fn nothing_is_left_within_the_error_of_the_calibration() {
        let quality = Quality { off_grid_error: 0.05, noise_floor: 0.04, ..Quality::default() };
        let left_of = |chi2_ndf, nrmse, alone| {
            let now = Figures { chi2_ndf, nrmse, pcc: 0.99 };
            Excess { left: 0.25, per_pixel: 0.6 }.within_calibration(now, &quality, alone).left
        };
        let left = |chi2_ndf, nrmse| left_of(chi2_ndf, nrmse, 0.1);
        assert_eq!([left(1.6, 0.029), left(1.6, 0.031)], [0.0, 0.25]);
        // A twentieth of the squared residual is no noise: 0.22 of 0.066 is below half of 0.03, of 0.068 above.
        assert_eq!([left(1.0 / 0.95, 0.066), left(1.0 / 0.95, 0.068)], [0.0, 0.25]);
        // Foci that stand alone err in full: 0.8 of the squared 0.03, of which 0.22 of 0.119 is inside.
        assert_eq!([left_of(1.0 / 0.95, 0.119, 0.8), left_of(1.0 / 0.95, 0.121, 0.8)], [0.0, 0.25]);
    }

    #[test]
    fn a_name_needs_most_of_the_excess_only_where_structure_is_left() {
        let of = |left| Excess { left, per_pixel: 1.0 };
        assert!(of(0.3).names_are_earned(false) && of(0.04).names_are_earned(true) && !of(0.1).names_are_earned(true));
        let verdicts = [of(0.9).verdict(false), of(0.1).verdict(true), of(0.9).verdict(true)];
        assert_eq!(verdicts, [Verdict::Adequate, Verdict::Incomplete, Verdict::NotThisModel]);
        assert_eq!(Excess { left: 0.9, per_pixel: 0.1 }.verdict(true), Verdict::Incomplete);
    }

    #[test]
    fn a_coarse_calibration_is_named_where_nothing_explains_the_structure() {
        let coarse = Quality { off_grid_error: 0.05, noise_floor: 0.03, ..Quality::default() };
        let note = |verdict, quality| coarse_calibration(verdict, &[], quality);
        assert!(note(Verdict::Incomplete, &coarse).is_some_and(|text| text.contains("errs by 4.0 %")));
        assert_eq!(note(Verdict::Adequate, &coarse), None);
        let fine = Quality { off_grid_error: 0.035, ..coarse };
        assert_eq!(note(Verdict::Incomplete, &fine), None);
    }
}
