//! Lenses by ray optics: each is a relay, telecentric on the object side, with the five Seidel aberrations.
//!
//! Rays through points rho of the pupil (unit disc) meet the sensor at the chief ray plus the transverse aberration
//! `-(1 / NA') grad W(rho, h)` (W. T. Welford, Aberrations of Optical Systems, 1986, section 7.2), where NA' is the
//! aperture on the image side, h the field in units of the corner of the object, and
//!
//! `W = W040 (rho.rho)^2 + W131 (h.rho)(rho.rho) + W222 (h.rho)^2 + W220 (h.h)(rho.rho) + W311 (h.h)(h.rho)`
//!
//! (Born & Wolf, section 5.3, in vector form). Tolerances add a defocus, a coma and an astigmatism that do not depend
//! on the field. A source at depth z moves its ray by `-m z NA rho` (NA on the object side): its cone of rays is cut at
//! another place. Since the relay is telecentric, the chief ray does not depend on the depth. A second stop, displaced
//! in proportion to h, clips the pupil off the axis. Each ray is blurred by diffraction, as a Gaussian of `0.225
//! wavelength / NA'` (Zhang, Zerubia, Olivo-Marin, Applied Optics 46, 1819, 2007), and integrated over the pixels in
//! closed form: nothing is interpolated between foci.

use super::change::Change;
use super::config::RelayConfig;
use super::edges::Edges;
use super::plane::{Chief, SensorPlane};
use super::{Lenses, Moved, Work};
use crate::config::BenchConfig;
use crate::error::BenchError;
use crate::foci::{Focus, Point};
use ommatidia_physics::effects::{EffectSetting, Ray};
use ommatidia_session::rng;
use rand_distr::{Distribution, StandardNormal};

/// Share of a pupil radius over which the second stop fades, so that the light is a smooth function of the field.
const STOP_EDGE: f64 = 0.12;

/// One lens as it was manufactured.
#[derive(Clone, Debug)]
struct Made {
    anchor_px: [f64; 2],
    axis_um: [f64; 2],
    /// Defocus, waves at the rim.
    defocus: f64,
    /// Coma that does not depend on the field, waves at the rim.
    coma: [f64; 2],
    /// Astigmatism along the axes and along the diagonals, waves at the rim.
    astigmatism: [f64; 2],
}

/// A ray in the pupil.
#[derive(Clone, Copy, Debug)]
struct PupilRay {
    /// Place (row, col), pupil radii.
    rho: [f64; 2],
    /// Share of the light of a clear pupil.
    weight: f64,
}

/// The lenses.
#[derive(Clone, Debug)]
pub(crate) struct Relay {
    config: RelayConfig,
    lenses: Vec<Made>,
    rays: Vec<PupilRay>,
    edges: Edges,
    side: usize,
    plane: SensorPlane,
    /// Numerical aperture on the object side.
    aperture: f64,
    /// Distance of the object's corner from its centre, um.
    corner_um: f64,
    wavelength_um: f64,
    /// Distance between exit pupil and sensor, um.
    gap_um: f64,
    /// What has moved since the relay was made.
    change: Change,
}

