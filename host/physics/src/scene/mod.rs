//! Synthetic specimens on the object grid, as a fluorescence miniscope sees them.
//!
//! Sizes are in um, so a specimen looks the same on any grid. A specimen is emitted light, float32, >= 0, with maximum
//! 1; the caller sets the light level. Scene `index` of a seed depends only on the seed, a name, the index and the
//! grid.
//!
//! ```
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! use ommatidia_physics::scene::{SceneConfig, Specimen};
//! use ommatidia_session::ObjectGrid;
//! let grid = ObjectGrid { rows: 48, cols: 64, pixel_um: 2.8 };
//! let config = SceneConfig { specimens: vec![Specimen::Beads, Specimen::Cells], ..SceneConfig::default() };
//! let scenes = config.build()?;
//! let beads = scenes.draw(&grid, 7, "example", 0);
//! assert_eq!(beads.dim(), (48, 64));
//! assert_eq!(beads.iter().fold(0.0f32, |m, v| m.max(*v)), 1.0);
//! // The same seed, name and index give the same scene; the kinds take turns.
//! assert_eq!(beads, scenes.draw(&grid, 7, "example", 0));
//! assert_ne!(beads, scenes.draw(&grid, 7, "example", 1));
//! # Ok(())
//! # }
//! ```

mod beads;
mod canvas;
mod cells;
mod haze;
mod images;
mod leaves;
mod mottle;
mod neurons;
mod points;
pub mod resolution;
mod section;
mod target;
mod threads;
mod vessels;
mod worms;

use canvas::Canvas;
use images::ImageFolder;
pub use images::SceneError;
use ndarray::Array2;
use ommatidia_session::ObjectGrid;
use ommatidia_session::rng;
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
    /// Vessel trees that branch by Murray's law.
    Vessels,
    /// Undulating worms.
    Worms,
    /// Resolution targets: three-bar groups and Siemens stars.
    Target,
    /// Brain sections: layers of labelled cells on a bright, mottled background, with dark tracts and vessels.
    Section,
    /// Sources of a single object pixel, from a few to a tenth of all pixels.
    Points,
    /// Curved lines a pixel wide.
    Threads,
    /// Dead leaves: opaque ellipses of all sizes on top of each other.
    Leaves,
    /// Random light in squares of one to eight pixels.
    Mottle,
}

impl Specimen {
    /// The default kinds of scenes: those that leave most of the field dark, as samples for the instrument usually do.
    pub const USUAL: [Self; 6] = [Self::Beads, Self::Cells, Self::Neurons, Self::Vessels, Self::Worms, Self::Target];

    /// Kinds that look like no sample in particular, but have detail of every size and sharpness, some of them under
    /// haze. Networks that trained on them as well keep their quality on specimens that nobody thought of.
    pub const GENERAL: [Self; 4] = [Self::Points, Self::Threads, Self::Leaves, Self::Mottle];

    /// What networks are trained on: the usual kinds, sections and the general ones in turn.
    pub fn for_training() -> Vec<Self> {
        Self::USUAL.into_iter().chain([Self::Section]).chain(Self::GENERAL).collect()
    }

    /// Draws a specimen of this kind at time `time_s`, [rows, cols] of `grid`, >= 0, maximum 1. Only worms move with
    /// time.
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
            Self::Points => points::draw(&mut canvas, rng),
            Self::Threads => threads::draw(&mut canvas, rng),
            Self::Leaves => leaves::draw(&mut canvas, rng),
            Self::Mottle => mottle::draw(&mut canvas, rng),
        }
        if Self::GENERAL.contains(&self) {
            haze::maybe(&mut canvas, rng);
        }
        normalised(canvas.into_light())
    }
}

/// Where scenes come from: synthetic specimens, pictures, or resolution targets.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SceneConfig {
    /// Kinds of specimens; they take turns from scene to scene.
    pub specimens: Vec<Specimen>,
    /// A folder of grey .tif or .png pictures from which scenes are cut: half of the scenes on average, or all of them
    /// without `specimens`.
    pub images: Option<PathBuf>,
    /// Draw resolution targets instead of specimens and pictures, one period for each scene ([`resolution`]).
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub targets: bool,
    /// Number of frames of each scene. More than one make a short video.
    #[serde(skip_serializing_if = "is_one")]
    pub video_frames: usize,
    /// Time from one frame of a video to the next, s.
    #[serde(skip_serializing_if = "is_usual_interval")]
    pub video_interval_s: f64,
}

/// Default time from one frame of a video to the next, s.
const INTERVAL_S: f64 = 0.02;

// Defaults are left out of records, as in files written before these fields existed.
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
    /// Prepares the source of scenes and reads the pictures.
    ///
    /// # Errors
    /// There are neither specimens nor pictures, the video has no frames or an impossible interval, or a picture cannot
    /// be read.
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
    /// Index of the video to which frame `index` belongs.
    pub fn video(&self, index: u64) -> u64 {
        index / self.video_frames as u64
    }

    /// Draws scene `index` of `seed`, [rows, cols] of `grid`, >= 0, maximum 1.
    ///
    /// `what` names the purpose, so that e.g. training never sees the scenes of a bench. Consecutive indices are the
    /// frames of a video, then the next video.
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

/// Scales the maximum to 1; a dark scene stays dark.
fn normalised(mut light: Array2<f32>) -> Array2<f32> {
    let max = light.fold(0.0f32, |m, v| m.max(*v));
    if max > 0.0 {
        light.mapv_inplace(|v| v.max(0.0) / max);
    }
    light
}

#[cfg(test)]
mod tests;
