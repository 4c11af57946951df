//! Checks the configuration of the virtual instrument.

use super::config::BenchConfig;
use super::error::BenchError;

impl BenchConfig {
    /// Checks the numbers that neither the manifest nor the pupil checks.
    ///
    /// # Errors
    /// Names the first impossible number.
    pub(super) fn check(&self) -> Result<(), BenchError> {
        let wrong =
            |field, expected: &str, found: String| Err(BenchError::Config { field, expected: expected.into(), found });
        let (sensor, optics, stacks) = (&self.sensor, &self.optics, &self.stacks);
        for (field, v) in [
            ("sensor.gain_dn_per_e", sensor.gain_dn_per_e),
            ("optics.object_distance_um", optics.object_distance_um),
            ("optics.half_response_tangent", optics.half_response_tangent),
            ("optics.magnification_error", 1.0 + self.optics.magnification_error),
            ("scan.bead_e", self.scan.bead_e),
            ("stacks.exposure_ms", stacks.exposure_ms),
        ] {
            if !(v.is_finite() && v > 0.0) {
                return wrong(field, "a number above zero", v.to_string());
            }
        }
        for (field, v) in [
            ("sensor.black_level_dn", sensor.black_level_dn),
            ("sensor.read_noise_e", sensor.read_noise_e),
            ("sensor.offset_rms_dn", sensor.offset_rms_dn),
            ("sensor.prnu_rms", sensor.prnu_rms),
            ("array.placement_rms_px", self.array.placement_rms_px),
            ("aberrations.scatter", self.aberrations.scatter),
            ("aberrations.tilt_scatter", self.aberrations.tilt_scatter),
            ("stacks.interval_ms", stacks.interval_ms),
        ] {
            if !(v.is_finite() && v >= 0.0) {
                return wrong(field, "a number, zero or more", v.to_string());
            }
        }
        if !(1..=16).contains(&sensor.bit_depth) {
            return wrong("sensor.bit_depth", "1 to 16", sensor.bit_depth.to_string());
        }
        if self.full_scale_e().is_nan() || self.full_scale_e() <= 0.0 {
            return wrong("sensor.black_level_dn", "less than the highest code", sensor.black_level_dn.to_string());
        }
        if optics.psf_field_px < optics.psf_window_px {
            return wrong("optics.psf_field_px", "at least psf_window_px", optics.psf_field_px.to_string());
        }
        for (field, n) in [
            ("scan.rows", self.scan.rows),
            ("scan.cols", self.scan.cols),
            ("scan.depths_um", self.scan.depths_um.len()),
            ("stacks.dark_frames", stacks.dark_frames),
            ("stacks.flat_frames", stacks.flat_frames),
            ("stacks.scene_frames", stacks.scene_frames),
            ("stacks.scene_depths_um", stacks.scene_depths_um.len()),
            ("stacks.flat_levels", stacks.flat_levels.len()),
        ] {
            if n == 0 {
                return wrong(field, "one or more", "0".into());
            }
        }
        for (field, exposures) in [
            ("stacks.dark_exposures_ms", &stacks.dark_exposures_ms),
            ("stacks.flat_exposures_ms", &stacks.flat_exposures_ms),
        ] {
            if let Some(v) = exposures.iter().find(|v| !(v.is_finite() && **v > 0.0)) {
                return wrong(field, "numbers above zero", v.to_string());
            }
        }
        for (field, depths) in
            [("scan.depths_um", &self.scan.depths_um), ("stacks.scene_depths_um", &stacks.scene_depths_um)]
        {
            if let Some(z) = depths.iter().find(|z| !z.is_finite()) {
                return wrong(field, "finite depths", z.to_string());
            }
        }
        let [low, high] = stacks.scene_peak;
        if !(low > 0.0 && high >= low && high.is_finite()) {
            return wrong("stacks.scene_peak", "two ascending shares above zero", format!("{:?}", stacks.scene_peak));
        }
        match stacks.flat_levels.iter().find(|l| !(l.is_finite() && **l >= 0.0)) {
            Some(level) => wrong("stacks.flat_levels", "shares of full scale, zero or more", level.to_string()),
            None => Ok(()),
        }
    }
}
