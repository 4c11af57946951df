//! PSFs of a round pupil on pixels, with their derivatives.

use super::TERMS;
use ndarray::{Array2, Zip};
use ommatidia_physics::optics::zernike;

/// Distance of the two Gauss points from the centre of a pixel, px: they integrate cubics over the pixel exactly.
const GAUSS_PX: f64 = 0.288_675_134_594_812_9;
/// Step of the central differences that are the slopes of the terms, which are polynomials, in radii of the pupil.
const SLOPE_STEP: f64 = 1e-4;

/// A pupil at one place of the source.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pupil {
    /// Coefficients of Z_2 to Z_11, rad.
    pub terms: [f64; TERMS],
    /// Apodisation a: the amplitude at the rim is `exp(-a)`.
    pub apodisation: f64,
    /// Radius of the pupil: cut-off frequency of the amplitude, cycles/px.
    pub radius: f64,
}

/// Samples of a pupil's plane.
#[derive(Clone, Debug)]
pub(super) struct Kernel {
    /// Coordinates along one axis, -1 to 1.
    rho: Vec<f64>,
    /// Share of each sample inside the rim.
    inside: Array2<f64>,
    /// Z_2 to Z_11.
    terms: Vec<Array2<f64>>,
    /// Square of the distance from the centre.
    square: Array2<f64>,
}

/// A complex array.
#[derive(Clone, Debug)]
pub(super) struct Complex {
    re: Array2<f64>,
    im: Array2<f64>,
}

impl Kernel {
    /// Samples for PSFs in windows of `side` pixels and cut-off frequencies up to `radius`, cycles/px.
    pub(super) fn new(side: usize, radius: f64) -> Self {
        // Samples at distance d in the pupil repeat the field after 1 / d: 1.5 windows.
        let n = ((3.0 * radius * side as f64).ceil() as usize).clamp(20, 96);
        let rho: Vec<f64> = (0..n).map(|i| (2 * i + 1) as f64 / n as f64 - 1.0).collect();
        let polar = |(i, j): (usize, usize)| (rho[i].hypot(rho[j]), rho[i].atan2(rho[j]));
        let of = |value: &dyn Fn(f64, f64) -> f64| {
            Array2::from_shape_fn((n, n), |at| {
                let (r, theta) = polar(at);
                value(r, theta)
            })
        };
        Self {
            inside: of(&|r, _| ((1.0 - r) * n as f64 / 2.0 + 0.5).clamp(0.0, 1.0)),
            terms: (0..TERMS).map(|k| of(&|r, theta| zernike(k + 2, r, theta))).collect(),
            square: of(&|r, _| r * r),
            rho,
        }
    }

    /// The PSF in a window of `side` pixels about the centre, not normalised.
    pub(super) fn psf(&self, pupil: &Pupil, side: usize) -> Array2<f64> {
        self.psf_by(&self.waves(side, pupil.radius), pupil)
    }

    /// The PSF of a pupil whose [`Self::waves`] are known.
    pub(super) fn psf_by(&self, waves: &[Complex; 2], pupil: &Pupil) -> Array2<f64> {
        let light = transform(waves, &self.amplitude(pupil));
        binned(&(&light.re * &light.re + &light.im * &light.im))
    }

    /// The PSF and its derivatives by the ten terms, the apodisation, and the logarithm of the radius.
    pub(super) fn psf_and_slopes(&self, pupil: &Pupil, side: usize) -> (Array2<f64>, Vec<Array2<f64>>) {
        let waves = self.waves(side, pupil.radius);
        let amplitude = self.amplitude(pupil);
        let light = transform(&waves, &amplitude);
        let slope = |by: &Complex| {
            let mut product = &light.re * &by.re;
            Zip::from(&mut product).and(&light.im).and(&by.im).for_each(|p, a, b| *p += a * b);
            product * 2.0
        };
        let mut slopes = Vec::with_capacity(TERMS + 2);
        let mut moved: Vec<Array2<f64>> = Vec::new();
        for term in &self.terms {
            // The derivative of exp(i c Z) is i Z times it.
            let turned = Complex { re: -(&amplitude.im * term), im: &amplitude.re * term };
            let by = slope(&transform(&waves, &turned));
            if moved.len() < 2 {
                moved.push(by.clone());
            }
            slopes.push(binned(&by));
        }
        let less = Complex { re: -(&amplitude.re * &self.square), im: -(&amplitude.im * &self.square) };
        slopes.push(binned(&slope(&transform(&waves, &less))));
        // Z_2 = 2 rho_x moves the PSF by -1 / (pi R) px a rad along the columns, Z_3 along the rows; a wider pupil is
        // as a window seen from farther away.
        let at = samples(side);
        let n = at.len();
        let wider = Array2::from_shape_fn((n, n), |(r, c)| {
            std::f64::consts::PI * pupil.radius * (at[c] * moved[0][[r, c]] + at[r] * moved[1][[r, c]])
        });
        slopes.push(binned(&wider));
        (binned(&(&light.re * &light.re + &light.im * &light.im)), slopes)
    }

