//! Noise from frames: black level and read noise from darks, gain by photon transfer from flats.
//!
//! Photon transfer (Janesick, *Photon Transfer*, SPIE 2007): over frames of the same light the variance of a pixel is
//! `var = gain * (mean - black) + read^2 + 1/12`; taking it pixel by pixel over time keeps the fixed pattern out. The last
//! term is the rounding to whole DN. Lamp flicker moves all pixels together: its variance is measured on the frame means and
//! taken off.

mod reading;
mod response;
mod video;

use super::stats::{PixelStats, Summary};
use super::{NoiseModel, Source, Sources};
use crate::linalg::NotConverged;
use crate::session::{Role, Session, SessionError, Stack};
use ndarray::Array2;
use response::{Level, ResponseSums};
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Variance of rounding to whole DN, DN^2.
pub const ROUNDING_DN2: f64 = 1.0 / 12.0;
/// Error that is allowed for beside counting statistics (nonlinearity, drift), relative to each level's variance.
const MODEL_ERROR: f64 = 2e-3;

/// Share of a scene's pixels that are taken for dark where nothing else tells the black level.
const DARKEST: f64 = 1e-3;

/// Values that are assumed where a session cannot tell them.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct NoiseConfig {
    /// Gain, DN per electron, where there are no flats.
    pub nominal_gain_dn_per_e: f64,
    /// Read noise, electrons rms, where nothing shows it.
    pub nominal_read_noise_e: f64,
}

impl Default for NoiseConfig {
    fn default() -> Self {
        Self { nominal_gain_dn_per_e: 1.0, nominal_read_noise_e: 2.0 }
    }
}

/// What the maps of a sensor leave of its true patterns, rms over the pixels; 0 where there is no map.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MapErrors {
    /// Of the offsets, DN.
    pub offset_dn: f64,
    /// Of the responses, relative.
    pub response: f64,
}

/// What the frames say of the sensor.
#[derive(Clone, Debug)]
pub struct NoiseCalibration {
    /// The figures.
    pub model: NoiseModel,
    /// Offset of each pixel from the black level, DN, [sensor rows, sensor cols]; None: no darks.
    pub offset_dn: Option<Array2<f32>>,
    /// Response of each pixel relative to the mean, [sensor rows, sensor cols]; None: the flats show no spread beyond their noise,
    /// or there are no darks to tell it from offsets.
    pub response: Option<Array2<f32>>,
    /// Variance of the reading of each pixel, rounding included, DN^2, [sensor rows, sensor cols]; None: the pixels are alike, or there
    /// are too few darks to tell.
    pub reading_dn2: Option<Array2<f32>>,
    /// What these maps leave of the true patterns.
    pub left: MapErrors,
    /// Photon transfer, [level, (mean above black, variance, fitted variance)], DN and DN^2.
    pub photon_transfer: Array2<f32>,
    /// Figures that the session cannot tell, and what follows.
    pub notes: Vec<NoiseNote>,
}

/// A pixel whose reading scatters this many times as much as the common one is of no use in a focus.
const USELESS: f32 = 5.0;
/// Nor is one that answers to light with less than this share of the mean, or with more than the other.
const ANSWERS: std::ops::Range<f32> = 0.5..2.0;

impl NoiseCalibration {
    /// Pixels that say nothing of a focus: telegraph and hot ones, whose readings scatter far more than those of the others, and dead ones,
    /// [sensor rows, sensor cols]; None: there are none.
    pub fn useless(&self) -> Option<Array2<bool>> {
        let common_dn2 = self.model.variance_dn2(self.model.black_level_dn) as f32;
        let noisy = self.reading_dn2.as_ref().map(|map| map.mapv(|v| v > USELESS * USELESS * common_dn2));
        let dead = self.response.as_ref().map(|map| map.mapv(|r| !ANSWERS.contains(&r)));
        let both = match (noisy, dead) {
            (Some(a), Some(b)) => Some(&a | &b),
            (a, b) => a.or(b),
        };
        both.filter(|map| map.iter().any(|useless| *useless))
    }
}

