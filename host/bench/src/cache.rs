//! Stored foci of the object pixels and of the bead scan.
//!
//! Computing foci is most of the work of a scene. As long as no effect moves the chief rays, the foci are the same in
//! every measurement, so they are computed once. Instruments with the same optics and different effects share one
//! cache.

use super::config::{AberrationConfig, ArrayConfig, BenchConfig, ObjectConfig, OpticsConfig};
use super::family::config::{FamilyName, KernelsConfig, RelayConfig};
use super::foci::{Foci, Point};
use super::optics::VirtualOptics;
use std::sync::OnceLock;

/// Largest memory for the foci of the object, bytes, and again for those of the scan.
const LIMIT_BYTES: usize = 600_000_000;

/// Everything that the foci depend on.
#[derive(Clone, Debug, PartialEq)]
struct Build {
    instrument_seed: u64,
    sensor: ([usize; 2], f64),
    array: ArrayConfig,
    optics: OpticsConfig,
    aberrations: AberrationConfig,
    family: (FamilyName, RelayConfig, KernelsConfig),
    object: ObjectConfig,
    scene_z_um: Option<f64>,
    scan: [usize; 2],
    depths_um: Vec<f64>,
}

/// Stored foci by lens; those of a lens are computed on first use.
#[derive(Debug)]
pub(super) struct FocusCache {
    build: Build,
    object: Vec<OnceLock<Foci>>,
    scan: Vec<OnceLock<Foci>>,
}

impl FocusCache {
    /// An empty cache. It stays empty if the foci would need too much memory.
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

    /// Whether an instrument of this configuration has the same foci as the cache.
    pub(super) fn fits(&self, config: &BenchConfig) -> bool {
        self.build == build_of(config)
    }

    /// Foci of the object pixels through lens `l`, row by row; `None` if they need too much memory.
    pub(super) fn object(&self, l: usize, optics: &VirtualOptics, points: impl Fn() -> Vec<Point>) -> Option<&Foci> {
        kept(&self.object, l, optics, points)
    }

    /// Foci of the bead scan through lens `l`, in the order of its frames; `None` if they need too much memory.
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
        // Not inside the lock: a thread that computes may start another session that waits for the same lens. If two
        // threads compute the same foci, both get the same bits.
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
        family: (config.family, config.relay.clone(), config.kernels.clone()),
        object: config.object.clone(),
        scene_z_um: config.stacks.scene_depths_um.first().copied(),
        scan: [config.scan.rows, config.scan.cols],
        depths_um: config.scan.depths_um.clone(),
    }
}
