//! Kernels drawn at random: lobes of light around a centre, as engineered pupils make them.

use super::image::{Set, normalise};
use crate::family::config::KernelsConfig;
use ommatidia_session::rng;
use rand::RngExt;
use rand_distr::{Distribution, Exp1, StandardNormal};

/// Distance between samples, pixels.
const STEP_PX: f64 = 0.25;

/// Draws the kernels; the same seed gives the same ones.
///
/// Each is a sum of Gaussian lobes. Their light is distributed like that of speckle (negative exponential; Goodman,
/// Speckle Phenomena in Optics, 2007, section 3.2.2), their places like a Gaussian cloud that is scaled to the rms
/// radius
/// of the configuration and centred on its light.
pub(super) fn draw(config: &KernelsConfig, seed: u64) -> Set {
    let half = (4.0 * config.rms_px.max(2.0 * config.lobe_px) / STEP_PX).ceil() as usize;
    let side = 2 * half + 1;
    let one = |k: usize| {
        let mut rng = rng::stream(seed, "bench/kernel", k as u64);
        let mut lobes: Vec<Lobe> = (0..config.lobes)
            .map(|_| {
                let light: f64 = Exp1.sample(&mut rng);
                let [y, x]: [f64; 2] = [0; 2].map(|_| StandardNormal.sample(&mut rng));
                let sigma = config.lobe_px * rng.random_range(1.0..2.0);
                // A cloud has no far lobes, so that the kernel ends within its image.
                Lobe { light, at: [y, x].map(|v| v.clamp(-2.0, 2.0)), sigma }
            })
            .collect();
        centre(&mut lobes, config.rms_px);
        let mut image = vec![0.0f32; side * side];
        for (i, v) in image.iter_mut().enumerate() {
            let [y, x] = [i / side, i % side].map(|k| (k as f64 - half as f64) * STEP_PX);
            *v = lobes.iter().map(|lobe| lobe.at(y, x)).sum::<f64>() as f32;
        }
        normalise(&mut image);
        vec![vec![image]]
    };
    Set { images: (0..config.count).map(one).collect(), side, step_px: STEP_PX }
}

struct Lobe {
    light: f64,
    at: [f64; 2],
    sigma: f64,
}

impl Lobe {
    fn at(&self, y: f64, x: f64) -> f64 {
        let square = (y - self.at[0]).powi(2) + (x - self.at[1]).powi(2);
        self.light / (self.sigma * self.sigma) * (-0.5 * square / (self.sigma * self.sigma)).exp()
    }
}

/// Moves the lobes so that the centroid is 0 and the rms radius `rms_px`, as far as the width of the lobes lets it.
fn centre(lobes: &mut [Lobe], rms_px: f64) {
    let total: f64 = lobes.iter().map(|l| l.light).sum();
    let mean = [0, 1].map(|k| lobes.iter().map(|l| l.light * l.at[k]).sum::<f64>() / total);
    lobes.iter_mut().for_each(|l| l.at = [l.at[0] - mean[0], l.at[1] - mean[1]]);
    let cloud = lobes.iter().map(|l| l.light * (l.at[0].powi(2) + l.at[1].powi(2))).sum::<f64>() / total;
    let own = lobes.iter().map(|l| l.light * 2.0 * l.sigma * l.sigma).sum::<f64>() / total;
    if cloud > 0.0 {
        let factor = ((rms_px * rms_px - own).max(0.0) / cloud).sqrt();
        lobes.iter_mut().for_each(|l| l.at = l.at.map(|v| v * factor));
    }
}
