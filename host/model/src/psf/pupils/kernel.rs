//! PSFs of a round pupil on pixels, with their derivatives.

use super::TERMS;
use ndarray::{Array2, Axis, Zip};
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
        let n = ((3.0 * radius * side as f64).ceil() as usize).clamp(20, 96).next_multiple_of(2);
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

    /// The PSF of a pupil in the window of [`Self::waves`], which are those of its radius; not normalised.
    pub(super) fn psf(&self, waves: &Waves, pupil: &Pupil) -> Array2<f64> {
        let light = transform(waves, &self.amplitude(pupil));
        binned(&(&light.re * &light.re + &light.im * &light.im))
    }

    /// The PSF and its derivatives by the ten terms, the apodisation, and the logarithm of the radius.
    pub(super) fn psf_and_slopes(&self, waves: &Waves, pupil: &Pupil) -> (Array2<f64>, Vec<Array2<f64>>) {
        let amplitude = self.amplitude(pupil);
        let light = transform(waves, &amplitude);
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
            let by = slope(&transform(waves, &turned));
            if moved.len() < 2 {
                moved.push(by.clone());
            }
            slopes.push(binned(&by));
        }
        let less = Complex { re: -(&amplitude.re * &self.square), im: -(&amplitude.im * &self.square) };
        slopes.push(binned(&slope(&transform(waves, &less))));
        // Z_2 = 2 rho_x moves the PSF by -1 / (pi R) px a rad along the columns, Z_3 along the rows; a wider pupil is
        // as a window seen from farther away.
        let at = &waves.at;
        let wider = Array2::from_shape_fn((at.len(), at.len()), |(r, c)| {
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
        let mut size = self.inside.clone();
        if pupil.apodisation != 0.0 {
            size.zip_mut_with(&self.square, |w, s| *w *= (-pupil.apodisation * s).exp());
        }
        let (mut re, mut im) = (size.clone(), size);
        Zip::from(&mut re).and(&mut im).and(&phase).for_each(|re, im, phase| {
            let (sin, cos) = if *re == 0.0 { (0.0, 0.0) } else { phase.sin_cos() };
            *re *= cos;
            *im *= sin;
        });
        Complex { re, im }
    }

    /// What a pupil of a radius, cycles/px, needs for PSFs in windows of `side` pixels.
    pub(super) fn waves(&self, side: usize, radius: f64) -> Waves {
        let at = samples(side);
        let (x, rho) = (&at[at.len() / 2..], &self.rho[self.rho.len() / 2..]);
        let phase =
            Array2::from_shape_fn((x.len(), rho.len()), |(i, j)| std::f64::consts::TAU * radius * rho[j] * x[i]);
        let [cos, sin] = [f64::cos, f64::sin].map(|f| phase.mapv(f));
        Waves { turned: [cos.t().to_owned(), sin.t().to_owned()], along: [cos, sin], at }
    }
}

/// Plane waves on the samples of a window.
#[derive(Clone, Debug)]
pub(super) struct Waves {
    /// Cosine and sine of `2 pi radius rho x` for x > 0 and rho > 0, [x, rho]. Samples of pupil and window are
    /// symmetric about zero.
    along: [Array2<f64>; 2],
    /// Their transposes.
    turned: [Array2<f64>; 2],
    /// All samples x along one axis, px from the centre.
    at: Vec<f64>,
}

/// Where a window is sampled along one axis: two points a pixel, px from its centre.
fn samples(side: usize) -> Vec<f64> {
    let middle = (side as f64 - 1.0) / 2.0;
    (0..side).flat_map(|i| [i as f64 - middle - GAUSS_PX, i as f64 - middle + GAUSS_PX]).collect()
}

/// The field of an amplitude in the pupil at the samples of a window:
/// `sum_rho exp(2 pi i radius rho . x) P(rho)`.
fn transform(waves: &Waves, amplitude: &Complex) -> Complex {
    let columns = halved(amplitude, Axis(0), |side, wave| waves.along[wave].dot(side));
    halved(&columns, Axis(1), |side, wave| side.dot(&waves.turned[wave]))
}

