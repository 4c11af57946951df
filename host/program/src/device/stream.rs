//! Streams frames through a device. Frames that arrive while the device is busy are dropped and counted.

use super::client::Client;
use super::error::DeviceError;
use super::flash::upload;
use super::runtime::{Place, Runtime};
use super::scope::Scope;
use super::transport::Transport;
use half::f16;
use ommatidia_network::network_file::NetworkFile;
use ommatidia_shared::wire::{
    CameraChange, CameraSettings, CameraStatus, Capture, Info, Refusal, RunReport, Telemetry,
};
use std::path::Path;
use std::time::{Duration, Instant};

/// Number of consecutive failed frames that ends the stream.
const FAILURES: u32 = 3;
/// Longest wait for a pulse at the trigger input of the board.
const TRIGGER: Duration = Duration::from_secs(60);

/// A frame that was reconstructed.
#[derive(Clone, Debug)]
pub struct StreamedFrame {
    /// Its number in the source.
    pub frame: usize,
    /// Time of its reconstruction since the stream began.
    pub at: Duration,
    /// Frames dropped since the previous reconstruction.
    pub dropped_before: usize,
    /// Frames dropped so far.
    pub dropped: usize,
    /// Of a camera: frames of its grid that were not taken since the previous reconstruction.
    pub missed_before: u32,
    /// Whether the device was restarted since the previous reconstruction: its clock and the numbers of its camera's
    /// frames have begun again.
    pub restarted_before: bool,
    /// Number of the frame whose statistics of the field were used: its own if the reconstruction is exact.
    pub field_frame: usize,
    /// Report of the device.
    pub report: RunReport,
    /// The reconstruction, row by row.
    pub object: Vec<f16>,
}

/// Figures of a whole stream.
#[derive(Clone, Debug)]
pub struct StreamReport {
    /// Board, as the device reports it.
    pub board: String,
    /// Frames that were reconstructed.
    pub reconstructed: usize,
    /// Frames that should have been reconstructed and were not: they arrived too fast, or the line lost them.
    pub dropped: usize,
    /// Of the dropped frames, those that the line lost.
    pub failed: usize,
    /// Of the dropped frames, those that the sensor did not deliver.
    pub undelivered: usize,
    /// How often the device was restarted during the stream.
    pub restarts: usize,
    /// Of the reconstructed frames, those that are approximate (statistics of the field held from an earlier frame).
    pub held: usize,
    /// Wall time of all frames.
    pub took: Duration,
    /// Figures of the device at the end.
    pub telemetry: Telemetry,
    /// The frame since which the optics have moved, by the watch of the device; `None` without an alarm, or where it is
    /// from before this stream.
    pub moved_since: Option<usize>,
    /// Of a camera: its settings and figures at the end, and the frames of its grid that were not taken between two
    /// that were. A restart of the device begins another grid.
    pub camera: Option<(CameraStatus, u32)>,
}

/// Where frames come from.
pub enum Frames<'a> {
    /// The host: returns frame `n`, sensor codes row by row.
    Stack(&'a mut dyn FnMut(usize) -> anyhow::Result<Vec<u16>>),
    /// The device's camera, with these settings changed.
    Camera(CameraChange),
}

/// A sequence of frames to stream.
pub struct FrameFeed<'a> {
    /// Number of frames.
    pub len: usize,
    /// Frames per second; `None`: each frame waits for the device.
    pub fps: Option<f64>,
    /// Only every `nth` frame is reconstructed; the device sleeps meanwhile.
    pub nth: usize,
    /// Which region of each is reconstructed, and whether exactly.
    pub scope: Scope,
    /// Where they come from.
    pub source: Frames<'a>,
}

/// Streams frames through the device; `show` receives each reconstruction as it arrives, and none is kept. A device
/// that is restarted meanwhile gets the settings of its camera again.
///
/// # Errors
/// The device cannot be started, refuses a request, or fails on several consecutive frames; its camera has other
/// settings than at the start; or `show` fails.
pub fn stream(
    runtime: &Runtime,
    state: Option<&Path>,
    blob: &NetworkFile,
    feed: FrameFeed<'_>,
    show: &mut dyn FnMut(&StreamedFrame) -> anyhow::Result<()>,
) -> anyhow::Result<StreamReport> {
    let (report, line) = stream_over(runtime.start(None, state)?, runtime.place(), blob, feed, show)?;
    line.wait()?;
    Ok(report)
}

