//! Measures the noise of a session's sensor.

use super::bend::Bend;
use super::calibration::{Estimate, MapErrors, NoiseCalibration, NoiseConfig};
use super::frames::{Background, DARKEST, background_of_beads, darkest, darks, groups, read_group};
use super::linearity::{LitLevel, Shown, bend};
use super::notes::{NoiseError, NoiseNote};
use super::reading::ReadingMap;
use super::response::{Level, ResponseMap, ResponseSums};
use super::transfer::{ROUNDING_DN2, Transfer, curve};
use super::{reading, video};
use crate::noise::model::{NoiseModel, Source, Sources};
use crate::noise::stats::{Offsets, Summary};
use ommatidia_session::{Role, Session, Stack};

/// Results from the darks, DN.
struct Dark {
    /// Black level and offsets.
    offsets: Offsets,
    /// Temporal variance without light; `None` for a single frame.
    level: Option<Summary>,
    /// Number of frames.
    frames: f64,
    /// Variance of each pixel, if the pixels differ.
    reading: Option<ReadingMap>,
}

/// Measures the noise of a session's sensor: black level, gain, read noise and pixel maps. `step` is called after each
/// frame that is read.
///
/// Values that the session does not determine are taken from `config`, and [`NoiseCalibration::notes`] lists them.
///
/// # Errors
/// A nominal value is not above zero, a frame cannot be read, or the variance of the flats does not grow with the
/// light.
pub fn measure_noise(
    session: &Session,
    config: &NoiseConfig,
    step: &mut dyn FnMut(),
) -> Result<NoiseCalibration, NoiseError> {
    for (field, found) in
        [("nominal_gain_dn_per_e", config.nominal_gain_dn_per_e), ("nominal_read_noise_e", config.nominal_read_noise_e)]
    {
        if let Some(found) = found.filter(|v| !(v.is_finite() && *v > 0.0)) {
            return Err(NoiseError::Nominal { field, found });
        }
    }
    let saturation_dn = session.manifest().sensor.saturation_dn();
    let mut notes = Vec::new();
    let dark = measure_darks(session, saturation_dn, step)?;
    if dark.as_ref().is_some_and(|d| d.level.is_none()) {
        notes.push(NoiseNote::OneDark);
    }
    let mut background = None;
    let black = if let Some(dark) = &dark {
        dark.offsets.black_dn
    } else if session.stacks_of(Role::Bead).next().is_some() {
        let seen = background.insert(background_of_beads(session, step)?);
        notes.push(NoiseNote::NoDarks { black_level_dn: seen.median });
        seen.median
    } else {
        let black_level_dn = darkest(session)?;
        notes.push(NoiseNote::GuessedBlack { black_level_dn, percent: 100.0 * DARKEST });
        black_level_dn
    };
    let dark_level = dark.as_ref().and_then(|d| d.level);
    let Flats { levels, response } = measure_flats(session, black, dark.as_ref(), saturation_dn, step)?;
    let (lit, levels): (Vec<LitLevel>, Vec<Summary>) = levels.into_iter().map(|l| (l, l.summary)).unzip();
    let bend = match bend(&lit, dark_level, saturation_dn - black) {
        Shown::Nothing => None,
        Shown::Bend(found) => Some(found),
        Shown::Levels(Bend { beta, sigma, .. }) => {
            notes.push(NoiseNote::Levels { bend: beta, sigma });
            None
        }
    };
    let mut transfer = Transfer::fit(&levels, dark_level, bend);
    let mut of_video = false;
    if transfer.is_err()
        && config.nominal_gain_dn_per_e.is_none()
        && let Some(found) = video::transfer(session, black, saturation_dn)?
    {
        notes.push(NoiseNote::GainOfVideo { gain_dn_per_e: found.slope, sigma: found.slope_sigma });
        (transfer, of_video) = (Ok(found), true);
    }
    let mut sources =
        Sources { black_level: dark.as_ref().map_or(Source::Inferred, |_| Source::Measured), ..Sources::default() };
    let gain = gain(session, &transfer, config, &mut sources, &mut notes)?;
    if of_video {
        sources.gain = Source::Inferred;
    }
    let read_noise = read_noise(
        ReadNoise { dark: dark_level, transfer: transfer.as_ref().ok(), of_video, background, gain },
        config,
        &mut sources,
        &mut notes,
    );
    let model = NoiseModel {
        black_level_dn: black,
        gain_dn_per_e: gain.value,
        gain_sigma: gain.sigma,
        read_noise_e: read_noise.value,
        read_noise_sigma: read_noise.sigma,
        saturation_dn,
        sources,
    };
    let photon_transfer = curve(&levels, dark_level, &transfer);
    let map_errors = MapErrors {
        offset_dn: dark.as_ref().map_or(0.0, |d| d.offsets.error_dn),
        response: response.as_ref().map_or(0.0, |r| r.error),
        reading: dark.as_ref().and_then(|d| d.reading.as_ref()).map_or(0.0, |r| r.error),
    };
    let (offset_dn, reading) = dark.map_or((None, None), |d| (Some(d.offsets.offset_dn), d.reading));
    Ok(NoiseCalibration {
        model,
        offset_dn,
        reading_dn2: reading.map(|r| r.variance_dn2),
        response: response.map(|r| r.response),
        bend,
        map_errors,
        photon_transfer,
        notes,
    })
}

