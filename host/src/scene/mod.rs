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
}

impl Specimen {
    /// All kinds.
    pub const ALL: [Self; 6] = [Self::Beads, Self::Cells, Self::Neurons, Self::Vessels, Self::Worms, Self::Target];

    /// One specimen of this kind, [rows, cols] of `grid`, >= 0, maximum 1.
    pub fn draw(self, grid: &ObjectGrid, rng: &mut impl Rng) -> Array2<f32> {
        let mut canvas = Canvas::new(grid);
        match self {
            Self::Beads => beads::draw(&mut canvas, rng),
            Self::Cells => cells::draw(&mut canvas, rng),
            Self::Neurons => neurons::draw(&mut canvas, rng),
            Self::Vessels => vessels::draw(&mut canvas, rng),
            Self::Worms => worms::draw(&mut canvas, rng),
            Self::Target => target::draw(&mut canvas, rng),
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
}

impl Default for SceneConfig {
    fn default() -> Self {
        Self { specimens: Specimen::ALL.to_vec(), images: None, targets: false }
    }
}

/// A source of scenes.
#[derive(Clone, Debug)]
pub struct Scenes {
    specimens: Vec<Specimen>,
    images: Option<ImageFolder>,
    targets: bool,
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
        Ok(Scenes { specimens: self.specimens.clone(), images, targets: self.targets })
    }
}

impl Scenes {
    /// Scene `index` of `seed` for `what` (so that training never sees the scenes of a bench), [rows, cols] of `grid`,
    /// >= 0, maximum 1. Kinds take turns.
    pub fn draw(&self, grid: &ObjectGrid, seed: u64, what: &str, index: u64) -> Array2<f32> {
        if self.targets {
            let periods = resolution::PERIODS_PX;
            return resolution::target(grid, periods[index as usize % periods.len()]);
        }
        let mut rng = rng::stream(seed, what, index);
        if let Some(images) = &self.images
            && (self.specimens.is_empty() || rng.random_bool(0.5))
        {
            return normalised(images.draw(grid, &mut rng));
        }
        self.specimens[index as usize % self.specimens.len()].draw(grid, &mut rng)
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
