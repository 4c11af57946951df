//! How a run begins: from new weights, from another run's weights, or from its own checkpoint.

use super::{RecentLoss, Trainer, VALIDATION};
use crate::train::adam::Adam;
use crate::train::checkpoint::Checkpoint;
use crate::train::ops::fourier::Fourier;
use crate::train::settings::{Difference, same};
use crate::train::{
    Architecture, Backend, Estimator, FeatureSteps, FilterMask, Lenses, Mode, Predictor, Start, Task, TrainConfig,
    TrainError, regression, weights,
};
use ommatidia_physics::noise::NoiseModel;
use ommatidia_session::rng;
use rand::seq::SliceRandom;
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

/// Smallest number of pairs that can be divided into training and validation.
const FEWEST: usize = 4;

/// Maximum number of held-out frames that a checkpoint keeps, and maximum number of their pixels together.
const CASES: usize = 16;
const CASE_PIXELS: usize = 1 << 22;

/// Number of steps that are timed to turn minutes into steps.
const TIMED: u64 = 8;

impl<'a> Trainer<'a> {
    /// A run with new weights.
    ///
    /// # Errors
    /// The configuration is not valid, a sensor map has another shape than the frames, there are too few pairs, or a
    /// pair does not fit the network.
    pub fn new(task: Task<'a>, training: TrainConfig) -> Result<Self, TrainError> {
        Self::with_lenses(task, training, None)
    }

    /// A run with new weights and calibrated lenses, for networks that start from PSFs or are trained on the view of
    /// each lens.
    ///
    /// # Errors
    /// As [`Trainer::new`]; or the network needs lenses and `lenses` is None.
    pub fn with_lenses(task: Task<'a>, training: TrainConfig, lenses: Option<&'a Lenses>) -> Result<Self, TrainError> {
        task.network.check()?;
        training.check()?;
        let seed = training.seed;
        let mut current = weights::random(&task.network, seed);
        if let (Some(feedback), Some(lenses)) = (&task.network.feedback, lenses) {
            current.extend(lenses.feedback(feedback));
        }
        let untrained = Checkpoint::untrained(task.network.clone(), task.noise, training, current);
        let state = Checkpoint { maps: task.maps.clone(), ..untrained };
        let mut run = Self::with_state(task, state, lenses)?;
        let kept = (CASE_PIXELS / (run.task.network.frame[0] * run.task.network.frame[1]))
            .clamp(1, CASES)
            .min(run.held_out.len());
        run.state.cases = run.loader().cases(&run.held_out[..kept], VALIDATION)?;
        let start = run.state.body.training.start;
        if start != Start::Random {
            let mut fitted = run.state.current.clone();
            match run.lenses {
                Some(lenses) if start == Start::Psf => lenses.start(&run.task.network, &run.plan, &mut fitted)?,
                _ => regression::fit(&run.loader(), &run.train, &mut fitted)?,
            }
            run.state.weights = fitted.clone();
            run.state.current = fitted;
        }
        Ok(run)
    }

    /// A run that starts from the best weights of the checkpoint at `path`, with the filter mask of that checkpoint.
    ///
    /// # Errors
    /// As [`Trainer::with_lenses`]; or the checkpoint cannot be read or holds another network.
    pub fn fine_tune(
        task: Task<'a>,
        training: TrainConfig,
        lenses: Option<&'a Lenses>,
        path: &Path,
    ) -> Result<Self, TrainError> {
        let from = Checkpoint::read(path)?;
        if !from.body.network.learns_as(&task.network) {
            return Err(TrainError::Resume {
                path: path.into(),
                field: "network",
                expected: format!("{:?}", task.network),
                found: format!("{:?}", from.body.network),
            });
        }
        // The weights are given: no start is computed.
        let mut run = Self::with_lenses(task, TrainConfig { start: Start::Random, ..training }, lenses)?;
        // What is calibrated stays that of this run's instrument.
        run.state.current.extend(from.weights.into_iter().filter(|(name, _)| !weights::is_calibrated(name)));
        run.state.weights = run.state.current.clone();
        run.state.adam = Adam::new(&run.state.current);
        Ok(match from.body.filter_mask {
            Some(mask) => run.with_mask(mask),
            None => run,
        })
    }

    /// The same run with the filters limited to a mask, now and after every step.
    #[must_use]
    pub fn with_mask(mut self, mask: FilterMask) -> Self {
        self.state.body.filter_mask = Some(mask);
        self.apply_mask();
        self.state.weights = self.state.current.clone();
        self
    }

    /// The same run with weights and features rounded as in integers of 8 bits, now and in every step; the features to
    /// multiples of `steps`.
    ///
    /// # Errors
    /// There is not one step for each channel, or the network is not one that devices run.
    pub fn with_feature_steps(mut self, steps: FeatureSteps) -> Result<Self, TrainError> {
        self.state.body.feature_steps = Some(steps);
        self.network(Mode::Infer).map(|_| ())?;
        Ok(self)
    }

    /// A new run of the same task with the same settings, whose filters start from calibrated PSFs.
    ///
    /// # Errors
    /// As [`Trainer::with_lenses`].
    pub fn restarted_from_psfs(&self) -> Result<Self, TrainError> {
        let training = TrainConfig { start: Start::Psf, ..self.state.body.training.clone() };
        Self::with_lenses(self.task.clone(), training, self.lenses)
    }

