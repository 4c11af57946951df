#![allow(clippy::unwrap_used)]

use super::session::gain;
use super::transfer::Transfer;
use super::*;
use crate::noise::draw::draw_electrons;
use crate::noise::model::{Source, Sources};
use crate::noise::stats::Summary;
use ndarray::Array2;
use ommatidia_model::testing::Testbed;
use ommatidia_session::{Existing, Role, SampleType, Session, SessionWriter, StackEntry, StackSpec, rng};

fn measured(bed: &Testbed) -> NoiseCalibration {
    measured_with(bed, NoiseConfig::default())
}

fn measured_with(bed: &Testbed, config: NoiseConfig) -> NoiseCalibration {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("session");
    Testbed { scan: 2, scenes: 0, ..bed.clone() }.write(&path);
    measure_noise(&Session::open(&path).unwrap(), &config, &mut || {}).unwrap()
}

/// The notes as a user reads them.
fn texts(found: &NoiseCalibration) -> String {
    found.notes.iter().map(|note| format!("{note}\n")).collect()
}

fn given(gain_dn_per_e: Option<f64>, read_noise_e: Option<f64>) -> NoiseConfig {
    NoiseConfig { nominal_gain_dn_per_e: gain_dn_per_e, nominal_read_noise_e: read_noise_e }
}

/// A video of a specimen that keeps still, at a gain of 0.4 and a read noise of 2 e-, and nothing else.
fn video(config: NoiseConfig) -> NoiseCalibration {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("session");
    let mut manifest = Testbed::new().manifest;
    (manifest.sensor.rows, manifest.sensor.cols) = (90, 90);
    let mut writer = SessionWriter::create(&path, &manifest, Existing::Keep).unwrap();
    let spec = StackSpec { frames: 72, rows: 90, cols: 90, samples: SampleType::U16, pixel_um: None };
    let mut frames = writer.frames("scene.npy", spec).unwrap();
    for k in 0..72 {
        let light = |(r, c): (usize, usize)| 15.0 + 400.0 * (((r * 7 + c * 3) % 101) as f32 / 100.0).powi(3);
        let mut frame = Array2::from_shape_fn((90, 90), light);
        draw_electrons(frame.as_slice_mut().unwrap(), 2.0, &mut rng::stream(3, "still", k));
        frames.push(frame.mapv(|e| (100.0 + 0.4 * e).round()).view()).unwrap();
    }
    frames.finish().unwrap();
    writer.add(StackEntry::plain(Role::Scene, "scene.npy", 10.0));
    writer.finish().unwrap();
    measure_noise(&Session::open(&path).unwrap(), &config, &mut || {}).unwrap()
}

#[test]
fn a_value_that_was_given_comes_before_an_estimate_from_a_video() {
    let none = video(given(None, None));
    assert!((none.model.gain_dn_per_e / 0.4 - 1.0).abs() < 0.15, "{:?}", none.model);
    assert!(texts(&none).contains("or set --gain"), "{}", texts(&none));
    // Also where it is the value that would be used without it.
    for (gain, read_noise) in [(1.0, 2.0), (0.7, 3.5)] {
        let both = video(given(Some(gain), Some(read_noise)));
        assert_eq!((both.model.gain_dn_per_e, both.model.read_noise_e), (gain, read_noise));
        assert!(!texts(&both).contains("--"), "{}", texts(&both));
    }
    let alone = video(given(None, Some(7.0)));
    assert_eq!(alone.model.read_noise_e, 7.0);
    assert_eq!(alone.model.gain_dn_per_e, none.model.gain_dn_per_e);
    assert!(!texts(&alone).contains("--read-noise"), "{}", texts(&alone));
}

#[test]
fn darks_and_flats_decide_and_a_note_names_the_value_that_is_not_used() {
    let found = measured_with(&Testbed::new(), given(Some(1.0), Some(7.0)));
    assert!((found.model.gain_dn_per_e / 0.4 - 1.0).abs() < 0.02, "{:?}", found.model);
    assert!((found.model.read_noise_e / 2.0 - 1.0).abs() < 0.05, "{:?}", found.model);
    let text = texts(&found);
    assert!(text.contains("the gain that was given, 1 DN/e-, is not used: the flats"), "{text}");
    assert!(text.contains("the read noise that was given, 7 e-, is not used: the darks"), "{text}");
    assert!(texts(&measured_with(&Testbed::new(), given(Some(0.4), Some(2.0)))).is_empty());
    let flats = measured_with(&Testbed { dark_frames: 0, ..Testbed::new() }, given(None, Some(7.0)));
    assert!(texts(&flats).contains("the flats of this session show"), "{}", texts(&flats));
    // Bead frames hold stray light as well: they give way.
    let beads = Testbed { dark_frames: 0, flat_levels_e: Vec::new(), ..Testbed::new() };
    assert_eq!(measured_with(&beads, given(None, Some(3.0))).model.read_noise_e, 3.0);
}

#[test]
fn gain_read_noise_and_offsets_come_out_of_a_flickering_lamp_and_a_fixed_pattern() {
    for (gain, read) in [(0.4, 2.0), (1.1, 1.2), (0.25, 6.0)] {
        let flat_levels_e = vec![200.0, 800.0, 2000.0];
        let bed = Testbed { gain_dn_per_e: gain, read_noise_e: read, flicker: 0.02, flat_levels_e, ..Testbed::new() };
        let n = measured(&bed);
        assert!((n.model.gain_dn_per_e / gain - 1.0).abs() < 0.02, "{:?}", n.model);
        assert!((n.model.read_noise_e / read - 1.0).abs() < 0.05, "{:?}", n.model);
        assert!(n.notes.is_empty() && n.photon_transfer.nrows() == 4);
        let offset = n.offset_dn.unwrap();
        // The pattern is -1, 0, 1 by (13 r + 7 c) mod 3; the hot pixel keeps all of its offset.
        let sigma = (gain * gain * read * read / 12.0).sqrt();
        assert!((f64::from(offset[[0, 0]]) + 1.0).abs() < 5.0 * sigma, "{}", offset[[0, 0]]);
        assert!(offset[[3, 5]] > 400.0);
    }
}