/// A figure that the session cannot tell, and what follows.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum NoiseNote {
    /// No darks.
    #[error(
        "no dark frames: black level {black_level_dn:.2} DN is the median of the bead frames and holds any stray light; \
         no per-pixel offsets are corrected"
    )]
    NoDarks {
        /// The value that is used.
        black_level_dn: f64,
    },
    /// Neither darks nor beads.
    #[error(
        "no dark frames and no bead frames: black level {black_level_dn:.2} DN is the {percent} % quantile of the scenes, a guess that \
         holds whatever light is everywhere; no per-pixel offsets are corrected"
    )]
    GuessedBlack {
        /// The value that is used.
        black_level_dn: f64,
        /// The quantile.
        percent: f64,
    },
    /// Single dark frame.
    #[error("only one dark frame at each exposure: the read noise cannot be told from the fixed pattern")]
    OneDark,
    /// No flats that identify the gain.
    #[error(
        "gain is nominal, {gain_dn_per_e} DN/e- ({reason}): light in electrons, drawn noise and chi2 scale with it; \
         geometry, PSFs and predictions in DN do not depend on it. Measure flats at several light levels, two frames or more each, \
         or give --gain"
    )]
    NominalGain {
        /// The value that is used.
        gain_dn_per_e: f64,
        /// What is missing.
        reason: &'static str,
    },
    /// Gain from a video.
    #[error(
        "gain {gain_dn_per_e:.3} +- {sigma:.3} DN/e- is from differences of the scenes' frames (no flats): it holds as far as the \
         specimen keeps still. Measure flats at several light levels, two frames or more each, or give --gain"
    )]
    GainOfVideo {
        /// The value that is used.
        gain_dn_per_e: f64,
        /// Its standard error.
        sigma: f64,
    },
    /// Nothing shows the read noise.
    #[error(
        "read noise is nominal, {read_noise_e} e-: noise drawn in dark parts and the weights of faint light depend on it. \
         Measure two dark frames or more, or give --read-noise"
    )]
    NominalReadNoise {
        /// The value that is used.
        read_noise_e: f64,
    },
    /// Read noise known in DN only.
    #[error("read noise {read_noise_dn:.3} DN is measured; in electrons it rests on the nominal gain")]
    ReadNoiseInDn {
        /// Read noise, DN rms.
        read_noise_dn: f64,
    },
}

/// Why the noise cannot be measured.
#[derive(Debug, Error)]
pub enum NoiseError {
    /// The session.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// The numbers.
    #[error(transparent)]
    NotConverged(#[from] NotConverged),
    /// A nominal value makes no sense.
    #[error("{field}: expected a finite value above zero, found {found}")]
    Nominal {
        /// Which.
        field: &'static str,
        /// What was given.
        found: f64,
    },
    /// Flats and darks contradict one another.
    #[error(
        "{path}: photon transfer: expected the variance to grow with the light, found a slope of {slope:.4} +- {sigma:.4} DN/e-; \
         check that the levels in the table are right, and that flats are raw and unsaturated"
    )]
    Slope {
        /// The flats.
        path: std::path::PathBuf,
        /// Fitted slope.
        slope: f64,
        /// Its standard error.
        sigma: f64,
    },
}

/// What the darks say, DN.
struct Dark {
    black: f64,
    offset: Array2<f32>,
    level: Option<Summary>,
    frames: f64,
    offset_left_dn: f64,
    reading_dn2: Option<Array2<f32>>,
}

