//! Lenses by diffraction: each has a pupil with Zernike aberrations that change over the field.

use super::lens::Lens;
use super::{Lenses, Moved, Work};
use crate::config::{BenchConfig, OpticsConfig};
use crate::error::BenchError;
use crate::foci::{Focus, Point};
use ommatidia_physics::effects::{EffectSetting, Ray};
use ommatidia_physics::optics::{MicrolensArray, OpticsError, Psf, Pupil, PupilConfig};

/// The lenses.
#[derive(Debug)]
pub(crate) struct Pupils {
    pupil: Pupil,
    array: MicrolensArray,
    lenses: Vec<Lens>,
    sensor: [usize; 2],
    /// Tangent of the field angle for which the configuration states aberrations.
    reference_tangent: f64,
    half_response_tangent: f64,
    distortion_px: f64,
    /// Defocus of a source at 1 um from the focal plane, waves rms.
    waves_per_um: f64,
}

impl Pupils {
    /// Builds the lenses and plans their pupil.
    ///
    /// # Errors
    /// A number of the configuration is impossible, or the aperture is wider than the distance of the lenses.
    pub(crate) fn build(config: &BenchConfig) -> Result<Self, BenchError> {
        let optics = &config.optics;
        let array = MicrolensArray {
            object_distance_um: optics.object_distance_um,
            magnification: config.true_magnification(),
            pixel_pitch_um: config.sensor.pixel_pitch_um,
        };
        let pupil = PupilConfig {
            wavelength_um: optics.wavelength_um,
            aperture_um: optics.aperture_um,
            distance_um: array.image_distance_um(),
            soft_edge: optics.soft_edge,
            pixel_um: config.sensor.pixel_pitch_um,
            oversampling: optics.oversampling,
            field_px: optics.psf_field_px,
        };
        let grid = config.manifest().object;
        let corner_um = (grid.rows as f64).hypot(grid.cols as f64) / 2.0 * grid.pixel_um;
        let lenses = config.places_px().into_iter().enumerate();
        Ok(Self {
            pupil: pupil.build()?,
            array,
            lenses: lenses.map(|(l, nominal)| Lens::manufacture(config, &array, l, nominal)).collect(),
            sensor: [config.sensor.rows, config.sensor.cols],
            reference_tangent: corner_um / optics.object_distance_um,
            half_response_tangent: optics.half_response_tangent,
            distortion_px: optics.distortion_px,
            waves_per_um: defocus_per_um(optics),
        })
    }
}

impl Pupils {
    /// The pupil whose PSFs are larger by a share: that of longer waves.
    fn grown(&self, growth: f64) -> Result<Pupil, OpticsError> {
        let config = self.pupil.config();
        PupilConfig { wavelength_um: config.wavelength_um * (1.0 + growth), ..*config }.build()
    }
}

impl Lenses for Pupils {
    fn side(&self) -> usize {
        self.pupil.config().field_px
    }

    fn anchors_px(&self) -> Vec<[f64; 2]> {
        self.lenses.iter().map(|l| l.anchor_px).collect()
    }

    fn axes_um(&self) -> Vec<[f64; 2]> {
        self.lenses.iter().map(|l| l.axis_um).collect()
    }

    /// By Eq. 1 of Yang et al. (2024).
    fn ray(&self, l: usize, at_um: [f64; 2]) -> Ray {
        let lens = &self.lenses[l];
        let scale = self.array.magnification / self.array.pixel_pitch_um;
        let centre = self.sensor.map(|n| (n as f64 - 1.0) / 2.0);
        Ray {
            lens: l,
            object_um: at_um,
            field_px: at_um.map(|v| v * scale),
            axis_px: [0, 1].map(|k| (at_um[k] - lens.axis_um[k]) * scale),
            anchor_px: [0, 1].map(|k| lens.anchor_px[k] - centre[k]),
            pixel_pitch_um: self.array.pixel_pitch_um,
            px_per_um: scale,
        }
    }

    fn focus_px(&self, l: usize, point: Point, moved: Moved) -> [f64; 2] {
        let lens = &self.lenses[l];
        let h = self.array.tangents(lens.axis_um, point.at_um).map(|t| t / self.reference_tangent);
        let square = h[0] * h[0] + h[1] * h[1];
        let ray = self.array.chief_ray_px(lens.anchor_px, point.at_um);
        [0, 1].map(|k| ray[k] + self.distortion_px * square * h[k] + moved.shift.px[k])
    }

    fn focus(&self, l: usize, point: Point, moved: Moved, work: &mut Work) -> Focus {
        let lens = &self.lenses[l];
        let tangents = self.array.tangents(lens.axis_um, point.at_um);
        let h = tangents.map(|t| t / self.reference_tangent);
        let (centre, shift) = super::split(self.focus_px(l, point, moved));
        let mut wavefront = lens.wavefront(h);
        wavefront.coefficient.iter_mut().zip(moved.wavefront.coefficient).for_each(|(c, v)| *c += v);
        wavefront.coefficient[3] += self.waves_per_um * (point.z_um + moved.shift.z_um);
        let Work { psf, pupil, grown, .. } = work;
        if moved.shift.growth != 0.0 && grown.as_ref().is_none_or(|(growth, ..)| *growth != moved.shift.growth) {
            *grown = self.grown(moved.shift.growth).ok().map(|pupil| {
                let scratch = pupil.scratch();
                (moved.shift.growth, pupil, scratch)
            });
        }
        match grown.as_mut().filter(|_| moved.shift.growth != 0.0) {
            Some((_, larger, scratch)) => larger.psf(&wavefront, shift, scratch, psf),
            None => self.pupil.psf(&wavefront, shift, pupil.get_or_insert_with(|| self.pupil.scratch()), psf),
        }
        let tangent = tangents[0].hypot(tangents[1]);
        let cos4 = (1.0 + tangent * tangent).powi(-2);
        let response = 1.0 / (1.0 + (tangent / self.half_response_tangent).powi(4));
        Focus { centre, transmission: cos4 * response }
    }

    fn refuses(&self, effect: &EffectSetting) -> Option<String> {
        let growth = match effect.id.as_str() {
            "spectral_shift" => effect.params.get("change"),
            "magnification" => effect.params.get("eps"),
            _ => None,
        };
        let error = self.grown(*growth?).err()?;
        Some(format!("such small PSFs need finer samples ({error}); raise optics.oversampling"))
    }

    fn work(&self) -> Work {
        Work { pupil: Some(self.pupil.scratch()), psf: Psf::default(), ..Work::default() }
    }
}

/// Defocus per distance from the focal plane, waves rms per um: a source nearer to the lens by z has a path longer by
/// `z NA^2 / 2` at the rim of the pupil; the rms of Noll's Z_4 is `1 / (2 sqrt 3)` of that (Born & Wolf, section 9.2).
fn defocus_per_um(optics: &OpticsConfig) -> f64 {
    let na = optics.aperture_um / 2.0 / optics.object_distance_um;
    na * na / 2.0 / optics.wavelength_um / (2.0 * 3f64.sqrt())
}
