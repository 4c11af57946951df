//! What a frame and its reconstruction show of the error without the truth.

use super::UncertaintyError;
use super::smooth::{mean, roughness, scatter};
use ndarray::{Array2, ArrayView2, Zip};
use ommatidia_model::forward::Forward;
use ommatidia_model::instrument::Instrument;
use ommatidia_physics::noise::ROUNDING_DN2;

/// Features of a pixel, see [`Observer::see`].
pub(super) const PIXEL: usize = 9;
/// Features of a frame, see [`Observer::see`].
pub(super) const FRAME: usize = 7;
/// Classes of brightness: the reconstruction relative to the brightest pixels of its frame.
const BRIGHTNESS: [f32; 3] = [0.01, 0.05, 0.2];
/// Rings of the field, of equal width from the centre to the corner.
pub(super) const RINGS: usize = 3;
/// Groups of pixels: a ring and a class of brightness.
pub(super) const GROUPS: usize = RINGS * (BRIGHTNESS.len() + 1);
/// Reconstructions above this part of the brightest pixels count as lit.
pub(super) const LIT: f32 = 0.05;
/// Squared residuals, in variances, count as this much at most, so that a hot pixel decides nothing.
const MOST_CHI2: f32 = 400.0;

/// Ring of each object pixel.
pub(super) fn rings([rows, cols]: [usize; 2]) -> Array2<u8> {
    Array2::from_shape_fn((rows, cols), |at| ((radius(at, [rows, cols]) * RINGS as f64) as usize).min(RINGS - 1) as u8)
}

/// Distance from the centre of the field, 1 at its corners.
fn radius((r, c): (usize, usize), [rows, cols]: [usize; 2]) -> f64 {
    let [y, x] = [(r, rows), (c, cols)].map(|(at, n)| at as f64 - (n as f64 - 1.0) / 2.0);
    let corner = ((rows as f64 - 1.0) / 2.0).hypot((cols as f64 - 1.0) / 2.0);
    y.hypot(x) / corner.max(f64::MIN_POSITIVE)
}

/// Ring of a group.
pub(super) fn ring_of(group: usize) -> usize {
    group / (BRIGHTNESS.len() + 1)
}

/// Class of brightness of a group.
pub(super) fn class_of(group: usize) -> usize {
    group % (BRIGHTNESS.len() + 1)
}

/// What is seen of one frame.
#[derive(Clone, Debug)]
pub(super) struct Seen {
    /// Light of the instrument's unit for one unit of the reconstruction: the predicted frame then has the light of the
    /// measured one.
    pub light: f64,
    /// The reconstruction in the light unit of the instrument, [object rows, object cols].
    pub object: Array2<f32>,
    /// Features of each pixel, in the order of the object grid.
    pub pixels: Vec<[f32; PIXEL]>,
    /// Features of the frame.
    pub frame: [f64; FRAME],
    /// Group of each pixel.
    pub groups: Vec<u8>,
    /// Logarithms of the misfit of the predicted frame: of single pixels, and of means of 4 x 4 of them.
    pub misfit: [f64; 2],
}

/// Predicts frames from reconstructions, and compares.
#[derive(Clone, Debug)]
pub(super) struct Observer {
    forward: Forward,
    dark_dn: Array2<f32>,
    /// A'1, DN for one unit of light in each object pixel.
    sensitivity: Array2<f32>,
    /// Effective height of the PSF: sum A^2 / sum A of a point at the centre, DN for one unit.
    height: f32,
    gain: f64,
    saturation: f32,
    reading_dn2: Option<Array2<f32>>,
    read_dn2: f32,
}

impl Observer {
    /// Plans the comparison with an instrument, at the depth nearest to 0 um.
    ///
    /// # Errors
    /// The parts of the instrument disagree, or no light reaches the sensor.
    pub fn new(instrument: &Instrument) -> Result<Self, UncertaintyError> {
        let forward = Forward::new(instrument)?;
        let noise = forward.noise_with(forward.effects());
        let operator = forward.operator();
        let [rows, cols] = operator.object_shape();
        let sensitivity = operator.adjoint(Array2::ones(operator.sensor_shape()).view()).map_err(inner)?;
        let mut point = Array2::zeros((rows, cols));
        point[[rows / 2, cols / 2]] = 1.0;
        let psf = operator.apply(point.view()).map_err(inner)?;
        let (sum, squares) = psf.iter().fold((0.0f32, 0.0f32), |(s, q), v| (s + v, q + v * v));
        let dark_dn = forward.expected_dn(Array2::zeros((rows, cols)).view(), &forward.context())?;
        let read_dn2 = (noise.gain_dn_per_e * noise.read_noise_e).powi(2) + ROUNDING_DN2;
        if sum.is_nan() || sum <= 0.0 || squares <= 0.0 {
            return Err(UncertaintyError::Black { index: 0 });
        }
        Ok(Self {
            height: squares / sum,
            sensitivity,
            dark_dn,
            gain: noise.gain_dn_per_e,
            saturation: noise.saturation_dn as f32,
            reading_dn2: forward.reading_dn2().cloned(),
            read_dn2: read_dn2 as f32,
            forward,
        })
    }

