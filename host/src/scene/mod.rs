//! Synthetic specimens on the object grid: what a fluorescence miniscope is pointed at.
//!
//! Sizes are in um, so a specimen looks the same on any grid. A specimen is emitted light, float32, >= 0, its maximum 1; the
//! photon budget is set by whom it is drawn for. The `index`-th specimen of a seed depends on nothing else.

mod beads;
mod canvas;
mod cells;
mod images;
mod neurons;
pub mod resolution;
mod section;
mod target;
mod vessels;
mod worms;

use crate::rng;
use crate::session::ObjectGrid;
use canvas::Canvas;
use images::ImageFolder;
pub use images::SceneError;
use ndarray::Array2;
use rand::{Rng, RngExt};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Kind of specimen.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Specimen {
    /// Fluorescent beads of random size, brightness and place.
    Beads,
    /// Cell bodies, some with a dark or a bright nucleus.
    Cells,
    /// Neurons: somata with tapering, branching dendrites.
    Neurons,
    /// Trees of vessels that branch by Murray's law.
    Vessels,
    /// Undulating worms.
    Worms,
    /// Resolution targets: three-bar groups and Siemens stars.
    Target,
    /// Brain sections: layers of labelled cells over a glowing, mottled ground, with dark tracts and vessels.
    Section,
}

impl Specimen {
    /// The kinds that scenes are drawn from where none is named: those that leave most of the field dark, as the instrument's users label
    /// their samples.
    pub const USUAL: [Self; 6] = [Self::Beads, Self::Cells, Self::Neurons, Self::Vessels, Self::Worms, Self::Target];

    /// One specimen of this kind at `time_s`, [rows, cols] of `grid`, >= 0, maximum 1. Worms move; all else keeps still.
    pub fn draw(self, grid: &ObjectGrid, time_s: f64, rng: &mut impl Rng) -> Array2<f32> {
        let mut canvas = Canvas::new(grid);
        match self {
            Self::Beads => beads::draw(&mut canvas, rng),
            Self::Cells => cells::draw(&mut canvas, rng),
            Self::Neurons => neurons::draw(&mut canvas, rng),
            Self::Vessels => vessels::draw(&mut canvas, rng),
            Self::Worms => worms::draw(&mut canvas, time_s, rng),
            Self::Target => target::draw(&mut canvas, rng),
            Self::Section => section::draw(&mut canvas, rng),
        }
        normalised(canvas.into_light())
    }
}

/// What scenes are drawn from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SceneConfig {
    /// Kinds of specimens, one of which is drawn for each scene.
    pub specimens: Vec<Specimen>,
    /// A folder of grey .tif or .png pictures to cut scenes from as well; as likely as all specimens together.
    pub images: Option<PathBuf>,
    /// Instead of all these: resolution targets, one period a scene ([`resolution`]).
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub targets: bool,
    /// Frames of each scene: more than one make short videos.
    #[serde(skip_serializing_if = "is_one")]
    pub video_frames: usize,
    /// Time from one frame of a video to the next, s.
    #[serde(skip_serializing_if = "is_usual_interval")]
    pub video_interval_s: f64,
}

/// Time from frame to frame of a video where none is named, s.
const INTERVAL_S: f64 = 0.02;

// What is as it always was is left out of records.
fn is_one(n: &usize) -> bool {
    *n == 1
}

fn is_usual_interval(s: &f64) -> bool {
    *s == INTERVAL_S
}

impl Default for SceneConfig {
    fn default() -> Self {
        Self {
            specimens: Specimen::USUAL.to_vec(),
            images: None,
            targets: false,
            video_frames: 1,
            video_interval_s: INTERVAL_S,
        }
    }
}

/// A source of scenes.
#[derive(Clone, Debug)]
pub struct Scenes {
    specimens: Vec<Specimen>,
    images: Option<ImageFolder>,
    targets: bool,
    video_frames: usize,
    video_interval_s: f64,
}

impl SceneConfig {
    /// Makes the source; reads the pictures.
    ///
    /// # Errors
    /// There is nothing to draw from, or a picture cannot be read.
    pub fn build(&self) -> Result<Scenes, SceneError> {
        let images = self.images.as_deref().map(ImageFolder::open).transpose()?;
        if self.specimens.is_empty() && images.is_none() {
            return Err(SceneError::Nothing);
        }
        if self.video_frames == 0 || !(self.video_interval_s.is_finite() && self.video_interval_s >= 0.0) {
            return Err(SceneError::Video { frames: self.video_frames, interval_s: self.video_interval_s });
        }
        Ok(Scenes {
            specimens: self.specimens.clone(),
            images,
            targets: self.targets,
            video_frames: self.video_frames,
            video_interval_s: self.video_interval_s,
        })
    }
}

impl Scenes {
    /// Number of the video that frame `index` belongs to.
    pub fn video(&self, index: u64) -> u64 {
        index / self.video_frames as u64
    }

    /// Scene `index` of `seed` for `what` (so that training never sees the scenes of a bench), [rows, cols] of `grid`,
    /// >= 0, maximum 1. Kinds take turns, and so do the frames of a video.
    pub fn draw(&self, grid: &ObjectGrid, seed: u64, what: &str, index: u64) -> Array2<f32> {
        if self.targets {
            let periods = resolution::PERIODS_PX;
            return resolution::target(grid, periods[index as usize % periods.len()]);
        }
        let time_s = (index % self.video_frames as u64) as f64 * self.video_interval_s;
        let index = self.video(index);
        let mut rng = rng::stream(seed, what, index);
        if let Some(images) = &self.images
            && (self.specimens.is_empty() || rng.random_bool(0.5))
        {
            return normalised(images.draw(grid, &mut rng));
        }
        self.specimens[index as usize % self.specimens.len()].draw(grid, time_s, &mut rng)
    }
}

/// Scales to maximum 1; an empty scene stays empty.
fn normalised(mut light: Array2<f32>) -> Array2<f32> {
    let max = light.fold(0.0f32, |m, v| m.max(*v));
    if max > 0.0 {
        light.mapv_inplace(|v| v.max(0.0) / max);
    }
    light
}

#[cfg(test)]
mod tests;
