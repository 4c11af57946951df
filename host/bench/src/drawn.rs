//! Instruments drawn at random: small enough that a session takes seconds, as strongly aberrated as the demo and
//! stronger.
//!
//! Everything that differs from one instrument to the next is drawn: the places of the lenses, magnification, aperture,
//! aberrations, distortion, vignetting, gain, black level, read noise and fixed patterns of the sensor, and the light.

use super::config::{BenchConfig, StackConfig};
use super::error::BenchError;
use super::family::config::{FamilyName, StackOf};
use super::family::{self, Moved};
use super::foci::Point;
use ommatidia_session::rng;
use rand::RngExt;
use serde::{Deserialize, Serialize};

/// Share of full scale that the brightest pixel of a bead reaches.
const BEAD_PEAK: f64 = 0.7;

/// Measured PSFs for an instrument of the family `kernels`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct MeasuredPsfs {
    /// Files, or folders of files.
    pub paths: Vec<String>,
    /// What the frames of a file are.
    pub stack_of: StackOf,
}

impl BenchConfig {
    /// Instrument `number` of a family, 3 x 3 lenses on 98 x 98 pixels, as it measures a session to be calibrated from:
    /// darks at two exposures, flats at three levels and two exposures, a bead scan of 11 x 11 positions at three
    /// depths
    /// (at one, if measured PSFs have no depth) and eight scenes.
    ///
    /// # Errors
    /// Measured PSFs cannot be read.
    pub fn drawn(family: FamilyName, number: u64, measured: Option<&MeasuredPsfs>) -> Result<Self, BenchError> {
        let mut rng = rng::stream(number, &format!("bench/drawn/{family}"), 0);
        let mut between = |low: f64, high: f64| rng.random_range(low..high);
        let mut c = Self { family, instrument_seed: number, ..Self::default() };
        (c.sensor.rows, c.sensor.cols) = (98, 98);
        c.sensor.gain_dn_per_e = between(0.3, 0.6);
        c.sensor.black_level_dn = between(48.0, 160.0);
        c.sensor.read_noise_e = between(1.2, 3.5);
        c.sensor.prnu_rms = between(0.001, 0.006);
        c.sensor.offset_rms_dn = between(0.5, 2.0);
        c.array.pitch_px = between(25.0, 27.0);
        c.array.placement_rms_px = between(0.1, 1.2);
        (c.object.rows, c.object.cols) = (30, 30);
        c.optics.object_distance_um = 300.0;
        c.optics.magnification = between(0.62, 0.7);
        // The grid of the manifest: one object pixel for each sensor pixel.
        c.object.pixel_um = c.sensor.pixel_pitch_um / c.optics.magnification;
        c.optics.magnification_error = between(-0.006, 0.006);
        let lens_pitch_um = c.array.pitch_px * c.sensor.pixel_pitch_um / (1.0 + c.optics.magnification);
        c.optics.aperture_um = lens_pitch_um * between(0.75, 0.99);
        c.optics.distortion_px = between(-0.15, 0.15);
        c.optics.half_response_tangent = between(0.24, 0.4);
        c.optics.psf_window_px = 21;
        c.optics.psf_field_px = 27;
        // From half of the demo's aberrations to half as much again; single terms vary about that.
        let strength = between(0.5f64.ln(), 1.2f64.ln()).exp();
        let a = &mut c.aberrations;
        for term in [&mut a.defocus, &mut a.spherical, &mut a.field_curvature, &mut a.astigmatism, &mut a.coma] {
            *term *= strength * between(0.7, 1.3);
        }
        a.scatter *= strength;
        a.tilt_scatter *= strength;
        let r = &mut c.relay;
        for term in [&mut r.spherical, &mut r.coma, &mut r.astigmatism, &mut r.field_curvature] {
            *term *= strength * between(0.7, 1.3);
        }
        r.scatter *= strength;
        r.distortion_px = between(-0.4, 0.4);
        r.stop_walk = between(0.0, 0.35);
        r.stop_radius = between(0.95, 1.1);
        let k = &mut c.kernels;
        k.rms_px = between(1.5, 2.4);
        k.count = 2 + (between(0.0, 3.0) as usize);
        k.lobes = 3 + (between(0.0, 5.0) as usize);
        k.lobe_px = between(0.55, 0.8);
        k.turn_rad_per_um = between(0.003, 0.008);
        k.morph *= strength;
        k.turn_rad *= strength;
        k.stretch *= strength;
        k.warp_px *= strength;
        k.falloff = between(0.1, 0.5);
        (c.scan.rows, c.scan.cols) = (11, 11);
        c.scan.depths_um = vec![-60.0, 0.0, 60.0];
        if let Some(measured) = measured {
            c.kernels.psfs = measured.paths.clone();
            c.kernels.stack_of = measured.stack_of;
            if measured.stack_of == StackOf::Field {
                c.scan.depths_um = vec![0.0];
            }
        }
        c.stacks = StackConfig::of_a_study();
        let light = between(0.6f64.ln(), 2.5f64.ln()).exp();
        c.stacks.scene_peak = [0.06 * light, 0.2 * light];
        c.scan.bead_e = BEAD_PEAK * c.full_scale_e() / c.brightest()?;
        Ok(c)
    }

    /// Largest share of a bead's light in one pixel, over the middle and the corners of the object and all lenses.
    fn brightest(&self) -> Result<f64, BenchError> {
        let lenses = family::build(self)?;
        let mut work = lenses.work();
        let mut most = f64::MIN_POSITIVE;
        let half = [self.object.rows, self.object.cols].map(|n| (n as f64 - 1.0) / 2.0 * self.object.pixel_um);
        for l in 0..lenses.anchors_px().len() {
            for place in 0..9 {
                let at_um = [(place / 3) as f64 - 1.0, (place % 3) as f64 - 1.0];
                let point = Point { at_um: [at_um[0] * half[0], at_um[1] * half[1]], z_um: 0.0 };
                let focus = lenses.focus(l, point, Moved::default(), &mut work);
                let peak = work.psf.share.iter().fold(0.0f32, |m, v| m.max(*v));
                most = most.max(focus.transmission * f64::from(peak));
            }
        }
        Ok(most)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn every_instrument_is_another_one_and_the_same_number_gives_the_same() {
        for family in FamilyName::ALL {
            let [a, b, again] = [1, 2, 1].map(|n| BenchConfig::drawn(family, n, None).unwrap());
            assert_eq!(a, again);
            assert!(a.sensor != b.sensor && a.optics != b.optics && a.stacks != b.stacks, "{family}");
            // The session is one that a calibration takes.
            a.manifest().check(std::path::Path::new("session.toml")).unwrap();
            assert!(a.build(&[]).unwrap().frames() > 400 && a.scan.bead_e > 1000.0);
        }
    }
}
