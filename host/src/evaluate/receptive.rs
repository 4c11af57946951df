//! The effective receptive field (ERF; W. Luo et al., NeurIPS 2016; paper, section 2E): the gradient of one reconstructed pixel to the frame, averaged
//! over frames, beside the PSF of that place; and the learned filters in real space, beside pseudo-inverses of calibrated PSFs.

use crate::artifact::{self, ArtifactError, Header, Provenance, Tensors};
use crate::forward::Forward;
use crate::instrument::Instrument;
use crate::train::network::{Mode, Network, values};
use crate::train::ops::fourier::Fourier;
use crate::train::{Checkpoint, Family, Lenses, NetworkConfig, Sight, pseudo_inverse};
use anyhow::ensure;
use ndarray::{Array2, Array3, ArrayView2, Axis, s};
use serde::{Deserialize, Serialize};
use std::path::Path;
use std::sync::Arc;

/// Kind of the artifact.
pub const KIND: &str = "receptive-field";
/// Version of its layout.
pub const VERSION: u32 = 1;

/// How far beyond the field a place is looked at, and how far the network's crop is widened for it, pixels.
const BEYOND: usize = 6;
const WIDENED: usize = 8;

/// The receptive field of one place in numbers.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Place {
    /// `centre`, `edge`, `corner` or `beyond`.
    pub name: String,
    /// Object pixel; negative beyond the field.
    pub pixel: [i64; 2],
    /// Pearson correlation of the positive part with the PSF of the place, over the frame.
    pub pcc: f64,
    /// The same with the PSF of the place mirrored through the centre of the field: what any localised pattern would reach.
    pub pcc_elsewhere: f64,
    /// Part of the positive weight that lies where the PSF has more than a hundredth of its maximum.
    pub on_foci: f64,
    /// Part of the frame that this is.
    pub foci_area: f64,
    /// Negative weight over all weight, both as magnitudes.
    pub negative: f64,
}

/// One learned filter in numbers.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Filter {
    /// Highest magnitude of its Pearson correlation with a pseudo-inverse.
    pub pcc: f64,
    /// Part of its energy within half a lens pitch of the lags at which foci can lie (multiples of the pitch up to two each way).
    pub on_lattice: f64,
}

/// What the header of the artifact holds.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// Name of the network.
    pub network: String,
    /// Frames averaged over.
    pub frames: usize,
    /// The places.
    pub places: Vec<Place>,
    /// The filters; none of a network without.
    pub filters: Vec<Filter>,
    /// Part of the filters' energy that lies in the span of the pseudo-inverses.
    pub in_span: f64,
}

/// Receptive fields, PSFs and filters.
#[derive(Clone, Debug)]
pub struct Receptive {
    /// In numbers.
    pub summary: Summary,
    /// Receptive fields, [place, frame rows, frame cols], their largest magnitude 1.
    pub fields: Array3<f32>,
    /// PSFs of the places, the same way.
    pub psfs: Array3<f32>,
    /// Learned filters in space, lag 0 in the middle, [filter, T, T], their largest magnitude 1.
    pub filters: Array3<f32>,
    /// Pseudo-inverses of as many calibrated PSFs.
    pub inverses: Array3<f32>,
}

