//! From training pairs to what one step of training uses.

use super::ops::fourier::Fourier;
use super::{Architecture, Estimator, Lenses, NetworkConfig, NetworkInput, Task, TrainError, normalise};
use ndarray::{Array2, ArrayView2};
use ommatidia_model::metrics::Case;
use ommatidia_physics::noise::{NoiseModel, draw_electrons};
use ommatidia_session::rng;
use rand::{Rng, RngExt};
use rayon::prelude::*;

/// One training example: the input of the network and its targets.
#[derive(Clone, Debug)]
pub struct Example {
    /// The normalised frame.
    pub input: NetworkInput,
    /// Object divided by its maximum, in C order, [object rows * object cols].
    pub target: Vec<f32>,
    /// Target of each lens alone, for a CM2Net with calibrated lenses; see [`Lenses::views`].
    pub views: Option<Vec<f32>>,
}

/// What names the random numbers of a set of examples: the same names give the same examples.
#[derive(Clone, Copy, Debug)]
pub struct Draw<'a> {
    /// Purpose of the examples, such as `train`.
    pub name: &'a str,
    /// Index of the set, such as the step.
    pub index: u64,
}

/// Makes examples of training pairs: draws the photon budget and the noise, corrects, normalises, transforms.
#[derive(Clone, Copy, Debug)]
pub struct Loader<'a> {
    /// Pairs, network, noise and sensor maps.
    pub task: &'a Task<'a>,
    /// Plan of the Fourier transforms.
    pub plan: &'a Fourier,
    /// Range of the brightest pixel of a frame, electrons; drawn uniformly in its logarithm.
    peak_e: [f64; 2],
    seed: u64,
    lenses: Option<&'a Lenses>,
    estimator: Option<&'a Estimator>,
}

impl<'a> Loader<'a> {
    /// Examples of the pairs of `task`, with brightest pixels between the two `peak_e`, electrons; `seed` draws noise
    /// and brightness.
    pub fn new(task: &'a Task<'a>, plan: &'a Fourier, peak_e: [f64; 2], seed: u64) -> Self {
        Self { task, plan, peak_e, seed, lenses: None, estimator: None }
    }

    /// The same examples with the targets of each lens, where the network is a CM2Net.
    #[must_use]
    pub fn with_lenses(self, lenses: Option<&'a Lenses>) -> Self {
        Self { lenses, ..self }
    }

    /// The same examples with what the network's estimator finds, where it has one.
    #[must_use]
    pub fn with_estimator(self, estimator: Option<&'a Estimator>) -> Self {
        Self { estimator, ..self }
    }

