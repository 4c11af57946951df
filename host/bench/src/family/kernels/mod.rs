//! Lenses with given PSFs: a set of kernels, drawn at random or measured, placed over the field.
//!
//! The focus of a point is a blend of the set's kernels, turned and stretched. Weights of the blend, turn and stretch
//! are smooth functions of the field that each lens has for itself. There is no pupil and no ray: what the kernels are
//! is all that is known of the optics. The kernel is a continuous image (bilinear between its samples) that is
//! averaged over each pixel, so a focus can lie anywhere. Every lens has its own irregular distortion (a polynomial of
//! second and third order) and falloff.
//!
//! Depth: drawn kernels turn in proportion to it, as the lobes of a double helix do (Pavani et al., PNAS 106, 2995,
//! 2009); of measured stacks, the slices nearest to the depth are blended. A set with one plane knows no depth.

mod drawn;
mod files;
mod image;

use super::change::Change;
use super::config::KernelsConfig;
use super::plane::{Chief, SensorPlane};
use super::{Lenses, Moved, Work};
use crate::config::BenchConfig;
use crate::error::BenchError;
use crate::foci::{Focus, Point};
use image::Set;
use ommatidia_physics::effects::{EffectSetting, Ray};
use ommatidia_session::rng;
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};

/// Samples along each axis over which a kernel is averaged in each pixel.
const SAMPLES: usize = 4;

/// One lens as it was manufactured.
#[derive(Clone, Debug)]
struct Made {
    anchor_px: [f64; 2],
    axis_um: [f64; 2],
    /// Logarithm of the weight of each kernel: at the axis, and its slope along each field axis.
    weights: Vec<[f64; 3]>,
    /// Turn of the kernels at the axis, rad, and its slopes.
    turn: [f64; 3],
    /// Slopes of the stretch.
    stretch: [f64; 2],
    /// Distortion: coefficients of the terms of [`terms`], (row, col) pixels.
    warp_px: [[f64; TERMS]; 2],
    /// Light of the lens on its axis.
    gain: f64,
}

const TERMS: usize = 7;

/// Terms of second and third order of the field.
fn terms([y, x]: [f64; 2]) -> [f64; TERMS] {
    [y * y, y * x, x * x, y * y * y, y * y * x, y * x * x, x * x * x]
}

/// The lenses.
#[derive(Clone, Debug)]
pub(crate) struct Kernels {
    config: KernelsConfig,
    set: Set,
    lenses: Vec<Made>,
    side: usize,
    plane: SensorPlane,
    corner_um: f64,
    /// Largest depth of scan and specimens, um.
    deepest_um: f64,
    change: Change,
}

