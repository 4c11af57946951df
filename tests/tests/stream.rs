//! `device stream`: frames at a given rate, a device that skips those that it has no time for, and a recording that can
//! be read at any time.
#![allow(clippy::unwrap_used)]

mod networks;

use networks::DENSE;
use ommatidia::device::{
    DeviceError, Firmware, FrameFeed, Frames, LoopbackConfig, Runtime, Scope, StreamRecording, StreamReport,
    StreamedFrame, find_qemu, reference, stream,
};
use ommatidia_shared::boards::{BOARDS, Board};
use ommatidia_shared::device::{PULSES_US, Response};
use ommatidia_shared::image::Region;
use ommatidia_shared::wire::{CameraChange, Refusal, SensorRegion, Setting, Trigger};

const REGION: Region = Region { row: 3, col: 4, rows: 5, cols: 6 };
/// Frames of the networks of this file.
const FRAME: [u16; 2] = [40, 52];

fn with_camera() -> Runtime {
    Runtime::Host(LoopbackConfig { camera: FRAME, ..LoopbackConfig::default() })
}

/// Streams `len` frames of the camera.
fn from_camera(
    runtime: &Runtime,
    change: CameraChange,
    (len, fps, nth, scope): (usize, Option<f64>, usize, Scope),
) -> anyhow::Result<(StreamReport, Vec<StreamedFrame>)> {
    let feed = FrameFeed { len, fps, nth, scope, source: Frames::Camera(change) };
    let mut shown = Vec::new();
    let report = stream(runtime, None, &networks::network(&DENSE, 30), feed, &mut |frame| {
        shown.push(frame.clone());
        Ok(())
    })?;
    Ok((report, shown))
}

#[test]
fn the_frames_of_a_camera_need_not_be_sent() {
    let change = CameraChange { exposure_us: Some(5_000), led_permille: Some(1000), ..CameraChange::default() };
    let (report, shown) = from_camera(&with_camera(), change, (7, None, 3, REGION.into())).unwrap();
    assert_eq!((report.reconstructed, report.dropped), (3, 0));
    assert_eq!(shown.iter().map(|frame| frame.frame).collect::<Vec<_>>(), [0, 3, 6]);
    let response = Response::of(&report.camera.unwrap().0.settings, 1000);
    let codes = |n| (0..40 * 52).map(|i| response.code(n, i)).collect();
    let frames: Vec<Vec<u16>> = (0..3).map(codes).collect();
    let whole = reference(&networks::network(&DENSE, 30), frames.as_slice().into()).unwrap();
    for (shown, whole) in shown.iter().zip(&whole) {
        assert_eq!(shown.object, networks::cut(whole, &DENSE, REGION));
    }
}

/// The stream distinguishes approximate frames from exact ones and names the frame of their statistics, whatever the
/// numbers of the runs.
#[test]
fn a_stream_names_the_frame_that_its_field_was_measured_in() {
    let scope = Scope { hold: 2, ..REGION.into() };
    let (report, shown) = from_camera(&with_camera(), CameraChange::default(), (14, None, 2, scope)).unwrap();
    assert_eq!(report.held, 4);
    let fields: Vec<_> = shown.iter().map(|f| (f.frame, f.field_frame, f.report.field_age)).collect();
    assert_eq!(fields, [(0, 0, 0), (2, 0, 1), (4, 0, 2), (6, 6, 0), (8, 6, 1), (10, 6, 2), (12, 12, 0)]);
}

#[test]
fn a_device_without_a_camera_says_so() {
    let runtime = Runtime::Host(LoopbackConfig::default());
    let error = from_camera(&runtime, CameraChange::default(), (1, None, 1, Scope::default())).unwrap_err();
    assert!(matches!(error.downcast_ref(), Some(DeviceError::NoCamera { .. })), "{error}");
}

