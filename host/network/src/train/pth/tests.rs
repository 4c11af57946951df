#![allow(clippy::unwrap_used)]
use super::*;
use crate::train::network::{Network, values as output_values};
use crate::train::ops::fourier::Fourier;
use crate::train::{Mode, NetworkInput, normalised};
use burn_tensor::activation::sigmoid;
use ndarray::Array2;
use ommatidia_session::rng;
use rand::RngExt;
use std::sync::Arc;

/// Written by PyTorch 2.15 with `tiny.py`.
const TINY: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/src/train/pth/tiny.pth");
const FOUND: &str = include_str!("tiny.json");

fn config() -> ImportConfig {
    let noise = NoiseModel { black_level_dn: 0.0, ..NoiseModel::nominal() };
    ImportConfig { frame: Some([12, 10]), object: Some([8, 8]), noise, maps: SensorMaps::default() }
}

fn numbers(name: &str) -> Vec<f32> {
    let json: serde_json::Value = serde_json::from_str(FOUND).unwrap();
    serde_json::from_value(json[name].clone()).unwrap()
}

#[test]
fn the_network_does_what_pytorch_does() {
    let checkpoint = import(Path::new(TINY), config()).unwrap();
    let network = &checkpoint.body.network;
    assert_eq!((network.channels, network.width, network.groups, network.blocks, network.reduction), (2, 4, 2, 1, 2));
    let frame = Array2::from_shape_vec((12, 10), numbers("frame")).unwrap();
    let plan = Arc::new(Fourier::new(network.fourier()));
    let frame = normalised(&checkpoint.frame_input().unwrap(), frame.view()).unwrap();
    let input = NetworkInput::of(network, &plan, &frame);
    let float = Network::new(network, &plan, &checkpoint.weights, Mode::Infer).unwrap();
    let found = output_values(sigmoid(float.forward(vec![input]).logits));
    let worst = found.iter().zip(numbers("object")).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(worst < 2e-6, "{worst}");
}

#[test]
fn what_was_imported_comes_back_as_it_was() {
    let folder = tempfile::tempdir().unwrap();
    let [path, kept] = ["weights.safetensors", "network"].map(|name| folder.path().join(name));
    let checkpoint = import(Path::new(TINY), config()).unwrap();
    // A checkpoint that was never trained holds no optimiser; reading it gives the initial state.
    checkpoint.write(&kept, ommatidia_session::artifact::Provenance::default()).unwrap();
    let read = Checkpoint::read(&kept).unwrap();
    assert_eq!((&read.weights, &read.current), (&checkpoint.weights, &checkpoint.weights));
    assert_eq!(export(&read, &path).unwrap(), read.weights.len() + 3);
    let bytes = std::fs::read(&path).unwrap();
    let file = safetensors::SafeTensors::deserialize(&bytes).unwrap();
    let published = PytorchReader::new(TINY).unwrap();
    for (name, tensor) in published.tensors() {
        let view = file.tensor(name).unwrap();
        assert_eq!(view.shape(), tensor.shape(), "{name}");
        if !UNUSED.contains(&name.as_str()) {
            let before = values(tensor).unwrap();
            let after = view.data().chunks_exact(4).map(|b| f32::from_le_bytes(b.try_into().unwrap()));
            assert!(before.iter().zip(after).all(|(a, b)| (a - b).abs() < 2e-9 + 1e-7 * a.abs()), "{name}");
        }
    }
    assert_eq!(published.len(), file.len());
}

#[test]
fn sizes_that_are_unknown_are_asked_for() {
    let error = import(Path::new(TINY), ImportConfig { object: None, ..config() }).unwrap_err().to_string();
    assert!(error.contains("--object"), "{error}");
    let error = import(Path::new(TINY), ImportConfig { frame: Some([20, 10]), ..config() }).unwrap_err().to_string();
    assert!(error.starts_with("frame:"), "{error}");
}

/// A library parses the file: this tests that its errors are reported, and that the tensors it accepts are checked.
#[test]
fn damaged_files_are_refused_and_nothing_worse() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("damaged.pth");
    let whole = std::fs::read(TINY).unwrap();
    let mut rng = rng::stream(7, "pth", 0);
    for i in 0..200 {
        let mut bytes = whole.clone();
        for _ in 0..rng.random_range(1..4) {
            // The pickle is at the front, the directory at the end.
            let n = bytes.len();
            let at = if rng.random::<bool>() { rng.random_range(0..3600) } else { rng.random_range(n - 2600..n) };
            bytes[at] = rng.random();
        }
        if i % 4 == 0 {
            bytes.truncate(rng.random_range(0..bytes.len()));
        }
        std::fs::write(&path, &bytes).unwrap();
        if let Ok(checkpoint) = import(&path, config()) {
            assert!(checkpoint.weights.values().flatten().all(|v| v.is_finite()));
        }
    }
    std::fs::write(&path, "weights").unwrap();
    assert!(import(&path, config()).unwrap_err().to_string().contains("torch.save"));
}
