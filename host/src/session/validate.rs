//! Parses a manifest and refuses sizes that cannot be.

use super::{Manifest, Role, SessionError};
use std::path::Path;

/// Version of the session format that this program reads and writes.
const FORMAT: u32 = 1;

impl Role {
    /// Name in the manifest.
    pub fn name(self) -> &'static str {
        match self {
            Self::Dark => "dark",
            Self::Flat => "flat",
            Self::Bead => "bead",
            Self::Scene => "scene",
        }
    }
}

impl Manifest {
    /// Parses and checks the text of `path`.
    ///
    /// # Errors
    /// No valid TOML, another format version, an unknown or missing key, or a size that cannot be.
    pub fn parse(path: &Path, text: &str) -> Result<Self, SessionError> {
        let syntax = |e: toml::de::Error| SessionError::Manifest { path: path.into(), detail: e.to_string() };
        // The version first: a later format may have keys that this program does not know.
        let raw: toml::Table = text.parse().map_err(syntax)?;
        let found = raw.get("format");
        if found.and_then(toml::Value::as_integer) != Some(i64::from(FORMAT)) {
            let found = found.map_or("none".into(), ToString::to_string);
            return Err(SessionError::Version { path: path.into(), expected: FORMAT, found });
        }
        let manifest: Self = toml::from_str(text).map_err(syntax)?;
        manifest.check(path)?;
        Ok(manifest)
    }

    /// Checks that each size can be, and that they agree with one another.
    ///
    /// # Errors
    /// The first one that cannot be; `path` is the file that is blamed.
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
        let least = if array.lenses() > 1 { f64::MIN_POSITIVE } else { 0.0 };
        if !(array.pitch_px.is_finite() && array.pitch_px >= least) {
            let expected = "the distance of neighbouring chief rays, sensor pixels";
            return Err(SessionError::value(path, "array.pitch_px", expected, array.pitch_px, fix));
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
            // A dark may be a bias frame, exposed for no time at all.
            let possible = exposure.is_finite() && (exposure > 0.0 || (exposure == 0.0 && stack.role == Role::Dark));
            if !possible {
                let field = format!("stack {i} (`{}`), exposure_ms", stack.file);
                return Err(SessionError::value(path, field, "a number above zero", exposure, "correct the manifest"));
            }
        }
        Ok(())
    }
}

/// One object pixel maps to one sensor pixel; figures in a manifest are rounded.
const PIXEL_TOLERANCE: f64 = 0.02;

/// No sensor is wider; beyond it a size is a slip of the pen.
const MAX_SIDE: usize = 1 << 20;