    /// Shape of the network.
    pub fn network(&self) -> &'a NetworkConfig {
        &self.task.network
    }

    /// Examples of the given pairs.
    ///
    /// # Errors
    /// A pair cannot be loaded, has the wrong shape, holds no light, or holds values that are not finite.
    pub fn examples(&self, pairs: &[usize], draw: Draw<'_>) -> Result<Vec<Example>, TrainError> {
        let one = |(i, &pair): (usize, &usize)| {
            let Simulated { mut light_dn, target } = self.simulate(pair, &mut self.stream(pairs.len(), i, draw))?;
            self.task.maps.correct(light_dn.view_mut());
            let frame = normalise(light_dn.as_slice().unwrap_or_default());
            let input = NetworkInput::of(self.network(), self.plan, &frame);
            let input = match self.estimator {
                Some(estimator) => input.with_estimate(estimator.estimate(light_dn.view())),
                None => input,
            };
            Ok(Example { input, views: self.views(pair, &target)?, target })
        };
        pairs.par_iter().enumerate().map(one).collect()
    }

    fn views(&self, index: usize, target: &[f32]) -> Result<Option<Vec<f32>>, TrainError> {
        let (Architecture::Cm2Net { .. }, Some(lenses)) = (&self.network().architecture, self.lenses) else {
            return Ok(None);
        };
        let [rows, cols] = self.network().object;
        let object =
            ArrayView2::from_shape((rows, cols), target).unwrap_or_else(|_| unreachable!("`simulate` checked it"));
        lenses.views(object).map(Some).map_err(|source| TrainError::Source { index, source: source.into() })
    }

    /// The same frames as the sensor delivers them, DN, [frame rows, frame cols], with their targets as truths.
    ///
    /// # Errors
    /// As [`Loader::examples`].
    pub fn cases(&self, pairs: &[usize], draw: Draw<'_>) -> Result<Vec<Case>, TrainError> {
        let black = self.task.noise.black_level_dn as f32;
        let one = |(i, &pair): (usize, &usize)| {
            let Simulated { light_dn, target } = self.simulate(pair, &mut self.stream(pairs.len(), i, draw))?;
            Ok(Case { frame_dn: light_dn.mapv(|v| v + black), truth: image(self.network().object, target) })
        };
        pairs.par_iter().enumerate().map(one).collect()
    }

    fn stream(&self, count: usize, i: usize, draw: Draw<'_>) -> impl Rng + use<> {
        rng::stream(self.seed, draw.name, draw.index * count as u64 + i as u64)
    }

    fn simulate(&self, index: usize, rng: &mut impl Rng) -> Result<Simulated, TrainError> {
        let Task { source, network, noise, maps } = self.task;
        let pair = source.pair(index).map_err(|source| TrainError::Source { index, source })?;
        let [object, expected] = [("object", &pair.object, network.object), ("frame", &pair.expected_e, network.frame)]
            .map(|(what, image, size)| check(index, what, image.view(), size));
        let (bright, peak) = (object?, expected?);
        let [low, high] = self.peak_e.map(f64::ln);
        let scale = ((low + (high - low) * rng.random::<f64>()).exp() / f64::from(peak)) as f32;
        let mut electrons: Vec<f32> = pair.expected_e.iter().map(|&e| e * scale).collect();
        draw_electrons(&mut electrons, noise.read_noise_e as f32, rng);
        let offset = maps.offset_dn.as_ref().and_then(|map| map.as_slice());
        Ok(Simulated {
            light_dn: image(network.frame, digitise(&electrons, noise, offset)),
            target: pair.object.iter().map(|&v| v / bright).collect(),
        })
    }
}

/// A simulated frame and its target.
struct Simulated {
    /// DN above black, not corrected, [frame rows, frame cols].
    light_dn: Array2<f32>,
    /// Object divided by its maximum, in C order.
    target: Vec<f32>,
}

/// An image of `size` [rows, cols] from its values in C order; their number must be right.
fn image(size: [usize; 2], values: Vec<f32>) -> Array2<f32> {
    Array2::from_shape_vec((size[0], size[1]), values).unwrap_or_default()
}

/// The analogue-to-digital converter: electrons to DN above black, with the offset of each pixel. Codes are whole
/// numbers within the range of the converter.
fn digitise(electrons: &[f32], noise: &NoiseModel, offset_dn: Option<&[f32]>) -> Vec<f32> {
    let (gain, black, top) = (noise.gain_dn_per_e as f32, noise.black_level_dn as f32, noise.saturation_dn as f32);
    let offset = |p: usize| offset_dn.map_or(0.0, |map| map[p]);
    let code = |(p, &e): (usize, &f32)| (black + offset(p) + gain * e).round().clamp(0.0, top) - black;
    electrons.iter().enumerate().map(code).collect()
}