impl Kernels {
    /// Draws or reads the kernels and draws the lenses; the same seed gives the same lenses.
    ///
    /// # Errors
    /// A number of the configuration is impossible, the PSFs cannot be read, or they have no depth and the
    /// configuration asks for one.
    pub(crate) fn build(config: &BenchConfig) -> Result<Self, BenchError> {
        let kernels = &config.kernels;
        let wrong =
            |field, expected: &str, found: String| Err(BenchError::Config { field, expected: expected.into(), found });
        for (field, v) in [
            ("kernels.rms_px", kernels.rms_px),
            ("kernels.lobe_px", kernels.lobe_px),
            ("kernels.slice_um", kernels.slice_um),
        ] {
            if !(v.is_finite() && v > 0.0) {
                return wrong(field, "a number above zero", v.to_string());
            }
        }
        let rates = [kernels.morph, kernels.turn_rad, kernels.stretch, kernels.warp_px, kernels.turn_rad_per_um];
        if let Some(v) = rates.iter().chain([&kernels.falloff]).find(|v| !v.is_finite()) {
            return wrong("kernels", "finite numbers", v.to_string());
        }
        if !(1..=32).contains(&kernels.count) || !(1..=256).contains(&kernels.lobes) {
            return wrong(
                "kernels",
                "1 to 32 kernels of 1 to 256 lobes",
                format!("{}, {}", kernels.count, kernels.lobes),
            );
        }
        if config.optics.psf_field_px.is_multiple_of(2) {
            return wrong("optics.psf_field_px", "an odd number", config.optics.psf_field_px.to_string());
        }
        let set =
            if kernels.psfs.is_empty() { drawn::draw(kernels, config.instrument_seed) } else { files::read(kernels)? };
        let depths = config.scan.depths_um.iter().chain(&config.stacks.scene_depths_um);
        let deepest_um = depths.fold(0.0f64, |m, z| m.max(z.abs()));
        let reach_um = reach_um(kernels, &set);
        if deepest_um > reach_um {
            let expected = format!("depths of at most {reach_um} um, which the PSFs reach");
            return Err(BenchError::Config { field: "scan.depths_um", expected, found: deepest_um.to_string() });
        }
        let centre_px = [config.sensor.rows, config.sensor.cols].map(|n| (n as f64 - 1.0) / 2.0);
        let (pixel_pitch_um, magnification) = (config.sensor.pixel_pitch_um, config.true_magnification());
        let plane = SensorPlane { centre_px, pixel_pitch_um, magnification };
        let places = config.places_px().into_iter().enumerate();
        let make = |(l, nominal): (usize, [f64; 2])| {
            let mut rng = rng::stream(config.instrument_seed, "bench/kernels", l as u64);
            let whole = rng.random_range(0.0..std::f64::consts::TAU);
            let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
            let anchor_px = [0, 1].map(|k| nominal[k] + config.array.placement_rms_px * normal());
            Made {
                anchor_px,
                axis_um: plane.axis_um(anchor_px),
                weights: (0..set.designs()).map(|_| [0; 3].map(|_| kernels.morph * normal())).collect(),
                turn: [whole, kernels.turn_rad * normal(), kernels.turn_rad * normal()],
                stretch: [0; 2].map(|_| kernels.stretch * normal()),
                warp_px: [0; 2].map(|_| [0; TERMS].map(|_| kernels.warp_px * normal())),
                gain: 1.0 - 0.1 * normal().abs().min(3.0),
            }
        };
        let object = &config.object;
        Ok(Self {
            lenses: places.map(make).collect(),
            set,
            side: config.optics.psf_field_px,
            plane,
            corner_um: (object.rows as f64).hypot(object.cols as f64) / 2.0 * object.pixel_um,
            deepest_um,
            config: kernels.clone(),
            change: Change::default(),
        })
    }

    /// Field (row, col) of a point, in units of the corner of the object.
    fn field(&self, l: usize, at_um: [f64; 2]) -> [f64; 2] {
        [0, 1].map(|k| (at_um[k] - self.lenses[l].axis_um[k]) / self.corner_um)
    }

    /// The chief ray of a point through a lens.
    fn chief(&self, l: usize, at_um: [f64; 2]) -> Chief {
        let Made { anchor_px, axis_um, .. } = self.lenses[l];
        let axis_px = self.plane.axis_px(anchor_px, axis_um);
        Chief { anchor_px, axis_px, off_axis_px: self.off_axis_px(l, at_um) }
    }

    /// Where the light of a point is centred, relative to the axis of its lens, pixels.
    fn off_axis_px(&self, l: usize, at_um: [f64; 2]) -> [f64; 2] {
        let (lens, terms) = (&self.lenses[l], terms(self.field(l, at_um)));
        let scale = self.plane.px_per_um();
        let at = [0, 1].map(|k| {
            let warp: f64 = lens.warp_px[k].iter().zip(&terms).map(|(c, t)| c * t).sum();
            (at_um[k] - lens.axis_um[k]) * scale + warp
        });
        let mm2 = (1e-3 * self.plane.pixel_pitch_um).powi(2) * (at[0] * at[0] + at[1] * at[1]);
        at.map(|v| v * (1.0 + self.change.gap + self.change.k1_per_mm2 * mm2))
    }
}

