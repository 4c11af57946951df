//! Computation of effective receptive fields.

use super::artifact::{FieldPoint, ReceptiveFields, Summary};
use super::images::{pcc, to_one};
use super::kernels::{filter_figures, kernels, share_in_span};
use crate::train::network::Network;
use crate::train::ops::fourier::Fourier;
use crate::train::{Architecture, Checkpoint, Mode, NetworkConfig, normalised};
use anyhow::ensure;
use ndarray::{Array2, Array3, Axis};
use ommatidia_model::forward::Forward;
use ommatidia_model::instrument::Instrument;
use ommatidia_model::psf::LowRankOperator;
use std::sync::Arc;

/// Distance of the point beyond the field from its edge, and margin by which the network's crop is widened for it,
/// pixels.
const BEYOND: usize = 6;
const WIDENED: usize = 8;

/// Computes the receptive fields of a network as means over raw frames, DN, each [frame rows, frame cols]; `done` is
/// called after each gradient.
///
/// # Errors
/// Network, instrument and frames have different sizes, or there are no frames.
pub fn receptive_fields(
    checkpoint: &Checkpoint,
    instrument: &Instrument,
    frames: &[Array2<f32>],
    mut done: impl FnMut(),
) -> anyhow::Result<ReceptiveFields> {
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
    ensure!(
        config.feedback.is_none(),
        "expected a network of one pass without Richardson-Lucy iterations, found {} passes and {} iterations; their \
         receptive fields are not computed",
        config.passes(),
        config.iterations()
    );
    ensure!(!frames.is_empty(), "expected frames to average over, found none");
    let [rows, cols] = config.object.map(|n| n as i64);
    let mut places = vec![
        ("centre", [rows / 2, cols / 2]),
        ("edge", [rows / 2, 3]),
        ("corner", [3, 3]),
        ("beyond", [rows / 2, -(BEYOND as i64)]),
    ];
    if matches!(config.architecture, Architecture::Cm2Net { .. }) {
        // Its crops end at the edge of the field.
        places.pop();
    }
    let input = checkpoint.frame_input()?;
    let normalised = frames.iter().map(|f| normalised(&input, f.view())).collect::<Result<Vec<_>, _>>()?;
    let [frame_rows, frame_cols] = config.frame;
    let mut fields = Array3::zeros((places.len(), frame_rows, frame_cols));
    let mut psfs = fields.clone();
    let mut summary =
        Summary { network: config.architecture.name().as_str().into(), frames: frames.len(), ..Summary::default() };
    for (i, (name, pixel)) in places.iter().enumerate() {
        let inside = (0..rows).contains(&pixel[0]) && (0..cols).contains(&pixel[1]);
        let margin = if inside { 0 } else { WIDENED };
        let wide = NetworkConfig { object: config.object.map(|n| n + 2 * margin), ..config.clone() };
        let plan = Arc::new(Fourier::new(wide.fourier()));
        let network = Network::new(&wide, &plan, &checkpoint.weights, Mode::Train)?;
        let at = pixel.map(|p| (p + margin as i64) as usize);
        let mut sum = vec![0.0f64; frame_rows * frame_cols];
        for x in &normalised {
            sum.iter_mut().zip(network.pixel_gradient(x, at)).for_each(|(s, g)| *s += f64::from(g));
            done();
        }
        let field = Array2::from_shape_fn((frame_rows, frame_cols), |(r, c)| sum[r * frame_cols + c] as f32);
        let psf_at = |pixel: [i64; 2]| psf(&operator, pixel);
        let (own, other) = (psf_at(*pixel)?, psf_at([rows - 1 - pixel[0], cols - 1 - pixel[1]])?);
        summary.places.push(point_figures(name, *pixel, &PointImages { field: &field, psf: &own, mirrored: &other }));
        fields.index_axis_mut(Axis(0), i).assign(&to_one(field));
        psfs.index_axis_mut(Axis(0), i).assign(&to_one(own));
    }
    let (filters, inverses) = kernels(checkpoint, instrument)?;
    let pitch = instrument.manifest.array.pitch_px;
    summary.filters = filters.outer_iter().map(|f| filter_figures(f, &inverses, pitch)).collect();
    summary.in_span = share_in_span(&filters, &inverses);
    Ok(ReceptiveFields { summary, fields, psfs, filters, inverses })
}

/// The PSF of an object pixel. Beyond the field it is the PSF of the nearest calibrated pixel, shifted along its chief
/// rays and cut at the edge of the sensor.
fn psf(operator: &LowRankOperator, pixel: [i64; 2]) -> anyhow::Result<Array2<f32>> {
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

/// The images that one point is judged by, each [frame rows, frame cols].
struct PointImages<'a> {
    /// Receptive field.
    field: &'a Array2<f32>,
    /// PSF of the point.
    psf: &'a Array2<f32>,
    /// PSF of the point mirrored through the centre of the field.
    mirrored: &'a Array2<f32>,
}

fn point_figures(name: &str, pixel: [i64; 2], images: &PointImages<'_>) -> FieldPoint {
    let PointImages { field, psf, mirrored } = images;
    let positive = field.mapv(|v| v.max(0.0));
    let sum = |f: &dyn Fn(f32) -> f32| field.iter().map(|&v| f64::from(f(v))).sum::<f64>();
    let (plus, minus) = (sum(&|v| v.max(0.0)), sum(&|v| (-v).max(0.0)));
    let peak = psf.iter().copied().fold(0.0f32, f32::max);
    let lit = |p: f32| p > 0.01 * peak;
    let on: f64 = positive.iter().zip(psf.iter()).filter(|(_, p)| lit(**p)).map(|(v, _)| f64::from(*v)).sum();
    FieldPoint {
        name: name.into(),
        pixel,
        pcc: pcc(positive.iter(), psf.iter()),
        pcc_elsewhere: pcc(positive.iter(), mirrored.iter()),
        on_foci: on / plus.max(f64::MIN_POSITIVE),
        foci_area: psf.iter().filter(|p| lit(**p)).count() as f64 / psf.len() as f64,
        negative: minus / (plus + minus).max(f64::MIN_POSITIVE),
    }
}
