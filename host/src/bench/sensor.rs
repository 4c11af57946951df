//! The virtual image sensor: light -> charge -> digital numbers.

use super::config::SensorConfig;
use crate::effects::{Chain, FrameContext};
use crate::noise::NoiseModel;
use crate::rng;
use ndarray::{Array2, Zip};
use rand::Rng;
use rand_distr::{Distribution, Normal, Poisson, StandardNormal};

/// A sensor with its fixed patterns.
///
/// `y = round(black + offset + gain (Poisson(light (1 + prnu)) + Normal(0, read noise)))`, clipped to the converter's
/// codes.
#[derive(Clone, Debug)]
pub(super) struct VirtualSensor {
    config: SensorConfig,
    offset_dn: Array2<f32>,
    response: Array2<f32>,
}

impl VirtualSensor {
    /// Draws the sensor; the same seed gives the same patterns.
    pub(super) fn manufacture(config: &SensorConfig, seed: u64) -> Self {
        let pattern = |what, mean: f64, rms: f64| {
            let mut rng = rng::stream(seed, what, 0);
            Array2::from_shape_simple_fn((config.rows, config.cols), || {
                let z: f64 = StandardNormal.sample(&mut rng);
                (mean + rms * z) as f32
            })
        };
        Self {
            offset_dn: pattern("bench/offset", 0.0, config.offset_rms_dn),
            response: pattern("bench/prnu", 1.0, config.prnu_rms),
            config: config.clone(),
        }
    }

    /// Highest code of the converter, DN.
    fn top(&self) -> f32 {
        (2f32).powi(self.config.bit_depth as i32) - 1.0
    }

    /// The expected frame for expected electrons `light_e`, DN, both [rows, cols]: clipped to the codes, not rounded.
    pub(super) fn expected(&self, light_e: &Array2<f32>, effects: &Chain, cx: &FrameContext<'_>) -> Array2<f32> {
        let mut charge = light_e * &self.response;
        effects.on_charge(&mut charge, cx);
        let top = self.top();
        let mut frame = self.convert(charge, effects, cx);
        frame.mapv_inplace(|v| v.clamp(0.0, top));
        frame
    }

    /// Draws the frame that the sensor reads for expected electrons `light_e`, whole DN, both [rows, cols].
    pub(super) fn expose(
        &self,
        light_e: &Array2<f32>,
        effects: &Chain,
        cx: &FrameContext<'_>,
        rng: &mut impl Rng,
    ) -> Array2<f32> {
        let noise = self.noise(effects);
        // An effect may change the gain at the same mean in DN: then there are this many times as many electrons.
        let more = self.config.gain_dn_per_e / noise.gain_dn_per_e;
        let mut charge = Zip::from(light_e).and(&self.response).map_collect(|light, response| {
            let mean = f64::from(light * response) * more;
            // Poisson::new fails only for means that are not above zero: no light, no electrons.
            Poisson::new(mean).map_or(0.0, |p| p.sample(rng) as f32)
        });
        effects.on_charge(&mut charge, cx);
        // Never fails: the configuration checks that the read noise is finite.
        if let Ok(reading) = Normal::new(0.0, noise.read_noise_e) {
            charge.mapv_inplace(|q| q + reading.sample(rng) as f32);
        }
        if more != 1.0 {
            charge /= more as f32;
        }
        let top = self.top();
        let mut frame = self.convert(charge, effects, cx);
        effects.on_reading(&mut frame, cx, rng);
        frame.mapv_inplace(|v| v.round().clamp(0.0, top));
        frame
    }

    /// The noise model of the sensor, as effects change it.
    fn noise(&self, effects: &Chain) -> NoiseModel {
        let mut noise = NoiseModel {
            black_level_dn: self.config.black_level_dn,
            gain_dn_per_e: self.config.gain_dn_per_e,
            read_noise_e: self.config.read_noise_e,
            saturation_dn: f64::from(self.top()),
            ..NoiseModel::nominal()
        };
        effects.on_noise(&mut noise);
        noise
    }

    fn convert(&self, mut charge_e: Array2<f32>, effects: &Chain, cx: &FrameContext<'_>) -> Array2<f32> {
        let (gain, black) = (self.config.gain_dn_per_e as f32, self.config.black_level_dn as f32);
        Zip::from(&mut charge_e).and(&self.offset_dn).for_each(|v, offset| *v = black + offset + gain * *v);
        effects.on_electronics(&mut charge_e, cx);
        charge_e
    }
}