#[test]
fn a_response_that_bends_is_measured_and_does_not_lower_the_gain() {
    let flat_levels_e = vec![800.0, 2500.0, 4500.0, 6500.0, 8500.0];
    let bed = Testbed { flat_levels_e, flat_frames: 16, flicker: 0.001, ..Testbed::new() };
    let straight = measured(&bed);
    assert!(straight.bend.is_none() && straight.notes.is_empty(), "{:?}", straight.bend);
    let bent = measured(&Testbed { bend: 0.03, ..bed });
    let found = bent.bend.unwrap();
    assert!((found.beta - 0.03).abs() < 4.0 * found.sigma && found.sigma < 0.003, "{found:?}");
    assert!((bent.model.gain_dn_per_e / 0.4 - 1.0).abs() < 0.01, "{:?}", bent.model);
    assert!(bent.notes.is_empty(), "{:?}", bent.notes);
}

#[test]
fn levels_in_saturation_and_single_frames_are_left_out() {
    let with = |levels: &[f64], flat_frames| {
        measured(&Testbed { flat_levels_e: levels.to_vec(), flat_frames, ..Testbed::new() })
    };
    let (all, fewer) = (with(&[500.0, 4000.0, 12_000.0], 4), with(&[500.0, 4000.0], 4));
    assert_eq!(all.photon_transfer.nrows(), 3);
    assert!((all.model.gain_dn_per_e - fewer.model.gain_dn_per_e).abs() < 1e-9);
    let single = with(&[500.0, 4000.0], 1);
    assert_eq!(single.model.sources.gain, Source::Nominal);
    assert!(single.notes.iter().any(|n| matches!(n, NoiseNote::NominalGain { .. })));
    assert!(single.notes.iter().any(|n| matches!(n, NoiseNote::ReadNoiseInDn { .. })));
}

#[test]
fn flats_without_darks_still_give_the_gain() {
    let n = measured(&Testbed { dark_frames: 0, ..Testbed::new() });
    assert!(
        (n.model.gain_dn_per_e / 0.4 - 1.0).abs() < 0.02 && n.model.sources.gain == Source::Measured,
        "{:?}",
        n.model
    );
    assert_eq!(n.model.sources.black_level, Source::Inferred);
}

#[test]
fn flats_whose_variance_falls_with_the_light_are_refused() {
    let level = |mean, variance| Summary { mean, variance, sigma: 0.01 * variance };
    let transfer =
        Transfer::fit(&[level(100.0, 50.0), level(1000.0, 20.0)], None, None).map_err(str::to_string).unwrap();
    assert!(transfer.slope < 0.0);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("session");
    Testbed { scan: 2, scenes: 0, ..Testbed::new() }.write(&path);
    let session = Session::open(&path).unwrap();
    let error = gain(&session, &Ok(transfer), &NoiseConfig::default(), &mut Sources::default(), &mut Vec::new());
    assert!(error.unwrap_err().to_string().contains("flat.npy: photon transfer: expected the variance to grow"));
}

#[test]
fn the_darks_of_the_exposure_of_the_frames_count_whatever_their_order() {
    // Without light 4 DN a millisecond above 60 DN; as many darks at 10 ms as at 40 ms.
    let black = |order: [f64; 2], scenes_ms: f64| {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("session");
        let mut manifest = Testbed::new().manifest;
        (manifest.sensor.rows, manifest.sensor.cols) = (30, 30);
        let mut writer = SessionWriter::create(&path, &manifest, Existing::Keep).unwrap();
        let spec = StackSpec { frames: 4, rows: 30, cols: 30, samples: SampleType::U16, pixel_um: None };
        let stacks = [(Role::Dark, order[0]), (Role::Dark, order[1]), (Role::Scene, scenes_ms)];
        for (s, (role, exposure_ms)) in stacks.into_iter().enumerate() {
            let name = format!("{s}.npy");
            let mut frames = writer.frames(&name, spec).unwrap();
            for k in 0..4 {
                let mut frame = Array2::from_elem((30, 30), 0.0f32);
                draw_electrons(frame.as_slice_mut().unwrap(), 3.0, &mut rng::stream(3, "dark", 4 * s as u64 + k));
                frames.push(frame.mapv(|e| (60.0 + 4.0 * exposure_ms as f32 + e).round()).view()).unwrap();
            }
            frames.finish().unwrap();
            writer.add(StackEntry::plain(role, &name, exposure_ms));
        }
        writer.finish().unwrap();
        measure_noise(&Session::open(&path).unwrap(), &NoiseConfig::default(), &mut || {}).unwrap().model.black_level_dn
    };
    for order in [[10.0, 40.0], [40.0, 10.0]] {
        for scenes_ms in [10.0, 12.0, 40.0] {
            let expected = if scenes_ms < 20.0 { 100.0 } else { 220.0 };
            let found = black(order, scenes_ms);
            assert!((found - expected).abs() < 1.0, "{order:?} {scenes_ms}: {found}");
        }
    }
}
