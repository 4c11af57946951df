//! Which instruments a study has: families in turn, and seeds for development apart from sealed ones.

use super::size::Size;
use ommatidia_bench::{BenchConfig, FamilyName, MeasuredPsfs, StackConfig};
use serde::{Deserialize, Serialize};

/// First instrument of a study on development seeds.
const FIRST: u64 = 1_000;
/// The n-th sealed study has instruments from n times this number on. No study has a million instruments, so none are
/// shared.
const SEALED: u64 = 1_000_000;
/// A study of unknown specimens has instruments of its own, which are so many numbers further on.
const OF_UNKNOWN: u64 = 500_000;
/// Every fourth instrument has a converter of 14 bits, for light of twenty thousand electrons.
const WIDE: u64 = 4;
/// Bits of such a converter.
const WIDE_BITS: u32 = 14;

/// A kind of instruments in the tables of a study.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// Diffraction at pupils.
    #[default]
    Pupils,
    /// Relays by traced rays.
    Relay,
    /// Kernels drawn at random.
    Kernels,
    /// Kernels that were measured.
    Measured,
}

impl Kind {
    /// The name in tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Pupils => "pupils",
            Self::Relay => "relay",
            Self::Kernels => "kernels, drawn",
            Self::Measured => "kernels, measured",
        }
    }
}

/// Kinds that a study has, in turn.
pub fn kinds(size: &Size) -> Vec<Kind> {
    let mut kinds = vec![Kind::Pupils, Kind::Relay, Kind::Kernels];
    if size.gentle {
        kinds.truncate(1);
    } else if size.measured.is_some() {
        kinds.push(Kind::Measured);
    }
    kinds
}

/// Kind of instrument `n`.
pub fn kind(size: &Size, n: u64) -> Kind {
    let kinds = kinds(size);
    kinds[(n % kinds.len() as u64) as usize]
}

/// Number that instrument `n` has in the virtual instrument's `--instrument`.
pub fn number(size: &Size, n: u64) -> u64 {
    let further = if size.is_of_unknown_specimens() { OF_UNKNOWN } else { 0 };
    let first = if size.sealed { SEALED * size.opening.max(1) as u64 } else { FIRST };
    first + further + n
}

/// Whether instrument `n` takes scenes of twenty thousand electrons.
pub fn is_wide(n: u64) -> bool {
    n % WIDE == WIDE - 1
}

/// Configuration of instrument `n`, as it measures the session that it is calibrated from.
///
/// # Errors
/// The measured PSFs cannot be read.
pub fn config(size: &Size, n: u64) -> anyhow::Result<BenchConfig> {
    if size.gentle {
        return Ok(gentle(n));
    }
    let family = match kind(size, n) {
        Kind::Pupils => FamilyName::Pupils,
        Kind::Relay => FamilyName::Relay,
        Kind::Kernels | Kind::Measured => FamilyName::Kernels,
    };
    let measured = size.measured.as_ref().filter(|_| kind(size, n) == Kind::Measured);
    let measured = measured.map(|m| MeasuredPsfs { paths: m.paths.clone(), stack_of: m.stack_of });
    let mut c = BenchConfig::drawn(family, number(size, n), measured.as_ref())?;
    if is_wide(n) {
        let before = c.full_scale_e();
        c.sensor.bit_depth = WIDE_BITS;
        let more = c.full_scale_e() / before;
        // The scenes stay as bright as they are with other converters; beads and flats use the range.
        c.stacks.scene_peak = c.stacks.scene_peak.map(|share| share / more);
        c.scan.bead_e *= more;
    }
    Ok(c)
}

/// A gentle instrument with pupils, for a check that `close` and the study work: weak light and a fine scan, so that
/// the errors of the calibration stay below the noise.
pub fn gentle(n: u64) -> BenchConfig {
    let mut c = BenchConfig { instrument_seed: 500 + n, ..BenchConfig::default() };
    (c.sensor.rows, c.sensor.cols) = (98, 98);
    c.array.pitch_px = 26.0;
    (c.object.rows, c.object.cols) = (30, 30);
    c.optics.psf_field_px = 23;
    c.optics.aperture_um = 28.9;
    c.optics.object_distance_um = 300.0;
    c.optics.distortion_px = 0.05;
    c.aberrations.field_curvature = 0.05;
    c.aberrations.astigmatism = 0.04;
    c.aberrations.coma = 0.035;
    (c.scan.rows, c.scan.cols) = (11, 11);
    c.scan.depths_um = vec![-60.0, 0.0, 60.0];
    c.scan.bead_e = 80_000.0;
    c.stacks = StackConfig::of_a_study();
    c.stacks.scene_peak = [0.05, 0.18];
    c
}