    /// Displacement of the centroid of the PSF by each term, (row, col) px a rad: the mean slope of the term over the
    /// light in the pupil, over 2 pi R.
    pub(super) fn displacements(&self, apodisation: f64, radius: f64) -> [[f64; 2]; TERMS] {
        let light =
            Zip::from(&self.inside).and(&self.square).map_collect(|w, s| w * w * (-2.0 * apodisation * s).exp());
        let value = |k: usize, y: f64, x: f64| zernike(k + 2, y.hypot(x), y.atan2(x));
        let mean_slope = |k: usize, [dy, dx]: [f64; 2]| {
            let slope = |(i, j): (usize, usize)| {
                let (y, x) = (self.rho[i], self.rho[j]);
                (value(k, y + dy, x + dx) - value(k, y - dy, x - dx)) / (2.0 * (dy + dx))
            };
            let sum: f64 = light.indexed_iter().filter(|(_, w)| **w > 0.0).map(|(at, w)| w * slope(at)).sum();
            sum / light.sum().max(f64::MIN_POSITIVE)
        };
        let ways = [[SLOPE_STEP, 0.0], [0.0, SLOPE_STEP]];
        std::array::from_fn(|k| ways.map(|way| -mean_slope(k, way) / (std::f64::consts::TAU * radius)))
    }

    fn amplitude(&self, pupil: &Pupil) -> Complex {
        let mut phase = Array2::<f64>::zeros(self.inside.dim());
        for (term, c) in self.terms.iter().zip(pupil.terms).filter(|(_, c)| *c != 0.0) {
            phase.scaled_add(c, term);
        }
        let size = Zip::from(&self.inside).and(&self.square).map_collect(|w, s| w * (-pupil.apodisation * s).exp());
        Complex { re: &size * &phase.mapv(f64::cos), im: &size * &phase.mapv(f64::sin) }
    }

    /// `exp(2 pi i radius rho x)` for the samples x of a window, [sample, rho], and its transpose.
    pub(super) fn waves(&self, side: usize, radius: f64) -> [Complex; 2] {
        let at = samples(side);
        let of = |value: fn(f64) -> f64| {
            Array2::from_shape_fn((at.len(), self.rho.len()), |(i, j)| {
                value(std::f64::consts::TAU * radius * self.rho[j] * at[i])
            })
        };
        let waves = Complex { re: of(f64::cos), im: of(f64::sin) };
        let turned = Complex { re: waves.re.t().to_owned(), im: waves.im.t().to_owned() };
        [waves, turned]
    }
}

/// Where a window is sampled along one axis: two points a pixel, px from its centre.
fn samples(side: usize) -> Vec<f64> {
    let middle = (side as f64 - 1.0) / 2.0;
    (0..side).flat_map(|i| [i as f64 - middle - GAUSS_PX, i as f64 - middle + GAUSS_PX]).collect()
}

/// The field of an amplitude in the pupil at the samples of a window.
fn transform([waves, turned]: &[Complex; 2], amplitude: &Complex) -> Complex {
    let product = |a: &Complex, b: &Complex| Complex {
        re: a.re.dot(&b.re) - a.im.dot(&b.im),
        im: a.re.dot(&b.im) + a.im.dot(&b.re),
    };
    product(&product(waves, amplitude), turned)
}

