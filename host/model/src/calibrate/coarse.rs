//! The note on PSFs that are known less well between the positions of the scan than the noise allows.

use super::CalibrateConfig;
use crate::instrument::Quality;

/// Share of the squared error between positions from which the number of terms is named as its cause.
const OF_TERMS: f64 = 0.5;

/// The note, where the error on positions that were left out is far from the noise ([`Quality::is_coarse`]).
pub(super) fn note(quality: &Quality, rank: usize, config: &CalibrateConfig) -> Option<String> {
    if !quality.is_coarse() {
        return None;
    }
    let error = quality.off_grid_excess();
    let without_noise2 = quality.approximation_error.powi(2) - quality.noise_floor.powi(2);
    let too_few_terms = without_noise2 > OF_TERMS * error * error;
    let scan = "the PSFs change between positions more than this scan resolves: scan more positions";
    let cause = match (config.one_psf, too_few_terms, config.rank.is_some(), rank >= config.max_rank) {
        (true, ..) => "one PSF stands for the whole field of a lens: calibrate without --one-psf".into(),
        (_, true, true, _) => format!("{rank} terms are too few for the beads themselves: raise --rank"),
        (_, true, false, true) => {
            format!("{rank} terms, the limit, are too few for the beads themselves: raise --max-rank")
        }
        (_, true, false, false) => format!("more than {rank} terms fit noise; {scan}, or more light"),
        (_, false, false, true) => {
            format!("{scan}; the rank is at its limit, {rank}: a larger --max-rank may help too")
        }
        (_, false, ..) => scan.to_string(),
    };
    Some(format!(
        "PSFs between the positions of the scan: the error on positions that were left out is {:.1} %, of which noise \
         makes {:.1} % and the calibration itself {:.1} %; on the beads that were fitted it is {:.1} %; {cause}. Until \
         then `close` will find structure that is the calibration's own",
        100.0 * quality.off_grid_error,
        100.0 * quality.noise_floor,
        100.0 * error,
        100.0 * quality.approximation_error
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(off_grid_error: f64, approximation_error: f64, noise_floor: f64) -> Quality {
        Quality { off_grid_error, approximation_error, noise_floor, ..Quality::default() }
    }

    #[test]
    fn a_note_needs_an_error_beyond_the_noise_and_beyond_two_percent() {
        let config = CalibrateConfig::default();
        // Beyond the noise: 0.03, 0.04 and 0.019; the noise itself is 0.04, 0.03 and 0.001.
        assert_eq!(note(&of(0.05, 0.04, 0.04), 9, &config), None);
        assert_eq!(note(&of(0.019, 0.001, 0.001), 9, &config), None);
        let text = note(&of(0.05, 0.03, 0.03), 9, &config).unwrap_or_default();
        assert!(text.contains("is 5.0 %, of which noise makes 3.0 % and the calibration itself 4.0 %"), "{text}");
    }

    #[test]
    fn the_note_tells_too_few_terms_from_a_scan_that_is_too_coarse() {
        let config = CalibrateConfig::default();
        let text = |approximation, rank, config: &CalibrateConfig| {
            note(&of(0.05, approximation, 0.01), rank, config).unwrap_or_default()
        };
        let limit = config.max_rank;
        let few = text(0.045, limit, &config);
        assert!(few.contains("raise --max-rank") && !few.contains("scan more"), "{few}");
        let coarse = text(0.012, 9, &config);
        assert!(coarse.contains("scan more positions") && !coarse.contains("--max-rank"), "{coarse}");
        let both = text(0.012, limit, &config);
        assert!(both.contains("scan more positions") && both.contains("--max-rank"), "{both}");
        let given = CalibrateConfig { rank: Some(3), ..config };
        assert!(text(0.045, 3, &given).contains("raise --rank"));
        let one = CalibrateConfig { one_psf: true, ..config };
        assert!(text(0.045, 1, &one).contains("without --one-psf"));
    }
}
