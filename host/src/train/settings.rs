//! How a network is trained, and the presets.

use super::trainer::same;
use super::{Family, FamilyName, NetworkConfig, TrainError};
use serde::{Deserialize, Serialize};

/// One part in this many of the steps is warm-up.
const WARMUP: u64 = 50;

/// Validations in a run.
const VALIDATIONS: u64 = 20;

/// Learning rates of a fine-tuning over those of a training from the start: it begins close to a good solution.
pub const FINE_TUNE_RATE: f64 = 0.3;

/// What the filters are before the first step.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Start {
    /// 0.001 x U[0, 1], as in the paper.
    Random,
    /// The linear filters that fit the training pairs best, one for each part of the field ([`super::regression`]).
    Regression,
    /// Calibrated PSFs, or their pseudo-inverses where filters are learned ([`super::Lenses`]).
    Psf,
}

/// How a network is trained.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrainConfig {
    /// Steps of the optimiser.
    pub steps: u64,
    /// Pairs in a step.
    pub batch: usize,
    /// Highest learning rate of the convolutions.
    pub learning_rate: f64,
    /// Highest learning rate of the filters, whose values are about 0.001.
    pub filter_learning_rate: f64,
    /// The learning rate at the end, as a part of the highest (cosine annealing).
    pub final_rate: f64,
    /// Steps over which the learning rate rises from zero.
    pub warmup: u64,
    /// A gradient longer than this many times its running mean is shortened to that.
    pub clip: f64,
    /// Peak of the expected frame, electrons: drawn evenly in its logarithm between these.
    pub peak_e: [f64; 2],
    /// Steps between validations; each writes a checkpoint.
    pub validate_every: u64,
    /// Part of the pairs that is held out.
    pub held_out: f64,
    /// Most held-out pairs that a validation looks at.
    pub validation_pairs: usize,
    /// Validations without a better one after which a run ends early; 0: never.
    #[serde(default)]
    pub patience: u64,
    /// What the filters are before the first step.
    pub start: Start,
    /// Seed of all that is drawn.
    pub seed: u64,
}

impl TrainConfig {
    /// Checks the values.
    ///
    /// # Errors
    /// A value is out of its range; the error names the field.
    pub fn check(&self) -> Result<(), TrainError> {
        let wrong =
            |field, expected: &str, found: String| Err(TrainError::Config { field, expected: expected.into(), found });
        for (field, n) in [("steps", self.steps), ("batch", self.batch as u64), ("validate_every", self.validate_every)]
        {
            if n == 0 {
                return wrong(field, "1 or more", n.to_string());
            }
        }
        let positive = [
            ("learning_rate", self.learning_rate),
            ("filter_learning_rate", self.filter_learning_rate),
            ("clip", self.clip),
            ("peak_e[0]", self.peak_e[0]),
            ("peak_e[1] - peak_e[0]", self.peak_e[1] - self.peak_e[0]),
        ];
        for (field, v) in positive {
            if !v.is_finite() || v <= 0.0 {
                return wrong(field, "a positive number", v.to_string());
            }
        }
        if !(0.0..=1.0).contains(&self.final_rate) {
            return wrong("final_rate", "0 to 1", self.final_rate.to_string());
        }
        if !(self.held_out > 0.0 && self.held_out < 1.0) {
            return wrong("held_out", "a part between 0 and 1", self.held_out.to_string());
        }
        Ok(())
    }

    /// The same for another number of steps: warm-up and validations keep their parts of it.
    pub fn with_steps(self, steps: u64) -> Self {
        Self { steps, warmup: steps / WARMUP, validate_every: (steps / VALIDATIONS).max(1), ..self }
    }

    /// Whether a run with one can be taken up with the other, which may have another number of `steps`.
    pub fn same_but_steps(&self, other: &Self) -> bool {
        let numbers = |c: &Self| {
            [c.learning_rate, c.filter_learning_rate, c.final_rate, c.clip, c.peak_e[0], c.peak_e[1], c.held_out]
        };
        let counts = |c: &Self| (c.batch, c.warmup, c.validate_every, c.validation_pairs, c.patience, c.start, c.seed);
        counts(self) == counts(other) && numbers(self).into_iter().zip(numbers(other)).all(|(a, b)| same(a, b))
    }

    /// Learning rate at `step` (from 0) as a part of the highest: linear rise, then half a cosine down to `final_rate`.
    pub fn rate(&self, step: u64) -> f64 {
        if step < self.warmup {
            return (step + 1) as f64 / self.warmup as f64;
        }
        let span = self.steps.saturating_sub(self.warmup).max(1);
        let at = ((step - self.warmup) as f64 / span as f64).min(1.0);
        self.final_rate + (1.0 - self.final_rate) * 0.5 * (1.0 + (std::f64::consts::PI * at).cos())
    }
}

