//! The values of frames: bit depth, saturation, black level, light levels, background, and what is missing.

use super::scan::{median, middle};
use super::{Finding, Severity};
use ndarray::Array2;
use ommatidia_physics::sensor::constant_dn;
use ommatidia_session::{Cut, FrameInfo, Role, Session, SessionError, Stack};

/// Frames of a stack that are read, evenly spread.
const SAMPLED: usize = 24;
/// Largest share of a frame's pixels at the highest code that is a remark rather than a warning.
const FEW: f64 = 1e-3;
/// Spread of the light of flats of one declared level, relative, that a lamp does not explain.
const ONE_LEVEL: f64 = 0.1;

/// Figures of one frame, DN.
#[derive(Clone, Copy, Debug)]
pub struct FrameLevel {
    /// Mean of the measured pixels.
    pub mean: f64,
    /// Median of the measured pixels.
    pub median: f64,
    /// Exposure, ms, and relative light of its row.
    pub dose: [f64; 2],
}

/// Figures of one stack.
#[derive(Clone, Debug)]
pub struct StackLevels {
    /// Its file.
    pub file: String,
    /// Its role.
    pub role: Role,
    /// Number of frames whose data are whole.
    pub count: usize,
    /// Frames that were sampled. Constant ones are left out, except of darks: a black level may lie below 0 DN.
    pub frames: Vec<FrameLevel>,
    /// Frames that were looked at for constant ones.
    pub looked: usize,
    /// Frames whose pixels all have one value below saturation: index, and the value, DN.
    pub constant: Vec<(usize, f32)>,
    /// Smallest and largest value, DN.
    pub range: [f32; 2],
    /// Share of the pixels at or above the highest code that the manifest allows.
    pub saturated: f64,
    /// Share of the pixels at the largest value, where that is below the highest code.
    pub at_top: f64,
    /// Largest power of two that divides every value; 1 where values are not whole.
    pub step: u32,
}

impl StackLevels {
    /// Whether all of its frames that were looked at are constant.
    pub fn is_constant(&self) -> bool {
        self.constant.len() == self.looked
    }
}

/// Reads a sample of all stacks and looks at the values.
///
/// # Errors
/// A frame cannot be read.
pub fn look(session: &Session, step: &mut dyn FnMut()) -> Result<(Vec<Finding>, Vec<StackLevels>), SessionError> {
    let top = session.manifest().sensor.saturation_dn() as f32;
    let whole = !session.is_computed();
    let levels = session.stacks().iter().map(|s| read(s, top, whole, step)).collect::<Result<Vec<_>, _>>()?;
    let mut findings = Vec::new();
    for level in &levels {
        findings.extend(codes(level, session));
    }
    findings.extend(black(&levels, session.manifest().sensor.saturation_dn()));
    findings.extend(flats(&levels));
    Ok((findings, levels))
}

/// Most pixels of a stack that are read for constant frames; of a longer one the sample is looked at. Bead frames are
/// read up to this number in any case.
fn most_px(role: Role) -> usize {
    if role == Role::Bead { 1 << 30 } else { 1 << 28 }
}

/// Reads a sample of a stack. All of its frames are looked at for constant ones, if that is wanted and it is not too
/// long.
fn read(stack: &Stack, top: f32, whole: bool, step: &mut dyn FnMut()) -> Result<StackLevels, SessionError> {
    let mut reader = stack.frames()?;
    let mut found = StackLevels {
        file: stack.entry().file.clone(),
        role: stack.role(),
        count: stack.whole().count(),
        frames: Vec::new(),
        looked: 0,
        constant: Vec::new(),
        range: [f32::INFINITY, f32::NEG_INFINITY],
        saturated: 0.0,
        at_top: 0.0,
        step: 0,
    };
    let (mut pixels, mut divisor, mut tops) = (0.0, 0u32, 0.0);
    let mut usable: Vec<&FrameInfo> = stack.whole().collect();
    if usable.is_empty() {
        usable = stack.info().iter().collect();
    }
    let sampled = sample(usable.len());
    let all = whole && usable.len() * reader.rows() * reader.cols() <= most_px(stack.role());
    let looked = if all { (0..usable.len()).collect() } else { sampled.clone() };
    found.looked = looked.len();
    for (n, info) in looked.into_iter().map(|n| (n, usable[n])) {
        let frame: Array2<f32> = reader.read(info.frame)?;
        let cut = if stack.role() == Role::Bead { Cut::of(&frame) } else { None };
        let measured = |(r, c): (usize, usize)| cut.as_ref().is_none_or(|cut| cut.holds(r, c));
        let mut values: Vec<f32> = frame.indexed_iter().filter(|(at, _)| measured(*at)).map(|(_, v)| *v).collect();
        step();
        if let Some(value) = constant_dn(values.iter()).filter(|v| *v < top) {
            found.constant.push((info.frame, value));
            if stack.role() != Role::Dark {
                continue;
            }
        }
        if !sampled.contains(&n) {
            continue;
        }
        for v in &values {
            if *v > found.range[1] {
                tops = 0.0;
            }
            found.range = [found.range[0].min(*v), found.range[1].max(*v)];
            found.saturated += f64::from(u8::from(*v >= top));
            tops += f64::from(u8::from(*v == found.range[1]));
            let whole = v.fract() == 0.0 && *v >= 0.0 && *v < 4e9;
            divisor |= if whole { *v as u32 } else { 1 };
        }
        pixels += values.len() as f64;
        let mean = values.iter().map(|v| f64::from(*v)).sum::<f64>() / values.len().max(1) as f64;
        let middle = f64::from(median(&mut values));
        found.frames.push(FrameLevel { mean, median: middle, dose: [info.exposure_ms, info.illumination] });
    }
    found.saturated /= f64::max(pixels, 1.0);
    found.at_top = tops / f64::max(pixels, 1.0);
    found.step = if divisor == 0 { 1 } else { 1 << divisor.trailing_zeros() };
    Ok(found)
}