/// Computes receptive fields of a network over frames, DN, [n, frame rows, frame cols].
///
/// # Errors
/// Network, instrument and frames are of different sizes.
pub fn receptive(
    checkpoint: &Checkpoint,
    instrument: &Instrument,
    frames: &[Array2<f32>],
    mut done: impl FnMut(),
) -> anyhow::Result<Receptive> {
    let config = &checkpoint.body.network;
    let operator = Forward::new(instrument)?.operator().clone();
    ensure!(
        operator.object_shape() == config.object && operator.sensor_shape() == config.frame,
        "expected an instrument of the network's size ({:?} -> {:?}), found {:?} -> {:?}",
        config.frame,
        config.object,
        operator.sensor_shape(),
        operator.object_shape()
    );
    ensure!(!frames.is_empty(), "expected frames to average over, found none");
    let [rows, cols] = config.object.map(|n| n as i64);
    let mut places = vec![
        ("centre", [rows / 2, cols / 2]),
        ("edge", [rows / 2, 3]),
        ("corner", [3, 3]),
        ("beyond", [rows / 2, -(BEYOND as i64)]),
    ];
    if matches!(config.family, Family::Cm2Net { .. }) {
        // Its crops end where the field does.
        places.pop();
    }
    let sight = Sight::new(&checkpoint.body, &checkpoint.maps);
    let seen = frames
        .iter()
        .map(|f| sight.check(f.view()).map(|()| sight.normalised(f.view())))
        .collect::<Result<Vec<_>, _>>()?;
    let [frame_rows, frame_cols] = config.frame;
    let mut fields = Array3::zeros((places.len(), frame_rows, frame_cols));
    let mut psfs = fields.clone();
    let mut summary =
        Summary { network: config.family.name().as_str().into(), frames: frames.len(), ..Summary::default() };
    for (i, (name, pixel)) in places.iter().enumerate() {
        let inside = (0..rows).contains(&pixel[0]) && (0..cols).contains(&pixel[1]);
        let margin = if inside { 0 } else { WIDENED };
        let wide = NetworkConfig { object: config.object.map(|n| n + 2 * margin), ..config.clone() };
        let plan = Arc::new(Fourier::new(wide.fourier()));
        let network = Network::new(&wide, &plan, &checkpoint.weights, Mode::Train)?;
        let at = pixel.map(|p| (p + margin as i64) as usize);
        let mut sum = vec![0.0f64; frame_rows * frame_cols];
        for x in &seen {
            sum.iter_mut().zip(network.pixel_gradient(x, at)).for_each(|(s, g)| *s += f64::from(g));
            done();
        }
        let field = Array2::from_shape_fn((frame_rows, frame_cols), |(r, c)| sum[r * frame_cols + c] as f32);
        let psf_at = |pixel: [i64; 2]| psf(&operator, pixel);
        let (own, other) = (psf_at(*pixel)?, psf_at([rows - 1 - pixel[0], cols - 1 - pixel[1]])?);
        summary.places.push(figures(name, *pixel, &field, &own, &other));
        fields.index_axis_mut(Axis(0), i).assign(&to_one(field));
        psfs.index_axis_mut(Axis(0), i).assign(&to_one(own));
    }
    let (filters, inverses) = kernels(checkpoint, instrument)?;
    let pitch = instrument.manifest.array.pitch_px;
    summary.filters = filters.outer_iter().map(|f| filter(f, &inverses, pitch)).collect();
    summary.in_span = in_span(&filters, &inverses);
    Ok(Receptive { summary, fields, psfs, filters, inverses })
}

/// The PSF of a place; beyond the field that of the nearest calibrated pixel, moved along its chief rays, cut at the sensor's edge.
fn psf(operator: &crate::psf::LowRankOperator, pixel: [i64; 2]) -> anyhow::Result<Array2<f32>> {
    let [rows, cols] = operator.object_shape();
    let near = [pixel[0].clamp(0, rows as i64 - 1), pixel[1].clamp(0, cols as i64 - 1)];
    let mut point = Array2::zeros((rows, cols));
    point[near.map(|v| v as usize)] = 1.0;
    let image = operator.apply(point.view())?;
    let moved = [pixel[0] - near[0], pixel[1] - near[1]];
    let (height, width) = image.dim();
    Ok(Array2::from_shape_fn((height, width), |(r, c)| {
        let from = [r as i64 - moved[0], c as i64 - moved[1]];
        let inside = (0..height as i64).contains(&from[0]) && (0..width as i64).contains(&from[1]);
        if inside { image[from.map(|v| v as usize)] } else { 0.0 }
    }))
}

fn figures(name: &str, pixel: [i64; 2], field: &Array2<f32>, psf: &Array2<f32>, elsewhere: &Array2<f32>) -> Place {
    let positive = field.mapv(|v| v.max(0.0));
    let sum = |f: &dyn Fn(f32) -> f32| field.iter().map(|&v| f64::from(f(v))).sum::<f64>();
    let (plus, minus) = (sum(&|v| v.max(0.0)), sum(&|v| (-v).max(0.0)));
    let peak = psf.iter().copied().fold(0.0f32, f32::max);
    let lit = |p: f32| p > 0.01 * peak;
    let on: f64 = positive.iter().zip(psf).filter(|(_, p)| lit(**p)).map(|(v, _)| f64::from(*v)).sum();
    Place {
        name: name.into(),
        pixel,
        pcc: pcc(positive.iter(), psf.iter()),
        pcc_elsewhere: pcc(positive.iter(), elsewhere.iter()),
        on_foci: on / plus.max(f64::MIN_POSITIVE),
        foci_area: psf.iter().filter(|p| lit(**p)).count() as f64 / psf.len() as f64,
        negative: minus / (plus + minus).max(f64::MIN_POSITIVE),
    }
}

