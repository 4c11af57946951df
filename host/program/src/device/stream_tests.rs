//! Streams over a device that is restarted, and whose sensor does not deliver some frames.
#![allow(clippy::unwrap_used)]
use super::*;
use crate::device::footprint::small_network;
use crate::device::loopback::{Loopback, LoopbackConfig};
use ommatidia_shared::wire::frame::decode;
use ommatidia_shared::wire::{FrameFrom, MAX_PACKET, Packet, Reply, Request, encode};
use std::path::PathBuf;

/// A device that is restarted before a request, and whose sensor does not deliver some frames.
struct Unsteady {
    line: Option<Loopback>,
    flash: PathBuf,
    requests: usize,
    runs: usize,
    /// Number of the request before which it is restarted.
    restart: Option<usize>,
    /// How many runs fail, from the third on.
    failures: usize,
    answer: Vec<u8>,
}

impl Unsteady {
    fn new(folder: &Path, restart: Option<usize>, failures: usize) -> Self {
        let flash = folder.join("flash");
        let line = Some(Self::start(&flash));
        Self { line, flash, requests: 0, runs: 0, restart, failures, answer: Vec::new() }
    }

    fn start(flash: &Path) -> Loopback {
        let config = LoopbackConfig { camera: [16, 16], flash_bytes: 1 << 16, ..LoopbackConfig::default() };
        Loopback::start_on(config, Some(flash.into())).unwrap()
    }
}

impl Transport for Unsteady {
    fn send(&mut self, bytes: &[u8]) -> Result<(), DeviceError> {
        if self.restart == Some(self.requests) {
            self.line.take().unwrap().finish()?;
            self.line = Some(Self::start(&self.flash));
        }
        self.requests += 1;
        let mut packet: Vec<u8> = bytes.iter().copied().filter(|byte| *byte != 0).collect();
        let Packet { seq, body } = decode::<Packet<Request<'_>>>(&mut packet).unwrap();
        if let Request::Run { frame: FrameFrom::Camera, .. } = body {
            self.runs += 1;
            if (3..3 + self.failures).contains(&self.runs) {
                let body = Reply::Refused(Refusal::NoFrame { waited_ms: 510 });
                self.answer = encode(&Packet { seq, body }, &mut [0; MAX_PACKET]).unwrap().to_vec();
                return Ok(());
            }
        }
        self.line.as_mut().unwrap().send(bytes)
    }

    fn receive(&mut self, buffer: &mut [u8], patience: Duration) -> Result<usize, DeviceError> {
        if self.answer.is_empty() {
            return self.line.as_mut().unwrap().receive(buffer, patience);
        }
        let answer = std::mem::take(&mut self.answer);
        buffer[..answer.len()].copy_from_slice(&answer);
        Ok(answer.len())
    }
}

/// Streams six frames of the camera, whose gain was set before.
fn stream_of(line: Unsteady) -> (anyhow::Result<(StreamReport, Unsteady)>, Vec<StreamedFrame>) {
    let gain = CameraChange { analog_gain_thousandths: Some(2000), ..CameraChange::default() };
    let mut client = Client::connect(line).unwrap().0;
    client.camera(gain).unwrap();
    let change = CameraChange { exposure_us: Some(5_000), interval_us: Some(10_000), ..CameraChange::default() };
    let feed = FrameFeed { source: Frames::Camera(change), len: 6, ..feed(None, 1) };
    let (blob, mut shown) = (small_network().unwrap().0, Vec::new());
    let report = stream_over(client.into_line(), Place::Host, &blob, feed, &mut |frame| {
        shown.push(frame.clone());
        Ok(())
    });
    (report, shown)
}