/// Checks the shape and the values of one image of a pair; returns its maximum, which is above 0.
fn check(index: usize, what: &'static str, image: ArrayView2<'_, f32>, size: [usize; 2]) -> Result<f32, TrainError> {
    let wrong = |expected: String, found: String| Err(TrainError::Pair { index, what, expected, found });
    if image.dim() != (size[0], size[1]) {
        return wrong(format!("{} x {} pixels", size[0], size[1]), format!("{} x {}", image.nrows(), image.ncols()));
    }
    if let Some(v) = image.iter().find(|v| !v.is_finite()) {
        return wrong("finite values".into(), v.to_string());
    }
    let max = image.iter().copied().fold(0.0, f32::max);
    if max > 0.0 { Ok(max) } else { wrong("at least one pixel above 0".into(), "none".into()) }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::super::ops::fourier::Spectrum;
    use super::super::testing::foci;
    use super::*;
    use crate::train::{Pair, Preset};
    use ommatidia_physics::noise::NoiseModel;
    use ommatidia_physics::sensor::SensorMaps;

    fn task<'a>(source: &'a Vec<Pair>, maps: &SensorMaps) -> Task<'a> {
        Task {
            source,
            network: Preset::Nano.network([40, 40], [16, 16]),
            noise: NoiseModel::nominal(),
            maps: maps.clone(),
        }
    }

    const fn draw(name: &str, index: u64) -> Draw<'_> {
        Draw { name, index }
    }

    #[test]
    fn the_same_draw_gives_the_same_example_and_another_does_not() {
        let pairs = foci(2, 40, 16, 10);
        let task = task(&pairs, &SensorMaps::default());
        let plan = Fourier::new(task.network.fourier());
        let loader = Loader::new(&task, &plan, [500.0, 5000.0], 3);
        let a = loader.examples(&[0, 1], draw("train", 4)).unwrap();
        let b = loader.examples(&[0, 1], draw("train", 4)).unwrap();
        let c = loader.examples(&[0, 1], draw("train", 5)).unwrap();
        assert_eq!(a[1].input, b[1].input);
        assert_ne!(a[1].input, c[1].input);
        assert_eq!(a[0].target.iter().copied().fold(0.0, f32::max), 1.0);
    }

    #[test]
    fn a_pair_that_does_not_fit_is_refused_by_its_number() {
        let mut pairs = foci(2, 40, 16, 10);
        pairs[1].expected_e[[3, 3]] = f32::NAN;
        let task = task(&pairs, &SensorMaps::default());
        let plan = Fourier::new(task.network.fourier());
        let loader = Loader::new(&task, &plan, [500.0, 5000.0], 3);
        let error = loader.examples(&[0, 1], draw("train", 0)).unwrap_err().to_string();
        assert!(error.contains("pair 1") && error.contains("frame"), "{error}");
    }

    #[test]
    fn what_the_network_sees_has_no_fixed_pattern_left() {
        let even = foci(1, 40, 16, 10);
        let response = Array2::from_shape_fn((40, 40), |(r, c)| 1.0 + 0.2 * ((r * 7 + c * 3) % 3) as f32);
        let mut uneven = even.clone();
        uneven[0].expected_e *= &response;
        let maps = SensorMaps {
            offset_dn: Some(&response * 40.0),
            inverse_response: Some(response.mapv(f32::recip)),
            ..SensorMaps::default()
        };
        let seen = |source: &Vec<Pair>, maps: &SensorMaps| {
            // So bright that noise is negligible.
            let peak = f64::from(source[0].expected_e.iter().copied().fold(0.0, f32::max)) * 8.0;
            let task = task(source, maps);
            let plan = Fourier::new(task.network.fourier());
            let loader = Loader::new(&task, &plan, [peak; 2], 3);
            loader.examples(&[0], draw("train", 0)).unwrap().remove(0).input.spectrum().to_vec()
        };
        let (clean, corrected) = (seen(&even, &SensorMaps::default()), seen(&uneven, &maps));
        let norm = |s: &Spectrum| s.iter().map(|v| v.norm_sqr()).sum::<f32>().sqrt();
        let off: Spectrum = clean.iter().zip(&corrected).map(|(a, b)| a - b).collect();
        assert!(norm(&off) < 0.1 * norm(&clean), "{} {}", norm(&off), norm(&clean));
    }

    #[test]
    fn saturation_clips_and_darkness_keeps_its_sign() {
        let dn = digitise(&[1e6, -1e6, 10.0], &NoiseModel::nominal(), Some(&[3.0, 3.0, 3.25]));
        assert_eq!(dn, [4031.0, -64.0, 7.0]);
        assert_eq!(normalise(&[-1.0, 4.0, 2.0]), [-0.25, 1.0, 0.5]);
    }
}
