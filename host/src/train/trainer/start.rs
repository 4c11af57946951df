//! How a run begins: anew, from another run's weights, or where it stopped.

use super::{Task, Trainer, same};
use crate::noise::NoiseModel;
use crate::rng;
use crate::train::adam::Adam;
use crate::train::checkpoint::{Body, Checkpoint};
use crate::train::ops::fourier::Fourier;
use crate::train::{Family, Lenses, Place, Start, Support, TrainConfig, TrainError, regression, weights};
use rand::seq::SliceRandom;
use std::path::Path;
use std::sync::Arc;

/// Fewest pairs that can be divided into training and validation.
const FEWEST: usize = 4;

/// Most held-out frames that a checkpoint keeps, and most pixels of them together.
const CASES: usize = 16;
const CASE_PIXELS: usize = 1 << 22;

impl<'a> Trainer<'a> {
    /// A run from the start.
    ///
    /// # Errors
    /// The configuration makes no sense, there are too few pairs, or a pair does not fit.
    pub fn new(task: Task<'a>, training: TrainConfig) -> Result<Self, TrainError> {
        Self::with_lenses(task, training, None)
    }

    /// A run from the start of a network that knows the calibrated lenses.
    ///
    /// # Errors
    /// As [`Trainer::new`]; or the network needs the lenses and has none.
    pub fn with_lenses(task: Task<'a>, training: TrainConfig, lenses: Option<&'a Lenses>) -> Result<Self, TrainError> {
        task.network.check()?;
        training.check()?;
        let seed = training.seed;
        let current = weights::random(&task.network, seed);
        let body = Body {
            network: task.network.clone(),
            noise: task.noise,
            training,
            curve: Vec::new(),
            best_step: 0,
            step: 0,
            norms: Default::default(),
            support: None,
            slowed: 0,
        };
        let adam = Adam::new(&current);
        let state = Checkpoint {
            body,
            weights: current.clone(),
            maps: task.maps.clone(),
            cases: Vec::new(),
            samples: Vec::new(),
            current,
            adam,
        };
        let mut run = Self::with_state(task, state, lenses)?;
        let kept = (CASE_PIXELS / (run.task.network.frame[0] * run.task.network.frame[1]))
            .clamp(1, CASES)
            .min(run.held_out.len());
        run.state.cases = run.loader().cases(&run.held_out[..kept], "validation", 0)?;
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

    /// A run that starts from the best weights of another, and within its taps: for an instrument that was closed, or for a device.
    ///
    /// # Errors
    /// As [`Trainer::with_lenses`]; or the checkpoint at `path` holds another network.
    pub fn fine_tune(
        task: Task<'a>,
        training: TrainConfig,
        lenses: Option<&'a Lenses>,
        path: &Path,
    ) -> Result<Self, TrainError> {
        let from = Checkpoint::read(path)?;
        if from.body.network != task.network {
            return Err(TrainError::Resume {
                path: path.into(),
                field: "network",
                expected: format!("{:?}", task.network),
                found: format!("{:?}", from.body.network),
            });
        }
        // The start is given: nothing is to be fitted first.
        let mut run = Self::with_lenses(task, TrainConfig { start: Start::Random, ..training }, lenses)?;
        run.state.adam = Adam::new(&from.weights);
        (run.state.weights, run.state.current) = (from.weights.clone(), from.weights);
        Ok(match from.body.support {
            Some(support) => run.within(support),
            None => run,
        })
    }

    /// The same with the filters held to a device's taps from now on.
    #[must_use]
    pub fn within(mut self, support: Support) -> Self {
        self.state.body.support = Some(support);
        self.hold();
        self.state.weights = self.state.current.clone();
        self
    }

    /// Takes up the run that wrote the checkpoint at `path`; the rest of it gives the same bits as if it had never stopped.
    ///
    /// # Errors
    /// As [`Trainer::new`]; the checkpoint cannot be read; or it was made with another network, sensor or settings (more `steps` is no
    /// reason to refuse).
    pub fn resume(task: Task<'a>, training: TrainConfig, path: &Path) -> Result<Self, TrainError> {
        Self::resume_with_lenses(task, training, None, path)
    }

    /// [`Trainer::resume`] of a network that knows the calibrated lenses.
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
        if !body.training.same_but_steps(&training) {
            return differ("training", format!("{training:?}"), format!("{:?}", body.training));
        }
        (state.body.training, state.body.noise) = (training, task.noise);
        let run = Self::with_state(task, state, lenses)?;
        Ok(Self { kept: true, ..run })
    }

    fn with_state(task: Task<'a>, state: Checkpoint, lenses: Option<&'a Lenses>) -> Result<Self, TrainError> {
        let plan = Arc::new(Fourier::new(task.network.fourier()));
        let training = &state.body.training;
        let (family, start) = (&task.network.family, training.start);
        let unfit = |field, expected: &str, found: &str| {
            Err(TrainError::Config { field, expected: expected.into(), found: found.into() })
        };
        if lenses.is_none() && (start == Start::Psf || matches!(family, Family::Cm2Net { .. })) {
            return unfit("instrument", "one whose lenses the network can know", "none");
        }
        match (family, start) {
            (Family::Cm2Net { .. }, Start::Psf | Start::Regression) => {
                return unfit("start", "random, for a CM2Net", "filters");
            }
            (Family::MultiWienerNet | Family::MultiFlatNet, Start::Regression) => {
                return unfit("start", "random or psf, for filters in space", "regression");
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
        Ok(Self {
            task,
            lenses,
            place: Place::Cpu,
            plan,
            train: pairs,
            held_out,
            state,
            kept: false,
            next: None,
            recent: (0.0, 0),
        })
    }
}

fn same_noise(a: &NoiseModel, b: &NoiseModel) -> bool {
    let values = |n: &NoiseModel| [n.black_level_dn, n.gain_dn_per_e, n.read_noise_e, n.saturation_dn];
    values(a).into_iter().zip(values(b)).all(|(a, b)| same(a, b))
}