    /// Rows and columns of the object grid.
    pub fn object_shape(&self) -> [usize; 2] {
        self.forward.operator().object_shape()
    }

    /// Light, in the instrument's unit, of one unit of `object`, by least squares between the measured frame and the
    /// predicted one; and the predicted light, DN above the dark frame.
    fn fit(&self, frame_dn: ArrayView2<'_, f32>, object: &Array2<f32>) -> Result<(f64, Array2<f32>), UncertaintyError> {
        if object.dim() != self.sensitivity.dim() {
            let (rows, cols) = object.dim();
            return Err(UncertaintyError::Shape { expected: self.object_shape(), found: [rows, cols] });
        }
        let total = |a: &Array2<f32>, b: &Array2<f32>| -> f64 {
            a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum()
        };
        let measured = &frame_dn - &self.dark_dn;
        let all: f64 = measured.iter().map(|v| f64::from(*v)).sum();
        let mut light = all.max(self.gain) / total(object, &self.sensitivity).max(f64::from(f32::MIN_POSITIVE));
        if !light.is_finite() || light > 1e30 {
            return Ok((1.0, Array2::zeros(measured.dim())));
        }
        let cx = self.forward.context();
        let charge = self.forward.expected_e(object.mapv(|v| v * light as f32).view(), &cx)?;
        let mut predicted = self.forward.frame_dn(charge, self.forward.effects(), &cx) - &self.dark_dn;
        let (mut both, mut own) = (0.0f64, 0.0f64);
        Zip::from(&frame_dn).and(&measured).and(&predicted).for_each(|&raw, &y, &m| {
            if raw < self.saturation {
                (both, own) = (both + f64::from(y) * f64::from(m), own + f64::from(m) * f64::from(m));
            }
        });
        // A frame that is darker than dark holds no light to scale by.
        let factor = if own > 0.0 { (both / own).max(1e-3) } else { 1.0 };
        light *= factor;
        predicted.mapv_inplace(|v| v * factor as f32);
        Ok((light, predicted))
    }

    /// The scale of an object against a frame alone, see [`Seen::light`].
    ///
    /// # Errors
    /// The object does not fit the instrument.
    pub fn light(&self, frame_dn: ArrayView2<'_, f32>, object: &Array2<f32>) -> Result<f64, UncertaintyError> {
        Ok(self.fit(frame_dn, object)?.0)
    }

    /// Looks at a frame, DN, [sensor rows, sensor cols], and its reconstruction in any unit, [object rows, object
    /// cols].
    ///
    /// Pixels: logarithms of the reconstruction, of its means over 7 x 7 and 15 x 15 pixels and its scatter over 5 x 5,
    /// of the noise that the frame's noise propagates to, of the misfit at the places of the frame that see the pixel,
    /// of the change of light that this misfit asks for; the square of the field radius; the brightest pixels of the
    /// frame. Frames: logarithms of the brightest signal in electrons, and of ratios that say how much of the field is
    /// lit and how fine its structure is.
    ///
    /// # Errors
    /// The reconstruction does not fit the instrument.
    pub fn see(&self, frame_dn: ArrayView2<'_, f32>, found: &Array2<f32>) -> Result<Seen, UncertaintyError> {
        let clean = found.mapv(|v| if v.is_finite() { v.max(0.0) } else { 0.0 });
        let (light, predicted) = self.fit(frame_dn, &clean)?;
        let object = clean.mapv(|v| v * light as f32);
        let measured = &frame_dn - &self.dark_dn;
        let mut weight = predicted.mapv(|m| self.gain as f32 * m.max(0.0));
        match &self.reading_dn2 {
            Some(map) => weight += map,
            None => weight += self.read_dn2,
        }
        let top = self.saturation;
        let off = Zip::from(&measured).and(&predicted).and(&self.dark_dn).map_collect(|y, m, d| y - m.min(top - d));
        let chi2 = Zip::from(&off).and(&weight).map_collect(|o, v| (o * o / v).min(MOST_CHI2));
        let misfit =
            [self.lit_chi2(&chi2, &predicted), self.coarse(&off, &weight, &predicted)].map(|v| v.max(1e-6).ln());
        weight.mapv_inplace(f32::recip);
        let back = |image: &Array2<f32>| self.forward.operator().adjoint(image.view()).map_err(inner);
        let (at_chi2, at_weight, at_off) = (back(&chi2)?, back(&weight)?, back(&(&off * &weight))?);
        let shape = self.object_shape();
        let bright = quantile(&object, 0.999).max(f32::MIN_POSITIVE);
        let noise = at_weight.mapv(|w| (self.height * w.max(1e-20)).sqrt().recip());
        let typical = quantile(&noise, 0.5);
        let (near, wide, texture) = (mean(object.view(), 3), mean(object.view(), 7), scatter(object.view(), 2));
        let all = object.indexed_iter().map(|(at, &x)| {
            let (n, w) = (noise[at], at_weight[at].max(1e-20));
            let local = at_chi2[at] / self.sensitivity[at].max(1e-20);
            [
                (x + n).ln(),
                (near[at] + n).ln(),
                (texture[at] + 0.1 * n).ln(),
                n.ln(),
                local.clamp(0.05, MOST_CHI2).ln(),
                ((at_off[at] / w / self.height).abs() + 0.1 * n).ln(),
                radius(at, shape).powi(2) as f32,
                (bright + typical).ln(),
                (wide[at] + n).ln(),
            ]
        });
        let rings = rings(shape);
        let groups = Zip::from(&object).and(&rings).map_collect(|x, ring| {
            let class = BRIGHTNESS.iter().filter(|edge| x / bright > **edge).count();
            (usize::from(*ring) * (BRIGHTNESS.len() + 1) + class) as u8
        });
        let frame = self.frame_features(&measured, &object, bright);
        Ok(Seen { light, pixels: all.collect(), frame, groups: groups.into_raw_vec_and_offset().0, misfit, object })
    }