/// Gain, DN per electron: the slope of the photon transfer, or the nominal value.
pub(super) fn gain(
    session: &Session,
    transfer: &Result<Transfer, &'static str>,
    config: &NoiseConfig,
    sources: &mut Sources,
    notes: &mut Vec<NoiseNote>,
) -> Result<Estimate, NoiseError> {
    match transfer {
        Ok(t) if t.slope > 3.0 * t.slope_sigma => {
            sources.gain = Source::Measured;
            let found = Estimate { value: t.slope, sigma: t.slope_sigma };
            if let Some(given_dn_per_e) = config.nominal_gain_dn_per_e.filter(|given| !found.agrees_with(*given)) {
                notes.push(NoiseNote::GivenGain { given_dn_per_e, gain_dn_per_e: found.value, sigma: found.sigma });
            }
            Ok(found)
        }
        Ok(t) => {
            let path = session.stacks_of(Role::Flat).next().map(Stack::path).unwrap_or_default();
            Err(NoiseError::Slope { path, slope: t.slope, sigma: t.slope_sigma })
        }
        Err(reason) => {
            let given = config.nominal_gain_dn_per_e;
            let gain_dn_per_e = given.unwrap_or(NoiseConfig::GAIN_DN_PER_E);
            notes.push(NoiseNote::NominalGain { gain_dn_per_e, reason, given: given.is_some() });
            Ok(Estimate { value: gain_dn_per_e, sigma: 0.0 })
        }
    }
}

/// Sources of the read noise, best first: darks, the photon transfer without light, the dark parts of bead frames. A
/// value that was given comes before those of a video and of bead frames, which show a specimen or stray light as well.
struct ReadNoise<'a> {
    dark: Option<Summary>,
    transfer: Option<&'a Transfer>,
    /// Whether the photon transfer is that of a video.
    of_video: bool,
    background: Option<Background>,
    /// Gain, DN per electron.
    gain: Estimate,
}