/// As [`stream`], over an open line, which it returns.
fn stream_over<T: Transport>(
    line: T,
    place: Place,
    blob: &NetworkFile,
    mut feed: FrameFeed<'_>,
    show: &mut dyn FnMut(&StreamedFrame) -> anyhow::Result<()>,
) -> anyhow::Result<(StreamReport, T)> {
    let (mut client, info) = Client::connect(line)?;
    let change = match feed.source {
        Frames::Camera(change) => Some(change),
        Frames::Stack(_) => None,
    };
    let mut session = Session { place, blob, change, settings: None, restarts: 0 };
    session.prepare(&mut client, &info)?;
    let start = Instant::now();
    let (mut reconstructed, mut held, mut failed, mut undelivered, mut in_a_row) = (0, 0, 0, 0, 0);
    let (mut next, mut first_missed) = (0, 0);
    // A board that went on since an earlier stream still holds its last run, and would give it again for the same
    // number. A frame that is sent ends that; one of the camera does not.
    let first_id: u32 = if change.is_some() { rand::random() } else { 1 };
    let (mut last, mut missed, mut restarts) = (None, 0_u32, 0);
    while next < feed.len {
        let frame = feed.due(next, start);
        match feed.one(&mut client, frame, first_id.wrapping_add(frame as u32)) {
            Ok((report, object)) => {
                in_a_row = 0;
                session.check(report.capture)?;
                let restarted_before = session.restarts > restarts;
                let since = report.capture.zip(last).filter(|_| !restarted_before);
                let missed_before = since.map_or(0, |(now, last)| missed_between(last, now));
                (last, restarts) = (report.capture, session.restarts);
                missed = missed.saturating_add(missed_before);
                let dropped_before = (frame - first_missed) / feed.nth;
                let dropped = frame / feed.nth - reconstructed;
                let field_frame = report.field_id.wrapping_sub(first_id) as usize;
                show(&StreamedFrame {
                    frame,
                    at: start.elapsed(),
                    dropped_before,
                    dropped,
                    missed_before,
                    restarted_before,
                    field_frame,
                    report,
                    object,
                })?;
                (reconstructed, first_missed) = (reconstructed + 1, frame + feed.nth);
                held += usize::from(report.field_age > 0);
            }
            Err(error) => {
                in_a_row += 1;
                match loss(&error) {
                    Some(loss) if in_a_row < FAILURES => {
                        failed += usize::from(loss == Loss::Line);
                        undelivered += usize::from(loss == Loss::Sensor);
                    }
                    _ => return Err(error),
                }
                session.resume(&mut client)?;
            }
        }
        next = frame + feed.nth;
    }
    let took = start.elapsed();
    session.resume(&mut client)?;
    let telemetry = client.telemetry()?;
    let moved_since = telemetry.watch.alarm.map(|alarm| alarm.since.wrapping_sub(first_id) as usize);
    let moved_since = moved_since.filter(|frame| *frame < next);
    let camera = if change.is_some() { Some((client.camera(CameraChange::default())?, missed)) } else { None };
    let report = StreamReport {
        board: info.board.as_str().into(),
        reconstructed,
        dropped: feed.len.div_ceil(feed.nth) - reconstructed,
        failed,
        undelivered,
        restarts: session.restarts,
        held,
        took,
        telemetry,
        moved_since,
        camera,
    };
    Ok((report, client.quit()))
}

/// What a stream needs of the device, at its start and after each restart.
struct Session<'a> {
    place: Place,
    blob: &'a NetworkFile,
    /// Of a camera: what to change.
    change: Option<CameraChange>,
    /// Of a camera: the settings in force since the start.
    settings: Option<CameraSettings>,
    /// How often the device was restarted.
    restarts: usize,
}

impl Session<'_> {
    /// Sets the camera and sends the network, if it is not there yet.
    fn prepare<T: Transport>(&mut self, client: &mut Client<T>, info: &Info) -> anyhow::Result<()> {
        if let Some(change) = self.change {
            if !info.live {
                return Err(DeviceError::NoCamera { board: self.place.board(&info.board) }.into());
            }
            let status = client.camera(change)?;
            fits(&status, self.blob)?;
            let settings = *self.settings.get_or_insert(status.settings);
            // Another time all of them: some may have been set before this stream.
            self.change = Some(CameraChange::to(settings));
            same(settings, status.settings)?;
        }
        upload(client, info, self.blob, &mut |_| {})?;
        Ok(())
    }

    /// Greets the device again. One that was restarted is prepared again, and counted.
    fn resume<T: Transport>(&mut self, client: &mut Client<T>) -> anyhow::Result<()> {
        let restarted = match client.telemetry() {
            Ok(_) => false,
            Err(DeviceError::Refused(Refusal::NoHello)) => true,
            Err(error) => return Err(error.into()),
        };
        let info = client.hello()?;
        if restarted {
            self.restarts += 1;
            self.prepare(client, &info)?;
        }
        Ok(())
    }

    /// A frame of the camera was taken with the settings of the start.
    fn check(&self, capture: Option<Capture>) -> Result<(), DeviceError> {
        self.settings.zip(capture).map_or(Ok(()), |(settings, capture)| same(settings, capture.settings))
    }
}

