//! Parses a manifest and rejects impossible sizes.

use super::error::SessionError;
use super::manifest::{ArrayGeometry, Manifest, Role, SensorSpec, StackEntry};
use std::path::Path;

/// Wavelengths that a session may state, um: from the ultraviolet to the near infrared.
const LIGHT_UM: std::ops::RangeInclusive<f64> = 0.2..=2.0;
/// Version of the session format that this program reads and writes.
const FORMAT: u32 = 1;

impl Role {
    /// Name of the role in the manifest.
    pub fn name(self) -> &'static str {
        match self {
            Self::Dark => "dark",
            Self::Flat => "flat",
            Self::Bead => "bead",
            Self::Scene => "scene",
        }
    }
}

/// Checks the nominal places of lenses. The error says what is expected of them.
fn check_places(places: &[[f64; 2]], array: &ArrayGeometry, sensor: &SensorSpec) -> Result<(), String> {
    if places.len() != array.lenses() {
        return Err(format!(
            "one place for each of rows x cols = {} x {} lenses (rows = 1 and cols = {} where they form no grid)",
            array.rows,
            array.cols,
            places.len()
        ));
    }
    let inside = |v: f64, n: usize| (0.0..n as f64).contains(&v);
    if !places.iter().all(|p| inside(p[0], sensor.rows) && inside(p[1], sensor.cols)) {
        return Err(format!("[row, col] on the sensor of {} x {} pixels", sensor.rows, sensor.cols));
    }
    let close = |a: &[f64; 2], b: &[f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]) < 0.5 * array.pitch_px;
    if places.iter().enumerate().any(|(i, a)| places[..i].iter().any(|b| close(a, b))) {
        return Err(format!("places at least half of array.pitch_px = {} apart", array.pitch_px));
    }
    Ok(())
}

impl Manifest {
    /// Parses and checks `text`, the content of the manifest at `path`.
    ///
    /// # Errors
    /// The text is not valid TOML, has another format version, an unknown key, a missing key, or an impossible size.
    pub fn parse(path: &Path, text: &str) -> Result<Self, SessionError> {
        let syntax = |e: toml::de::Error| SessionError::Manifest { path: path.into(), detail: e.to_string() };
        // The version is checked first: a later format may have keys that this program does not know.
        let raw: toml::Table = text.parse().map_err(syntax)?;
        let found = raw.get("format");
        if found.and_then(toml::Value::as_integer) != Some(i64::from(FORMAT)) {
            let found = found.map_or("no version".into(), ToString::to_string);
            return Err(SessionError::Version { path: path.into(), expected: FORMAT, found });
        }
        let manifest: Self = toml::from_str(text).map_err(syntax)?;
        manifest.check(path)?;
        Ok(manifest)
    }