/// Measures the noise of a session's sensor. `step` is called once a frame.
///
/// # Errors
/// A frame cannot be read, or flats show no photon transfer.
pub fn measure_noise(
    session: &Session,
    config: &NoiseConfig,
    mut step: impl FnMut(),
) -> Result<NoiseCalibration, NoiseError> {
    for (field, found) in
        [("nominal_gain_dn_per_e", config.nominal_gain_dn_per_e), ("nominal_read_noise_e", config.nominal_read_noise_e)]
    {
        if !(found.is_finite() && found > 0.0) {
            return Err(NoiseError::Nominal { field, found });
        }
    }
    let saturation_dn = session.manifest().sensor.saturation_dn();
    let mut notes = Vec::new();
    let dark = measure_darks(session, saturation_dn, &mut step)?;
    if dark.as_ref().is_some_and(|d| d.level.is_none()) {
        notes.push(NoiseNote::OneDark);
    }
    let mut background = None;
    let black = if let Some(dark) = &dark {
        dark.black
    } else if session.stacks_of(Role::Bead).next().is_some() {
        let seen = background.insert(background_of_beads(session, &mut step)?);
        notes.push(NoiseNote::NoDarks { black_level_dn: seen.median });
        seen.median
    } else {
        let black_level_dn = darkest(session)?;
        notes.push(NoiseNote::GuessedBlack { black_level_dn, percent: 100.0 * DARKEST });
        black_level_dn
    };
    let dark_level = dark.as_ref().and_then(|d| d.level);
    let Flats { levels, response } = measure_flats(session, black, dark.as_ref(), saturation_dn, &mut step)?;
    let mut transfer = Transfer::fit(&levels, dark_level);
    // A gain that the user gave is better than one from a specimen.
    let given = config.nominal_gain_dn_per_e != NoiseConfig::default().nominal_gain_dn_per_e;
    let mut of_video = false;
    if transfer.is_err()
        && !given
        && let Some(found) = video::transfer(session, black, saturation_dn)?
    {
        notes.push(NoiseNote::GainOfVideo { gain_dn_per_e: found.slope, sigma: found.slope_sigma });
        (transfer, of_video) = (Ok(found), true);
    }
    let mut sources =
        Sources { black_level: dark.as_ref().map_or(Source::Inferred, |_| Source::Measured), ..Sources::default() };
    let (gain, gain_sigma) = gain(session, &transfer, config, &mut sources, &mut notes)?;
    if of_video {
        sources.gain = Source::Inferred;
    }
    let (read_noise_e, read_noise_sigma) = read_noise(
        ReadNoise { dark: dark_level, transfer: transfer.as_ref().ok(), background, gain: (gain, gain_sigma) },
        config,
        &mut sources,
        &mut notes,
    );
    let model = NoiseModel {
        black_level_dn: black,
        gain_dn_per_e: gain,
        gain_sigma,
        read_noise_e,
        read_noise_sigma,
        saturation_dn,
        sources,
    };
    let photon_transfer = curve(&levels, dark_level, &transfer);
    let left = MapErrors {
        offset_dn: dark.as_ref().map_or(0.0, |d| d.offset_left_dn),
        response: response.as_ref().map_or(0.0, |(_, left)| *left),
    };
    let (offset_dn, reading_dn2) = dark.map_or((None, None), |d| (Some(d.offset), d.reading_dn2));
    Ok(NoiseCalibration {
        model,
        offset_dn,
        reading_dn2,
        response: response.map(|(map, _)| map),
        left,
        photon_transfer,
        notes,
    })
}

fn gain(
    session: &Session,
    transfer: &Result<Transfer, &'static str>,
    config: &NoiseConfig,
    sources: &mut Sources,
    notes: &mut Vec<NoiseNote>,
) -> Result<(f64, f64), NoiseError> {
    match transfer {
        Ok(t) if t.slope > 3.0 * t.slope_sigma => {
            sources.gain = Source::Measured;
            Ok((t.slope, t.slope_sigma))
        }
        Ok(t) => {
            let path = session.stacks_of(Role::Flat).next().map(Stack::path).unwrap_or_default();
            Err(NoiseError::Slope { path, slope: t.slope, sigma: t.slope_sigma })
        }
        Err(reason) => {
            let gain_dn_per_e = config.nominal_gain_dn_per_e;
            notes.push(NoiseNote::NominalGain { gain_dn_per_e, reason });
            Ok((gain_dn_per_e, 0.0))
        }
    }
}

/// What the read noise may be taken from, best first: darks, the photon transfer at no light, the dark parts of bead frames.
struct ReadNoise<'a> {
    dark: Option<Summary>,
    transfer: Option<&'a Transfer>,
    background: Option<Background>,
    /// Gain and its standard error, DN/e-.
    gain: (f64, f64),
}

/// Read noise and its standard error, electrons.
fn read_noise(
    from: ReadNoise<'_>,
    config: &NoiseConfig,
    sources: &mut Sources,
    notes: &mut Vec<NoiseNote>,
) -> (f64, f64) {
    let rounded = from.dark.map(|d| (d.variance, d.sigma));
    let fitted = from.transfer.map(|t| (t.intercept + ROUNDING_DN2, t.intercept_sigma));
    let seen = from.background.map(|b| (b.variance, 0.0));
    let (variance, sigma) = rounded.or(fitted).or(seen).unwrap_or((0.0, 0.0));
    let read_dn2 = variance - ROUNDING_DN2;
    if read_dn2 <= 0.0 {
        notes.push(NoiseNote::NominalReadNoise { read_noise_e: config.nominal_read_noise_e });
        return (config.nominal_read_noise_e, 0.0);
    }
    let measured = from.dark.is_some() && sources.gain == Source::Measured;
    sources.read_noise = if measured { Source::Measured } else { Source::Inferred };
    if sources.gain == Source::Nominal {
        notes.push(NoiseNote::ReadNoiseInDn { read_noise_dn: read_dn2.sqrt() });
    }
    let (gain, gain_sigma) = from.gain;
    let relative = (sigma / (2.0 * read_dn2)).hypot(gain_sigma / gain);
    (read_dn2.sqrt() / gain, relative * read_dn2.sqrt() / gain)
}

