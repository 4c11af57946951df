#![allow(clippy::unwrap_used)]
use super::super::testing::foci;
use super::*;
use crate::train::{Architecture, FeatureSteps, Loss, NetworkConfig, Pair, Preset, Start, weights};
use ommatidia_physics::noise::NoiseModel;
use ommatidia_physics::sensor::SensorMaps;

fn task(pairs: &Vec<Pair>) -> Task<'_> {
    let network = NetworkConfig { channels: 2, width: 4, reduction: 2, ..Preset::Nano.network([40, 40], [16, 16]) };
    Task { source: pairs, network, noise: NoiseModel::nominal(), maps: SensorMaps::default() }
}

fn training(steps: u64, start: Start) -> TrainConfig {
    TrainConfig {
        steps,
        batch: 2,
        validate_every: 3,
        warmup: 2,
        start,
        peak_e: [2000.0, 5000.0],
        ..Preset::Nano.training(1e4, 5)
    }
}

/// The derivative along a direction, by the chain of gradients and by a central difference. In f32 the difference of
/// two losses is good to a few parts in a thousand at this step.
#[test]
fn gradients_are_the_slope_of_the_loss() {
    slopes_agree(NetworkConfig::clone(&task(&Vec::new()).network), Start::Regression);
}

/// As above for the peers: through the spectra of kernels, the Wiener formula, and both losses of a CM2Net.
#[test]
fn gradients_of_peers_are_the_slopes_of_their_losses() {
    let plain = task(&Vec::new()).network;
    for architecture in [Architecture::MultiWienerNet, Architecture::MultiFlatNet] {
        slopes_agree(NetworkConfig { architecture, ..plain.clone() }, Start::Psf);
    }
    slopes_agree(lenses().cm2net(plain), Start::Random);
}

/// As above through a second pass: the gradients of its own layers, and those of the first pass through predictions.
#[test]
fn gradients_of_two_passes_are_the_slopes_of_their_loss() {
    slopes_agree(lenses().with_feedback(task(&Vec::new()).network, [2, 0], 1), Start::Regression);
}

/// As above behind an estimate.
#[test]
fn gradients_behind_an_estimate_are_the_slopes_of_their_loss() {
    slopes_agree(lenses().with_feedback(task(&Vec::new()).network, [2, 3], 1), Start::Regression);
}

fn lenses() -> Lenses {
    Lenses::of(&ommatidia_model::testing::square_array(3, [40, 40], [16, 16])).unwrap()
}

fn slopes_agree(network: NetworkConfig, start: Start) {
    let (pairs, lenses) = (foci(6, 40, 16, 10), lenses());
    let task = Task { network, ..task(&pairs) };
    let mut run = Trainer::with_lenses(task, training(1, start), Some(&lenses)).unwrap();
    // A pass begins with zeros behind which nothing has a slope.
    let estimates = run.estimator.is_some();
    let tails = run.state.current.iter_mut().filter(|(name, _)| {
        name.starts_with("pass") || (estimates && !weights::is_filter(name) && !weights::is_calibrated(name))
    });
    tails.for_each(|(_, t)| t.iter_mut().enumerate().for_each(|(i, v)| *v += ((i * 7) % 5) as f32 / 50.0 - 0.04));
    let run = run;
    let examples = run.loader().examples(&[0, 1], Draw { name: "train", index: 0 }).unwrap();
    let Batch { inputs, targets } = Batch::of(examples);
    let loss = |tensors: &Tensors, mode| {
        let network = Network::new(&run.task.network, &run.plan, tensors, mode).unwrap();
        let loss = run.loss(network.forward(inputs.clone()), targets.clone(), mode);
        (network, loss)
    };
    let (network, value) = loss(&run.state.current, Mode::Train);
    let gradients = network.gradients(value.backward());
    let learned = run.state.current.keys().filter(|name| !weights::is_calibrated(name)).count();
    assert_eq!(gradients.len(), learned, "every parameter has a gradient");
    for (name, g) in &gradients {
        let norm = g.iter().map(|&g| f64::from(g).powi(2)).sum::<f64>().sqrt();
        let length = run.state.current[name].iter().map(|&p| f64::from(p).powi(2)).sum::<f64>().sqrt();
        let size = if weights::is_filter(name) { 4e-4 * length } else { 2e-3 };
        let along = |sign: f64| {
            let mut moved = run.state.current.clone();
            let step = moved.get_mut(name).unwrap().iter_mut().zip(g);
            step.for_each(|(p, &g)| *p += (sign * size * f64::from(g) / norm.max(1e-30)) as f32);
            f64::from(loss(&moved, Mode::Infer).1.into_scalar::<f32>())
        };
        let slope = (along(1.0) - along(-1.0)) / (2.0 * size);
        assert!((slope - norm).abs() < 0.03 * norm + 1e-4, "{name}: {slope} {norm}");
    }
}

