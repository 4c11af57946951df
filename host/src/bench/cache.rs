//! Foci that are kept: where no effect moves the rays, the foci of the object pixels and of the bead scan are those of the instrument at
//! rest, whatever it is that it measures.
//!
//! Computing a focus is by far most of the work of a scene. Instruments of one build with other effects share what is kept.

use super::config::{AberrationConfig, ArrayConfig, BenchConfig, ObjectConfig, OpticsConfig};
use super::optics::{Focus, Point, VirtualOptics};
use std::sync::OnceLock;

/// Most memory for kept foci of the object, bytes; and as much for those of the scan.
const LIMIT_BYTES: usize = 600_000_000;

/// Foci of many points through one lens.
#[derive(Debug)]
pub(super) struct Foci {
    /// Side of a PSF, pixels.
    pub side: usize,
    /// One a point.
    pub focus: Vec<Focus>,
    /// Shares of the light, one PSF a point.
    pub share: Vec<f32>,
}

impl Foci {
    /// Focus and PSF of a point.
    pub(super) fn get(&self, point: usize) -> Option<(Focus, &[f32])> {
        let len = self.side * self.side;
        Some((*self.focus.get(point)?, self.share.get(point * len..(point + 1) * len)?))
    }
}

/// All that foci depend on.
#[derive(Clone, Debug, PartialEq)]
struct Build {
    instrument_seed: u64,
    sensor: ([usize; 2], f64),
    array: ArrayConfig,
    optics: OpticsConfig,
    aberrations: AberrationConfig,
    object: ObjectConfig,
    scene_z_um: Option<f64>,
    scan: [usize; 2],
    depths_um: Vec<f64>,
}

/// Kept foci by lens; each lens is computed when it is first asked for.
#[derive(Debug)]
pub(super) struct FocusCache {
    build: Build,
    object: Vec<OnceLock<Foci>>,
    scan: Vec<OnceLock<Foci>>,
}

impl FocusCache {
    /// Nothing kept yet; nothing ever, where it would take too much memory.
    pub(super) fn new(config: &BenchConfig) -> Self {
        let (lenses, side) = (config.array.rows * config.array.cols, config.optics.psf_field_px);
        let slots = |points: usize| {
            let bytes = points.saturating_mul(lenses).saturating_mul(side * side * size_of::<f32>());
            let kept = if bytes <= LIMIT_BYTES { lenses } else { 0 };
            (0..kept).map(|_| OnceLock::new()).collect()
        };
        let scan = &config.scan;
        Self {
            object: slots(config.object.rows.saturating_mul(config.object.cols)),
            scan: slots(scan.rows.saturating_mul(scan.cols).saturating_mul(scan.depths_um.len())),
            build: build_of(config),
        }
    }

    /// Whether an instrument of this configuration has the same foci.
    pub(super) fn fits(&self, config: &BenchConfig) -> bool {
        self.build == build_of(config)
    }

    /// Foci of the object's pixels, row by row. None: too many to keep.
    pub(super) fn object(&self, l: usize, optics: &VirtualOptics, points: impl Fn() -> Vec<Point>) -> Option<&Foci> {
        kept(&self.object, l, optics, points)
    }

    /// Foci of the bead scan in the order of its frames. None: too many to keep.
    pub(super) fn scan(&self, l: usize, optics: &VirtualOptics, points: impl Fn() -> Vec<Point>) -> Option<&Foci> {
        kept(&self.scan, l, optics, points)
    }
}

fn kept<'a>(
    slots: &'a [OnceLock<Foci>],
    l: usize,
    optics: &VirtualOptics,
    points: impl Fn() -> Vec<Point>,
) -> Option<&'a Foci> {
    let slot = slots.get(l)?;
    if slot.get().is_none() {
        // Not inside the lock: the threads that compute may take up another session that waits for the same lens. Should two compute
        // it, both have the same bits.
        let foci = optics.foci(l, &points());
        slot.set(foci).ok();
    }
    slot.get()
}

fn build_of(config: &BenchConfig) -> Build {
    let sensor = &config.sensor;
    Build {
        instrument_seed: config.instrument_seed,
        sensor: ([sensor.rows, sensor.cols], sensor.pixel_pitch_um),
        array: config.array.clone(),
        optics: config.optics.clone(),
        aberrations: config.aberrations.clone(),
        object: config.object.clone(),
        scene_z_um: config.stacks.scene_depths_um.first().copied(),
        scan: [config.scan.rows, config.scan.cols],
        depths_um: config.scan.depths_um.clone(),
    }
}