/// Frames that `import` found damaged, by the column `data` of their table.
pub fn damaged(session: &Session) -> Vec<Finding> {
    let what = "calibrate, evaluate, residual and close leave them out; reconstruct takes them like the others";
    let of_stack = |stack: &Stack| {
        let unknown = stack.info().iter().find_map(|info| Some((info.frame, info.unknown_data()?)));
        let unknown = unknown.map(|(frame, word)| {
            format!(
                "{}: frame {frame} has `{word}` in column `data` of its table, which says nothing: write `whole` or \
                 `damaged`",
                stack.path().display()
            )
        });
        let texts = [stack.damaged_note(what), unknown];
        texts.into_iter().flatten().map(|text| Finding::new("damaged frames", Severity::Warning, text))
    };
    session.stacks().iter().flat_map(of_stack).collect()
}

/// Indices of at most [`SAMPLED`] frames of `count`, the first and the last among them.
fn sample(count: usize) -> Vec<usize> {
    let n = count.min(SAMPLED);
    let mut all: Vec<usize> = (0..n).map(|i| if n > 1 { i * (count - 1) / (n - 1) } else { 0 }).collect();
    all.dedup();
    all
}

/// Bit depth, scale and saturation of a stack.
fn codes(s: &StackLevels, session: &Session) -> Vec<Finding> {
    let bits = session.manifest().sensor.bit_depth;
    let top = session.manifest().sensor.saturation_dn() as f32;
    let [low, high] = s.range;
    let file = &s.file;
    let one = |topic, severity, text: String| vec![Finding::new(topic, severity, text)];
    // Frames of one value say nothing of a scale; darks of one value are named as such.
    if s.frames.is_empty() || s.is_constant() {
        return Vec::new();
    }
    if high <= 1.0 && s.role != Role::Dark {
        let text = format!(
            "{file}: all values lie between {low} and {high}: the frames look scaled to 0..1. Write raw digital numbers"
        );
        return one("scale", Severity::Error, text);
    }
    if s.step > 1 && high > top {
        let shift = s.step.trailing_zeros();
        let text = format!(
            "{file}: values reach {high} DN, but {bits} bits end at {top}; all values are multiples of {}: the frames \
             look shifted left by {shift} bits. Divide them by {} (or set sensor.bit_depth = {}; the gain is then {} \
             times as large)",
            s.step,
            s.step,
            bits + shift,
            s.step
        );
        return one("bit depth", Severity::Error, text);
    }
    if high > top {
        let needed = (f64::from(high) + 1.0).log2().ceil();
        let text = format!(
            "{file}: values reach {high} DN, but sensor.bit_depth = {bits} ends at {top}: set sensor.bit_depth = \
             {needed}, or correct the frames"
        );
        return one("bit depth", Severity::Error, text);
    }
    if s.step > 1 {
        let text = format!(
            "{file}: all values are multiples of {}: the frames look shifted left by {} bits, or were scaled. Divide \
             them by {}, with sensor.bit_depth to match",
            s.step,
            s.step.trailing_zeros(),
            s.step
        );
        return one("bit depth", Severity::Warning, text);
    }
    if s.role != Role::Dark && s.saturated > 0.5 {
        let text = format!("{file}: {:.0} % of all pixels are saturated: measure with less light", 100.0 * s.saturated);
        return one("saturation", Severity::Error, text);
    }
    if s.saturated > FEW && s.role != Role::Dark {
        let text = format!(
            "{file}: {:.2} % of the pixels are saturated ({top} DN): less light or a shorter exposure avoids this",
            100.0 * s.saturated
        );
        return one("saturation", Severity::Warning, text);
    }
    // Many pixels at exactly the largest value, far below the end of the range: another converter's end.
    let code = (f64::from(high) + 1.0).log2();
    if s.at_top > 1e-4 && code.fract() == 0.0 && high < 0.6 * top && high >= 255.0 && s.role != Role::Dark {
        let text = format!(
            "{file}: {:.2} % of the pixels have the largest value, {high} DN, the end of {code} bits: set \
             sensor.bit_depth = {code} (it is {bits}); these pixels are saturated",
            100.0 * s.at_top
        );
        return one("bit depth", Severity::Error, text);
    }
    Vec::new()
}