#[test]
fn training_lowers_the_loss_and_keeps_the_best() {
    let pairs = foci(20, 40, 16, 10);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("net");
    let mut run = Trainer::new(task(&pairs), training(60, Start::Regression)).unwrap();
    run.run(&path, &Provenance::default(), |_| Next::Continue).unwrap();
    let curve = &run.checkpoint().body.curve;
    assert_eq!(curve.len(), 20);
    assert!(curve[19].validation_loss < 0.7 * curve[0].validation_loss, "{curve:?}");
    let best = curve.iter().min_by(|a, b| a.validation_loss.total_cmp(&b.validation_loss)).unwrap();
    let read = Checkpoint::read(&path).unwrap();
    assert_eq!(read.body.best_step, best.step);
    assert_eq!(read.weights, run.checkpoint().weights);
}

/// Figures of a training whose SSIM on held-out pairs was highest at its first validation, while its loss and its PSNR
/// got better until the end.
#[test]
fn each_loss_has_its_criterion() {
    let point =
        |step, validation_loss, psnr_db, ssim| CurvePoint { step, train_loss: 0.6, validation_loss, psnr_db, ssim };
    let (first, last) = (point(325, 0.5545, 33.69, 0.8890), point(6500, 0.5406, 34.16, 0.8765));
    assert!(last.is_better_than(&first, Loss::BceMseNrmse) && !first.is_better_than(&last, Loss::BceMseNrmse));
    assert!(first.is_better_than(&last, Loss::BceMse) && !last.is_better_than(&first, Loss::BceMse));
    assert!(!first.is_better_than(&first, Loss::BceMseNrmse));
}

#[test]
fn a_training_with_roundings_learns_and_resumes_with_the_same_bits() {
    let pairs = foci(20, 40, 16, 10);
    let folder = tempfile::tempdir().unwrap();
    let first = folder.path().join("first");
    let mut run = Trainer::new(task(&pairs), training(30, Start::Regression)).unwrap();
    run.run(&first, &Provenance::default(), |_| Next::Continue).unwrap();
    let steps = FeatureSteps::even(&task(&pairs).network, 0.1);
    let begin = |steps: u64| Trainer::fine_tune(task(&pairs), training(steps, Start::Random), None, &first).unwrap();
    let loss = |run: &mut Trainer<'_>| run.validate().unwrap().validation_loss;
    let plain = loss(&mut begin(12));
    let mut whole = begin(12).with_feature_steps(steps.clone()).unwrap();
    let before = loss(&mut begin(12).with_feature_steps(steps.clone()).unwrap());
    assert!(before > plain, "the roundings cost something: {before} {plain}");
    let path = folder.path().join("whole");
    whole.run(&path, &Provenance::default(), |_| Next::Continue).unwrap();
    let after = whole.checkpoint().body.curve.last().unwrap().validation_loss;
    assert!(after < before, "{after} {before}");
    let path = folder.path().join("part");
    let mut part = begin(12).with_feature_steps(steps.clone()).unwrap();
    part.run(&path, &Provenance::default(), |p| if p.step == 6 { Next::Stop } else { Next::Continue }).unwrap();
    let mut rest = Trainer::resume(task(&pairs), training(12, Start::Random), &path).unwrap();
    assert_eq!(rest.checkpoint().body.feature_steps, Some(steps));
    rest.run(&path, &Provenance::default(), |_| Next::Continue).unwrap();
    assert_eq!(rest.checkpoint().current, whole.checkpoint().current);
    let wrong = FeatureSteps::even(&NetworkConfig { width: 5, ..task(&pairs).network }, 0.1);
    let error = begin(12).with_feature_steps(wrong).err().unwrap().to_string();
    assert!(error.starts_with("feature_steps:"), "{error}");
}