/// Learned filters and pseudo-inverses in space, lag 0 in the middle.
fn kernels(checkpoint: &Checkpoint, instrument: &Instrument) -> anyhow::Result<(Array3<f32>, Array3<f32>)> {
    let config = &checkpoint.body.network;
    if matches!(config.family, Family::Cm2Net { .. }) {
        return Ok((Array3::zeros((0, 0, 0)), Array3::zeros((0, 0, 0))));
    }
    let t = config.filter_size;
    let plan = Arc::new(Fourier::new(config.fourier()));
    let network = Network::new(config, &plan, &checkpoint.weights, Mode::Infer)?;
    let [re, im] = network.filters().map(values);
    let centred = |spectra: Vec<Vec<rustfft::num_complex::Complex32>>| {
        let mut out = Array3::zeros((spectra.len(), t, t));
        for (mut target, spectrum) in out.outer_iter_mut().zip(spectra) {
            let kernel = plan.whole(spectrum);
            let image = Array2::from_shape_fn((t, t), |(r, c)| kernel[(r + t / 2) % t * t + (c + t / 2) % t]);
            target.assign(&to_one(image));
        }
        out
    };
    let starts = Lenses::of(instrument)?.kernels(config)?;
    let inverses = starts.chunks_exact(t * t).map(|k| pseudo_inverse(&plan, k, t)).collect();
    Ok((centred(plan.filters(&re, &im)), centred(inverses)))
}

fn filter(kernel: ArrayView2<'_, f32>, inverses: &Array3<f32>, pitch_px: f64) -> Filter {
    let best = inverses.outer_iter().map(|i| pcc(kernel.iter(), i.iter()).abs()).fold(0.0, f64::max);
    let middle = (kernel.nrows() / 2) as f64;
    // Distance to the nearest multiple of the pitch, where that is at most two away.
    let off = |i: usize| {
        let lag = (i as f64 - middle) / pitch_px;
        (lag - lag.round().clamp(-2.0, 2.0)).abs() * pitch_px
    };
    let energy = |v: f32| f64::from(v).powi(2);
    let near = |r: usize, c: usize| off(r) <= pitch_px / 4.0 && off(c) <= pitch_px / 4.0;
    let on: f64 = kernel.indexed_iter().filter(|((r, c), _)| near(*r, *c)).map(|(_, v)| energy(*v)).sum();
    Filter { pcc: best, on_lattice: on / kernel.iter().map(|v| energy(*v)).sum::<f64>().max(f64::MIN_POSITIVE) }
}

/// Part of the energy of `of` (each scaled to unit energy) that lies in the span of `by`: Gram-Schmidt.
fn in_span(of: &Array3<f32>, by: &Array3<f32>) -> f64 {
    let flat = |a: &Array3<f32>| -> Vec<Vec<f64>> {
        a.outer_iter().map(|i| i.iter().map(|&v| f64::from(v)).collect()).collect()
    };
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let mut basis: Vec<Vec<f64>> = Vec::new();
    for mut v in flat(by) {
        let before = dot(&v, &v);
        for b in &basis {
            let part = dot(&v, b);
            v.iter_mut().zip(b).for_each(|(v, b)| *v -= part * b);
        }
        let left = dot(&v, &v);
        if left > 1e-9 * before {
            basis.push(v.into_iter().map(|x| x / left.sqrt()).collect());
        }
    }
    let all = flat(of);
    let inside = |v: &Vec<f64>| basis.iter().map(|b| dot(v, b).powi(2)).sum::<f64>() / dot(v, v).max(f64::MIN_POSITIVE);
    all.iter().map(inside).sum::<f64>() / all.len().max(1) as f64
}

fn pcc<'a>(a: impl Iterator<Item = &'a f32>, b: impl Iterator<Item = &'a f32>) -> f64 {
    let (mut n, mut sums) = (0.0, [0.0; 5]);
    for (a, b) in a.zip(b).map(|(&a, &b)| (f64::from(a), f64::from(b))) {
        n += 1.0;
        sums.iter_mut().zip([a, b, a * a, b * b, a * b]).for_each(|(s, v)| *s += v);
    }
    let [a, b, aa, bb, ab] = sums;
    let variance = (aa - a * a / n) * (bb - b * b / n);
    if variance > 0.0 { (ab - a * b / n) / variance.sqrt() } else { 0.0 }
}

