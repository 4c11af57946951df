#![allow(clippy::unwrap_used)]

use super::*;
use crate::instrument::Instrument;
use crate::testing;
use ndarray::array;
use ommatidia_physics::scene::{SceneConfig, Specimen};
use ommatidia_session::artifact;
use std::path::Path;

/// Its first lens copies each object pixel to one sensor pixel; its second one adds nothing.
fn instrument() -> Instrument {
    let mut instrument = testing::instrument([16, 12], [20, 22], 3, 1);
    instrument.geometry.anchors_px = vec![[9.5, 10.5]; 2];
    instrument.psf.basis.fill(0.0);
    instrument.psf.basis[[0, 0, 1, 1]] = 1.0;
    instrument.psf.coefficients.fill(0.0);
    instrument.psf.coefficients.index_axis_mut(ndarray::Axis(0), 0).fill(40.0);
    instrument
}

fn config() -> SimulateConfig {
    let scenes = SceneConfig { specimens: vec![Specimen::Beads, Specimen::Target], ..SceneConfig::default() };
    SimulateConfig { count: 7, shard_pairs: 3, scenes, peak_e: Some([1000.0, 5000.0]), ..SimulateConfig::default() }
}

fn simulation(dir: &Path, seed: u64) -> Simulation {
    let file = dir.join("instrument");
    std::fs::write(&file, "stands for the instrument's file").unwrap();
    config().build(&instrument(), &file, seed).unwrap()
}

fn bytes_of(dir: &Path) -> Vec<(String, Vec<u8>)> {
    let mut files: Vec<_> = std::fs::read_dir(dir)
        .unwrap()
        .map(|e| e.unwrap().path())
        .map(|p| (p.file_name().unwrap().to_str().unwrap().to_string(), std::fs::read(p).unwrap()))
        .collect();
    files.sort();
    files
}

#[test]
fn pairs_come_back_and_frames_are_the_objects_light() {
    let dir = tempfile::tempdir().unwrap();
    let set = dir.path().join("set");
    let progress = simulation(dir.path(), 1).run(&set, Share::ALL, |_| ()).unwrap();
    assert_eq!(progress, Progress { made: 3, kept: 0, missing: 0 });
    let set = DataSet::open(&set).unwrap();
    assert_eq!(set.len(), 7);
    for i in 0..set.len() {
        let (object, frame) = set.pair(i).unwrap();
        assert_eq!((object.dim(), frame.dim()), ((16, 12), (20, 22)));
        assert_eq!(object.fold(0.0f32, |m, v| m.max(*v)), 1.0);
        let peak = frame.fold(0.0f32, |m, v| m.max(*v));
        assert!((1000.0..=5000.0).contains(&peak), "{peak}");
        // The optics copy object pixel (r, c) to sensor pixel (r + 2, c + 5): anchor minus half the object.
        for ((r, c), v) in object.indexed_iter() {
            assert!((frame[[r + 2, c + 5]] - v * peak).abs() < 1e-3 * peak);
        }
    }
    assert!(set.pair(7).unwrap_err().to_string().contains("has 7"));
}

#[test]
fn shares_and_a_killed_run_give_the_bytes_of_one_run() {
    let dir = tempfile::tempdir().unwrap();
    let [whole, shared, killed] = ["whole", "shared", "killed"].map(|n| dir.path().join(n));
    let simulation = simulation(dir.path(), 5);
    simulation.run(&whole, Share::ALL, |_| ()).unwrap();
    let second = simulation.run(&shared, "2/2".parse().unwrap(), |_| ()).unwrap();
    assert_eq!(second, Progress { made: 1, kept: 0, missing: 2 });
    assert!(DataSet::open(&shared).unwrap_err().to_string().contains("2 of 3 shards are missing"));
    simulation.run(&shared, "1/2".parse().unwrap(), |_| ()).unwrap();
    assert_eq!(bytes_of(&whole), bytes_of(&shared));
    simulation.run(&killed, Share::ALL, |_| ()).unwrap();
    std::fs::remove_file(killed.join("shard-00001.safetensors")).unwrap();
    // A shard cut short is made again.
    let path = killed.join("shard-00002.safetensors");
    let bytes = std::fs::read(&path).unwrap();
    std::fs::write(&path, &bytes[..bytes.len() - 1]).unwrap();
    assert!(DataSet::open(&killed).is_err());
    let again = simulation.run(&killed, Share::ALL, |_| ()).unwrap();
    assert_eq!(again, Progress { made: 2, kept: 1, missing: 0 });
    assert_eq!(bytes_of(&whole), bytes_of(&killed));
}

#[test]
fn a_larger_count_extends_a_data_set() {
    let dir = tempfile::tempdir().unwrap();
    let [whole, extended] = ["whole", "extended"].map(|n| dir.path().join(n));
    let few = simulation(dir.path(), 5);
    let more = SimulateConfig { count: few.plan().count + 3, ..config() };
    let more = more.build(&instrument(), &dir.path().join("instrument"), 5).unwrap();
    few.run(&extended, Share::ALL, |_| ()).unwrap();
    let progress = more.run(&extended, Share::ALL, |_| ()).unwrap();
    // The last shard of the smaller set was not full.
    assert_eq!(progress, Progress { made: 2, kept: 2, missing: 0 });
    more.run(&whole, Share::ALL, |_| ()).unwrap();
    assert_eq!(bytes_of(&whole), bytes_of(&extended));
    let error = few.run(&extended, Share::ALL, |_| ()).unwrap_err().to_string();
    assert!(error.contains("has 10 pairs already"), "{error}");
}