/// Range of the middle levels of darks of one exposure from which on they hold light: relative to their level, to full
/// scale, and in DN, since the levels of 8-bit cameras are a few whole numbers.
const LIT: [f64; 3] = [0.2, 0.005, 8.0];

/// Darks of one exposure that differ much from each other.
fn lit_dark(s: &StackLevels, top_dn: f64) -> Option<Finding> {
    let of = |exposure_ms: f64| s.frames.iter().filter(move |f| f.dose[0] == exposure_ms).map(|f| f.median);
    let range = |exposure_ms: f64| {
        let (low, high) = of(exposure_ms).fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
        [low, high]
    };
    let ranges = s.frames.iter().map(|f| range(f.dose[0]));
    let [low, high] = ranges.max_by(|a, b| (a[1] - a[0]).total_cmp(&(b[1] - b[0])))?;
    (high - low > (LIT[0] * low.abs()).max(LIT[1] * top_dn).max(LIT[2])).then(|| {
        let text = format!(
            "{}: the middle levels of darks of one exposure reach from {low:.1} to {high:.1} DN: light fell on them \
             (are they flats or scenes?), or the sensor warmed up. Measure them again, or leave them out of \
             session.toml",
            s.file
        );
        Finding::new("black level", Severity::Error, text)
    })
}

/// Levels of frames with light against those of the darks. `top_dn` is full scale.
fn black(levels: &[StackLevels], top_dn: f64) -> Vec<Finding> {
    let darks: Vec<&StackLevels> = levels.iter().filter(|s| s.role == Role::Dark).collect();
    if darks.is_empty() {
        return Vec::new();
    }
    // Darks of the exposure with the least level: dark current adds to the others.
    let mut by_exposure: Vec<(f64, Vec<f64>)> = Vec::new();
    for f in darks.iter().flat_map(|s| &s.frames) {
        match by_exposure.iter_mut().find(|(exposure_ms, _)| *exposure_ms == f.dose[0]) {
            Some((_, levels)) => levels.push(f.median),
            None => by_exposure.push((f.dose[0], vec![f.median])),
        }
    }
    let mean = |levels: &[f64]| levels.iter().sum::<f64>() / levels.len().max(1) as f64;
    let least = by_exposure.iter().map(|(_, levels)| levels).min_by(|a, b| mean(a).total_cmp(&mean(b)));
    let Some(dark) = least else { return Vec::new() };
    let black = mean(dark);
    let noise = dark.iter().fold(0.0f64, |m, v| m.max((v - black).abs())).max(1.0);
    let lit_darks: Vec<Finding> = darks.iter().filter_map(|s| lit_dark(s, top_dn)).collect();
    if !lit_darks.is_empty() {
        return lit_darks;
    }
    let mut findings = Vec::new();
    for s in levels.iter().filter(|s| s.role != Role::Dark && !s.frames.is_empty()) {
        let medians: Vec<f64> = s.frames.iter().map(|f| f.median).collect();
        let lowest = medians.iter().copied().fold(f64::INFINITY, f64::min);
        // More than any drift of a black level: half of it is gone.
        if lowest < black - 6.0 * noise && lowest < 0.5 * black {
            let text = format!(
                "{}: the middle level of a frame is {lowest:.1} DN, that of the darks {black:.1} DN: the dark frames \
                 look subtracted already, or the darks are no darks (flats or scenes in their place?). Write raw \
                 frames, or leave out the darks and write none that were subtracted",
                s.file
            );
            findings.push(Finding::new("black level", Severity::Error, text));
        } else if lowest < black - 6.0 * noise {
            let text = format!(
                "{}: frames lie up to {:.1} DN below the black level of the darks ({black:.1} DN): the black level \
                 drifts, or darks and frames have other settings. Measure the darks with the settings of the frames",
                s.file,
                black - lowest
            );
            findings.push(Finding::new("black level", Severity::Warning, text));
        }
        if s.role == Role::Bead && findings.is_empty() {
            let middle = middle(&medians);
            let text = if middle - black > 3.0 * noise {
                format!(
                    "{}: the middle level is {:.1} DN above that of the darks: a background",
                    s.file,
                    middle - black
                )
            } else {
                format!("{}: the level between the foci is that of the darks ({black:.1} DN)", s.file)
            };
            findings.push(Finding::new("black level", Severity::Ok, text));
        }
    }
    findings
}

