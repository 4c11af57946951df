#![allow(clippy::unwrap_used)]
use super::kernels::share_in_span;
use super::{ReceptiveFields, receptive_fields};
use crate::train::network::{Network, values};
use crate::train::ops::fourier::Fourier;
use crate::train::{Architecture, Checkpoint, Lenses, Mode, NetworkConfig, NetworkInput, Preset, normalised, weights};
use burn_tensor::activation::sigmoid;
use ndarray::{Array2, Array3, Axis};
use ommatidia_model::forward::Forward;
use ommatidia_model::instrument::Instrument;
use ommatidia_model::testing::square_array as instrument;
use ommatidia_physics::noise::NoiseModel;
use ommatidia_session::artifact::{Provenance, Tensors};
use std::sync::Arc;

fn checkpoint(network: NetworkConfig, weights: Tensors, noise: NoiseModel) -> Checkpoint {
    Checkpoint::untrained(network, noise, Preset::Nano.training(1e4, 1), weights)
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

/// Gradients agree with central differences of the whole network, for each kind of network.
#[test]
fn the_gradient_is_the_slope_of_the_pixel() {
    let (instrument, plain) = small();
    let lenses = Lenses::of(&instrument).unwrap();
    let wiener = NetworkConfig { architecture: Architecture::MultiWienerNet, ..plain.clone() };
    let cm2 = NetworkConfig { blocks: 1, ..lenses.cm2net(plain.clone()) };
    for config in [plain, wiener, cm2] {
        let plan = Arc::new(Fourier::new(config.fourier()));
        let weights = weights::random(&config, 4);
        let train = Network::new(&config, &plan, &weights, Mode::Train).unwrap();
        let infer = Network::new(&config, &plan, &weights, Mode::Infer).unwrap();
        let input = checkpoint(config.clone(), weights, instrument.noise).frame_input().unwrap();
        let x = normalised(&input, frame(&instrument).view()).unwrap();
        let pixel = [9, 12];
        let g = train.pixel_gradient(&x, pixel);
        let norm = g.iter().map(|&g| f64::from(g).powi(2)).sum::<f64>().sqrt();
        let at = |sign: f32| {
            let moved: Vec<f32> = x.iter().zip(&g).map(|(x, g)| x + sign * 0.02 * g / norm as f32).collect();
            let input = NetworkInput::of(&config, &plan, &moved);
            f64::from(values(sigmoid(infer.forward(vec![input]).logits))[pixel[0] * 20 + pixel[1]])
        };
        let slope = (at(1.0) - at(-1.0)) / 0.04;
        assert!((slope - norm).abs() < 0.03 * norm + 1e-6, "{:?}: {slope} {norm}", config.architecture);
    }
}

/// With the transposed PSF as filter, and an enhancement that passes the first channel on, the receptive field is the
/// PSF, also beyond the field.
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
        receptive_fields(&checkpoint(network, tensors, instrument.noise), &instrument, &[frame(&instrument)], || ())
            .unwrap();
    assert_eq!(found.summary.places.len(), 4);
    for place in &found.summary.places {
        assert!(place.pcc > 0.8 && place.pcc > place.pcc_elsewhere + 0.3 || place.name == "centre", "{place:?}");
        assert!(place.pcc > 0.8, "{place:?}");
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("erf");
    found.write(&path, Provenance::default()).unwrap();
    let read = ReceptiveFields::read(&path).unwrap();
    assert_eq!((read.fields, read.psfs, read.inverses), (found.fields, found.psfs, found.inverses));
    assert!(read.summary.places[3].name == "beyond" && read.summary.filters.len() == 1);
    assert!(found.summary.filters[0].on_lattice > 0.9, "{:?}", found.summary);
}

#[test]
fn a_span_holds_its_own_vectors_and_nothing_across() {
    let one = |i: usize| Array3::from_shape_fn((1, 4, 4), |(_, r, c)| f32::from(4 * r + c == i));
    let two = ndarray::concatenate![Axis(0), one(1), one(2)];
    assert!((share_in_span(&(one(1) + one(2)), &two) - 1.0).abs() < 1e-12);
    assert!(share_in_span(&one(3), &two) < 1e-12);
    assert!((share_in_span(&(one(1) + one(3)), &two) - 0.5).abs() < 1e-12);
}