impl Relay {
    /// Draws the lenses; the same seed gives the same lenses.
    ///
    /// # Errors
    /// A number of the configuration is impossible.
    pub(crate) fn build(config: &BenchConfig) -> Result<Self, BenchError> {
        let (relay, optics) = (&config.relay, &config.optics);
        let wrong =
            |field, expected: &str, found: String| Err(BenchError::Config { field, expected: expected.into(), found });
        for (field, v) in [("relay.stop_radius", relay.stop_radius), ("optics.wavelength_um", optics.wavelength_um)] {
            if !(v.is_finite() && v > 0.0) {
                return wrong(field, "a number above zero", v.to_string());
            }
        }
        let terms = [relay.spherical, relay.coma, relay.astigmatism, relay.field_curvature, relay.distortion_px];
        if let Some(v) = terms.iter().chain([&relay.scatter, &relay.stop_walk]).find(|v| !v.is_finite()) {
            return wrong("relay", "finite numbers", v.to_string());
        }
        let [rings, spokes] = relay.rays;
        if !(2..=64).contains(&rings) || !(5..=256).contains(&spokes) {
            return wrong("relay.rays", "2 to 64 rings of 5 to 256 rays", format!("{:?}", relay.rays));
        }
        if optics.psf_field_px.is_multiple_of(2) {
            return wrong("optics.psf_field_px", "an odd number", optics.psf_field_px.to_string());
        }
        let magnification = config.true_magnification();
        let centre_px = [config.sensor.rows, config.sensor.cols].map(|n| (n as f64 - 1.0) / 2.0);
        let plane = SensorPlane { centre_px, pixel_pitch_um: config.sensor.pixel_pitch_um, magnification };
        let places = config.places_px().into_iter().enumerate();
        let make = |(l, nominal): (usize, [f64; 2])| {
            let mut rng = rng::stream(config.instrument_seed, "bench/relay", l as u64);
            let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
            let anchor_px = [0, 1].map(|k| nominal[k] + config.array.placement_rms_px * normal());
            Made {
                anchor_px,
                axis_um: plane.axis_um(anchor_px),
                defocus: relay.scatter * normal(),
                coma: [0; 2].map(|_| relay.scatter * normal()),
                astigmatism: [0; 2].map(|_| relay.scatter * normal()),
            }
        };
        let object = &config.object;
        Ok(Self {
            lenses: places.map(make).collect(),
            rays: pupil_rays(rings, spokes),
            edges: Edges::tabulate(),
            side: optics.psf_field_px,
            plane,
            aperture: optics.aperture_um / 2.0 / optics.object_distance_um,
            corner_um: (object.rows as f64).hypot(object.cols as f64) / 2.0 * object.pixel_um,
            wavelength_um: optics.wavelength_um,
            gap_um: magnification * optics.object_distance_um,
            config: relay.clone(),
            change: Change::default(),
        })
    }

    /// Field (row, col) of a point, in units of the corner of the object.
    fn field(&self, l: usize, at_um: [f64; 2]) -> [f64; 2] {
        [0, 1].map(|k| (at_um[k] - self.lenses[l].axis_um[k]) / self.corner_um)
    }

    /// Where the chief ray of a point meets the sensor, relative to the axis of its lens, pixels.
    fn off_axis_px(&self, l: usize, at_um: [f64; 2]) -> [f64; 2] {
        let h = self.field(l, at_um);
        let cube = self.config.distortion_px * (h[0] * h[0] + h[1] * h[1]);
        let scale = self.plane.px_per_um();
        let at = [0, 1].map(|k| (at_um[k] - self.lenses[l].axis_um[k]) * scale + cube * h[k]);
        // The gap scales the image about the axis; a distortion acts on the image as it was.
        let mm2 = (1e-3 * self.plane.pixel_pitch_um).powi(2) * (at[0] * at[0] + at[1] * at[1]);
        at.map(|v| v * (1.0 + self.change.gap + self.change.k1_per_mm2 * mm2))
    }

    /// The chief ray of a point through a lens.
    fn chief(&self, l: usize, at_um: [f64; 2]) -> Chief {
        let Made { anchor_px, axis_um, .. } = self.lenses[l];
        let axis_px = self.plane.axis_px(anchor_px, axis_um);
        Chief { anchor_px, axis_px, off_axis_px: self.off_axis_px(l, at_um) }
    }

    /// Transverse aberration (row, col) of a ray, pixels.
    fn transverse_px(&self, l: usize, h: [f64; 2], rho: [f64; 2], z_um: f64) -> [f64; 2] {
        let (made, c) = (&self.lenses[l], &self.config);
        let (hr, rr, hh) = (dot(h, rho), dot(rho, rho), dot(h, h));
        let turned = [
            made.astigmatism[0] * rho[0] + made.astigmatism[1] * rho[1],
            made.astigmatism[1] * rho[0] - made.astigmatism[0] * rho[1],
        ];
        let own = dot(made.coma, rho);
        let image_aperture = self.aperture / self.plane.magnification;
        let to_px = self.wavelength_um / image_aperture / self.plane.pixel_pitch_um;
        // A source out of focus, and a sensor that is not where the image is: both cut the cone at another place.
        let cut_px = (self.plane.magnification * z_um * self.aperture + self.change.gap * self.gap_um * image_aperture)
            / self.plane.pixel_pitch_um;
        [0, 1].map(|k| {
            let slope = 4.0 * c.spherical * rr * rho[k]
                + c.coma * (h[k] * rr + 2.0 * hr * rho[k])
                + 2.0 * c.astigmatism * hr * h[k]
                + 2.0 * (c.field_curvature * hh + made.defocus) * rho[k]
                + made.coma[k] * rr
                + 2.0 * own * rho[k]
                + 2.0 * turned[k];
            -slope * to_px - cut_px * rho[k]
        })
    }