    /// The settings `training` with as many steps as fit into `minutes`, from the time of the first few steps of a
    /// trial run on `device`. The result depends on the machine.
    ///
    /// # Errors
    /// As [`Trainer::with_lenses`] and [`Trainer::step`]; or `minutes` is not a positive number.
    pub fn fit_to_time(
        task: &Task<'a>,
        training: TrainConfig,
        lenses: Option<&'a Lenses>,
        (minutes, device): (f64, Backend),
    ) -> Result<TrainConfig, TrainError> {
        if !(minutes.is_finite() && minutes > 0.0) {
            let (expected, found) = ("a positive number".into(), minutes.to_string());
            return Err(TrainError::Config { field: "--minutes", expected, found });
        }
        let mut trial = Self::with_lenses(task.clone(), training.clone(), lenses)?.on(device);
        // The first step allocates memory and is not timed.
        trial.step()?;
        let start = Instant::now();
        for _ in 0..TIMED {
            trial.step()?;
        }
        let steps = (60.0 * minutes * TIMED as f64 / start.elapsed().as_secs_f64()) as u64;
        Ok(training.with_steps(steps.max(1)))
    }

    /// Resumes the run that wrote the checkpoint at `path`; the result has the same bits as that of an uninterrupted
    /// run.
    ///
    /// # Errors
    /// As [`Trainer::new`]; the checkpoint cannot be read; or it was made with another network, sensor or settings
    /// (another number of `steps` is allowed; warm-up and validations stay those of the checkpoint).
    pub fn resume(task: Task<'a>, training: TrainConfig, path: &Path) -> Result<Self, TrainError> {
        Self::resume_with_lenses(task, training, None, path)
    }

    /// As [`Trainer::resume`], with calibrated lenses as in [`Trainer::with_lenses`].
    ///
    /// # Errors
    /// As [`Trainer::resume`].
    pub fn resume_with_lenses(
        task: Task<'a>,
        training: TrainConfig,
        lenses: Option<&'a Lenses>,
        path: &Path,
    ) -> Result<Self, TrainError> {
        let mut state = Checkpoint::read(path)?;
        let differ = |field, expected: String, found: String| {
            Err(TrainError::Resume { path: path.into(), field, expected, found })
        };
        let body = &state.body;
        if body.network != task.network {
            return differ("network", format!("{:?}", task.network), format!("{:?}", body.network));
        }
        if !same_noise(&body.noise, &task.noise) || state.maps != task.maps {
            return differ("noise", format!("{:?}", task.noise), format!("{:?}", body.noise));
        }
        if let Some(Difference { setting, here, there }) = body.training.difference(&training) {
            return differ(setting, there, here);
        }
        let TrainConfig { warmup, validate_every, .. } = body.training;
        state.body.training = TrainConfig { warmup, validate_every, ..training };
        state.body.noise = task.noise;
        let run = Self::with_state(task, state, lenses)?;
        Ok(Self { kept: true, ..run })
    }

    fn with_state(task: Task<'a>, state: Checkpoint, lenses: Option<&'a Lenses>) -> Result<Self, TrainError> {
        let plan = Arc::new(Fourier::new(task.network.fourier()));
        let training = &state.body.training;
        task.maps.check(task.network.frame)?;
        let (architecture, start) = (&task.network.architecture, training.start);
        let unfit = |field, expected: &str, found: &str| {
            Err(TrainError::Config { field, expected: expected.into(), found: found.into() })
        };
        let needs_lenses = task.network.feedback.is_some() && state.body.step == 0;
        if lenses.is_none()
            && (needs_lenses || start == Start::Psf || matches!(architecture, Architecture::Cm2Net { .. }))
        {
            return unfit("instrument", "an instrument with calibrated lenses", "none");
        }
        match (architecture, start) {
            (Architecture::Cm2Net { .. }, Start::Psf | Start::Regression) => {
                return unfit("start", "random, for a CM2Net", "a start for filters");
            }
            (Architecture::MultiWienerNet | Architecture::MultiFlatNet, Start::Regression) => {
                return unfit("start", "random or psf, for filters learned in space", "regression");
            }
            _ => (),
        }
        let count = task.source.len();
        if count < FEWEST {
            return Err(TrainError::TooFew { expected: FEWEST, found: count });
        }
        let mut pairs: Vec<usize> = (0..count).collect();
        pairs.shuffle(&mut rng::stream(training.seed, "hold out", 0));
        let kept = ((count as f64 * training.held_out).round() as usize).clamp(1, count - 1);
        let mut held_out = pairs.split_off(count - kept);
        held_out.truncate(training.validation_pairs.max(1));
        let predictor = Predictor::of(&task.network, &state.current)?;
        let estimator = predictor.as_ref().and_then(|p| Estimator::of(&task.network, p, &task.noise));
        Ok(Self {
            task,
            lenses,
            predictor,
            estimator,
            backend: Backend::Cpu,
            plan,
            train: pairs,
            held_out,
            state,
            kept: false,
            prepared: BTreeMap::new(),
            recent: RecentLoss::default(),
        })
    }
}

fn same_noise(a: &NoiseModel, b: &NoiseModel) -> bool {
    let values = |n: &NoiseModel| [n.black_level_dn, n.gain_dn_per_e, n.read_noise_e, n.saturation_dn];
    values(a).into_iter().zip(values(b)).all(|(a, b)| same(a, b))
}
