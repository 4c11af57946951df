//! Simulates a data set with an instrument, shard by shard.

use super::plan::{SHARD_KIND, VERSION};
use super::reader::{ShardBody, open_shard};
use super::vary::Vary;
use super::{DataSetError, DataSetPlan};
use crate::forward::{Forward, ForwardError};
use crate::instrument::Instrument;
use crate::psf::OperatorConfig;
use ndarray::{Array2, Array3};
use ommatidia_physics::effects::{Chain, EffectSetting, Stage};
use ommatidia_physics::scene::{SceneConfig, Scenes, Specimen};
use ommatidia_session::ObjectGrid;
use ommatidia_session::artifact::{self, Header, Provenance, Tensors};
use ommatidia_session::rng;
use rand::RngExt;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::path::Path;
use std::str::FromStr;

/// Settings of a data set.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SimulateConfig {
    /// Number of pairs.
    pub count: usize,
    /// Pairs per shard.
    pub shard_pairs: usize,
    /// Specimens that objects are drawn from.
    pub scenes: SceneConfig,
    /// Range of the brightest pixel of a frame, electrons, drawn with a uniform logarithm; None: 1 % to 80 % of full
    /// scale.
    pub peak_e: Option<[f64; 2]>,
    /// Effects on light at their largest strengths. Half of the scenes have one of them, with strengths drawn evenly,
    /// of either sign where the effect allows both; their frames are formed with it, their objects are not. Networks
    /// that trained on such pairs lose less when the instrument has changed since its calibration. Training draws the
    /// light of a pair anew, and scales the light of an effect with it.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub vary: Vec<EffectSetting>,
}

impl Default for SimulateConfig {
    fn default() -> Self {
        let scenes = SceneConfig { specimens: Specimen::for_training(), ..SceneConfig::default() };
        Self { count: 1024, shard_pairs: 64, scenes, peak_e: None, vary: Vec::new() }
    }
}

/// The share of shards that this machine simulates: `index` of `of`, counted from one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Share {
    index: usize,
    of: usize,
}

impl Share {
    /// Every shard.
    pub const ALL: Self = Self { index: 1, of: 1 };

    /// Whether piece number `shard`, counted from 0, belongs to this share.
    pub fn holds(self, shard: usize) -> bool {
        shard % self.of == self.index - 1
    }
}

impl fmt::Display for Share {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.index, self.of)
    }
}

impl FromStr for Share {
    type Err = String;

    /// Parses `I/N`, 1 <= I <= N.
    fn from_str(text: &str) -> Result<Self, String> {
        let parts = text.split_once('/').and_then(|(i, n)| Some((i.parse().ok()?, n.parse().ok()?)));
        match parts {
            Some((index, of)) if 1 <= index && index <= of => Ok(Self { index, of }),
            _ => Err(format!("expected I/N with 1 <= I <= N, e.g. 1/4, found `{text}`")),
        }
    }
}

/// Result of a run of the simulation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Progress {
    /// Number of shards that were written.
    pub made: usize,
    /// Number of shards of this share that existed already.
    pub kept: usize,
    /// Number of shards of the whole data set that are still missing.
    pub missing: usize,
}

/// A planned data set.
#[derive(Debug)]
pub struct Simulation {
    plan: DataSetPlan,
    scenes: Scenes,
    forward: Forward,
    grid: ObjectGrid,
    /// Effects of the instrument.
    effects: Vec<EffectSetting>,
    vary: Vary,
    /// The forward model at all depths, where a drawn effect may need them.
    deep: Option<Forward>,
}