/// Read noise, electrons.
fn read_noise(
    from: ReadNoise<'_>,
    config: &NoiseConfig,
    sources: &mut Sources,
    notes: &mut Vec<NoiseNote>,
) -> Estimate {
    let rounded = from.dark.map(|d| (d.variance, d.sigma));
    let fitted = from.transfer.map(|t| (t.intercept + ROUNDING_DN2, t.intercept_sigma));
    let seen = from.background.map(|b| (b.variance, 0.0));
    let given = config.nominal_read_noise_e;
    let of_sensor = rounded.or(fitted.filter(|_| !from.of_video));
    let found = if given.is_some() { of_sensor } else { of_sensor.or(fitted).or(seen) };
    let (variance, sigma) = found.unwrap_or((0.0, 0.0));
    let read_dn2 = variance - ROUNDING_DN2;
    if read_dn2 <= 0.0 {
        let read_noise_e = given.unwrap_or(NoiseConfig::READ_NOISE_E);
        notes.push(NoiseNote::NominalReadNoise { read_noise_e, given: given.is_some() });
        return Estimate { value: read_noise_e, sigma: 0.0 };
    }
    let measured = from.dark.is_some() && sources.gain == Source::Measured;
    sources.read_noise = if measured { Source::Measured } else { Source::Inferred };
    if sources.gain == Source::Nominal {
        notes.push(NoiseNote::ReadNoiseInDn { read_noise_dn: read_dn2.sqrt() });
    }
    let gain = from.gain;
    let relative = (sigma / (2.0 * read_dn2)).hypot(gain.sigma / gain.value);
    let found = Estimate { value: read_dn2.sqrt() / gain.value, sigma: relative * read_dn2.sqrt() / gain.value };
    if let Some(given_e) = given.filter(|given| !found.agrees_with(*given)) {
        let frames = if from.dark.is_some() { "darks" } else { "flats" };
        notes.push(NoiseNote::GivenReadNoise { given_e, read_noise_e: found.value, sigma: found.sigma, frames });
    }
    found
}

/// Black level, offsets and dark variance; `None` without darks.
fn measure_darks(session: &Session, saturation_dn: f64, step: &mut dyn FnMut()) -> Result<Option<Dark>, NoiseError> {
    let Some(group) = darks(session) else { return Ok(None) };
    let stats = read_group(session, Role::Dark, &group, step)?;
    let level = stats.summary(0.0, None, saturation_dn);
    let offsets = stats.offsets(level.map(|l| l.variance));
    let frames = group.frames.len() as f64;
    let level = level.map(|l| Summary { mean: 0.0, ..l });
    let reading = level.and_then(|_| {
        let (variances, freedom) = stats.variances();
        reading::by_pixel(&variances, freedom)
    });
    Ok(Some(Dark { offsets, level, frames, reading }))
}

/// Results from the flats.
struct Flats {
    /// The light levels, darkest first. Levels with a single frame or in saturation are left out.
    levels: Vec<LitLevel>,
    /// Response of each pixel; `None` without darks, because offsets would look like responses.
    response: Option<ResponseMap>,
}

fn measure_flats(
    session: &Session,
    black: f64,
    dark: Option<&Dark>,
    saturation_dn: f64,
    step: &mut dyn FnMut(),
) -> Result<Flats, NoiseError> {
    let (mut levels, mut sums) = (Vec::new(), ResponseSums::default());
    let without_light = dark.and_then(|d| d.level).map(|l| l.variance);
    for group in groups(session, Role::Flat) {
        let stats = read_group(session, Role::Flat, &group, step)?;
        let Some(summary) = stats.summary(black, dark.map(|d| &d.offsets.offset_dn), saturation_dn) else { continue };
        levels.push(LitLevel { dose: group.dose, summary, mean_error_dn: stats.mean_error() });
        if let (Some(dark), Some(dark_dn2)) = (dark, without_light) {
            let light_dn = stats.light(black, &dark.offsets.offset_dn, saturation_dn);
            let level = Level { light_dn: &light_dn, frames: group.frames.len() as f64, summary };
            // A level below its own noise cannot be divided by.
            if summary.mean > 0.0 && summary.mean * summary.mean > summary.variance {
                sums.add(&level, dark_dn2)?;
            }
        }
    }
    levels.sort_by(|a, b| a.summary.mean.total_cmp(&b.summary.mean));
    let response = dark.zip(without_light).and_then(|(d, dark_dn2)| sums.finish(dark_dn2 / d.frames));
    Ok(Flats { levels, response })
}
