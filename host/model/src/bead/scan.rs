//! The frames of a bead scan, read one at a time and corrected for black level, offset and response.

use super::BeadError;
use crate::slopes::{Slopes, slope_terms};
use ndarray::Array2;
use ommatidia_physics::noise::{Bend, NoiseModel};
use ommatidia_physics::sensor::SensorMaps;
use ommatidia_session::{Cut, FrameReader, Manifest, Role, Session};
use std::path::{Path, PathBuf};

/// Smallest number of bead frames of a calibration.
const FEWEST: usize = 4;

/// Position and exposure of one bead frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Bead {
    /// Index of its stack among the bead stacks.
    pub stack: usize,
    /// Index of the frame in its stack.
    pub frame: usize,
    /// Position on the object grid, fractional pixels, [row, col].
    pub at_px: [f64; 2],
    /// Depth, um.
    pub z_um: f64,
    /// Factor that converts its light to the reference exposure at illumination 1.
    pub to_reference: f64,
}

/// A bead scan: positions are in memory, frames stay on disk.
#[derive(Debug)]
pub struct BeadScan {
    /// Every bead frame of the session.
    pub beads: Vec<Bead>,
    /// Reference exposure, ms: that of the first bead stack.
    pub exposure_ms: f64,
    paths: Vec<PathBuf>,
    readers: Vec<FrameReader>,
    maps: SensorMaps,
    noise: NoiseModel,
    bend: Option<Bend>,
    /// Level and slopes that are taken off each frame, DN; empty: nothing.
    background_dn: Vec<Slopes>,
}

impl BeadScan {
    /// Opens the bead stacks of a session. Frames are corrected by `maps`, and made linear where the response has a
    /// `bend`.
    ///
    /// # Errors
    /// There is no bead stack, too few frames, an exposure of zero, a map has another shape than the sensor, or the
    /// object grid does not match the sensor's.
    pub fn open(session: &Session, noise: NoiseModel, maps: SensorMaps, bend: Option<Bend>) -> Result<Self, BeadError> {
        let manifest = session.manifest();
        check_grid(manifest)?;
        maps.check([manifest.sensor.rows, manifest.sensor.cols])?;
        let stacks = session.need(Role::Bead)?;
        let exposure_ms = stacks[0].entry().exposure_ms;
        let (mut beads, mut paths, mut readers) = (Vec::new(), Vec::new(), Vec::new());
        for (s, stack) in stacks.iter().enumerate() {
            paths.push(stack.path());
            readers.push(stack.frames()?);
            for info in stack.whole() {
                let light = info.exposure_ms / exposure_ms * info.illumination;
                if !(light.is_finite() && light > 0.0) {
                    return Err(BeadError::NoExposure {
                        path: stack.path(),
                        frame: info.frame,
                        exposure_ms: info.exposure_ms,
                        illumination: info.illumination,
                    });
                }
                beads.push(Bead {
                    stack: s,
                    frame: info.frame,
                    at_px: manifest.object.pixel_of_um(info.y_um, info.x_um),
                    z_um: info.z_um,
                    to_reference: 1.0 / light,
                });
            }
        }
        if beads.len() < FEWEST {
            return Err(BeadError::TooFew { path: paths.swap_remove(0), expected: FEWEST, found: beads.len() });
        }
        Ok(Self { beads, exposure_ms, paths, readers, maps, noise, bend, background_dn: Vec::new() })
    }

    /// The file of bead `n`.
    pub fn path(&self, n: usize) -> &Path {
        &self.paths[self.beads[n].stack]
    }

    /// The noise model of the sensor.
    pub fn noise(&self) -> &NoiseModel {
        &self.noise
    }

    /// Whether a pixel [row, col] is usable (neither hot nor dead).
    pub fn useful(&self, at: [usize; 2]) -> bool {
        self.maps.unusable.as_ref().is_none_or(|unusable| !unusable[at])
    }

    /// Takes a background off every frame from now on: level and slopes of each, DN.
    pub(super) fn set_background(&mut self, background_dn: Vec<Slopes>) {
        self.background_dn = background_dn;
    }

    /// Level of the background that is taken off frame `n`, DN; 0 below the black level. It adds to the noise.
    pub(super) fn background_dn(&self, n: usize) -> f64 {
        self.background_dn.get(n).map_or(0.0, |b| b[0].max(0.0))
    }

    /// Frame of bead `n`, [sensor rows, sensor cols]: light in DN above black (and above the background, once that is
    /// known) at its own exposure, corrected for the response of each pixel; NaN where the pixel is saturated.
    ///
    /// # Errors
    /// The file cannot be read or holds non-finite values.
    pub fn light_dn(&mut self, n: usize) -> Result<Array2<f32>, BeadError> {
        Ok(self.cut_light_dn(n)?.0)
    }

    /// As [`Self::light_dn`], with the measured box of a frame that was cropped and padded (None: all of it was
    /// measured).
    ///
    /// # Errors
    /// The file cannot be read or holds non-finite values.
    pub fn cut_light_dn(&mut self, n: usize) -> Result<(Array2<f32>, Option<Cut>), BeadError> {
        let bead = &self.beads[n];
        let mut frame = self.readers[bead.stack].read(bead.frame)?;
        let cut = Cut::of(&frame);
        let (black, top) = (self.noise.black_level_dn as f32, self.noise.saturation_dn as f32);
        frame.mapv_inplace(|v| if v >= top { f32::NAN } else { v - black });
        if let Some(bend) = self.bend {
            frame.mapv_inplace(|v| bend.straight(f64::from(v)) as f32);
        }
        self.maps.correct(frame.view_mut());
        if let Some(unusable) = &self.maps.unusable {
            bridge(&mut frame, unusable);
        }
        if let Some(background) = self.background_dn.get(n) {
            let dim = frame.dim();
            frame.indexed_iter_mut().for_each(|((r, c), v)| {
                *v -= slope_terms(dim, [r, c]).iter().zip(background).map(|(x, b)| x * b).sum::<f64>() as f32;
            });
        }
        Ok((frame, cut))
    }
}

/// Replaces each unusable pixel by the mean of the usable ones among its eight neighbours.
fn bridge(frame: &mut Array2<f32>, useless: &Array2<bool>) {
    for ((r, c), _) in useless.indexed_iter().filter(|(_, u)| **u) {
        let (rows, cols) =
            (r.saturating_sub(1)..(r + 2).min(frame.nrows()), c.saturating_sub(1)..(c + 2).min(frame.ncols()));
        let near =
            rows.flat_map(|r| cols.clone().map(move |c| [r, c])).filter(|at| !useless[*at] && frame[*at].is_finite());
        let (sum, count) = near.fold((0.0, 0.0), |(s, n), at| (s + frame[at], n + 1.0));
        frame[[r, c]] = if count > 0.0 { sum / count } else { 0.0 };
    }
}

/// Checks that one object pixel is one sensor pixel within 2 %.
///
/// # Errors
/// `object.pixel_um` differs from `sensor.pixel_pitch_um / optics.magnification` by more than 2 %.
pub(crate) fn check_grid(m: &Manifest) -> Result<(), BeadError> {
    let expected = m.sensor.pixel_pitch_um / m.optics.magnification;
    let found = m.object.pixel_um;
    if (found / expected - 1.0).abs() <= 0.02 { Ok(()) } else { Err(BeadError::Grid { expected, found }) }
}
