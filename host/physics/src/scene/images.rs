//! Scenes cut from the user's own pictures.

use super::canvas::log_uniform;
use ndarray::{Array2, s};
use ommatidia_session::{FrameReader, ObjectGrid, SessionError, remedy};
use rand::{Rng, RngExt};
use std::path::{Path, PathBuf};
use thiserror::Error;

/// Why scenes cannot be drawn.
#[derive(Debug, Error)]
pub enum SceneError {
    /// There are neither specimens nor pictures.
    #[error("specimens: expected at least one kind or a folder of pictures, found none; name one")]
    Nothing,
    /// A video has no frames, or an impossible interval.
    #[error(
        "video: expected one frame or more at an interval of zero or more, found {frames} frames at an interval of \
         {interval_s} s; correct the number of frames or the interval"
    )]
    Video {
        /// Number of frames of a video.
        frames: usize,
        /// Time between them, s.
        interval_s: f64,
    },
    /// The folder cannot be listed.
    #[error("{path}: cannot be read ({source}); {}; it must be a folder of .tif or .png pictures", remedy(.source))]
    Folder {
        /// The folder.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// The folder has no pictures.
    #[error("{path}: expected grey .tif or .png pictures, found none; convert them")]
    Empty {
        /// The folder.
        path: PathBuf,
    },
    /// A .tif cannot be read.
    #[error(transparent)]
    Stack(#[from] SessionError),
    /// A .png cannot be read.
    #[error("{path}: not a readable grey .png ({detail}); convert it to 8 or 16 bit grey")]
    Png {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        detail: String,
    },
}

/// Pictures in memory, with their background subtracted.
#[derive(Clone, Debug)]
pub(super) struct ImageFolder {
    pictures: Vec<Array2<f32>>,
}

impl ImageFolder {
    /// Reads every page of every .tif and every .png of a folder, in the order of their names.
    pub(super) fn open(folder: &Path) -> Result<Self, SceneError> {
        let failed = |source| SceneError::Folder { path: folder.into(), source };
        let entries = std::fs::read_dir(folder).map_err(failed)?;
        let mut paths: Vec<PathBuf> = entries.map(|e| e.map(|e| e.path())).collect::<Result<_, _>>().map_err(failed)?;
        paths.sort();
        let mut pictures = Vec::new();
        for path in paths {
            let suffix = path.extension().and_then(|s| s.to_str()).unwrap_or("").to_ascii_lowercase();
            match suffix.as_str() {
                "tif" | "tiff" => {
                    let mut frames = FrameReader::open(&path)?;
                    for i in 0..frames.len() {
                        pictures.push(without_background(frames.read(i)?));
                    }
                }
                "png" => pictures.push(without_background(read_png(&path)?)),
                _ => {}
            }
        }
        if pictures.is_empty() {
            return Err(SceneError::Empty { path: folder.into() });
        }
        Ok(Self { pictures })
    }

    /// Cuts a random part of a random picture, resampled to the grid, and flips it at random.
    pub(super) fn draw(&self, grid: &ObjectGrid, rng: &mut impl Rng) -> Array2<f32> {
        let picture = &self.pictures[rng.random_range(0..self.pictures.len())];
        let (rows, cols) = picture.dim();
        // Picture pixels per object pixel; a blurred picture becomes sharper with a larger scale.
        let most = (rows as f64 / grid.rows as f64).min(cols as f64 / grid.cols as f64);
        let scale = if most > 1.01 { log_uniform(rng, 1.0, most) } else { most };
        let (h, w) = (scale * grid.rows as f64, scale * grid.cols as f64);
        let top = rng.random_range(0.0..=(rows as f64 - h).max(0.0));
        let left = rng.random_range(0.0..=(cols as f64 - w).max(0.0));
        let mut cut = Array2::from_shape_fn((grid.rows, grid.cols), |(r, c)| {
            area_mean(picture, [top + r as f64 * scale, left + c as f64 * scale], scale)
        });
        if rng.random_bool(0.5) {
            cut.invert_axis(ndarray::Axis(0));
        }
        if rng.random_bool(0.5) {
            cut.invert_axis(ndarray::Axis(1));
        }
        cut
    }
}

/// Mean of the picture over a square of side `scale` pixels, rounded outwards to whole pixels.
fn area_mean(picture: &Array2<f32>, [top, left]: [f64; 2], scale: f64) -> f32 {
    let range = |from: f64, n: usize| {
        let low = (from as usize).min(n - 1);
        low..((from + scale).ceil() as usize).clamp(low + 1, n)
    };
    let part = picture.slice(s![range(top, picture.nrows()), range(left, picture.ncols())]);
    part.mean().unwrap_or(0.0)
}

/// Subtracts the 5th percentile: camera offset and stray light.
fn without_background(mut picture: Array2<f32>) -> Array2<f32> {
    let mut sorted: Vec<f32> = picture.iter().copied().collect();
    let k = sorted.len() / 20;
    let (_, background, _) = sorted.select_nth_unstable_by(k, f32::total_cmp);
    let background = *background;
    picture.mapv_inplace(|v| (v - background).max(0.0));
    picture
}

fn read_png(path: &Path) -> Result<Array2<f32>, SceneError> {
    let wrong = |detail: String| SceneError::Png { path: path.into(), detail };
    let file = std::fs::File::open(path).map_err(|e| wrong(e.to_string()))?;
    let mut decoder = png::Decoder::new(std::io::BufReader::new(file));
    decoder.set_transformations(png::Transformations::EXPAND);
    let mut reader = decoder.read_info().map_err(|e| wrong(e.to_string()))?;
    let (color, depth) = reader.output_color_type();
    if !matches!(color, png::ColorType::Grayscale | png::ColorType::GrayscaleAlpha) {
        return Err(wrong(format!("found {color:?}")));
    }
    let size = reader.output_buffer_size().ok_or_else(|| wrong("too large".into()))?;
    let mut bytes = vec![0; size];
    let info = reader.next_frame(&mut bytes).map_err(|e| wrong(e.to_string()))?;
    let channels = color.samples();
    let values: Vec<f32> = match depth {
        png::BitDepth::Sixteen => {
            bytes.chunks_exact(2 * channels).map(|b| f32::from(u16::from_be_bytes([b[0], b[1]]))).collect()
        }
        _ => bytes.chunks_exact(channels).map(|b| f32::from(b[0])).collect(),
    };
    Array2::from_shape_vec((info.height as usize, info.width as usize), values).map_err(|e| wrong(e.to_string()))
}
