//! One lens of the virtual instrument, as it was manufactured.

use crate::config::{AberrationConfig, BenchConfig};
use ommatidia_physics::optics::{MicrolensArray, Wavefront};
use ommatidia_session::rng;
use rand::Rng;
use rand_distr::{Distribution, StandardNormal};

/// One lens as it was manufactured: its place, and its wavefront error over the field.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Lens {
    /// Focus of the on-axis source (row, col), sensor pixels.
    pub anchor_px: [f64; 2],
    /// Object position (y, x) on the axis of the lens, um.
    pub axis_um: [f64; 2],
    /// Wavefront error on the axis.
    at_axis: Wavefront,
    /// Tilt of the lens: defocus that grows along each field axis, waves rms at unit field.
    tilt: [f64; 2],
    field: AberrationConfig,
}

impl Lens {
    /// Draws lens `l` of the array, with a nominal focus of the source on the axis, sensor pixels; the same seed gives
    /// the same lens.
    pub(super) fn manufacture(config: &BenchConfig, array: &MicrolensArray, l: usize, nominal: [f64; 2]) -> Self {
        let mut rng = rng::stream(config.instrument_seed, "bench/lens", l as u64);
        let anchor_px = nominal.map(|a| a + config.array.placement_rms_px * normal(&mut rng));
        let aberrations = &config.aberrations;
        let mut at_axis = Wavefront::default();
        // Defocus, astigmatisms, comas, trefoils, spherical: Z_4 to Z_11.
        for c in &mut at_axis.coefficient[3..] {
            *c = aberrations.scatter * normal(&mut rng);
        }
        at_axis.coefficient[3] += aberrations.defocus;
        at_axis.coefficient[10] += aberrations.spherical;
        let tilt = [0; 2].map(|_| aberrations.tilt_scatter * normal(&mut rng));
        let centre_px = [config.sensor.rows, config.sensor.cols].map(|n| (n as f64 - 1.0) / 2.0);
        let axis_um = array.axis_um(anchor_px, centre_px);
        Self { anchor_px, axis_um, at_axis, tilt, field: aberrations.clone() }
    }

    /// Wavefront error at field `h` = (row, col): tangents of the angle to the axis of the lens, in units of the
    /// reference angle.
    ///
    /// Seidel's third-order forms: coma grows with h, astigmatism and field curvature with h^2 (Born & Wolf, section
    /// 5.3).
    pub(super) fn wavefront(&self, h: [f64; 2]) -> Wavefront {
        let [y, x] = h;
        let mut w = self.at_axis;
        let c = &mut w.coefficient;
        c[3] += self.field.field_curvature * (y * y + x * x) + self.tilt[0] * y + self.tilt[1] * x;
        // h^2 sin 2 phi and h^2 cos 2 phi, phi from the column axis to the row axis, as in Noll's Z_5 and Z_6.
        c[4] += self.field.astigmatism * 2.0 * y * x;
        c[5] += self.field.astigmatism * (x * x - y * y);
        c[6] += self.field.coma * y;
        c[7] += self.field.coma * x;
        w
    }
}

fn normal(rng: &mut impl Rng) -> f64 {
    StandardNormal.sample(rng)
}
