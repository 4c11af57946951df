#![allow(clippy::unwrap_used)]

use super::super::network::values;
use super::super::ops::fourier::Fourier;
use super::super::{Mode, Network, NetworkConfig, NetworkInput, Preset, weights};
use super::*;
use std::sync::Arc;

/// A network with filters and biases of a usual size, and a frame.
fn network(config: &NetworkConfig) -> (ommatidia_session::artifact::Tensors, Vec<f32>) {
    let mut tensors = weights::random(config, 3);
    for (i, (name, tensor)) in tensors.iter_mut().enumerate() {
        if name.ends_with(".bias") {
            tensor.iter_mut().enumerate().for_each(|(k, v)| *v = ((k * 37 + i * 11) % 17) as f32 / 40.0 - 0.2);
        }
    }
    let frame = (0..config.frame[0] * config.frame[1]).map(|i| ((i * 7919) % 1013) as f32 / 1013.0).collect();
    (tensors, frame)
}

#[test]
fn outputs_are_those_of_the_graph() {
    for (preset, object) in [
        (Preset::Nano, [8, 12]),
        (Preset::Lite, [70, 210]),
        (Preset::Paper, [140, 226]),
        (Preset::Paper, [2, 2]),
        (Preset::Nano, [66, 2]),
    ] {
        let config = preset.network([150, 230], object);
        let (tensors, frame) = network(&config);
        let plan = Arc::new(Fourier::new(config.fourier()));
        let graph = Network::new(&config, &plan, &tensors, Mode::Infer).unwrap();
        let input = NetworkInput::of(&config, &plan, &frame);
        let [re, im] = graph.filters().map(values);
        let filtered = plan.forward(&[input.spectrum().to_vec()], &plan.filters(&re, &im));
        let want = values(graph.forward(vec![input]).logits);
        let most = filtered.iter().copied().fold(f32::NEG_INFINITY, f32::max);
        let enhancement = Enhancement::new(&config, 0, &tensors).unwrap();
        let run = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| enhancement.logits(filtered.clone(), 1.0 / most))
        };
        let got = run(1);
        let top = want.iter().fold(0.0f32, |m, v| m.max(v.abs()));
        let worst = got.iter().zip(&want).fold(0.0f32, |m, (a, b)| m.max((a - b).abs()));
        assert!(worst < 1e-5 * top, "{preset:?} {object:?}: {worst} of {top}");
        assert!(run(3) == got);
    }
}

#[test]
fn a_missing_weight_is_named() {
    let config = Preset::Nano.network([20, 20], [8, 8]);
    let (mut tensors, _) = network(&config);
    tensors.remove("enhancement.conv1.bias");
    let message = Enhancement::new(&config, 0, &tensors).err().unwrap().to_string();
    assert!(message.contains("enhancement.conv1.bias"), "{message}");
}