/// The same image with its largest magnitude 1.
fn to_one(image: Array2<f32>) -> Array2<f32> {
    let most = image.iter().fold(0.0f32, |m, v| m.max(v.abs()));
    if most > 0.0 { image / most } else { image }
}

const FIELDS: &str = "fields";
const PSFS: &str = "psfs";
const FILTERS: &str = "filters";
const INVERSES: &str = "inverses";

impl Receptive {
    /// Writes the artifact: whole, or not at all.
    ///
    /// # Errors
    /// See [`artifact::write`].
    pub fn write(&self, path: &Path, provenance: Provenance) -> Result<(), ArtifactError> {
        let stacks = [(FIELDS, &self.fields), (PSFS, &self.psfs), (FILTERS, &self.filters), (INVERSES, &self.inverses)];
        let full = stacks.into_iter().filter(|(_, stack)| !stack.is_empty());
        let tensors: Tensors = full.map(|(name, stack)| (name.into(), stack.clone().into_dyn())).collect();
        let header = Header { kind: KIND.into(), version: VERSION, provenance, body: &self.summary };
        artifact::write(path, &header, &tensors)
    }

    /// Reads the artifact.
    ///
    /// # Errors
    /// The file is missing, another artifact, or a tensor is missing or of the wrong shape.
    pub fn read(path: &Path) -> Result<Self, ArtifactError> {
        let (header, mut tensors) = artifact::read::<Summary>(path, KIND, VERSION)?;
        let summary = header.body;
        let mut take = |name: &str, count: usize| -> Result<Array3<f32>, ArtifactError> {
            if count == 0 {
                return Ok(Array3::zeros((0, 0, 0)));
            }
            let stack = artifact::take(path, &mut tensors, name, &[Some(count), None, None])?;
            Ok(stack.into_dimensionality().unwrap_or_default())
        };
        let (places, filters) = (summary.places.len(), summary.filters.len());
        let (fields, psfs) = (take(FIELDS, places)?, take(PSFS, places)?);
        let (filters, inverses) = (take(FILTERS, filters)?, take(INVERSES, filters)?);
        Ok(Self { summary, fields, psfs, filters, inverses })
    }
}

