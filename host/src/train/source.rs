//! Where training pairs come from, and how they become what the network sees.

use super::ops::fourier::Fourier;
use super::{Family, Lenses, NetworkConfig, Seen, SensorMaps, TrainError};
use crate::evaluate::Case;
use crate::noise::{NoiseModel, draw_electrons};
use crate::rng;
use ndarray::{Array2, ArrayView2};
use rand::{Rng, RngExt};
use rayon::prelude::*;

/// One training pair.
#[derive(Clone, Debug, PartialEq)]
pub struct Pair {
    /// Object, [object rows, object cols], >= 0, in any unit.
    pub object: Array2<f32>,
    /// What the sensor is expected to collect of it, electrons, [frame rows, frame cols]; noise-free.
    pub expected_e: Array2<f32>,
}

/// A set of training pairs.
pub trait PairSource: Sync {
    /// Number of pairs.
    fn len(&self) -> usize;

    /// Whether there are none.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The pair at `index` < `len()`: always the same.
    ///
    /// # Errors
    /// It cannot be read or made.
    fn pair(&self, index: usize) -> Result<Pair, Box<dyn std::error::Error + Send + Sync>>;
}

/// Pairs in memory.
impl PairSource for Vec<Pair> {
    fn len(&self) -> usize {
        self.as_slice().len()
    }

    fn pair(&self, index: usize) -> Result<Pair, Box<dyn std::error::Error + Send + Sync>> {
        self.get(index).cloned().ok_or_else(|| format!("there are {} pairs", self.as_slice().len()).into())
    }
}

/// What the network sees and what it shall say.
#[derive(Clone, Debug)]
pub struct Example {
    /// The normalised frame.
    pub seen: Seen,
    /// Object divided by its maximum, in C order.
    pub target: Vec<f32>,
    /// What each lens alone would show, for a network that is told so; see [`Lenses::views`].
    pub views: Option<Vec<f32>>,
}

/// Makes examples of pairs: draws the photon budget and the noise, corrects, normalises, transforms.
#[derive(Clone, Copy, Debug)]
pub struct Loader<'a> {
    /// The pairs.
    pub source: &'a dyn PairSource,
    /// Sizes that they must have.
    pub network: &'a NetworkConfig,
    /// Plan of the transform.
    pub plan: &'a Fourier,
    /// Noise of the sensor.
    pub noise: &'a NoiseModel,
    /// Fixed patterns that frames have and that are corrected before the network.
    pub maps: &'a SensorMaps,
    /// Range of the peaks, electrons.
    pub peak_e: [f64; 2],
    /// Seed of the draws.
    pub seed: u64,
    /// The calibrated lenses, for a network that is told what each would show.
    pub lenses: Option<&'a Lenses>,
}

impl std::fmt::Debug for dyn PairSource + '_ {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} pairs", self.len())
    }
}

impl Loader<'_> {
    /// Examples of the given pairs; `what` and `draw` name the random numbers: the same names, the same examples.
    ///
    /// # Errors
    /// A pair cannot be had, has the wrong shape, or holds values that are no numbers.
    pub fn examples(&self, pairs: &[usize], what: &str, draw: u64) -> Result<Vec<Example>, TrainError> {
        let one = |(i, &pair): (usize, &usize)| {
            let (mut light, target) = self.draw(pair, &mut self.stream(pairs.len(), i, what, draw))?;
            self.maps.correct(&mut light);
            let seen = Seen::of(self.network, self.plan, &normalise(&light));
            Ok(Example { seen, views: self.views(pair, &target)?, target })
        };
        pairs.par_iter().enumerate().map(one).collect()
    }

    fn views(&self, index: usize, target: &[f32]) -> Result<Option<Vec<f32>>, TrainError> {
        let (Family::Cm2Net { .. }, Some(lenses)) = (&self.network.family, self.lenses) else {
            return Ok(None);
        };
        let [rows, cols] = self.network.object;
        let object = ArrayView2::from_shape((rows, cols), target).unwrap_or_else(|_| unreachable!("`draw` checked it"));
        lenses.views(object).map(Some).map_err(|source| TrainError::Source { index, source: source.into() })
    }

    /// The same frames as the sensor delivers them, DN, [frame rows, frame cols], and their targets.
    ///
    /// # Errors
    /// As [`Loader::examples`].
    pub fn cases(&self, pairs: &[usize], what: &str, draw: u64) -> Result<Vec<Case>, TrainError> {
        let image = |size: [usize; 2], values| Array2::from_shape_vec((size[0], size[1]), values).unwrap_or_default();
        let one = |(i, &pair): (usize, &usize)| {
            let (light, target) = self.draw(pair, &mut self.stream(pairs.len(), i, what, draw))?;
            let frame = light.iter().map(|v| v + self.noise.black_level_dn as f32).collect();
            Ok(Case { frame_dn: image(self.network.frame, frame), truth: image(self.network.object, target) })
        };
        pairs.par_iter().enumerate().map(one).collect()
    }

    fn stream(&self, count: usize, i: usize, what: &str, draw: u64) -> impl Rng + use<> {
        rng::stream(self.seed, what, draw * count as u64 + i as u64)
    }

    /// A drawn frame, DN above black, and its target, in C order.
    fn draw(&self, index: usize, rng: &mut impl Rng) -> Result<(Vec<f32>, Vec<f32>), TrainError> {
        let pair = self.source.pair(index).map_err(|source| TrainError::Source { index, source })?;
        let [object, expected] =
            [("object", &pair.object, self.network.object), ("frame", &pair.expected_e, self.network.frame)]
                .map(|(what, image, size)| check(index, what, image.view(), size));
        let (bright, peak) = (object?, expected?);
        let [low, high] = self.peak_e.map(f64::ln);
        let scale = ((low + (high - low) * rng.random::<f64>()).exp() / f64::from(peak)) as f32;
        let mut electrons: Vec<f32> = pair.expected_e.iter().map(|&e| e * scale).collect();
        draw_electrons(&mut electrons, self.noise.read_noise_e as f32, rng);
        let offset = self.maps.offset_dn.as_ref().and_then(|map| map.as_slice());
        Ok((digitise(&electrons, self.noise, offset), pair.object.iter().map(|&v| v / bright).collect()))
    }
}