/// The transform along one axis. `product` of half of the samples with the cosines (0) or the sines (1) gives half of
/// the values: those of the sum of the samples at rho and -rho, and of their difference, hold all of them, since
/// `exp(i t) a + exp(-i t) b = cos(t) (a + b) + i sin(t) (a - b)`. It takes a quarter of the multiplications.
fn halved(of: &Complex, axis: Axis, product: impl Fn(&Array2<f64>, usize) -> Array2<f64>) -> Complex {
    let folded = |a: &Array2<f64>| {
        let (low, high) = a.view().split_at(axis, a.len_of(axis) / 2);
        let mut low = low;
        low.invert_axis(axis);
        (product(&(&high + &low), 0), product(&(&high - &low), 1))
    };
    let ((re_even, re_odd), (im_even, im_odd)) = (folded(&of.re), folded(&of.im));
    // i (re + i im) = -im + i re.
    let unfolded = |even: &Array2<f64>, odd: &Array2<f64>, sign: f64| {
        let half = even.len_of(axis);
        let mut size = even.raw_dim();
        size[axis.index()] = 2 * half;
        let mut out = Array2::zeros(size);
        let (mut low, mut high) = out.view_mut().split_at(axis, half);
        low.invert_axis(axis);
        Zip::from(&mut low).and(&mut high).and(even).and(odd).for_each(|low, high, even, odd| {
            *low = even - sign * odd;
            *high = even + sign * odd;
        });
        out
    };
    Complex { re: unfolded(&re_even, &im_odd, -1.0), im: unfolded(&im_even, &re_odd, 1.0) }
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

    #[test]
    fn the_transform_is_the_sum_over_the_pupil() {
        let (kernel, side, radius) = (Kernel::new(7, 0.3), 7, 0.22);
        let amplitude = kernel.amplitude(&pupil());
        let (waves, at) = (kernel.waves(side, radius), samples(side));
        let light = transform(&waves, &amplitude);
        for (r, c) in [(0, 0), (3, 9), (7, 6), (13, 2)] {
            let mut sum = [0.0; 2];
            for ((i, j), re) in amplitude.re.indexed_iter() {
                let phase = std::f64::consts::TAU * radius * (kernel.rho[i] * at[r] + kernel.rho[j] * at[c]);
                let im = amplitude.im[[i, j]];
                sum[0] += re * phase.cos() - im * phase.sin();
                sum[1] += re * phase.sin() + im * phase.cos();
            }
            let off = (light.re[[r, c]] - sum[0]).hypot(light.im[[r, c]] - sum[1]);
            assert!(off < 1e-10, "{r} {c}: {off}");
        }
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
        let own = kernel.psf(&kernel.waves(SIDE, of.radius), &of);
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
        let psf_of = |p: &Pupil| kernel.psf(&kernel.waves(SIDE, p.radius), p);
        let (psf, slopes) = kernel.psf_and_slopes(&kernel.waves(SIDE, of.radius), &of);
        assert!((&psf - &psf_of(&of)).iter().all(|v| v.abs() < 1e-9));
        for (k, slope) in slopes.iter().enumerate() {
            let by = |d: f64| {
                let mut p = of;
                match k {
                    k if k < TERMS => p.terms[k] += d,
                    TERMS => p.apodisation += d,
                    _ => p.radius *= d.exp(),
                }
                psf_of(&p)
            };
            let difference = (by(1e-4) - by(-1e-4)) / 2e-4;
            let size = difference.mapv(|v| v * v).sum().sqrt();
            let off = (slope - &difference).mapv(|v| v * v).sum().sqrt();
            assert!(off < 1e-5 * size.max(1e-3), "{k}: {off} of {size}");
        }
    }
}
