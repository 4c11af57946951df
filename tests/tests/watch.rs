//! The watch on the optics: a device computes its bits, and on the virtual instrument it finds the lens that moved.
#![allow(clippy::unwrap_used)]

mod networks;

use networks::{DENSE, Shape, TAPPED};
use ommatidia::device::{DeviceError, Firmware, LoopbackConfig, RunRequest, Runtime, find_qemu, run};
use ommatidia_bench::{BenchConfig, FamilyName};
use ommatidia_model::calibrate::{CalibrateConfig, calibrate};
use ommatidia_model::instrument::Instrument;
use ommatidia_network::watch::WatchMaps;
use ommatidia_physics::effects::EffectSetting;
use ommatidia_physics::scene::Specimen;
use ommatidia_physics::sensor::sensor_codes;
use ommatidia_session::{Role, Session};
use ommatidia_shared::boards::BOARDS;
use ommatidia_shared::watch::{Alarm, BASELINE, Report, Watch};

/// Frames of one scene whose light changes a little, and whose right half brightens at the end.
fn frames(shape: &Shape, seed: u64) -> Vec<Vec<u16>> {
    let scene = &networks::frames(shape, 1, seed)[0];
    let cols = usize::from(shape.frame[1]);
    let frame = |n: usize| {
        let code = |(i, code): (usize, &u16)| {
            let more = if n > BASELINE as usize + 3 && i % cols > cols / 2 { code / 8 } else { 0 };
            (code / 2 + more + ((i * 31 + n * 17) % 7) as u16).min(1000)
        };
        scene.iter().enumerate().map(code).collect()
    };
    (0..BASELINE as usize + 12).map(frame).collect()
}

/// What this machine makes of the frames.
fn reports(file: &ommatidia_network::network_file::NetworkFile, frames: &[Vec<u16>]) -> Vec<Report> {
    let network = file.network().unwrap();
    let maps = network.watch().unwrap();
    let mut watch = Watch::new();
    let see = |(id, frame): (u32, &Vec<u16>)| {
        let saturated = frame.iter().filter(|code| **code >= network.header().sensor.saturation_dn).count();
        watch.see(&maps, frame, saturated as u32, id);
        watch.report(&maps)
    };
    (1..).zip(frames).map(see).collect()
}

/// On every emulated board and in this process: the same report after every frame, an alarm included.
#[test]
fn a_device_computes_the_bits_of_the_host() {
    let mut runtimes = vec![Runtime::Host(LoopbackConfig::default())];
    let boards = BOARDS.into_iter().filter(|board| board.emulated);
    match boards.map(|board| Firmware::build(board, "app")).collect::<Result<Vec<_>, _>>() {
        Ok(boards) if find_qemu().is_some() => runtimes.extend(boards.into_iter().map(Runtime::Qemu)),
        Ok(_) | Err(DeviceError::NoFirmware { .. }) => {
            assert!(std::env::var_os("OMMATIDIA_REQUIRE_QEMU").is_none());
            ommatidia_tests::skip("a_device_computes_the_bits_of_the_host", "no emulator");
        }
        Err(error) => panic!("{error}"),
    }
    // Small networks, since a baseline takes many frames: the watch sees frames alone.
    let dense =
        Shape { frame: [27, 30], object: [16, 18], tile: 32, step: 32, channels: 1, width: 2, groups: 0, ..DENSE };
    let tapped = Shape { frame: [31, 25], object: [20, 14], tile: 16, step: 8, width: 2, blocks: 0, ..TAPPED };
    for (shape, seed) in [(&dense, 71), (&tapped, 72)] {
        let file = networks::network_of(&networks::with_watch(shape, 7), seed);
        let frames = frames(shape, seed);
        let expected = reports(&file, &frames);
        assert!(expected.last().unwrap().alarm.is_some(), "{:?}", expected.last());
        assert!(expected[BASELINE as usize].alarm.is_none(), "{:?}", expected[BASELINE as usize]);
        for runtime in &runtimes {
            let device = run(runtime, &file, RunRequest::from(&frames[..]), None, &mut |_| {}).unwrap();
            let found: Vec<Report> = device.reports.iter().map(|report| report.watch).collect();
            assert_eq!(found, expected, "{}", device.board);
            assert_eq!(device.telemetry.watch, *expected.last().unwrap());
            assert_eq!(device.differing_bits, 0);
        }
    }
}

/// Cells, other ones in each frame, of about the same light.
fn bench(frames: usize) -> BenchConfig {
    let mut config = BenchConfig { family: FamilyName::Relay, instrument_seed: 77, ..BenchConfig::default() };
    config.stacks.scene_frames = frames;
    config.stacks.scene_peak = [0.5, 0.5];
    config.scenes.specimens = vec![Specimen::Cells, Specimen::Neurons];
    config
}

/// Codes of the scenes of a session that the virtual instrument measures.
fn scenes(config: &BenchConfig, seed: u64, effects: &[EffectSetting]) -> Vec<Vec<u16>> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("session");
    config.build(effects).unwrap().measure_some(&path, seed, &[Role::Scene], |_| ()).unwrap();
    let session = Session::open(&path).unwrap();
    let stack = &session.need(Role::Scene).unwrap()[0];
    let mut reader = stack.frames().unwrap();
    let shape = [config.sensor.rows, config.sensor.cols];
    (0..reader.len()).map(|i| sensor_codes(reader.read(i).unwrap().view(), shape).unwrap()).collect()
}

fn calibrated() -> Instrument {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("session");
    let config = BenchConfig { scenes: Default::default(), stacks: Default::default(), ..bench(0) };
    config.build(&[]).unwrap().measure(&path, 11, |_| ()).unwrap();
    let session = Session::open(&path).unwrap();
    calibrate(&session, &CalibrateConfig::default(), || ()).unwrap().instrument
}

fn watched(maps: &WatchMaps, frames: &[&[Vec<u16>]]) -> Report {
    let mut watch = Watch::new();
    for (id, frame) in (0..).zip(frames.iter().flat_map(|part| part.iter())) {
        watch.see(&maps.maps(), frame, 0, id);
    }
    watch.report(&maps.maps())
}

/// An instrument calibrated on its beads watches specimens that are new in every frame: nothing, until a lens moves.
#[test]
fn the_lens_that_moved_is_named_and_nothing_else_is() {
    let maps = WatchMaps::of(&calibrated(), 1).unwrap();
    println!("{:?}", maps.figures(4031.0));
    let quiet = scenes(&bench(260), 41, &[]);
    let report = watched(&maps, &[&quiet]);
    println!("{report:?}");
    assert!(report.alarm.is_none() && report.frames > 200, "{report:?}");
    for (name, value, statistic) in [("row_px_4", 0.3, 4), ("col_px_4", -0.3, 13)] {
        let moved = scenes(&bench(160), 42, &[EffectSetting::new("lens_decentre", &[(name, value)])]);
        let report = watched(&maps, &[&quiet[..200], &moved]);
        println!("{name}: {report:?}");
        let Alarm { statistic: found, since, millionths, .. } = report.alarm.unwrap();
        assert_eq!(found, statistic, "{name}");
        assert!((190..260).contains(&since), "{name}: {since}");
        let found = f64::from(millionths) / 1e6;
        assert!((found - value).abs() < 0.5 * value.abs(), "{name}: {found} px");
    }
}