/// The converter: electrons -> DN above black, the offsets of the pixels in it; the code is whole and within the converter's range.
fn digitise(electrons: &[f32], noise: &NoiseModel, offset_dn: Option<&[f32]>) -> Vec<f32> {
    let (gain, black, top) = (noise.gain_dn_per_e as f32, noise.black_level_dn as f32, noise.saturation_dn as f32);
    let offset = |p: usize| offset_dn.map_or(0.0, |map| map[p]);
    let code = |(p, &e): (usize, &f32)| (black + offset(p) + gain * e).round().clamp(0.0, top) - black;
    electrons.iter().enumerate().map(code).collect()
}

/// A frame above black divided by its maximum; negative values stay. A frame without light stays as it is.
pub fn normalise(light_dn: &[f32]) -> Vec<f32> {
    let max = light_dn.iter().copied().fold(0.0, f32::max);
    let scale = if max > 0.0 { 1.0 / max } else { 1.0 };
    light_dn.iter().map(|&v| v * scale).collect()
}

/// Checks shape and values; gives the maximum, which is above zero.
fn check(index: usize, what: &'static str, image: ArrayView2<'_, f32>, size: [usize; 2]) -> Result<f32, TrainError> {
    let wrong = |expected: String, found: String| Err(TrainError::Pair { index, what, expected, found });
    if image.dim() != (size[0], size[1]) {
        return wrong(format!("{} x {} pixels", size[0], size[1]), format!("{} x {}", image.nrows(), image.ncols()));
    }
    if let Some(v) = image.iter().find(|v| !v.is_finite()) {
        return wrong("finite values".into(), v.to_string());
    }
    let max = image.iter().copied().fold(0.0, f32::max);
    if max > 0.0 { Ok(max) } else { wrong("light in it".into(), "none".into()) }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
pub(super) mod tests {
    use super::super::ops::fourier::Spectrum;
    use super::*;

    /// A sensor like the demo's.
    pub fn noise() -> NoiseModel {
        NoiseModel {
            black_level_dn: 64.0,
            gain_dn_per_e: 0.4,
            gain_sigma: 0.0,
            read_noise_e: 2.0,
            read_noise_sigma: 0.0,
            saturation_dn: 4095.0,
            sources: crate::noise::Sources::default(),
        }
    }

    /// Pairs of random points seen through 3 x 3 foci `pitch` apart, each a small cross; the side lenses see the object shifted by `pitch`.
    pub fn foci(count: usize, frame: usize, object: usize, pitch: usize) -> Vec<Pair> {
        let make = |i: usize| {
            let mut rng = rng::stream(11, "points", i as u64);
            let mut o = Array2::<f32>::zeros((object, object));
            for _ in 0..12 {
                o[[rng.random_range(0..object), rng.random_range(0..object)]] = rng.random_range(0.3..1.0f32);
            }
            let mut f = Array2::<f32>::zeros((frame, frame));
            let middle = (frame - object) / 2;
            for ((r, c), &v) in o.indexed_iter().filter(|(_, v)| **v > 0.0) {
                for lens in 0..9 {
                    let (r0, c0) = (r + middle + (lens / 3) * pitch - pitch, c + middle + (lens % 3) * pitch - pitch);
                    for (dr, dc, w) in [(0i32, 0i32, 0.5f32), (1, 0, 0.15), (-1, 0, 0.1), (0, 1, 0.15), (0, -1, 0.1)] {
                        let (r, c) = ((r0 as i32 + dr) as usize, (c0 as i32 + dc) as usize);
                        if let Some(p) = f.get_mut((r, c)) {
                            *p += v * w * 1000.0;
                        }
                    }
                }
            }
            Pair { object: o, expected_e: f }
        };
        (0..count).map(make).collect()
    }

    #[test]
    fn the_same_draw_gives_the_same_example_and_another_does_not() {
        let (pairs, network) = (foci(2, 40, 16, 10), super::super::Preset::Nano.network([40, 40], [16, 16]));
        let (plan, noise) = (Fourier::new(network.fourier()), noise());
        let loader = Loader {
            source: &pairs,
            network: &network,
            plan: &plan,
            noise: &noise,
            maps: &SensorMaps::default(),
            peak_e: [500.0, 5000.0],
            seed: 3,
            lenses: None,
        };
        let a = loader.examples(&[0, 1], "train", 4).unwrap();
        let b = loader.examples(&[0, 1], "train", 4).unwrap();
        let c = loader.examples(&[0, 1], "train", 5).unwrap();
        assert_eq!(a[1].seen, b[1].seen);
        assert_ne!(a[1].seen, c[1].seen);
        assert_eq!(a[0].target.iter().copied().fold(0.0, f32::max), 1.0);
    }

    #[test]
    fn a_pair_that_does_not_fit_is_refused_by_its_number() {
        let mut pairs = foci(2, 40, 16, 10);
        let network = super::super::Preset::Nano.network([40, 40], [16, 16]);
        let (plan, noise) = (Fourier::new(network.fourier()), noise());
        pairs[1].expected_e[[3, 3]] = f32::NAN;
        let loader = Loader {
            source: &pairs,
            network: &network,
            plan: &plan,
            noise: &noise,
            maps: &SensorMaps::default(),
            peak_e: [500.0, 5000.0],
            seed: 3,
            lenses: None,
        };
        let error = loader.examples(&[0, 1], "train", 0).unwrap_err().to_string();
        assert!(error.contains("pair 1") && error.contains("frame"), "{error}");
    }

    #[test]
    fn what_the_network_sees_has_no_fixed_pattern_left() {
        let network = super::super::Preset::Nano.network([40, 40], [16, 16]);
        let (plan, noise) = (Fourier::new(network.fourier()), noise());
        let even = foci(1, 40, 16, 10);
        let response = Array2::from_shape_fn((40, 40), |(r, c)| 1.0 + 0.2 * ((r * 7 + c * 3) % 3) as f32);
        let mut uneven = even.clone();
        uneven[0].expected_e *= &response;
        let maps = SensorMaps { offset_dn: Some(&response * 40.0), inverse_gain: Some(response.mapv(f32::recip)) };
        let seen = |source: &Vec<Pair>, maps: &SensorMaps| {
            // So bright that noise is nothing.
            let peak = f64::from(source[0].expected_e.iter().copied().fold(0.0, f32::max)) * 8.0;
            let loader = Loader {
                source,
                network: &network,
                plan: &plan,
                noise: &noise,
                maps,
                peak_e: [peak; 2],
                seed: 3,
                lenses: None,
            };
            loader.examples(&[0], "train", 0).unwrap().remove(0).seen.spectrum().to_vec()
        };
        let (clean, corrected) = (seen(&even, &SensorMaps::default()), seen(&uneven, &maps));
        let norm = |s: &Spectrum| s.iter().map(|v| v.norm_sqr()).sum::<f32>().sqrt();
        let off: Spectrum = clean.iter().zip(&corrected).map(|(a, b)| a - b).collect();
        assert!(norm(&off) < 0.1 * norm(&clean), "{} {}", norm(&off), norm(&clean));
    }

    #[test]
    fn saturation_clips_and_darkness_keeps_its_sign() {
        let dn = digitise(&[1e6, -1e6, 10.0], &noise(), Some(&[3.0, 3.0, 3.25]));
        assert_eq!(dn, [4031.0, -64.0, 7.0]);
        assert_eq!(normalise(&[-1.0, 4.0, 2.0]), [-0.25, 1.0, 0.5]);
    }
}