#[test]
fn what_a_camera_cannot_do_is_refused_before_the_first_frame() {
    let refused = |change| from_camera(&with_camera(), change, (1, None, 1, Scope::default())).unwrap_err();
    let error = refused(CameraChange { exposure_us: Some(30_000), ..CameraChange::default() });
    match error.downcast_ref() {
        Some(DeviceError::Refused(Refusal::Setting(error))) => {
            // 20 ms from frame to frame, of which 40 rows of 20 us are read out.
            assert_eq!((error.setting, error.least, error.most), (Setting::Exposure, 20, 19_200));
        }
        other => panic!("{other:?}"),
    }
    let region = SensorRegion { row: 0, col: 0, rows: 40, cols: 40, bin: 1 };
    let error = refused(CameraChange { region: Some(region), ..CameraChange::default() });
    let other_frame = DeviceError::CameraRegion { rows: 40, cols: 40, network: FRAME };
    assert_eq!(error.to_string(), other_frame.to_string());
}

/// The recording has the start of each exposure on the device's clock, and the settings; frames that were not taken are
/// gaps in its numbers.
#[test]
fn a_recording_of_a_camera_is_one_with_times() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.tif");
    let change = CameraChange { interval_us: Some(10_000), exposure_us: Some(2_000), ..CameraChange::default() };
    let feed = FrameFeed { len: 9, fps: Some(20.0), nth: 2, scope: REGION.into(), source: Frames::Camera(change) };
    let mut recording = StreamRecording::create(&path, REGION, Default::default()).unwrap();
    let mut captures = Vec::new();
    let blob = networks::network(&DENSE, 30);
    let report = stream(&with_camera(), None, &blob, feed, &mut |frame| {
        captures.extend(frame.report.capture);
        recording.push(frame)
    });
    let (status, missed) = report.unwrap().camera.unwrap();
    let table = std::fs::read_to_string(StreamRecording::table_path(&path)).unwrap();
    let mut lines = table.lines().map(|line| line.split(',').collect::<Vec<_>>());
    let heading = lines.next().unwrap();
    let column = |name: &str| heading.iter().position(|column| *column == name).unwrap();
    let mut gaps = 0;
    let rows: Vec<_> = lines.collect();
    assert_eq!(rows.len(), captures.len());
    for (i, (row, capture)) in rows.iter().zip(&captures).enumerate() {
        assert_eq!(row.len(), heading.len());
        let number = |name: &str| row[column(name)].parse::<f64>().unwrap();
        assert_eq!((number("exposure_start_s") * 1e6).round() as u64, capture.start_us);
        assert_eq!((number("exposure_s"), number("interval_s")), (0.002, 0.01));
        assert_eq!((row[column("rows")], row[column("cols")], row[column("trigger")]), ("40", "52", "device"));
        assert_eq!(number("camera_frame") as u32, capture.number);
        gaps += number("missed_before") as u32;
        if i > 0 {
            let last = captures[i - 1];
            assert_eq!(number("missed_before") as u32, capture.number - last.number - 1);
            let (step, places) = (capture.start_us - last.start_us, u64::from(capture.number - last.number));
            assert!(step.abs_diff(places * 10_000) < 5_000, "{step} us for {places} places of 10 ms");
        }
    }
    // Every tenth place of the grid was taken: 20 frames a second, every second of them.
    assert!(missed == gaps && gaps >= 9 * (captures.len() as u32 - 1) - 8, "{missed} {gaps}");
    assert_eq!(status.frames as usize, captures.len());
    assert!(recording.interval_s().is_none());
}