    /// Checks that each size is possible and that the sizes agree with each other.
    ///
    /// # Errors
    /// Names the first impossible size; `path` is the file in the message.
    pub fn check(&self, path: &Path) -> Result<(), SessionError> {
        let (sensor, array, optics, object) = (&self.sensor, &self.array, &self.optics, &self.object);
        let fix = "correct the manifest";
        for (field, n) in [
            ("sensor.rows", sensor.rows),
            ("sensor.cols", sensor.cols),
            ("array.rows", array.rows),
            ("array.cols", array.cols),
            ("object.rows", object.rows),
            ("object.cols", object.cols),
        ] {
            if n == 0 || n > MAX_SIDE {
                return Err(SessionError::value(path, field, format!("1 to {MAX_SIDE}"), n, fix));
            }
        }
        for (field, v) in [
            ("sensor.pixel_pitch_um", sensor.pixel_pitch_um),
            ("optics.magnification", optics.magnification),
            ("object.pixel_um", object.pixel_um),
        ] {
            if !(v.is_finite() && v > 0.0) {
                return Err(SessionError::value(path, field, "a number above zero", v, fix));
            }
        }
        if let Some(v) = optics.wavelength_um.filter(|v| !LIGHT_UM.contains(v)) {
            let expected = format!("a wavelength of {} to {} um", LIGHT_UM.start(), LIGHT_UM.end());
            return Err(SessionError::value(path, "optics.wavelength_um", expected, v, fix));
        }
        let least = if array.lenses() > 1 { f64::MIN_POSITIVE } else { 0.0 };
        if !(array.pitch_px.is_finite() && array.pitch_px >= least) {
            let above = if array.lenses() > 1 { "above zero" } else { "zero or more" };
            let expected = format!("the distance between neighbouring chief rays in sensor pixels, {above}");
            return Err(SessionError::value(path, "array.pitch_px", expected, array.pitch_px, fix));
        }
        if let Some(places) = &array.lenses_px {
            check_places(places, array, sensor).map_err(|expected| {
                SessionError::value(path, "array.lenses_px", expected, format!("{places:?}"), fix)
            })?;
        }
        if !(1..=32).contains(&sensor.bit_depth) {
            return Err(SessionError::value(path, "sensor.bit_depth", "1 to 32", sensor.bit_depth, fix));
        }
        let window = optics.psf_window_px;
        if window % 2 == 0 || window > sensor.rows.min(sensor.cols) {
            let expected = "an odd number no larger than the frame";
            return Err(SessionError::value(path, "optics.psf_window_px", expected, window, fix));
        }
        let pixel_um = sensor.pixel_pitch_um / optics.magnification;
        if (object.pixel_um / pixel_um - 1.0).abs() > PIXEL_TOLERANCE {
            let expected = format!("pixel_pitch_um / magnification = {pixel_um:.4}");
            return Err(SessionError::value(path, "object.pixel_um", expected, object.pixel_um, fix));
        }
        self.check_stacks(path)
    }

    fn check_stacks(&self, path: &Path) -> Result<(), SessionError> {
        for (i, stack) in self.stacks.iter().enumerate() {
            let exposure = stack.exposure_ms;
            // A dark may be a bias frame, with an exposure of zero.
            let possible = exposure.is_finite() && (exposure > 0.0 || (exposure == 0.0 && stack.role == Role::Dark));
            if !possible {
                let field = format!("stack {i} (`{}`), exposure_ms", stack.file);
                let expected = if stack.role == Role::Dark { "zero or more" } else { "a number above zero" };
                return Err(SessionError::value(path, field, expected, exposure, "correct the manifest"));
            }
            self.check_registration(path, i, stack)?;
        }
        Ok(())
    }

    /// The registration of a truth needs a truth, and cannot be off by more than the object.
    fn check_registration(&self, path: &Path, i: usize, stack: &StackEntry) -> Result<(), SessionError> {
        let (px, most) = (stack.truth_registration_px, self.object.rows.max(self.object.cols) as f64);
        let field = |name: &str| format!("stack {i} (`{}`), {name}", stack.file);
        if !(0.0..most).contains(&px) {
            let expected = format!("object pixels, zero or more and below {most}");
            return Err(SessionError::value(
                path,
                field("truth_registration_px"),
                expected,
                px,
                "correct the manifest",
            ));
        }
        if px > 0.0 && stack.truth.is_none() {
            let fix = "name the file of the truth, or delete the line";
            return Err(SessionError::value(path, field("truth_registration_px"), "a stack with `truth`", px, fix));
        }
        if stack.truth_registration_per_frame && px == 0.0 {
            let (name, expected) = ("truth_registration_per_frame", "truth_registration_px above zero beside it");
            return Err(SessionError::value(path, field(name), expected, true, "state how well the truths are placed"));
        }
        Ok(())
    }
}

/// Allowed relative difference between `object.pixel_um` and pixel pitch over magnification: manifests hold rounded
/// values.
const PIXEL_TOLERANCE: f64 = 0.02;

/// Largest number of rows or columns; a larger value is taken for a typing error.
const MAX_SIDE: usize = 1 << 20;