    /// Light of a ray after the second stop, of the light that a clear pupil has in it.
    fn passes(&self, h: [f64; 2], rho: [f64; 2]) -> f64 {
        let walk = self.config.stop_walk;
        let radius = (rho[0] - walk * h[0]).hypot(rho[1] - walk * h[1]);
        let t = ((self.config.stop_radius - radius) / STOP_EDGE + 0.5).clamp(0.0, 1.0);
        t * t * (3.0 - 2.0 * t)
    }
}

impl Lenses for Relay {
    fn side(&self) -> usize {
        self.side
    }

    fn anchors_px(&self) -> Vec<[f64; 2]> {
        self.lenses.iter().map(|l| l.anchor_px).collect()
    }

    fn axes_um(&self) -> Vec<[f64; 2]> {
        self.lenses.iter().map(|l| l.axis_um).collect()
    }

    fn ray(&self, l: usize, at_um: [f64; 2]) -> Ray {
        self.plane.ray(l, at_um, self.chief(l, at_um))
    }

    fn focus_px(&self, l: usize, point: Point, moved: Moved) -> [f64; 2] {
        self.chief(l, point.at_um).focus_px(moved.shift.px)
    }

    fn focus(&self, l: usize, point: Point, moved: Moved, work: &mut Work) -> Focus {
        let (centre, rest) = super::split(self.focus_px(l, point, moved));
        let (side, h) = (self.side, self.field(l, point.at_um));
        let middle = (side / 2) as f64;
        let size = 1.0 + moved.shift.growth;
        let diffraction_um = 0.225 * self.wavelength_um * self.plane.magnification / self.aperture;
        let sigma = size * diffraction_um / self.plane.pixel_pitch_um;
        let Work { psf, lines: [rows, cols], .. } = work;
        psf.side = side;
        psf.share.clear();
        psf.share.resize(side * side, 0.0);
        rows.resize(side, 0.0);
        cols.resize(side, 0.0);
        let mut passed = 0.0;
        for ray in &self.rays {
            let light = ray.weight * self.passes(h, ray.rho);
            if light == 0.0 {
                continue;
            }
            passed += light;
            let at = self.transverse_px(l, h, ray.rho, point.z_um + moved.shift.z_um);
            let r = self.edges.shares(middle + rest[0] + size * at[0], sigma, rows);
            let c = self.edges.shares(middle + rest[1] + size * at[1], sigma, cols);
            for i in r {
                let (row, share) = (&mut psf.share[i * side..][..side], light * rows[i]);
                row[c.clone()].iter_mut().zip(&cols[c.clone()]).for_each(|(v, s)| *v += (share * s) as f32);
            }
        }
        let sum: f32 = psf.share.iter().sum();
        // Light that misses the field counts as light of the focus, so that none is lost.
        psf.share.iter_mut().for_each(|v| *v /= sum.max(f32::MIN_POSITIVE));
        Focus { centre, transmission: passed }
    }

    fn refuses(&self, effect: &EffectSetting) -> Option<String> {
        super::without_pupils(effect)
    }

    fn moved(&self, change: &Change) -> Option<Box<dyn Lenses>> {
        let mut moved = self.clone();
        moved.change = change.clone();
        for (l, lens) in moved.lenses.iter_mut().enumerate() {
            lens.anchor_px = change.anchor_px(l, lens.anchor_px, self.plane.centre_px);
            lens.axis_um = self.plane.axis_um(lens.anchor_px);
        }
        Some(Box::new(moved))
    }
}

fn dot(a: [f64; 2], b: [f64; 2]) -> f64 {
    a[0] * b[0] + a[1] * b[1]
}

/// Rays on rings of equal light (the midpoint of each in the square of the radius), rings turned against each other.
fn pupil_rays(rings: usize, spokes: usize) -> Vec<PupilRay> {
    let weight = 1.0 / (rings * spokes) as f64;
    let ring = |i: usize| {
        let radius = ((i as f64 + 0.5) / rings as f64).sqrt();
        (0..spokes).map(move |k| {
            let turn = std::f64::consts::TAU * (k as f64 + 0.5 * (i % 2) as f64) / spokes as f64;
            PupilRay { rho: [radius * turn.sin(), radius * turn.cos()], weight }
        })
    };
    (0..rings).flat_map(ring).collect()
}
