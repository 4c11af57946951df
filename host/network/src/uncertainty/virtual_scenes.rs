//! Frames with known objects: specimens through the calibrated instrument, whose own uncertainty is drawn too.

use super::UncertaintyError;
use ndarray::Array2;
use ommatidia_model::forward::Forward;
use ommatidia_model::instrument::Instrument;
use ommatidia_physics::effects::{Chain, EffectSetting};
use ommatidia_physics::scene::{SceneConfig, Scenes, Specimen};
use ommatidia_session::{ObjectGrid, rng};
use rand::{Rng, RngExt};
use rand_distr::{Distribution, StandardNormal};
use serde::{Deserialize, Serialize};

/// The default range of the brightest pixel, electrons, where full scale allows it.
const PEAK_E: [f64; 2] = [100.0, 20_000.0];
/// The brightest pixel is at most this part of full scale.
const OF_FULL_SCALE: f64 = 0.8;

/// What virtual frames show.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VirtualConfig {
    /// Specimens, in turn.
    pub specimens: Vec<Specimen>,
    /// Range of the brightest pixel of a frame, electrons, drawn with a uniform logarithm; None: 100 to 20,000, at most
    /// 80 % of full scale.
    pub peak_e: Option<[f64; 2]>,
}

impl Default for VirtualConfig {
    fn default() -> Self {
        let specimens = Specimen::USUAL.into_iter().chain([Specimen::Section]).collect();
        Self { specimens, peak_e: None }
    }
}

/// Standard error of one parameter of an effect of the instrument.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EffectError {
    /// Id of the effect.
    pub id: String,
    /// Name of the parameter.
    pub name: String,
    /// Its standard error, in the unit of the parameter.
    pub sigma: f64,
}

/// One virtual frame.
#[derive(Clone, Debug)]
pub struct VirtualFrame {
    /// Kind of specimen.
    pub specimen: Specimen,
    /// Expected signal of the brightest pixel, electrons.
    pub peak_e: f64,
    /// The object, [object rows, object cols], >= 0, in the light unit of the instrument.
    pub object: Array2<f32>,
    /// The frame with noise, DN, [sensor rows, sensor cols].
    pub frame_dn: Array2<f32>,
}

/// A source of virtual frames.
#[derive(Debug)]
pub struct VirtualScenes {
    forward: Forward,
    replicates: Vec<Forward>,
    effects: Vec<EffectSetting>,
    errors: Vec<EffectError>,
    kinds: Vec<(Specimen, Scenes)>,
    grid: ObjectGrid,
    peak_e: [f64; 2],
}

impl VirtualConfig {
    /// Plans virtual frames of an instrument. `errors` are those of its effects; the replicates of its calibration are
    /// used as they are.
    ///
    /// # Errors
    /// There are no specimens, the range of light is no range, or the instrument is inconsistent.
    pub fn build(&self, instrument: &Instrument, errors: &[EffectError]) -> Result<VirtualScenes, UncertaintyError> {
        let peak_e = self.peak_e.unwrap_or_else(|| {
            let most = OF_FULL_SCALE * instrument.noise.full_scale_e();
            [PEAK_E[0].min(most / 10.0), PEAK_E[1].min(most)]
        });
        if !(peak_e[0] > 0.0 && peak_e[1] > peak_e[0] && peak_e[1].is_finite()) {
            return Err(UncertaintyError::Config {
                field: "peak_e",
                expected: "two ascending numbers of electrons above zero".into(),
                found: format!("{peak_e:?}"),
            });
        }
        let forwards = (0..instrument.replicates.len()).filter_map(|j| instrument.replicate(j));
        let kinds = self.specimens.iter().map(|kind| {
            let config = SceneConfig { specimens: vec![*kind], ..SceneConfig::default() };
            Ok((*kind, config.build()?))
        });
        let kinds: Vec<_> = kinds.collect::<Result<_, UncertaintyError>>()?;
        if kinds.is_empty() {
            return Err(ommatidia_physics::scene::SceneError::Nothing.into());
        }
        Ok(VirtualScenes {
            forward: Forward::new(instrument)?,
            replicates: forwards.map(|i| Forward::new(&i)).collect::<Result<_, _>>()?,
            effects: instrument.effects.clone(),
            errors: errors.to_vec(),
            kinds,
            grid: instrument.manifest.object,
            peak_e,
        })
    }
}

