//! A file that is shown: its description, and its pictures one at a time.

use ndarray::Array2;
use ommatidia_report::Look;
use ommatidia_session::SampleType;
use serde::{Serialize, Serializer};

/// A file that is open for a browser.
pub trait Source: Send {
    /// What it shows.
    fn description(&self) -> &Description;

    /// Reads one picture: all numbers are within the bounds of the description.
    ///
    /// # Errors
    /// The file has changed, or the picture cannot be read.
    fn read(&mut self, group: usize, pane: usize, frame: usize) -> anyhow::Result<Picture>;
}

/// One picture.
pub struct Picture {
    /// Its values, [rows, cols]; NaN where there is none.
    pub values: Array2<f32>,
    /// What is known of this frame: time, place, depth.
    pub label: String,
}

/// What a file shows.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Description {
    /// Its main figures: names and values.
    pub facts: Vec<[String; 2]>,
    /// What a person should know, such as what is damaged.
    pub notes: Vec<String>,
    /// Its pictures.
    pub groups: Vec<Group>,
}

/// Pictures that belong together: one slider moves them all.
#[derive(Clone, Debug, Serialize)]
pub struct Group {
    /// Its name.
    pub name: String,
    /// Number of frames.
    pub frames: usize,
    /// Depth of each frame, um; empty where all have the same.
    pub z_um: Vec<f64>,
    /// What is shown of each frame, side by side.
    pub panes: Vec<Pane>,
    /// The panes that are compared with a swipe at first.
    pub swipe: Option<[usize; 2]>,
}

/// One of the pictures of a frame.
#[derive(Clone, Debug, Serialize)]
pub struct Pane {
    /// Its name.
    pub name: String,
    /// Unit of its values; may be empty.
    pub unit: String,
    /// Rows and columns.
    pub size: [usize; 2],
    /// Height and width of a pixel, um, where they are known.
    pub pixel_um: Option<[f64; 2]>,
    /// Where its pixels lie.
    pub plane: Plane,
    /// Its colours.
    #[serde(serialize_with = "map_name")]
    pub look: Look,
    /// Type of the samples that are sent.
    #[serde(serialize_with = "sample_name")]
    pub samples: SampleType,
}

/// Where the pixels of a picture lie.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Plane {
    /// On the sensor.
    Sensor,
    /// In the object.
    Object,
    /// Not known.
    Unknown,
}

impl Pane {
    /// A raw frame, DN.
    pub fn raw(name: &str, size: [usize; 2], pitch_um: f64) -> Self {
        Self {
            name: name.into(),
            unit: "DN".into(),
            size,
            pixel_um: Some([pitch_um; 2]),
            plane: Plane::Sensor,
            look: Look::Raw,
            samples: SampleType::F32,
        }
    }

    /// An object.
    pub fn object(name: &str, size: [usize; 2], pixel_um: Option<f64>, unit: &str) -> Self {
        Self {
            unit: unit.into(),
            pixel_um: pixel_um.map(|um| [um; 2]),
            plane: Plane::Object,
            look: Look::Light,
            ..Self::raw(name, size, 1.0)
        }
    }

    /// A residual, standard deviations.
    pub fn residual(name: &str, size: [usize; 2], pitch_um: f64) -> Self {
        Self { unit: "sigma".into(), look: Look::Residual, ..Self::raw(name, size, pitch_um) }
    }
}

/// Name of a look's colours, for the page.
pub fn colours(look: Look) -> &'static str {
    match look {
        Look::Raw => "grey",
        Look::Light => "inferno",
        Look::Residual => "diverging",
        Look::Map => "viridis",
    }
}

fn map_name<S: Serializer>(look: &Look, to: S) -> Result<S::Ok, S::Error> {
    to.serialize_str(colours(*look))
}

fn sample_name<S: Serializer>(samples: &SampleType, to: S) -> Result<S::Ok, S::Error> {
    to.serialize_str(samples.name())
}