/// Flats of several levels without a table that says so.
fn flats(levels: &[StackLevels]) -> Vec<Finding> {
    let dark: Vec<f64> =
        levels.iter().filter(|s| s.role == Role::Dark).flat_map(|s| s.frames.iter().map(|f| f.mean)).collect();
    let black = dark.iter().sum::<f64>() / dark.len().max(1) as f64;
    let mut findings = Vec::new();
    for s in levels.iter().filter(|s| s.role == Role::Flat) {
        let mut doses: Vec<[f64; 2]> = s.frames.iter().map(|f| f.dose).collect();
        doses.sort_by(|a, b| a.partial_cmp(b).unwrap_or(std::cmp::Ordering::Equal));
        doses.dedup();
        for dose in doses {
            let light: Vec<f64> = s.frames.iter().filter(|f| f.dose == dose).map(|f| f.mean - black).collect();
            let (low, high) = light.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(*v), h.max(*v)));
            let mean = light.iter().sum::<f64>() / light.len() as f64;
            if light.len() > 1 && high - low > ONE_LEVEL * mean.abs().max(1.0) {
                let text = format!(
                    "{}: frames of one declared light level ({} ms, illumination {}) range from {low:.0} to {high:.0} \
                     DN above black: several levels count as one, and the gain would be wrong. Give each frame its \
                     relative light in a table, column `illumination` (or exposure_ms)",
                    s.file, dose[0], dose[1]
                );
                findings.push(Finding::new("flats", Severity::Error, text));
                break;
            }
        }
    }
    findings
}

/// Largest relative difference between a pixel size that a file states and one of the manifest.
const SAME_SIZE: f64 = 0.02;

/// The pixel size that a TIFF states, against the manifest. A file may state the pixel of the sensor, or that pixel as
/// seen in the object.
///
/// # Errors
/// A stack cannot be opened.
pub fn pixel_sizes(session: &Session) -> Result<Vec<Finding>, SessionError> {
    let m = session.manifest();
    let (sensor, object) = (m.sensor.pixel_pitch_um, m.sensor.pixel_pitch_um / m.optics.magnification);
    let mut findings = Vec::new();
    for stack in session.stacks() {
        let Some(pixel_um) = stack.frames()?.scale().pixel_um else { continue };
        let fits = |um: f64| pixel_um.iter().all(|v| (v / um - 1.0).abs() < SAME_SIZE);
        if !(fits(sensor) || fits(object)) {
            let [y, x] = pixel_um;
            let text = format!(
                "{} says that a pixel is {x} x {y} um; session.toml says {sensor} um on the sensor, which is \
                 {object:.3} um in the object. Correct sensor.pixel_pitch_um or optics.magnification, or the file's \
                 metadata (binned or rescaled frames?)",
                stack.entry().file
            );
            findings.push(Finding::new("pixel size", Severity::Warning, text));
        }
    }
    Ok(findings)
}

/// What is there and what is missing.
pub fn counts(session: &Session, levels: &[StackLevels]) -> Vec<Finding> {
    let count = |role: Role| levels.iter().filter(|s| s.role == role).map(|s| s.count).sum::<usize>();
    let [dark, flat, bead, scene] = [Role::Dark, Role::Flat, Role::Bead, Role::Scene].map(count);
    let damaged = session.stacks().iter().flat_map(|s| s.info()).filter(|info| info.is_damaged()).count();
    let apart = if damaged > 0 { format!(", and {damaged} damaged frames") } else { String::new() };
    let text = format!("{dark} darks, {flat} flats, {bead} beads, {scene} scenes{apart}");
    let mut findings = vec![Finding::new("counts", Severity::Ok, text)];
    let mut lacks = |text: &str| findings.push(Finding::new("counts", Severity::Warning, text));
    if dark < 2 {
        lacks("fewer than two dark frames: black level, read noise and fixed pattern are guesses. Measure ten or more");
    }
    let doses = session
        .stacks_of(Role::Flat)
        .flat_map(|s| s.info().iter().map(|i| (i.illumination * i.exposure_ms).to_bits()))
        .collect::<std::collections::BTreeSet<_>>();
    if doses.len() < 2 {
        lacks(
            "fewer than two light levels of flats: the gain is a guess. Measure several, with two frames or more each",
        );
    }
    if bead > 0 && bead < 25 {
        lacks("fewer than 25 bead positions: PSFs between them are guesses. Scan 5 x 5 positions or more");
    }
    findings
}