#[test]
fn another_data_set_is_not_mixed_in() {
    let dir = tempfile::tempdir().unwrap();
    let [a, b] = ["a", "b"].map(|n| dir.path().join(n));
    simulation(dir.path(), 1).run(&a, Share::ALL, |_| ()).unwrap();
    let error = simulation(dir.path(), 2).run(&a, Share::ALL, |_| ()).unwrap_err().to_string();
    assert!(error.contains("another instrument, seed or configuration"), "{error}");
    simulation(dir.path(), 2).run(&b, Share::ALL, |_| ()).unwrap();
    std::fs::copy(b.join("shard-00000.safetensors"), a.join("shard-00000.safetensors")).unwrap();
    assert!(matches!(DataSet::open(&a).unwrap_err(), DataSetError::Foreign { .. }));
}

#[test]
fn an_indexed_artifact_equals_the_whole_one() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a");
    let header = artifact::Header {
        kind: "shard".into(),
        version: 1,
        provenance: artifact::Provenance::new("test", 0, &()),
        body: 3u32,
    };
    let (x, y) = (array![[1.0f32, 2.0], [3.0, 4.0]], array![[5.0f32, 6.0, 7.0], [8.0, 9.0, 10.0]]);
    let tensors = artifact::Tensors::from([("x".into(), x.into_dyn()), ("y".into(), y.clone().into_dyn())]);
    artifact::write(&path, &header, &tensors).unwrap();
    let index: artifact::Index<u32> = artifact::Index::open(&path, "shard", 1).unwrap();
    assert_eq!(index.header(), &header);
    assert_eq!(index.read_entry("y", 1).unwrap(), y.row(1).to_owned().into_dyn());
    assert!(index.read_entry("y", 2).is_err() && index.read_entry("z", 0).is_err());
    assert!(artifact::Index::<u32>::open(&path, "shard", 2).unwrap_err().to_string().contains("version 2, found 1"));
    assert!(artifact::Index::<u32>::open(&path, "instrument", 1).is_err());
    let bytes = std::fs::read(&path).unwrap();
    for keep in [0, 5, 20, bytes.len() - 1] {
        std::fs::write(&path, &bytes[..keep]).unwrap();
        assert!(artifact::Index::<u32>::open(&path, "shard", 1).is_err(), "{keep}");
    }
}

#[test]
fn impossible_configurations_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("instrument");
    std::fs::write(&file, "x").unwrap();
    for (change, field) in [
        (SimulateConfig { count: 0, ..config() }, "count"),
        (SimulateConfig { shard_pairs: 0, ..config() }, "shard_pairs"),
        (SimulateConfig { peak_e: Some([9.0, 3.0]), ..config() }, "peak_e"),
    ] {
        let error = change.build(&instrument(), &file, 1).unwrap_err().to_string();
        assert!(error.contains(field), "{error}");
    }
    for text in ["0/2", "3/2", "1", "a/b", "1/0"] {
        assert!(text.parse::<Share>().is_err(), "{text}");
    }
}

/// Pairs without a drawn effect are those of a data set that draws none; others hold the effect.
#[test]
fn half_of_the_frames_hold_an_effect() {
    let dir = tempfile::tempdir().unwrap();
    let plain = simulation(dir.path(), 4);
    let vary = ["veiling_glare=0.2", "array_shift=2"].map(|text| text.parse().unwrap()).to_vec();
    let varied = SimulateConfig { count: 60, vary, ..config() };
    let varied = varied.build(&instrument(), &dir.path().join("instrument"), 4).unwrap();
    let dark = |frame: &ndarray::Array2<f32>| frame.fold(f32::MAX, |m, v| m.min(*v));
    let [mut same, mut brighter, mut moved] = [0; 3];
    for i in 0..60 {
        let ((object, frame), (other, with)) = (plain.pair(i).unwrap(), varied.pair(i).unwrap());
        assert_eq!(object, other);
        match (frame == with, dark(&with) > dark(&frame)) {
            (true, _) => same += 1,
            (false, true) => brighter += 1,
            (false, false) => moved += 1,
        }
    }
    assert!(same >= 20 && brighter >= 8 && moved >= 8, "{same} {brighter} {moved}");
    // Noise that training draws itself, drifts over time, and depths that were not calibrated.
    for text in ["row_noise=2", "photobleaching=0.5", "lag=0.1", "defocus=10"] {
        let bad = SimulateConfig { vary: vec![text.parse().unwrap()], ..config() };
        let error = bad.build(&instrument(), &dir.path().join("instrument"), 4).err().unwrap().to_string();
        assert!(error.contains("vary") && error.contains(text.split('=').next().unwrap()), "{error}");
    }
    // An array that leaves the sensor.
    let gone = SimulateConfig { count: 60, vary: vec!["array_shift=50".parse().unwrap()], ..config() };
    let gone = gone.build(&instrument(), &dir.path().join("instrument"), 4).unwrap();
    let errors: Vec<String> = (0..60).filter_map(|i| Some(gone.pair(i).err()?.to_string())).collect();
    assert!(!errors.is_empty() && errors.iter().all(|e| e.contains("array_shift=")), "{errors:?}");
}