/// Means over the two by two samples of each pixel.
fn binned(fine: &Array2<f64>) -> Array2<f64> {
    Array2::from_shape_fn((fine.nrows() / 2, fine.ncols() / 2), |(r, c)| {
        let row = |i: usize| fine[[2 * r + i, 2 * c]] + fine[[2 * r + i, 2 * c + 1]];
        0.25 * (row(0) + row(1))
    })
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use ommatidia_physics::optics::{Psf, PupilConfig, Wavefront};

    const SIDE: usize = 21;

    fn pupil() -> Pupil {
        let mut terms = [0.0; TERMS];
        terms[..9].copy_from_slice(&[0.4, -0.3, 0.5, 0.2, -0.3, 0.25, 0.15, -0.1, 0.1]);
        Pupil { terms, apodisation: 0.0, radius: 0.22 }
    }

    /// The pupils of the bench are other code: transforms on a fine grid.
    #[test]
    fn equals_the_pupil_of_the_bench() {
        let of = pupil();
        let mut wavefront = Wavefront::default();
        for (k, c) in of.terms.iter().enumerate().skip(2) {
            wavefront.coefficient[k + 1] = c / std::f64::consts::TAU;
        }
        let aperture_um = 2.0 * of.radius * 0.5 * 1000.0 / 2.0;
        let bench = PupilConfig {
            wavelength_um: 0.5,
            aperture_um,
            distance_um: 1000.0,
            soft_edge: 0.0,
            pixel_um: 2.0,
            oversampling: 5,
            field_px: 63,
        };
        let bench = bench.build().unwrap();
        let (mut scratch, mut psf) = (bench.scratch(), Psf::default());
        // The bench's pupils hold the centroid of the focus, where tilt and coma move it.
        let kernel = Kernel::new(SIDE, 0.3);
        let own = kernel.psf(&of, SIDE);
        let by_rad = kernel.displacements(of.apodisation, of.radius);
        let centroid = [0, 1].map(|a| of.terms.iter().zip(by_rad).map(|(c, d)| c * d[a]).sum());
        bench.psf(&wavefront, centroid, &mut scratch, &mut psf);
        let skip = (psf.side - SIDE) / 2;
        let other =
            Array2::from_shape_fn((SIDE, SIDE), |(r, c)| f64::from(psf.share[(r + skip) * psf.side + c + skip]));
        let scale = (&own * &other).sum() / (&own * &own).sum();
        let off = (&own * scale - &other).mapv(|v| v * v).sum() / other.mapv(|v| v * v).sum();
        assert!(off.sqrt() < 0.02, "{}", off.sqrt());
    }

    /// In a disc of even light a tilt of 1 rad displaces by 1 / (pi R), and coma of 1 rad, sqrt(8) (3 r^3 - 2 r) cos,
    /// by its value at the rim, sqrt(8), over 2 pi R (the theorem of Gauss); even terms do not. The rim of 32 samples
    /// is 5 % short of it.
    #[test]
    fn displacements_are_mean_slopes() {
        let found = Kernel::new(SIDE, 0.5).displacements(0.0, 0.22);
        let per_rad = 1.0 / (std::f64::consts::TAU * 0.22);
        let near = |found: f64, want: f64| assert!((found - want).abs() < 0.2 * per_rad, "{found} instead of {want}");
        for (k, want) in [(0, [0.0, -2.0]), (1, [-2.0, 0.0]), (5, [-8f64.sqrt(), 0.0]), (6, [0.0, -8f64.sqrt()])] {
            (0..2).for_each(|a| near(found[k][a], want[a] * per_rad));
        }
        for k in (0..TERMS).filter(|k| super::super::EVEN[*k]) {
            found[k].iter().for_each(|v| near(*v, 0.0));
        }
    }

    #[test]
    fn slopes_are_those_of_differences() {
        let kernel = Kernel::new(SIDE, 0.3);
        let of = Pupil { apodisation: 0.3, ..pupil() };
        let (psf, slopes) = kernel.psf_and_slopes(&of, SIDE);
        assert!((&psf - &kernel.psf(&of, SIDE)).iter().all(|v| v.abs() < 1e-9));
        for (k, slope) in slopes.iter().enumerate() {
            let by = |d: f64| {
                let mut p = of;
                match k {
                    k if k < TERMS => p.terms[k] += d,
                    TERMS => p.apodisation += d,
                    _ => p.radius *= d.exp(),
                }
                kernel.psf(&p, SIDE)
            };
            let difference = (by(1e-4) - by(-1e-4)) / 2e-4;
            let size = difference.mapv(|v| v * v).sum().sqrt();
            let off = (slope - &difference).mapv(|v| v * v).sum().sqrt();
            assert!(off < 1e-5 * size.max(1e-3), "{k}: {off} of {size}");
        }
    }
}