/// On the emulated boards: settings, limits, times, pulses, and a duty cycle whose frames are fresh.
#[test]
fn a_board_exposes_each_frame_after_it_was_asked_for() {
    let Some(boards) = boards("a_board_exposes_each_frame_after_it_was_asked_for") else { return };
    for firmware in boards {
        let name = firmware.board().name;
        let runtime = Runtime::Qemu(firmware);
        let region = SensorRegion { row: 0, col: 0, rows: FRAME[0], cols: FRAME[1], bin: 2 };
        let change = CameraChange {
            region: Some(region),
            exposure_us: Some(4_995),
            interval_us: Some(20_000),
            analog_gain_thousandths: Some(1_260),
            led_permille: Some(300),
            trigger: None,
        };
        // One frame in a second, half a second apart.
        let (report, shown) = from_camera(&runtime, change, (4, Some(4.0), 2, Scope::default())).unwrap();
        let (status, missed) = report.camera.unwrap();
        let set = status.settings;
        assert_eq!((set.exposure_us, set.analog_gain_thousandths, set.led_permille), (5_000, 1_250, 302), "{name}");
        let captures: Vec<_> = shown.iter().map(|frame| frame.report.capture.unwrap()).collect();
        assert_eq!(captures.len(), 2);
        // The second one was exposed when its turn came, and not right after the first.
        let apart_us = captures[1].start_us - captures[0].start_us;
        assert!(apart_us > 300_000 && missed > 14, "{name}: {apart_us} us apart, {missed} frames between");
        let places = u64::from(captures[1].number - captures[0].number);
        assert!(apart_us.abs_diff(places * 20_000) < 15_000, "{name}: {apart_us} us, {places} places");
        // The LED was lit for two exposures. An emulated clock may run on between two instructions.
        assert!((10_000..60_000).contains(&status.lit_us), "{name}: {}", status.lit_us);
        // What the camera saw is what the settings say, and the device reconstructed it.
        let response = Response::of(&set, 302);
        let frames: Vec<Vec<u16>> = (0..2).map(|n| (0..40 * 52).map(|i| response.code(n, i)).collect()).collect();
        let whole = reference(&networks::network(&DENSE, 30), frames.as_slice().into()).unwrap();
        assert_eq!(shown.iter().map(|frame| frame.object.clone()).collect::<Vec<_>>(), whole, "{name}");
        // Pulses start exposures.
        let change = CameraChange { trigger: Some(Trigger::Input), ..change };
        let (_, shown) = from_camera(&runtime, change, (2, None, 1, Scope::default())).unwrap();
        for capture in shown.iter().map(|frame| frame.report.capture.unwrap()) {
            assert!(capture.start_us % PULSES_US < 20_000, "{name}: {capture:?}");
        }
        // The region is refused by the limit of the array.
        let region = SensorRegion { rows: 400, ..region };
        let change = CameraChange { region: Some(region), ..CameraChange::default() };
        let error = from_camera(&runtime, change, (1, None, 1, Scope::default())).unwrap_err();
        assert!(error.to_string().contains("rows: 400; from 1 to 240"), "{name}: {error}");
    }
}

/// The emulated boards; `None` where they cannot run here.
fn boards(test: &str) -> Option<Vec<Firmware>> {
    let build = |board: Board| match Firmware::build(board, "app") {
        Ok(firmware) if find_qemu().is_some() => Ok(firmware),
        Ok(_) => Err("qemu-system-arm is not on the PATH".into()),
        Err(DeviceError::NoFirmware { detail }) => Err(detail),
        Err(error) => panic!("{error}"),
    };
    let boards = BOARDS.into_iter().filter(|board| board.emulated).map(build).collect::<Result<Vec<_>, String>>();
    match boards {
        Ok(boards) => Some(boards),
        Err(missing) => {
            assert!(std::env::var_os("OMMATIDIA_REQUIRE_QEMU").is_none(), "{missing}");
            ommatidia_tests::skip(test, &missing);
            None
        }
    }
}

/// One frame per second: the boards sleep in between, and report for how long.
#[test]
fn a_board_sleeps_between_frames() {
    let Some(boards) = boards("a_board_sleeps_between_frames") else { return };
    let (blob, frames) = (networks::network(&DENSE, 31), networks::frames(&DENSE, 5, 31));
    for firmware in boards {
        let name = firmware.board().name;
        let mut read = |n: usize| Ok(frames[n].clone());
        let source = Frames::Stack(&mut read);
        let feed = FrameFeed { len: 5, fps: Some(2.0), nth: 2, scope: Scope::default(), source };
        let report = stream(&Runtime::Qemu(firmware), None, &blob, feed, &mut |_| Ok(())).unwrap();
        let activity = report.telemetry.activity.unwrap();
        assert_eq!(report.reconstructed + report.dropped, 3, "{name}");
        // Two seconds pass between the first and the last frame. The core has nothing to do for most of this time.
        assert!(activity.total_ms >= 1800 && activity.asleep_ms > 300, "{name}: {activity:?}");
        assert!(activity.asleep_ms < activity.total_ms, "{name}: {activity:?}");
        println!("{name}: {activity:?}, {:?}", report.took);
    }
}