impl SimulateConfig {
    /// Plans a data set of `instrument`; the provenance holds the hash of the instrument's `file`.
    ///
    /// # Errors
    /// A setting is out of range, there are no scenes, or the instrument is inconsistent.
    pub fn build(&self, instrument: &Instrument, file: &Path, seed: u64) -> Result<Simulation, DataSetError> {
        let full = (instrument.noise.saturation_dn - instrument.noise.black_level_dn) / instrument.noise.gain_dn_per_e;
        let peak_e = self.peak_e.unwrap_or([0.01 * full, 0.8 * full]);
        self.check(peak_e)?;
        let mut provenance = Provenance::new("simulate", seed, self);
        // The plan holds it; a shard is the same whatever the count, so that a data set can be extended.
        if let Some(config) = provenance.config.as_object_mut() {
            config.remove("count");
        }
        // By role and not by path: every machine that shares the work must plan the same bytes.
        provenance.inputs.insert("instrument".into(), artifact::file_hash(file)?);
        let manifest = &instrument.manifest;
        let plan = DataSetPlan {
            kind: "dataset".into(),
            version: VERSION,
            provenance,
            count: self.count,
            shard_pairs: self.shard_pairs,
            object: [manifest.object.rows, manifest.object.cols],
            frame: [manifest.sensor.rows, manifest.sensor.cols],
            noise: instrument.noise,
            peak_e,
        };
        let forward = Forward::new(instrument)?;
        let vary = Vary::of(&self.vary, forward.layout())?;
        let depth = instrument.psf.depth_nearest(0.0);
        let deep = || Forward::with_all_depths(instrument, OperatorConfig { depth, ..OperatorConfig::default() });
        let deep = vary.moves().then(deep).transpose()?;
        for setting in vary.largest() {
            let forward = deep.as_ref().unwrap_or(&forward);
            if !changes_frames(forward, setting)? {
                let expected = "effects that change single frames of this instrument";
                return Err(DataSetError::Config { field: "vary", expected, found: setting.to_string() });
            }
        }
        Ok(Simulation {
            plan,
            scenes: self.scenes.build()?,
            forward,
            grid: manifest.object,
            effects: instrument.effects.clone(),
            vary,
            deep,
        })
    }

    fn check(&self, peak_e: [f64; 2]) -> Result<(), DataSetError> {
        let positive = |field, n: usize| match n {
            0 => Err(DataSetError::Config { field, expected: "one or more", found: "0".into() }),
            _ => Ok(()),
        };
        positive("count", self.count)?;
        positive("shard_pairs", self.shard_pairs)?;
        if peak_e[0] > 0.0 && peak_e[1] >= peak_e[0] && peak_e[1].is_finite() {
            return Ok(());
        }
        let expected = "two ascending numbers of electrons above zero";
        Err(DataSetError::Config { field: "peak_e", expected, found: format!("{peak_e:?}") })
    }
}

/// Whether a frame of a bright point and of even light differs with an effect.
fn changes_frames(forward: &Forward, setting: &EffectSetting) -> Result<bool, DataSetError> {
    let [rows, cols] = forward.operator().object_shape();
    let mut object = Array2::ones((rows, cols));
    object[[rows / 3, cols / 3]] = 50.0;
    let cx = forward.context();
    let frame = |chain: &Chain| Ok(forward.light_e(&forward.scene(object.view(), chain, &cx)?, chain, &cx));
    let with = Chain::build(std::slice::from_ref(setting), forward.layout())?;
    let frames: Result<_, ForwardError> = frame(&Chain::default()).and_then(|plain| Ok(plain != frame(&with)?));
    Ok(frames?)
}

impl Simulation {
    /// The plan of the data set.
    pub fn plan(&self) -> &DataSetPlan {
        &self.plan
    }

    /// Writes the shards of `share` to folder `dir` and keeps those that exist. Calls `done` with the number of pairs
    /// after each shard.
    ///
    /// # Errors
    /// The folder holds another data set, is not writable, or an object shows no light.
    pub fn run(&self, dir: &Path, share: Share, done: impl Fn(usize)) -> Result<Progress, DataSetError> {
        let existed = dir.is_dir();
        self.plan.write_or_resume(dir).inspect_err(|_| {
            if !existed {
                let _ = std::fs::remove_dir(dir);
            }
        })?;
        let mut progress = Progress::default();
        for k in (0..self.plan.shards()).filter(|k| share.holds(*k)) {
            if open_shard(dir, &self.plan, k).is_ok() {
                progress.kept += 1;
            } else {
                let made = self.make(dir, k);
                if made.is_err() && progress == Progress::default() && share == Share::ALL {
                    // A plan alone is of no use. What is finished is kept: the next run goes on from there.
                    DataSetPlan::remove(dir, !existed);
                }
                made?;
                progress.made += 1;
            }
            done(self.plan.pairs_of(k).len());
        }
        let there = |k: &usize| DataSetPlan::shard_path(dir, *k).is_file();
        progress.missing = self.plan.shards() - (0..self.plan.shards()).filter(there).count();
        Ok(progress)
    }