#[test]
fn peers_learn_and_resume_with_the_same_bits() {
    let (pairs, lenses) = (foci(12, 40, 16, 10), lenses());
    let folder = tempfile::tempdir().unwrap();
    let plain = task(&pairs).network;
    let wiener = NetworkConfig { architecture: Architecture::MultiWienerNet, ..plain.clone() };
    let passes = lenses.with_feedback(plain.clone(), [2, 0], 1);
    let all = [(wiener, Start::Psf), (lenses.cm2net(plain), Start::Random), (passes, Start::Psf)];
    for (network, start) in all {
        let task = || Task { network: network.clone(), ..task(&pairs) };
        let [whole, halved] = ["whole", "halved"].map(|name| folder.path().join(name));
        let (provenance, training) = (Provenance::default(), training(12, start));
        let mut run = Trainer::with_lenses(task(), training.clone(), Some(&lenses)).unwrap();
        run.run(&whole, &provenance, |_| Next::Continue).unwrap();
        let curve = &run.checkpoint().body.curve;
        assert!(curve[3].validation_loss < curve[0].validation_loss, "{curve:?}");
        let mut run = Trainer::with_lenses(task(), training.clone(), Some(&lenses)).unwrap();
        run.run(&halved, &provenance, |p| if p.step == 7 { Next::Stop } else { Next::Continue }).unwrap();
        let mut run = Trainer::resume_with_lenses(task(), training, Some(&lenses), &halved).unwrap();
        run.run(&halved, &provenance, |_| Next::Continue).unwrap();
        assert!(std::fs::read(whole).unwrap() == std::fs::read(halved).unwrap());
    }
    let blind =
        Trainer::new(Task { network: lenses.cm2net(task(&pairs).network), ..task(&pairs) }, training(3, Start::Random));
    assert!(matches!(blind, Err(TrainError::Config { field: "instrument", .. })));
}

#[test]
fn a_run_that_gets_no_better_ends_early() {
    let pairs = foci(10, 40, 16, 10);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("net");
    let mut run = Trainer::new(task(&pairs), TrainConfig { patience: 2, ..training(300, Start::Random) }).unwrap();
    // With every step doing nothing, the first validation stays the best.
    run.state.body.training.learning_rate = 1e-30;
    run.state.body.training.filter_learning_rate = 1e-30;
    run.run(&path, &Provenance::default(), |_| Next::Continue).unwrap();
    let body = &run.checkpoint().body;
    assert!(body.step == 9 && body.best_step == 3 && run.is_done(), "{body:?}");
}

/// Examples with estimates are used again: a run that stops and goes on takes the same ones.
#[test]
fn a_run_with_estimates_that_was_stopped_ends_in_the_same_bits() {
    let (pairs, lenses) = (foci(12, 40, 16, 10), lenses());
    let folder = tempfile::tempdir().unwrap();
    let [whole, halved] = ["whole", "halved"].map(|name| folder.path().join(name));
    let network = lenses.with_feedback(task(&pairs).network, [1, 5], 1);
    let task = || Task { network: network.clone(), ..task(&pairs) };
    let training = TrainConfig { validate_every: 10, ..training(80, Start::Psf) };
    let mut run = Trainer::with_lenses(task(), training.clone(), Some(&lenses)).unwrap();
    run.run(&whole, &Provenance::default(), |_| Next::Continue).unwrap();
    let curve = &run.checkpoint().body.curve;
    assert!(curve[7].validation_loss < curve[0].validation_loss, "{curve:?}");
    let mut run = Trainer::with_lenses(task(), training.clone(), Some(&lenses)).unwrap();
    run.run(&halved, &Provenance::default(), |p| if p.step == 63 { Next::Stop } else { Next::Continue }).unwrap();
    let mut run = Trainer::resume_with_lenses(task(), training, Some(&lenses), &halved).unwrap();
    run.run(&halved, &Provenance::default(), |_| Next::Continue).unwrap();
    assert!(std::fs::read(whole).unwrap() == std::fs::read(halved).unwrap());
}