fn same(expected: CameraSettings, found: CameraSettings) -> Result<(), DeviceError> {
    if expected == found { Ok(()) } else { Err(DeviceError::OtherSettings { expected, found }) }
}

/// Frames between two that were not taken. Numbers of a device that was restarted begin again.
fn missed_between(last: Capture, now: Capture) -> u32 {
    now.number.checked_sub(last.number).map_or(0, |places| places.saturating_sub(1))
}

/// The camera gives the frames that the network takes.
fn fits(camera: &CameraStatus, blob: &NetworkFile) -> anyhow::Result<()> {
    let (region, frame) = (camera.settings.region, blob.network()?.header().frame);
    let network = [frame.rows, frame.cols];
    if [region.rows, region.cols] == network {
        return Ok(());
    }
    Err(DeviceError::CameraRegion { rows: region.rows, cols: region.cols, network }.into())
}

/// Why a frame is not shown although the stream goes on with the next one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Loss {
    /// The line has damaged or lost it.
    Line,
    /// The sensor did not deliver it.
    Sensor,
    /// The device was restarted.
    Restart,
}

fn loss(error: &anyhow::Error) -> Option<Loss> {
    match error.downcast_ref()? {
        DeviceError::Damaged { .. } | DeviceError::Silent { .. } => Some(Loss::Line),
        DeviceError::Refused(Refusal::NoFrame { .. }) => Some(Loss::Sensor),
        DeviceError::Refused(Refusal::NoHello) => Some(Loss::Restart),
        _ => None,
    }
}

impl FrameFeed<'_> {
    /// The newest frame that has arrived and is due, `next` at the earliest; waits for `next` if it has not arrived.
    fn due(&self, next: usize, start: Instant) -> usize {
        let Some(fps) = self.fps else { return next };
        let comes = Duration::from_secs_f64(next as f64 / fps);
        std::thread::sleep(comes.saturating_sub(start.elapsed()));
        let newest = (start.elapsed().as_secs_f64() * fps) as usize;
        newest.clamp(next, self.len - 1) / self.nth * self.nth
    }

    fn one<T: Transport>(
        &mut self,
        client: &mut Client<T>,
        frame: usize,
        id: u32,
    ) -> anyhow::Result<(RunReport, Vec<f16>)> {
        let report = match &mut self.source {
            Frames::Stack(read) => {
                client.send_frame(&read(frame)?)?;
                client.reconstruct(id, self.scope)?
            }
            Frames::Camera(_) => live(client, id, self.scope)?,
        };
        let object = client.fetch(&report)?;
        Ok((report, object))
    }
}

/// Has the camera expose a frame. Where it waits for pulses, the device is asked again until one comes.
fn live<T: Transport>(client: &mut Client<T>, id: u32, scope: Scope) -> Result<RunReport, DeviceError> {
    let began = Instant::now();
    loop {
        match client.reconstruct_live(id, scope) {
            Err(DeviceError::Refused(Refusal::NoTrigger { .. })) if began.elapsed() < TRIGGER => {}
            Err(DeviceError::Refused(Refusal::NoTrigger { .. })) => {
                return Err(DeviceError::NoTrigger { seconds: TRIGGER.as_secs() });
            }
            other => return other,
        }
    }
}

#[cfg(test)]
mod tests {
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
            let (status, missed) = report.camera.unwrap();
            let seen = (report.restarts, report.failed, report.reconstructed + report.dropped);
            // A board that is asked to end and is restarted has ended.
            let expected = usize::from(restart + 1 < requests);
            assert!(seen == (expected, 0, 6) && report.dropped <= 1, "request {restart}: {report:?}");
            assert_eq!(status.settings, wanted);
            assert!(missed < 100 && shown.iter().all(|frame| frame.missed_before < 100), "{missed}");
            let restarts = shown.iter().filter(|frame| frame.restarted_before).count();
            assert!(restarts == expected || shown.len() == 6 - report.dropped, "request {restart}");
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
}
