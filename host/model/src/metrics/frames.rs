//! What figures of predictions are computed from: frames, and the noise of their sensor.

use ndarray::Array2;
use ommatidia_physics::noise::NoiseModel;

/// One scene as predicted, as expected, and as measured; DN, black level included, each [sensor rows, sensor cols].
#[derive(Clone, Debug)]
pub struct FrameComparison {
    /// The model's prediction, noise-free.
    pub predicted: Array2<f32>,
    /// The true expectation, noise-free; None where only a measured frame exists.
    pub expected: Option<Array2<f32>>,
    /// The measured frame.
    pub measured: Array2<f32>,
}

impl FrameComparison {
    /// What the prediction is judged against: the true expectation where it is known, else the measured frame.
    pub(super) fn reference(&self) -> &Array2<f32> {
        self.expected.as_ref().unwrap_or(&self.measured)
    }
}

/// The noise and fixed pattern of a sensor: what the likelihood of a frame depends on.
#[derive(Clone, Copy, Debug)]
pub struct SensorNoise<'a> {
    /// Noise model of the sensor.
    pub noise: &'a NoiseModel,
    /// Fixed pattern relative to the black level, DN, [sensor rows, sensor cols]; None: unknown, taken as 0.
    pub offset_dn: Option<&'a Array2<f32>>,
    /// Variance of each pixel's reading without light, DN^2, [sensor rows, sensor cols]; None: `noise` holds for all
    /// pixels.
    pub reading_dn2: Option<&'a Array2<f32>>,
}

impl SensorNoise<'_> {
    /// Offset of the pixel `at` (row, col), DN.
    pub(super) fn offset_at(&self, at: (usize, usize)) -> f64 {
        self.offset_dn.and_then(|map| map.get(at)).map_or(0.0, |v| f64::from(*v))
    }

    /// Variance, DN^2, of the pixel `at` (row, col) whose expected level without its offset is `level_dn`.
    pub(super) fn variance_dn2(&self, at: (usize, usize), level_dn: f64) -> f64 {
        let beyond =
            self.reading_dn2.map_or(0.0, |m| f64::from(m[at]) - self.noise.variance_dn2(self.noise.black_level_dn));
        self.noise.variance_dn2(level_dn) + beyond
    }
}