#[test]
fn a_run_that_was_stopped_ends_in_the_same_bits() {
    let pairs = foci(10, 40, 16, 10);
    let folder = tempfile::tempdir().unwrap();
    let [whole, halved] = ["whole", "halved"].map(|name| folder.path().join(name));
    let (provenance, training) = (Provenance::default(), training(9, Start::Random));
    let mut run = Trainer::new(task(&pairs), training.clone()).unwrap();
    run.run(&whole, &provenance, |_| Next::Continue).unwrap();
    let mut run = Trainer::new(task(&pairs), training.clone()).unwrap();
    // Stopped between two checkpoints: the steps after the last one are taken again.
    run.run(&halved, &provenance, |p| if p.step == 5 { Next::Stop } else { Next::Continue }).unwrap();
    let mut run = Trainer::resume(task(&pairs), training, &halved).unwrap();
    assert_eq!(run.checkpoint().body.step, 3);
    run.run(&halved, &provenance, |_| Next::Continue).unwrap();
    assert!(std::fs::read(whole).unwrap() == std::fs::read(halved).unwrap());
}

#[test]
fn another_network_is_not_resumed() {
    let pairs = foci(10, 40, 16, 10);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("net");
    Trainer::new(task(&pairs), training(3, Start::Random))
        .unwrap()
        .run(&path, &Provenance::default(), |_| Next::Continue)
        .unwrap();
    let mut other = task(&pairs);
    other.network.channels = 3;
    let error = Trainer::resume(other, training(3, Start::Random), &path).err().unwrap();
    assert!(matches!(error, TrainError::Resume { field: "network", .. }), "{error}");
    let mut faster = training(3, Start::Random);
    faster.learning_rate *= 2.0;
    let resumed = Trainer::resume(task(&pairs), faster, &path);
    assert!(matches!(resumed, Err(TrainError::Resume { field: "--learning-rate", .. })));
    // A checkpoint of another loss.
    let loss = TrainConfig { loss: Loss::BceMse, ..training(3, Start::Random) };
    let error = Trainer::resume(task(&pairs), loss, &path).err().unwrap().to_string();
    assert!(error.contains("`--loss` is bce-mse-nrmse in") && error.contains("for bce-mse;"), "{error}");
    let vary = TrainConfig { vary: vec!["halo=0.1".parse().unwrap()], ..training(3, Start::Random) };
    let error = Trainer::resume(task(&pairs), vary, &path).err().unwrap().to_string();
    assert!(error.contains("`--vary` is none in") && error.contains("halo=0.1;"), "{error}");
    let longer = training(3, Start::Random).with_steps(200);
    let longer = Trainer::resume(task(&pairs), longer, &path).unwrap();
    let training = &longer.checkpoint().body.training;
    assert_eq!((training.steps, training.warmup, training.validate_every), (200, 2, 3));
}

#[test]
fn a_loss_that_is_not_finite_stops_the_run() {
    let pairs = foci(10, 40, 16, 10);
    let mut run = Trainer::new(task(&pairs), training(3, Start::Random)).unwrap();
    run.state.current.values_mut().next().unwrap().fill(f32::NAN);
    assert!(matches!(run.step(), Err(TrainError::Diverged { step: 0, .. })));
}

/// A run of 9 steps whose weights `spoil` changes after the 5th: it goes back to the checkpoint of the 3rd step and
/// continues with half the learning rates.
fn goes_back_after(spoil: impl Fn(&mut Tensors)) -> Checkpoint {
    let pairs = foci(10, 40, 16, 10);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("net");
    let provenance = Provenance::default();
    let mut run = Trainer::new(task(&pairs), training(9, Start::Random)).unwrap();
    run.run(&path, &provenance, |p| if p.step == 5 { Next::Stop } else { Next::Continue }).unwrap();
    spoil(&mut run.state.current);
    let mut steps = Vec::new();
    run.run(&path, &provenance, |p| {
        steps.push(p.step);
        Next::Continue
    })
    .unwrap();
    assert_eq!(steps, [4, 5, 6, 7, 8, 9]);
    let read = Checkpoint::read(&path).unwrap();
    assert_eq!((read.body.step, read.body.slowed), (9, 1));
    read
}

#[test]
fn a_run_goes_back_where_its_loss_is_not_finite() {
    goes_back_after(|weights| weights.values_mut().next().unwrap().fill(f32::NAN));
}

/// A step that is too long can end at a finite but large loss, from which a network does not recover.
#[test]
fn a_run_goes_back_where_its_held_out_loss_has_diverged() {
    let tail = format!("{}.bias", weights::name::TAIL);
    let read = goes_back_after(|weights| weights.get_mut(&tail).unwrap().fill(20.0));
    assert!(read.body.curve.iter().all(|p| p.validation_loss < 10.0), "{:?}", read.body.curve);
}
