//! Settings of a training run, and the presets.

use super::{Architecture, ArchitectureName, Loss, NetworkConfig, TrainError};
use clap::ValueEnum;
use ommatidia_physics::effects::EffectSetting;
use serde::{Deserialize, Serialize};

/// Learning rates of fine-tuning relative to those of the first training. Fine-tuning starts near good weights.
pub const FINE_TUNE_RATE: f64 = 0.3;

/// Warm-up takes one step of this many.
const WARMUP: u64 = 50;

/// Number of validations in a run.
const VALIDATIONS: u64 = 20;

/// Filters before the first step; see [`super::regression`] and [`super::Lenses`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Start {
    /// Random: 0.001 x U[0, 1], as in Yang et al. 2024.
    Random,
    /// The linear filters that fit the training pairs best, one for each part of the field.
    Regression,
    /// Calibrated PSFs, or their pseudo-inverses for architectures that learn filters.
    Psf,
}

/// Settings of a training run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrainConfig {
    /// Number of steps of the optimiser.
    pub steps: u64,
    /// Number of pairs in a step.
    pub batch: usize,
    /// Highest learning rate of the convolutions.
    pub learning_rate: f64,
    /// Highest learning rate of the filters, whose values are about 0.001.
    pub filter_learning_rate: f64,
    /// Learning rate at the end relative to the highest (cosine annealing).
    pub final_rate: f64,
    /// Number of steps over which the learning rate rises from 0.
    pub warmup: u64,
    /// Maximum length of a gradient relative to the running mean of its length; longer gradients are shortened.
    pub clip: f64,
    /// Range of the brightest pixel of an expected frame, electrons; drawn uniformly in its logarithm.
    pub peak_e: [f64; 2],
    /// Number of steps between validations; each validation writes a checkpoint.
    pub validate_every: u64,
    /// Fraction of the pairs that is held out for validation.
    pub held_out: f64,
    /// Maximum number of held-out pairs in a validation.
    pub validation_pairs: usize,
    /// Number of validations without better weights after which a run ends early; 0: never.
    #[serde(default)]
    pub patience: u64,
    /// Filters before the first step.
    pub start: Start,
    /// What training makes small.
    #[serde(default)]
    pub loss: Loss,
    /// Effects that half of the simulated pairs have, at their largest strengths; see
    /// [`SimulateConfig::vary`](ommatidia_model::dataset::SimulateConfig::vary).
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub vary: Vec<EffectSetting>,
    /// Seed of all random numbers.
    pub seed: u64,
}

impl TrainConfig {
    /// Checks that every value is in its range.
    ///
    /// # Errors
    /// [`TrainError::Config`] with the name of the first field that is not.
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
            return wrong("held_out", "a fraction between 0 and 1", self.held_out.to_string());
        }
        Ok(())
    }

    /// The same settings for another number of steps, with the default warm-up and distance of validations for it.
    pub fn with_steps(self, steps: u64) -> Self {
        Self { steps, warmup: steps / WARMUP, validate_every: (steps / VALIDATIONS).max(1), ..self }
    }

    /// The settings for fine-tuning: both learning rates are multiplied by [`FINE_TUNE_RATE`].
    #[must_use]
    pub fn for_fine_tuning(self) -> Self {
        Self {
            learning_rate: self.learning_rate * FINE_TUNE_RATE,
            filter_learning_rate: self.filter_learning_rate * FINE_TUNE_RATE,
            ..self
        }
    }

    /// The first setting in which `other` differs, with its value here and there; a run can be resumed where there is
    /// none. The number of steps may differ, with what follows from it: the warm-up and the distance of validations.
    pub fn difference(&self, other: &Self) -> Option<Difference> {
        let numbers = |c: &Self| {
            [
                ("--learning-rate", c.learning_rate),
                ("--filter-learning-rate", c.filter_learning_rate),
                ("final_rate", c.final_rate),
                ("clip", c.clip),
                ("peak_e[0]", c.peak_e[0]),
                ("peak_e[1]", c.peak_e[1]),
                ("held_out", c.held_out),
            ]
        };
        let others = |c: &Self| {
            [
                ("--batch", c.batch.to_string()),
                ("--seed", c.seed.to_string()),
                ("--start", name_of(c.start)),
                ("--loss", name_of(c.loss)),
                ("--patience", c.patience.to_string()),
                ("--vary", list_of(&c.vary)),
                ("validation_pairs", c.validation_pairs.to_string()),
            ]
        };
        let differs = others(self).into_iter().zip(others(other)).find(|(a, b)| a.1 != b.1);
        differs.map(|((setting, here), (_, there))| Difference { setting, here, there }).or_else(|| {
            let ((setting, here), (_, there)) =
                numbers(self).into_iter().zip(numbers(other)).find(|(a, b)| !same(a.1, b.1))?;
            Some(Difference { setting, here: here.to_string(), there: there.to_string() })
        })
    }

    /// Learning rate at `step` (from 0) relative to the highest: linear warm-up, then half a cosine down to
    /// `final_rate` (I. Loshchilov, F. Hutter, arXiv:1608.03983, without restarts).
    ///
    /// ```
    /// use ommatidia_network::train::{Preset, TrainConfig};
    ///
    /// let config = TrainConfig { steps: 110, warmup: 10, final_rate: 0.1, ..Preset::Nano.training(1e4, 1) };
    /// assert_eq!((config.rate(0), config.rate(10)), (0.1, 1.0));
    /// assert!((config.rate(60) - 0.55).abs() < 1e-12);
    /// ```
    pub fn rate(&self, step: u64) -> f64 {
        if step < self.warmup {
            return (step + 1) as f64 / self.warmup as f64;
        }
        let span = self.steps.saturating_sub(self.warmup).max(1);
        let at = ((step - self.warmup) as f64 / span as f64).min(1.0);
        self.final_rate + (1.0 - self.final_rate) * 0.5 * (1.0 + (std::f64::consts::PI * at).cos())
    }
}