#[test]
fn a_device_that_is_restarted_gets_its_settings_again() {
    let folder = tempfile::tempdir().unwrap();
    // The first stream leaves the network in the flash.
    for _ in 0..2 {
        stream_of(Unsteady::new(folder.path(), None, 0)).0.unwrap();
    }
    let (report, all) = stream_of(Unsteady::new(folder.path(), None, 0));
    let requests = report.unwrap().1.requests;
    let wanted = all[0].report.capture.unwrap().settings;
    assert_eq!((wanted.exposure_us, wanted.analog_gain_thousandths, wanted.interval_us), (5_000, 2_000, 10_000));
    let mut streams = 0;
    // Not the first requests, which are those of the host that sets the gain.
    for restart in 3..requests {
        let (report, shown) = stream_of(Unsteady::new(folder.path(), Some(restart), 0));
        assert!(shown.iter().all(|frame| frame.report.capture.unwrap().settings == wanted), "request {restart}");
        let Ok((report, _)) = report else {
            assert!(shown.is_empty(), "before the first frame the user starts again: request {restart}");
            continue;
        };
        streams += 1;
        let (status, missed) = report.camera.clone().unwrap();
        let seen = (report.restarts, report.failed, report.reconstructed + report.dropped);
        // A board that is asked to end and is restarted has ended.
        let expected = usize::from(restart + 1 < requests);
        assert!(seen == (expected, 0, 6) && report.dropped <= 1, "request {restart}: {report:?}");
        assert_eq!(status.settings, wanted);
        assert!(missed < 100 && shown.iter().all(|frame| frame.missed_before < 100), "{missed}");
        let restarts = shown.iter().filter(|frame| frame.restarted_before).count();
        // No frame comes after a restart during the last one.
        let expected = report.dropped == 1 && shown.last().unwrap().frame == 5;
        assert_eq!(restarts, usize::from(expected), "request {restart}");
    }
    assert!(streams > 12, "{streams} of {requests}");
}

#[test]
fn frames_that_the_sensor_drops_are_counted_and_too_many_in_a_row_end_the_stream() {
    let folder = tempfile::tempdir().unwrap();
    for failures in 0..FAILURES as usize {
        let (report, shown) = stream_of(Unsteady::new(folder.path(), None, failures));
        let (report, _) = report.unwrap();
        assert_eq!((report.undelivered, report.failed, report.restarts), (failures, 0, 0));
        assert_eq!((report.reconstructed, report.dropped, shown.len()), (6 - failures, failures, 6 - failures));
    }
    let (report, shown) = stream_of(Unsteady::new(folder.path(), None, FAILURES as usize));
    let error = report.map(|_| ()).unwrap_err();
    assert!(matches!(error.downcast_ref(), Some(DeviceError::Refused(Refusal::NoFrame { .. }))), "{error}");
    assert_eq!(shown.len(), 2);
}

#[test]
fn other_settings_than_those_at_the_start_end_the_stream() {
    let folder = tempfile::tempdir().unwrap();
    let (report, shown) = stream_of(Unsteady::new(folder.path(), None, 0));
    let capture = shown[0].report.capture.unwrap();
    let settings = report.unwrap().0.camera.unwrap().0.settings;
    let (blob, place) = (&small_network().unwrap().0, Place::Host);
    let session = Session { place, blob, change: None, settings: Some(settings), restarts: 0 };
    session.check(Some(capture)).unwrap();
    let other = CameraSettings { exposure_us: 13_200, ..settings };
    let error = session.check(Some(Capture { settings: other, ..capture })).unwrap_err().to_string();
    assert!(error.contains("13200") && error.contains("5000"), "{error}");
}

#[test]
fn a_smaller_number_is_no_missed_frame() {
    let folder = tempfile::tempdir().unwrap();
    let (_, shown) = stream_of(Unsteady::new(folder.path(), None, 0));
    let capture = shown[0].report.capture.unwrap();
    let numbered = |number| Capture { number, ..capture };
    assert_eq!(missed_between(numbered(7), numbered(10)), 2);
    assert_eq!(missed_between(numbered(7), numbered(8)), 0);
    assert_eq!(missed_between(numbered(7), numbered(0)), 0);
}

fn feed(fps: Option<f64>, nth: usize) -> FrameFeed<'static> {
    FrameFeed { len: 10, fps, nth, scope: Scope::default(), source: Frames::Camera(CameraChange::default()) }
}

#[test]
fn what_comes_too_fast_is_passed_over_and_what_comes_later_is_waited_for() {
    let start = Instant::now().checked_sub(Duration::from_millis(45)).unwrap();
    assert!(feed(Some(100.0), 1).due(0, start) >= 4);
    assert_eq!(feed(Some(100.0), 1).due(9, start), 9);
    assert!(start.elapsed() >= Duration::from_millis(90));
    assert_eq!(feed(None, 1).due(3, start), 3);
}

#[test]
fn only_every_nth_frame_is_due() {
    let start = Instant::now().checked_sub(Duration::from_secs(60)).unwrap();
    assert_eq!([0, 4, 8].map(|next| feed(Some(100.0), 4).due(next, start)), [8; 3]);
    assert_eq!([0, 4, 8].map(|next| feed(None, 4).due(next, start)), [0, 4, 8]);
}