/// Black level, offsets and dark variance, from the exposure with most dark frames.
fn measure_darks(session: &Session, saturation_dn: f64, step: &mut impl FnMut()) -> Result<Option<Dark>, NoiseError> {
    let groups = groups(session, Role::Dark);
    let Some(group) = groups.iter().max_by_key(|g| g.frames.len()) else {
        return Ok(None);
    };
    let stats = read_group(session, Role::Dark, group, step)?;
    let level = stats.summary(0.0, None, saturation_dn);
    let (black, offset, offset_left_dn) = stats.offsets(level.map(|l| l.variance));
    let frames = group.frames.len() as f64;
    let level = level.map(|l| Summary { mean: 0.0, ..l });
    let reading_dn2 = level.and_then(|_| {
        let (variances, freedom) = stats.variances();
        reading::by_pixel(&variances, freedom)
    });
    Ok(Some(Dark { black, offset, level, frames, offset_left_dn, reading_dn2 }))
}

/// What the flats say.
struct Flats {
    /// Mean and variance of each light level, from darkest to brightest; levels of one frame or in saturation are left out.
    levels: Vec<Summary>,
    /// Response of each pixel; None without darks, since offsets would pass for it.
    response: Option<(Array2<f32>, f64)>,
}

fn measure_flats(
    session: &Session,
    black: f64,
    dark: Option<&Dark>,
    saturation_dn: f64,
    step: &mut impl FnMut(),
) -> Result<Flats, NoiseError> {
    let (mut levels, mut sums) = (Vec::new(), ResponseSums::default());
    let without_light = dark.and_then(|d| d.level).map(|l| l.variance);
    for group in groups(session, Role::Flat) {
        let stats = read_group(session, Role::Flat, &group, step)?;
        let Some(summary) = stats.summary(black, dark.map(|d| &d.offset), saturation_dn) else { continue };
        levels.push(summary);
        if let (Some(dark), Some(dark_dn2)) = (dark, without_light) {
            let light_dn = stats.light(black, &dark.offset, saturation_dn);
            let level = Level { light_dn: &light_dn, frames: group.frames.len() as f64, summary };
            // A level darker than its own noise divides by nothing.
            if summary.mean > 0.0 && summary.mean * summary.mean > summary.variance {
                sums.add(&level, dark_dn2)?;
            }
        }
    }
    levels.sort_by(|a, b| a.mean.total_cmp(&b.mean));
    let response = dark.zip(without_light).and_then(|(d, dark_dn2)| sums.finish(dark_dn2 / d.frames));
    Ok(Flats { levels, response })
}

/// Frames of one exposure and light level: (stack, frame).
struct Group {
    frames: Vec<(usize, usize)>,
}

fn groups(session: &Session, role: Role) -> Vec<Group> {
    let mut keyed: Vec<([f64; 2], Group)> = Vec::new();
    for (s, stack) in session.stacks_of(role).enumerate() {
        for info in stack.info() {
            let key = [info.exposure_ms, if role == Role::Dark { 0.0 } else { info.illumination }];
            match keyed.iter_mut().find(|(k, _)| *k == key) {
                Some((_, g)) => g.frames.push((s, info.frame)),
                None => keyed.push((key, Group { frames: vec![(s, info.frame)] })),
            }
        }
    }
    keyed.into_iter().map(|(_, g)| g).collect()
}

fn read_group(session: &Session, role: Role, group: &Group, step: &mut impl FnMut()) -> Result<PixelStats, NoiseError> {
    let mut readers = session.stacks_of(role).map(Stack::frames).collect::<Result<Vec<_>, _>>()?;
    let sensor = session.manifest().sensor;
    let mut stats = PixelStats::new([sensor.rows, sensor.cols]);
    for (s, frame) in &group.frames {
        stats.add(&readers[*s].read(*frame)?);
        step();
    }
    Ok(stats)
}