    fn make(&self, dir: &Path, k: usize) -> Result<(), DataSetError> {
        let pairs = self.plan.pairs_of(k);
        let made: Vec<_> = pairs.clone().into_par_iter().map(|i| self.pair(i)).collect::<Result<_, _>>()?;
        let [r, c] = self.plan.object;
        let [rows, cols] = self.plan.frame;
        let mut objects = Array3::zeros((pairs.len(), r, c));
        let mut frames = Array3::zeros((pairs.len(), rows, cols));
        for (i, (object, frame)) in made.into_iter().enumerate() {
            objects.index_axis_mut(ndarray::Axis(0), i).assign(&object);
            frames.index_axis_mut(ndarray::Axis(0), i).assign(&frame);
        }
        let path = DataSetPlan::shard_path(dir, k);
        // A shard belongs to one share, so what is left of it belongs to a run that was killed.
        artifact::remove_leftovers(&path);
        let plan = self.plan.hash().map_err(|e| DataSetError::Plan { path: path.clone(), detail: e.to_string() })?;
        let header = Header {
            kind: SHARD_KIND.into(),
            version: VERSION,
            provenance: self.plan.provenance.clone(),
            body: ShardBody { shard: k, plan },
        };
        let tensors = Tensors::from([("objects".into(), objects.into_dyn()), ("frames_e".into(), frames.into_dyn())]);
        Ok(artifact::write(&path, &header, &tensors)?)
    }

    /// Pair `i`: the object [object rows, object cols] with maximum 1, and its noise-free frame [sensor rows, sensor
    /// cols] in electrons, scaled so that its brightest pixel has the drawn level. A drawn effect acts after that.
    ///
    /// # Errors
    /// No light reaches the sensor, with the drawn effect or without, or the forward model refuses the object.
    pub fn pair(&self, i: usize) -> Result<(Array2<f32>, Array2<f32>), DataSetError> {
        let seed = self.plan.provenance.seed;
        let object = self.scenes.draw(&self.grid, seed, "simulate/scene", i as u64);
        let cx = self.forward.context();
        let mut frame = self.forward.expected_e(object.view(), &cx)?;
        let peak = frame.fold(0.0f32, |m, v| m.max(*v));
        if peak.is_nan() || peak <= 0.0 {
            return Err(DataSetError::Black { index: i });
        }
        let [low, high] = self.plan.peak_e.map(f64::ln);
        let mut rng = rng::stream(seed, "simulate/light", self.scenes.video(i as u64));
        let light = (rng.random_range(low..=high).exp() / f64::from(peak)) as f32;
        let drawn = self.vary.draw(seed, self.scenes.video(i as u64));
        if self.effects.is_empty() && drawn.is_none() {
            frame.mapv_inplace(|v| v * light);
            return Ok((object, frame));
        }
        // An effect need not be proportional to the light: form the frame again at its level.
        let Some(drawn) = drawn else {
            return Ok((object.clone(), self.forward.expected_e(object.mapv(|v| v * light).view(), &cx)?));
        };
        let chain: Vec<EffectSetting> = self.effects.iter().cloned().chain([drawn.clone()]).collect();
        let chain = Chain::build(&chain, self.forward.layout())?;
        let forward = self.deep.as_ref().filter(|_| chain.acts_at(Stage::Geometry)).unwrap_or(&self.forward);
        let cx = forward.context();
        let scene = forward.scene(object.mapv(|v| v * light).view(), &chain, &cx)?;
        frame = forward.light_e(&scene, &chain, &cx);
        if !frame.iter().any(|v| *v > 0.0) {
            return Err(DataSetError::Dark { index: i, effect: drawn.to_string() });
        }
        Ok((object, frame))
    }

    /// Frame `i` with noise as the sensor would deliver it, whole DN, of its noise-free electrons as [`Self::pair`]
    /// gives them. The same number gives the same draws.
    pub fn drawn_dn(&self, i: usize, frame_e: Array2<f32>) -> Array2<f32> {
        let mut rng = rng::stream(self.plan.provenance.seed, "simulate/noise", i as u64);
        self.forward.draw_dn(frame_e, &self.forward.context(), &mut rng)
    }
}
