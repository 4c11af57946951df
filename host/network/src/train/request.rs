//! From what a user asks for to the shape of a network and the settings of its training.

use super::{Architecture, ArchitectureName, Lenses, Loss, NetworkConfig, Preset, Start, TrainConfig, TrainError};

/// Terms of each lens that predict frames between passes.
const TERMS: usize = 4;

/// What a user asks of a training run. None stands for the value of the preset.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TrainRequest {
    /// Preset of sizes and schedule.
    pub preset: Preset,
    /// Architecture of the network.
    pub architecture: ArchitectureName,
    /// Number of filters.
    pub filters: Option<usize>,
    /// Number of passes.
    pub passes: Option<usize>,
    /// Number of Richardson-Lucy iterations ahead of the first pass.
    pub iterations: Option<usize>,
    /// Number of steps; warm-up and validations follow it.
    pub steps: Option<u64>,
    /// Number of pairs in a step.
    pub batch: Option<usize>,
    /// Highest learning rate of the convolutions.
    pub learning_rate: Option<f64>,
    /// Highest learning rate of the filters.
    pub filter_learning_rate: Option<f64>,
    /// Filters before the first step.
    pub start: Option<Start>,
    /// What training makes small.
    pub loss: Option<Loss>,
    /// Number of validations without better weights after which the run ends early.
    pub patience: Option<u64>,
    /// Whether the run starts from trained weights: learning rates are lower then, and no start is computed.
    pub fine_tuning: bool,
    /// Seed of all random numbers.
    pub seed: u64,
}

impl TrainRequest {
    /// The network for frames and objects of these sizes, [rows, cols].
    ///
    /// # Errors
    /// [`TrainError::Config`]: a CM2Net is asked for without `lenses`, whose views it crops, or passes or iterations
    /// without `lenses`, whose PSFs predict frames; or passes or iterations of another architecture.
    pub fn network(
        &self,
        frame: [usize; 2],
        object: [usize; 2],
        lenses: Option<&Lenses>,
    ) -> Result<NetworkConfig, TrainError> {
        let preset = self.preset.network(frame, object);
        let network = NetworkConfig { channels: self.filters.unwrap_or(preset.channels), ..preset };
        let of_preset = match self.architecture {
            ArchitectureName::SvFourierNet => self.preset.feedback(),
            _ => [1, 0],
        };
        let passes = self.passes.unwrap_or(of_preset[0]);
        let iterations = self.iterations.unwrap_or(of_preset[1]);
        if self.architecture != ArchitectureName::SvFourierNet {
            let wrong = |field, expected: &str, found: usize| {
                Err(TrainError::Config { field, expected: expected.into(), found: found.to_string() })
            };
            if passes > 1 {
                return wrong("--passes", "1 for this network", passes);
            }
            if iterations > 0 {
                return wrong("--richardson-lucy", "0 for this network", iterations);
            }
        }
        Ok(match self.architecture {
            ArchitectureName::SvFourierNet => match (passes, iterations, lenses) {
                (0 | 1, 0, _) => network,
                (passes, iterations, Some(lenses)) => lenses.with_feedback(network, [passes, iterations], TERMS),
                (_, _, None) => {
                    let field = match (self.passes, self.iterations) {
                        (Some(2..), _) => "--passes",
                        (_, Some(1..)) => "--richardson-lucy",
                        _ => "--preset host",
                    };
                    let expected = "--instrument FILE, whose PSFs predict frames".into();
                    return Err(TrainError::Config { field, expected, found: "none".into() });
                }
            },
            ArchitectureName::MultiWienerNet => NetworkConfig { architecture: Architecture::MultiWienerNet, ..network },
            ArchitectureName::MultiFlatNet => NetworkConfig { architecture: Architecture::MultiFlatNet, ..network },
            ArchitectureName::Cm2Net => {
                let lenses = lenses.ok_or_else(|| TrainError::Config {
                    field: "--network cm2net",
                    expected: "--instrument FILE, whose lenses it crops".into(),
                    found: "none".into(),
                })?;
                self.preset.cm2net(lenses.cm2net(network))
            }
        })
    }

    /// The settings for training `network` with frames whose brightest pixels lie between the two `peak_e`, on a sensor
    /// with the full scale `full_scale_e`; both electrons.
    pub fn training(&self, network: &NetworkConfig, full_scale_e: f64, peak_e: [f64; 2]) -> TrainConfig {
        let preset = self.preset.training(full_scale_e, self.seed);
        let mut training = Preset::for_architecture(preset, self.architecture, network.filter_size);
        training.peak_e = peak_e;
        if let Some(steps) = self.steps {
            training = training.with_steps(steps);
        }
        if self.fine_tuning {
            training = TrainConfig { start: Start::Random, ..training.for_fine_tuning() };
        }
        TrainConfig {
            batch: self.batch.unwrap_or(training.batch),
            learning_rate: self.learning_rate.unwrap_or(training.learning_rate),
            filter_learning_rate: self.filter_learning_rate.unwrap_or(training.filter_learning_rate),
            start: self.start.unwrap_or(training.start),
            loss: self.loss.unwrap_or(training.loss),
            patience: self.patience.unwrap_or(training.patience),
            ..training
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::train::FINE_TUNE_RATE;

    #[test]
    fn what_is_asked_for_wins_over_the_preset() {
        let request = TrainRequest { steps: Some(100), batch: Some(3), filters: Some(2), ..TrainRequest::default() };
        let network = request.network([40, 40], [16, 16], None).unwrap();
        let training = request.training(&network, 1e4, [10.0, 20.0]);
        assert_eq!((network.channels, training.steps, training.batch, training.warmup), (2, 100, 3, 2));
        assert_eq!(training.peak_e, [10.0, 20.0]);
    }

    #[test]
    fn fine_tuning_lowers_the_rates_that_were_not_asked_for() {
        let request = TrainRequest { fine_tuning: true, learning_rate: Some(1.0), ..TrainRequest::default() };
        let network = request.network([40, 40], [16, 16], None).unwrap();
        let training = request.training(&network, 1e4, [10.0, 20.0]);
        let preset = Preset::Nano.training(1e4, 0);
        assert_eq!(training.learning_rate, 1.0);
        assert_eq!(training.filter_learning_rate, FINE_TUNE_RATE * preset.filter_learning_rate);
    }

    #[test]
    fn estimates_need_lenses_and_filters() {
        let request = TrainRequest { iterations: Some(5), ..TrainRequest::default() };
        let error = request.network([40, 40], [16, 16], None).unwrap_err().to_string();
        assert!(error.contains("--richardson-lucy") && error.contains("--instrument"), "{error}");
        let host = TrainRequest { preset: Preset::Host, ..TrainRequest::default() };
        let error = host.network([40, 40], [16, 16], None).unwrap_err().to_string();
        assert!(error.contains("--preset host") && error.contains("--instrument"), "{error}");
        let request = TrainRequest { architecture: ArchitectureName::MultiWienerNet, ..request };
        let error = request.network([40, 40], [16, 16], None).unwrap_err().to_string();
        assert!(error.contains("--richardson-lucy: expected 0"), "{error}");
    }

    #[test]
    fn a_cm2net_without_lenses_is_refused() {
        let request = TrainRequest { architecture: ArchitectureName::Cm2Net, ..TrainRequest::default() };
        let error = request.network([40, 40], [16, 16], None).unwrap_err().to_string();
        assert!(error.contains("--instrument"), "{error}");
    }
}