/// What the dark parts of the bead frames say.
#[derive(Clone, Copy)]
struct Background {
    median: f64,
    variance: f64,
}

/// A low quantile of the scenes, DN; 0 where there are none.
fn darkest(session: &Session) -> Result<f64, NoiseError> {
    let mut least = f64::INFINITY;
    for stack in session.stacks_of(Role::Scene) {
        let mut frames = stack.frames()?;
        for i in (0..stack.len()).step_by(stack.len().div_ceil(9).max(1)) {
            let mut values: Vec<f32> = frames.read(i)?.into_iter().collect();
            let at = (values.len() as f64 * DARKEST) as usize;
            least = least.min(f64::from(*values.select_nth_unstable_by(at, f32::total_cmp).1));
        }
    }
    Ok(if least.is_finite() { least } else { 0.0 })
}

/// Median of bead frames, and the variance of what lies below it (which no focus touches).
fn background_of_beads(session: &Session, step: &mut impl FnMut()) -> Result<Background, NoiseError> {
    let (mut medians, mut variances) = (Vec::new(), Vec::new());
    if let Some(stack) = session.stacks_of(Role::Bead).next() {
        let mut frames = stack.frames()?;
        for i in (0..stack.len()).step_by(stack.len().div_ceil(9)) {
            let mut values: Vec<f32> = frames.read(i)?.into_iter().collect();
            let middle = values.len() / 2;
            let median = f64::from(*values.select_nth_unstable_by(middle, f32::total_cmp).1);
            let below = values[..middle].iter().map(|v| (f64::from(*v) - median).powi(2)).sum::<f64>();
            medians.push(median);
            variances.push(below / middle.max(1) as f64);
            step();
        }
    }
    let middle = |v: &mut Vec<f64>| {
        v.sort_by(f64::total_cmp);
        v.get(v.len() / 2).copied().unwrap_or(0.0)
    };
    Ok(Background { median: middle(&mut medians), variance: middle(&mut variances) })
}

/// `variance - 1/12 = slope * mean + intercept`, weighted.
struct Transfer {
    slope: f64,
    slope_sigma: f64,
    intercept: f64,
    intercept_sigma: f64,
}

impl Transfer {
    fn fit(levels: &[Summary], dark: Option<Summary>) -> Result<Self, &'static str> {
        if levels.is_empty() {
            return Err("no flats with two unsaturated frames or more at one light level");
        }
        let points: Vec<Summary> = dark.into_iter().chain(levels.iter().copied()).collect();
        let range = points.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |r, p| [r[0].min(p.mean), r[1].max(p.mean)]);
        if points.len() < 2 || range[1] - range[0] <= 0.1 * range[1].abs() {
            return Err("the flats have one light level and there are no darks to set against it");
        }
        let mut s = [0.0; 5];
        for p in &points {
            let w = 1.0 / (p.sigma.powi(2) + (MODEL_ERROR * p.variance.max(ROUNDING_DN2)).powi(2));
            let y = p.variance - ROUNDING_DN2;
            for (sum, v) in s.iter_mut().zip([w, w * p.mean, w * p.mean * p.mean, w * y, w * p.mean * y]) {
                *sum += v;
            }
        }
        let determinant = s[0] * s[2] - s[1] * s[1];
        Ok(Self {
            slope: (s[0] * s[4] - s[1] * s[3]) / determinant,
            slope_sigma: (s[0] / determinant).sqrt(),
            intercept: (s[2] * s[3] - s[1] * s[4]) / determinant,
            intercept_sigma: (s[2] / determinant).sqrt(),
        })
    }
}

fn curve(levels: &[Summary], dark: Option<Summary>, transfer: &Result<Transfer, &'static str>) -> Array2<f32> {
    let points: Vec<Summary> = dark.into_iter().chain(levels.iter().copied()).collect();
    let fitted = |p: &Summary| transfer.as_ref().map_or(p.variance, |t| t.slope * p.mean + t.intercept + ROUNDING_DN2);
    Array2::from_shape_fn((points.len(), 3), |(i, c)| {
        [points[i].mean, points[i].variance, fitted(&points[i])][c] as f32
    })
}

#[cfg(test)]
mod tests;