/// Sizes and schedules that are known to work.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Preset {
    /// For the demo and the smallest device: minutes on two cores.
    #[default]
    Nano,
    /// Between the two: an hour on a workstation.
    Lite,
    /// The network of the paper: nine filters, 0.18 M parameters behind them, random start, Adam at 5e-5.
    Paper,
}

impl Preset {
    /// The network for frames and objects of these sizes, [rows, cols]. The filter is a power of two that holds both.
    pub fn network(self, frame: [usize; 2], object: [usize; 2]) -> NetworkConfig {
        let longest = frame.iter().chain(&object).copied().max().unwrap_or(1);
        let (channels, width, groups, blocks, reduction) = match self {
            Self::Nano => (6, 16, 2, 1, 8),
            Self::Lite => (9, 24, 2, 2, 12),
            Self::Paper => (9, 32, 2, 3, 16),
        };
        NetworkConfig {
            frame,
            object,
            filter_size: longest.next_power_of_two(),
            channels,
            width,
            groups,
            blocks,
            reduction,
            family: Family::SvFourierNet,
        }
    }

    /// The parts of a CM2Net: features, and residual blocks in each of its two parts. The paper's has 20 blocks of 48; the others take about as many
    /// multiplications a step as the same preset's SV-FourierNet takes seconds' worth of.
    pub fn cm2net(self, network: NetworkConfig) -> NetworkConfig {
        let (width, blocks) = match self {
            Self::Nano => (16, 3),
            Self::Lite => (24, 8),
            Self::Paper => (48, 20),
        };
        NetworkConfig { width, blocks, reduction: 1, ..network }
    }

    /// What another family changes in a schedule: peers that learn in space start from PSFs, and learn them at a rate that suits their size.
    pub fn for_family(training: TrainConfig, family: FamilyName, filter_size: usize) -> TrainConfig {
        let t = filter_size as f64;
        match family {
            FamilyName::SvFourierNet => training,
            FamilyName::Cm2Net => TrainConfig { learning_rate: training.learning_rate / 5.0, ..training },
            // Squares of PSFs sum to 1, so values are about 1/T.
            FamilyName::MultiWienerNet => TrainConfig {
                start: Start::Psf,
                filter_learning_rate: training.filter_learning_rate * 25.6 / t,
                ..training
            },
            // A step in space of size a moves frequencies by about a T.
            FamilyName::MultiFlatNet => {
                TrainConfig { start: Start::Psf, filter_learning_rate: training.filter_learning_rate / t, ..training }
            }
        }
    }

    /// The schedule, for a sensor with this full scale, electrons.
    pub fn training(self, full_scale_e: f64, seed: u64) -> TrainConfig {
        // Few steps are better spent on many small batches at a high rate; the paper's schedule is for 48 hours on a large GPU.
        let batch = if self == Self::Paper { 4 } else { 1 };
        let (steps, learning_rate, filter_learning_rate, start) = match self {
            Self::Nano => (8000, 5e-3, 2e-4, Start::Random),
            Self::Lite => (40_000, 4e-3, 2e-4, Start::Random),
            Self::Paper => (60_000, 5e-5, 5e-5, Start::Random),
        };
        TrainConfig {
            steps,
            batch,
            learning_rate,
            filter_learning_rate,
            final_rate: 0.02,
            warmup: steps / WARMUP,
            clip: 5.0,
            peak_e: [0.05 * full_scale_e, 0.9 * full_scale_e],
            validate_every: (steps / VALIDATIONS).max(1),
            held_out: 0.1,
            validation_pairs: 16,
            patience: 0,
            start,
            seed,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rate_rises_then_falls_by_half_a_cosine() {
        let c = TrainConfig { steps: 110, warmup: 10, final_rate: 0.1, ..Preset::Nano.training(1e4, 1) };
        assert_eq!(c.rate(0), 0.1);
        assert_eq!(c.rate(10), 1.0);
        assert!((c.rate(60) - 0.55).abs() < 1e-12);
        assert!((c.rate(110) - 0.1).abs() < 1e-12);
    }

    #[test]
    fn presets_pass_their_own_checks() -> Result<(), TrainError> {
        for preset in [Preset::Nano, Preset::Lite, Preset::Paper] {
            preset.network([214, 214], [96, 96]).check()?;
            preset.training(1e4, 1).check()?;
        }
        assert_eq!(Preset::Nano.network([214, 200], [96, 96]).filter_size, 256);
        Ok(())
    }

    #[test]
    fn what_cannot_be_is_refused_by_name() {
        let bad = TrainConfig { batch: 0, ..Preset::Nano.training(1e4, 1) };
        assert!(bad.check().is_err_and(|e| e.to_string().starts_with("batch:")));
        let odd = Preset::Nano.network([20, 20], [9, 8]);
        assert!(odd.check().is_err_and(|e| e.to_string().starts_with("object:")));
    }
}