/// Network sizes and schedules for common uses.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Preset {
    /// For the demo and the smallest device; trains for minutes on two cores.
    #[default]
    Nano,
    /// Between the two; trains for about an hour on a workstation.
    Lite,
    /// For the best pictures: `nano` with two passes. Needs the instrument, trains for half an hour on two cores, and
    /// takes 1.5 times the memory and 2.6 times the instructions of `nano` on a device.
    Host,
    /// The network of the paper: nine filters, 0.18 M parameters after them, random start, learning rate 5e-5.
    Paper,
}

impl Preset {
    /// The network for frames and objects of these sizes, [rows, cols]. The filter's side is the smallest power of two
    /// that holds both.
    pub fn network(self, frame: [usize; 2], object: [usize; 2]) -> NetworkConfig {
        let longest = frame.iter().chain(&object).copied().max().unwrap_or(1);
        let (channels, width, groups, blocks, reduction) = match self {
            Self::Nano | Self::Host => (6, 16, 2, 1, 8),
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
            architecture: Architecture::SvFourierNet,
            feedback: None,
        }
    }

    /// Number of passes, and number of Richardson-Lucy iterations ahead of the first one, of an SV-FourierNet.
    pub fn feedback(self) -> [usize; 2] {
        match self {
            Self::Host => [2, 0],
            Self::Nano | Self::Lite | Self::Paper => [1, 0],
        }
    }

    /// The same network with the sizes of a CM2Net: feature channels, and residual blocks in each of its two parts. The
    /// published CM2Net has 20 blocks of 48 channels; a step of the smaller ones takes about as long as a step of the
    /// preset's SV-FourierNet.
    pub fn cm2net(self, network: NetworkConfig) -> NetworkConfig {
        let (width, blocks) = match self {
            Self::Nano | Self::Host => (16, 3),
            Self::Lite => (24, 8),
            Self::Paper => (48, 20),
        };
        NetworkConfig { width, blocks, reduction: 1, ..network }
    }

    /// The schedule `training` for another architecture: networks that learn in space start from PSFs, with a filter
    /// learning rate that suits the size of their values.
    pub fn for_architecture(training: TrainConfig, architecture: ArchitectureName, filter_size: usize) -> TrainConfig {
        let t = filter_size as f64;
        match architecture {
            ArchitectureName::SvFourierNet => training,
            ArchitectureName::Cm2Net => TrainConfig { learning_rate: training.learning_rate / 5.0, ..training },
            // The squares of a PSF sum to 1, so its values are about 1/T.
            ArchitectureName::MultiWienerNet => TrainConfig {
                start: Start::Psf,
                filter_learning_rate: training.filter_learning_rate * 25.6 / t,
                ..training
            },
            // A step of size a in space changes the values in frequency by about a T.
            ArchitectureName::MultiFlatNet => {
                TrainConfig { start: Start::Psf, filter_learning_rate: training.filter_learning_rate / t, ..training }
            }
        }
    }

    /// The schedule for a sensor with this full scale, electrons; `seed` draws all random numbers.
    pub fn training(self, full_scale_e: f64, seed: u64) -> TrainConfig {
        // Short trainings gain more from small batches at a high rate; the paper's schedule is for 48 hours on a large
        // GPU.
        let batch = if self == Self::Paper { 4 } else { 1 };
        let (steps, learning_rate, filter_learning_rate, start) = match self {
            Self::Nano => (8000, 2e-3, 2e-4, Start::Random),
            Self::Lite => (40_000, 2e-3, 2e-4, Start::Random),
            Self::Host => (24_000, 2e-3, 2e-4, Start::Random),
            Self::Paper => (60_000, 5e-5, 5e-5, Start::Random),
        };
        let loss = if self == Self::Paper { Loss::BceMse } else { Loss::BceMseNrmse };
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
            loss,
            vary: Vec::new(),
            seed,
        }
    }
}

/// A setting that differs between two runs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Difference {
    /// The option of `train`, or the field where there is no option.
    pub setting: &'static str,
    /// Its value here.
    pub here: String,
    /// Its value there.
    pub there: String,
}

/// Settings of effects as options give them.
fn list_of(effects: &[EffectSetting]) -> String {
    if effects.is_empty() {
        return "none".into();
    }
    effects.iter().map(ToString::to_string).collect::<Vec<_>>().join(" ")
}

/// The name of a value in options.
fn name_of(value: impl ValueEnum) -> String {
    value.to_possible_value().map_or_else(String::new, |v| v.get_name().to_string())
}

/// Whether two numbers agree up to the rounding of writing and reading them as JSON.
pub(super) fn same(a: f64, b: f64) -> bool {
    (a - b).abs() <= 1e-12 * a.abs().max(b.abs())
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
        for preset in [Preset::Nano, Preset::Lite, Preset::Host, Preset::Paper] {
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