/// Depth that the PSFs reach on either side, um.
fn reach_um(config: &KernelsConfig, set: &Set) -> f64 {
    if config.psfs.is_empty() {
        // Drawn lobes may turn by half a turn.
        return std::f64::consts::PI / config.turn_rad_per_um.abs().max(1e-12);
    }
    (set.slices() as f64 - 1.0) / 2.0 * config.slice_um
}

impl Lenses for Kernels {
    fn side(&self) -> usize {
        self.side
    }

    fn anchors_px(&self) -> Vec<[f64; 2]> {
        self.lenses.iter().map(|l| l.anchor_px).collect()
    }

    fn axes_um(&self) -> Vec<[f64; 2]> {
        self.lenses.iter().map(|l| l.axis_um).collect()
    }

    fn ray(&self, l: usize, at_um: [f64; 2]) -> Ray {
        self.plane.ray(l, at_um, self.chief(l, at_um))
    }

    fn focus_px(&self, l: usize, point: Point, moved: Moved) -> [f64; 2] {
        self.chief(l, point.at_um).focus_px(moved.shift.px)
    }

    fn focus(&self, l: usize, point: Point, moved: Moved, work: &mut Work) -> Focus {
        let (centre, rest) = super::split(self.focus_px(l, point, moved));
        let (lens, h, z_um) = (&self.lenses[l], self.field(l, point.at_um), point.z_um + moved.shift.z_um);
        let linear = |[at, y, x]: [f64; 3]| at + y * h[0] + x * h[1];
        let weights = &mut work.lines[0];
        weights.clear();
        weights.extend(lens.weights.iter().map(|w| linear(*w).exp()));
        let sum: f64 = weights.iter().sum();
        weights.iter_mut().for_each(|w| *w /= sum);
        let slice = if self.config.psfs.is_empty() { 0.0 } else { z_um / self.config.slice_um };
        self.set.blend(weights, slice, h, &mut work.kernel);
        let helix = if self.config.psfs.is_empty() { self.config.turn_rad_per_um * z_um } else { 0.0 };
        // Smooth and above zero for any field. A larger gap makes a larger spot.
        let size = (1.0 + self.change.gap) * (1.0 + moved.shift.growth);
        let stretch = (lens.stretch[0] * h[0] + lens.stretch[1] * h[1]).tanh().exp() * size;
        let placed = image::Placed {
            rest,
            turn_rad: linear(lens.turn) + helix + self.change.turn_rad,
            stretch: stretch.max(0.05),
            samples: SAMPLES,
        };
        work.psf.side = self.side;
        self.set.place(&work.kernel, &placed, self.side, &mut work.psf.share);
        let square = h[0] * h[0] + h[1] * h[1];
        Focus { centre, transmission: lens.gain / (1.0 + self.config.falloff * square) }
    }

    fn moved(&self, change: &Change) -> Option<Box<dyn Lenses>> {
        let mut moved = self.clone();
        moved.change = change.clone();
        for (l, lens) in moved.lenses.iter_mut().enumerate() {
            lens.anchor_px = change.anchor_px(l, lens.anchor_px, self.plane.centre_px);
            lens.axis_um = self.plane.axis_um(lens.anchor_px);
        }
        Some(Box::new(moved))
    }

    fn refuses(&self, effect: &EffectSetting) -> Option<String> {
        let value = |name: &str| effect.params.get(name).map_or(0.0, |v| v.abs());
        // The farthest focus from an axis: across the object, from a lens on the other side.
        let corner_mm = 2e-3 * self.corner_um * self.plane.magnification;
        let moved_um = match effect.id.as_str() {
            "defocus" => value("z_um"),
            "tilt" => (value("row_um_per_mm") + value("col_um_per_mm")) * 1e-3 * self.corner_um,
            "field_curvature" => value("a_um_per_mm2") * corner_mm * corner_mm,
            _ => return super::without_pupils(effect),
        };
        let reach_um = reach_um(&self.config, &self.set);
        (moved_um > 0.0 && self.deepest_um + moved_um > reach_um).then(|| {
            format!("it moves sources by up to {moved_um:.0} um, and the PSFs reach {reach_um:.0} um from the focus")
        })
    }
}