impl VirtualScenes {
    /// Range of the brightest pixel, electrons.
    pub fn peak_e(&self) -> [f64; 2] {
        self.peak_e
    }

    /// Kinds of specimens; frame i shows the kind i modulo their number.
    pub fn specimens(&self) -> Vec<Specimen> {
        self.kinds.iter().map(|(kind, _)| *kind).collect()
    }

    /// Number of replicates of the calibration that are drawn from.
    pub fn replicates(&self) -> usize {
        self.replicates.len()
    }

    /// Frame `i` of the purpose `what`. It depends on the seed, the purpose and the number alone.
    ///
    /// # Errors
    /// No light reaches the sensor.
    pub fn frame(&self, seed: u64, what: &str, i: usize) -> Result<VirtualFrame, UncertaintyError> {
        self.frame_within(self.peak_e, seed, what, i)
    }

    /// As [`VirtualScenes::frame`], with another range of the brightest pixel, electrons.
    pub(super) fn frame_within(
        &self,
        peak_e: [f64; 2],
        seed: u64,
        what: &str,
        i: usize,
    ) -> Result<VirtualFrame, UncertaintyError> {
        let (specimen, scenes) = &self.kinds[i % self.kinds.len()];
        let mut object = scenes.draw(&self.grid, seed, &format!("{what}/scene"), i as u64);
        let mut draws = rng::stream(seed, &format!("{what}/light"), i as u64);
        let chain = self.chain(&mut draws);
        let cx = self.forward.context();
        let expected = |forward: &Forward, object: &Array2<f32>| -> Result<Array2<f32>, UncertaintyError> {
            Ok(forward.light_e(&forward.scene(object.view(), &chain, &cx)?, &chain, &cx))
        };
        let mut light_e = expected(&self.forward, &object)?;
        let brightest = light_e.fold(0.0f32, |m, v| m.max(*v));
        if brightest.is_nan() || brightest <= 0.0 {
            return Err(UncertaintyError::Black { index: i });
        }
        let [low, high] = peak_e.map(f64::ln);
        let peak_e = draws.random_range(low..=high).exp();
        let factor = (peak_e / f64::from(brightest)) as f32;
        object.mapv_inplace(|v| v * factor);
        if chain.is_empty() {
            light_e.mapv_inplace(|v| v * factor);
        } else {
            // An effect need not be proportional to the light: form the frame again at its level.
            light_e = expected(&self.forward, &object)?;
        }
        // The covariance of the delete-a-group jackknife is (J - 1)/J sum_j d_j d_j', d_j = s_j - s. One replicate,
        // drawn evenly, times a standard normal number and sqrt(J - 1), has that covariance.
        let count = self.replicates.len();
        if count > 1 {
            let replicate = &self.replicates[draws.random_range(0..count)];
            let z: f64 = StandardNormal.sample(&mut draws);
            let factor = (z * (count as f64 - 1.0).sqrt()) as f32;
            let other = expected(replicate, &object)?;
            light_e.zip_mut_with(&other, |v, o| *v = (*v + factor * (o - *v)).max(0.0));
        }
        light_e.mapv_inplace(|v| v.max(0.0));
        let mut noise = rng::stream(seed, &format!("{what}/noise"), i as u64);
        let frame_dn = self.forward.draw_with(light_e, &chain, &cx, &mut noise);
        Ok(VirtualFrame { specimen: *specimen, peak_e, object, frame_dn })
    }

    /// The effects with their parameters drawn from their errors; as they are where the draw is out of range.
    fn chain(&self, draws: &mut impl Rng) -> Chain {
        if self.errors.is_empty() {
            return self.forward.effects().clone();
        }
        let mut drawn = self.effects.clone();
        for error in &self.errors {
            let z: f64 = StandardNormal.sample(draws);
            for effect in drawn.iter_mut().filter(|e| e.id == error.id && e.table.is_none()) {
                if let Some(value) = effect.params.get_mut(&error.name) {
                    *value += z * error.sigma;
                }
            }
        }
        Chain::build(&drawn, self.forward.layout()).unwrap_or_else(|_| self.forward.effects().clone())
    }
}
