//! `device stream`: frames at a given rate, a device that skips those that it has no time for, and a recording that can
//! be read at any time.
#![allow(clippy::unwrap_used)]

mod networks;

use networks::DENSE;
use ommatidia_host::device::{
    DeviceError, Firmware, FrameFeed, Frames, LoopbackConfig, Runtime, Scope, camera_frame, find_qemu, reference,
    stream,
};
use ommatidia_shared::boards::{BOARDS, Board};
use ommatidia_shared::image::Region;

const REGION: Region = Region { row: 3, col: 4, rows: 5, cols: 6 };

#[test]
fn the_frames_of_a_camera_need_not_be_sent() {
    let blob = networks::network(&DENSE, 30);
    let camera_px = 40 * 52;
    let runtime = Runtime::Host(LoopbackConfig { camera_px, ..LoopbackConfig::default() });
    let feed = FrameFeed { len: 7, fps: None, nth: 3, scope: REGION.into(), source: Frames::Camera };
    let mut shown = Vec::new();
    let report = stream(&runtime, None, &blob, feed, &mut |frame| {
        shown.push(frame.clone());
        Ok(())
    });
    let report = report.unwrap();
    assert_eq!((report.reconstructed, report.dropped), (3, 0));
    assert_eq!(shown.iter().map(|frame| frame.frame).collect::<Vec<_>>(), [0, 3, 6]);
    let frames: Vec<Vec<u16>> = (0..3).map(|n| camera_frame(n, camera_px)).collect();
    let whole = reference(&blob, frames.as_slice().into()).unwrap();
    for (shown, whole) in shown.iter().zip(&whole) {
        assert_eq!(shown.object, networks::cut(whole, &DENSE, REGION));
    }
}

/// The stream distinguishes approximate frames from exact ones and names the frame of their statistics, whatever the
/// numbers of the runs.
#[test]
fn a_stream_names_the_frame_that_its_field_was_measured_in() {
    let runtime = Runtime::Host(LoopbackConfig { camera_px: 40 * 52, ..LoopbackConfig::default() });
    let scope = Scope { hold: 2, ..REGION.into() };
    let feed = FrameFeed { len: 14, fps: None, nth: 2, scope, source: Frames::Camera };
    let mut shown = Vec::new();
    let report = stream(&runtime, None, &networks::network(&DENSE, 32), feed, &mut |frame| {
        shown.push((frame.frame, frame.field_frame, frame.report.field_age));
        Ok(())
    });
    assert_eq!(report.unwrap().held, 4);
    assert_eq!(shown, [(0, 0, 0), (2, 0, 1), (4, 0, 2), (6, 6, 0), (8, 6, 1), (10, 6, 2), (12, 12, 0)]);
}

#[test]
fn a_device_without_a_camera_says_so() {
    let runtime = Runtime::Host(LoopbackConfig::default());
    let feed = FrameFeed { len: 1, fps: None, nth: 1, scope: Scope::default(), source: Frames::Camera };
    let error = stream(&runtime, None, &networks::network(&DENSE, 1), feed, &mut |_| Ok(())).unwrap_err();
    assert!(matches!(error.downcast_ref(), Some(DeviceError::NoCamera { .. })), "{error}");
}

/// One frame per second: the boards sleep in between, and report for how long.
#[test]
fn a_board_sleeps_between_frames() {
    let build = |board: Board| match Firmware::build(board, "app") {
        Ok(firmware) if find_qemu().is_some() => Ok(firmware),
        Ok(_) => Err("qemu-system-arm is not on the PATH".into()),
        Err(DeviceError::NoFirmware { detail }) => Err(detail),
        Err(error) => panic!("{error}"),
    };
    let boards = BOARDS.into_iter().filter(|board| board.emulated).map(build).collect::<Result<Vec<_>, String>>();
    let boards = match boards {
        Ok(boards) => boards,
        Err(missing) => {
            assert!(std::env::var_os("OMMATIDIA_REQUIRE_QEMU").is_none(), "{missing}");
            return ommatidia_tests::skip("a_board_sleeps_between_frames", &missing);
        }
    };
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