/// The middle of an image: filters are all but empty further out.
pub fn middle(image: ArrayView2<'_, f32>, side: usize) -> ArrayView2<'_, f32> {
    let side = side.min(image.nrows()).min(image.ncols());
    let [top, left] = [image.nrows(), image.ncols()].map(|n| (n - side) / 2);
    image.slice_move(s![top..top + side, left..left + side])
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::artifact::Tensors;
    use crate::noise::NoiseModel;
    use crate::testing::square_array as instrument;
    use crate::train::{Body, MeanNorms, Preset, SensorMaps, weights};
    use burn::tensor::activation::sigmoid;

    fn checkpoint(network: NetworkConfig, weights: Tensors, noise: NoiseModel) -> Checkpoint {
        let body = Body {
            network,
            noise,
            training: Preset::Nano.training(1e4, 1),
            curve: Vec::new(),
            best_step: 0,
            step: 0,
            norms: MeanNorms::default(),
            support: None,
            slowed: 0,
        };
        let maps = SensorMaps::default();
        let adam = Default::default();
        Checkpoint { body, current: weights.clone(), weights, maps, cases: Vec::new(), samples: Vec::new(), adam }
    }

    fn small() -> (Instrument, NetworkConfig) {
        let instrument = instrument(3, [60, 60], [20, 20]);
        let network = NetworkConfig { channels: 2, width: 4, reduction: 2, ..Preset::Nano.network([60, 60], [20, 20]) };
        (instrument, network)
    }

    fn frame(instrument: &Instrument) -> Array2<f32> {
        let object = Array2::from_shape_fn((20, 20), |(r, c)| 10.0 + ((r * 7 + c * 3) % 11) as f32 * 20.0);
        Forward::new(instrument).unwrap().operator().apply(object.view()).unwrap() + 64.0
    }

    /// Against central differences of the whole network, for a network of each kind.
    #[test]
    fn the_gradient_is_the_slope_of_the_pixel() {
        let (instrument, plain) = small();
        let lenses = Lenses::of(&instrument).unwrap();
        let wiener = NetworkConfig { family: Family::MultiWienerNet, ..plain.clone() };
        let cm2 = NetworkConfig { blocks: 1, ..lenses.cm2net(plain.clone()) };
        for config in [plain, wiener, cm2] {
            let plan = Arc::new(Fourier::new(config.fourier()));
            let weights = weights::random(&config, 4);
            let train = Network::new(&config, &plan, &weights, Mode::Train).unwrap();
            let infer = Network::new(&config, &plan, &weights, Mode::Infer).unwrap();
            let sight = Sight::new(&checkpoint(config.clone(), weights, instrument.noise).body, &SensorMaps::default());
            let x = sight.normalised(frame(&instrument).view());
            let pixel = [9, 12];
            let g = train.pixel_gradient(&x, pixel);
            let norm = g.iter().map(|&g| f64::from(g).powi(2)).sum::<f64>().sqrt();
            let at = |sign: f32| {
                let moved: Vec<f32> = x.iter().zip(&g).map(|(x, g)| x + sign * 0.02 * g / norm as f32).collect();
                let seen = crate::train::Seen::of(&config, &plan, &moved);
                f64::from(values(sigmoid(infer.say(vec![seen]).logits))[pixel[0] * 20 + pixel[1]])
            };
            let slope = (at(1.0) - at(-1.0)) / 0.04;
            assert!((slope - norm).abs() < 0.03 * norm + 1e-6, "{:?}: {slope} {norm}", config.family);
        }
    }

    /// Filters that are the transposed PSF, and an enhancement that hands the first channel on: the receptive field is the PSF, at its own place, also
    /// beyond the field.
    #[test]
    fn the_receptive_field_of_a_matched_filter_is_the_psf() {
        let (instrument, network) = small();
        let network = NetworkConfig { channels: 1, width: 4, groups: 1, ..network };
        let plan = Fourier::new(network.fourier());
        let kernel = Lenses::of(&instrument).unwrap().kernels(&network).unwrap();
        let (re, im) = plan.kernel_parts(&kernel);
        let mut tensors: Tensors = weights::random(&network, 1).into_iter().map(|(n, t)| (n, t * 0.0)).collect();
        for (name, values) in weights::FILTERS.into_iter().zip([re, im.iter().map(|v| -v).collect()]) {
            tensors.get_mut(name).unwrap().iter_mut().zip(values).for_each(|(t, v)| *t = v);
        }
        let mut one = |name: &str, at: [usize; 4]| tensors.get_mut(&format!("{name}.weight")).unwrap()[at] = 1.0;
        for i in 0..4 {
            one(weights::name::HEAD, [i, i, 1, 1]);
            // Four features become the four pixels of a square.
            one(weights::name::UPSCALE, [i, i, 1, 1]);
        }
        one(weights::name::TAIL, [0, 0, 1, 1]);
        let found =
            receptive(&checkpoint(network, tensors, instrument.noise), &instrument, &[frame(&instrument)], || ())
                .unwrap();
        assert_eq!(found.summary.places.len(), 4);
        for place in &found.summary.places {
            assert!(place.pcc > 0.8 && place.pcc > place.pcc_elsewhere + 0.3 || place.name == "centre", "{place:?}");
            assert!(place.pcc > 0.8, "{place:?}");
        }
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("erf");
        found.write(&path, Provenance::default()).unwrap();
        let read = Receptive::read(&path).unwrap();
        assert_eq!((read.fields, read.psfs, read.inverses), (found.fields, found.psfs, found.inverses));
        assert!(read.summary.places[3].name == "beyond" && read.summary.filters.len() == 1);
        assert!(found.summary.filters[0].on_lattice > 0.9, "{:?}", found.summary);
    }

    #[test]
    fn a_span_holds_its_own_vectors_and_nothing_across() {
        let one = |i: usize| Array3::from_shape_fn((1, 4, 4), |(_, r, c)| f32::from(4 * r + c == i));
        let two = ndarray::concatenate![Axis(0), one(1), one(2)];
        assert!((in_span(&(one(1) + one(2)), &two) - 1.0).abs() < 1e-12);
        assert!(in_span(&one(3), &two) < 1e-12);
        assert!((in_span(&(one(1) + one(3)), &two) - 0.5).abs() < 1e-12);
    }
}