    fn frame_features(&self, measured: &Array2<f32>, object: &Array2<f32>, bright: f32) -> [f64; FRAME] {
        let count = object.len() as f64;
        let (sum, squares) =
            object.iter().fold((0.0f64, 0.0f64), |(s, q), v| (s + f64::from(*v), q + f64::from(*v).powi(2)));
        let (average, bright) = ((sum / count).max(1e-30), f64::from(bright));
        let peak_e = f64::from(quantile(measured, 0.9995)) / self.gain;
        let lit = object.iter().filter(|v| f64::from(**v) > 0.2 * bright).count() as f64 / count;
        [
            peak_e.max(3.0).ln(),
            (average / bright).ln(),
            (squares / count / average.powi(2)).max(1.0).ln(),
            (roughness(object.view()) / average).max(1e-6).ln(),
            (roughness(mean(object.view(), 3).view()) / average).max(1e-6).ln(),
            (lit + 1e-3).ln(),
            (f64::from(quantile(object, 0.5)) / bright + 1e-3).ln(),
        ]
    }

    /// Mean of chi-squared over lit pixels: those above three times the read noise; over all of them in a dark frame.
    fn lit_chi2(&self, chi2: &Array2<f32>, predicted: &Array2<f32>) -> f64 {
        let least = 3.0 * self.read_dn2.sqrt();
        let lit = chi2.iter().zip(predicted).filter(|(_, m)| **m > least).map(|(x, _)| f64::from(*x));
        let (n, sum) = lit.fold((0usize, 0.0), |(n, s), x| (n + 1, s + x));
        if n >= 100 { sum / n as f64 } else { chi2.iter().map(|x| f64::from(*x)).sum::<f64>() / chi2.len() as f64 }
    }

    /// Chi-squared of means over 4 x 4 pixels, where errors that neighbours share stand out of the noise.
    fn coarse(&self, off: &Array2<f32>, variance: &Array2<f32>, predicted: &Array2<f32>) -> f64 {
        const SIDE: usize = 4;
        let blocks = off.exact_chunks((SIDE, SIDE)).into_iter().zip(variance.exact_chunks((SIDE, SIDE)));
        let least = 3.0 * self.read_dn2.sqrt() * (SIDE * SIDE) as f32 / SIDE as f32;
        let (mut lit, mut any) = ((0usize, 0.0f64), (0usize, 0.0f64));
        for ((off, variance), light) in blocks.zip(predicted.exact_chunks((SIDE, SIDE))) {
            let chi2 = f64::from((off.sum().powi(2) / variance.sum()).min(MOST_CHI2 * 16.0));
            any = (any.0 + 1, any.1 + chi2);
            if light.sum() > least {
                lit = (lit.0 + 1, lit.1 + chi2);
            }
        }
        let (n, sum) = if lit.0 >= 25 { lit } else { any };
        sum / n.max(1) as f64
    }
}

/// The value below which the share `share` of an image lies.
fn quantile(image: &Array2<f32>, share: f64) -> f32 {
    let mut values: Vec<f32> = image.iter().copied().collect();
    let at = ((values.len() as f64 - 1.0) * share).round() as usize;
    let (_, value, _) = values.select_nth_unstable_by(at, f32::total_cmp);
    *value
}

fn inner(error: ommatidia_model::psf::OperatorError) -> UncertaintyError {
    UncertaintyError::Forward(error.into())
}
