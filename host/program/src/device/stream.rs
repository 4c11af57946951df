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
                let Some(loss) = loss(&error).filter(|_| in_a_row < FAILURES) else { return Err(error) };
                session.resume(&mut client)?;
                match loss {
                    // The device may hold statistics of a damaged frame: the hello makes it forget them.
                    Loss::Line => (failed, _) = (failed + 1, client.hello()?),
                    Loss::Sensor => undelivered += 1,
                    Loss::Restart => {}
                }
            }
        }
        next = frame + feed.nth;
    }
    let took = start.elapsed();
    let (telemetry, status) = loop {
        session.resume(&mut client)?;
        match figures(&mut client, change.is_some()) {
            Err(DeviceError::Refused(Refusal::NoHello)) => {}
            figures => break figures?,
        }
    };
    let moved_since = telemetry.watch.alarm.map(|alarm| alarm.since.wrapping_sub(first_id) as usize);
    let moved_since = moved_since.filter(|frame| *frame < next);
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
        camera: status.map(|status| (status, missed)),
    };
    Ok((report, client.quit()))
}

/// What the device says at the end of a stream.
fn figures<T: Transport>(
    client: &mut Client<T>,
    of_camera: bool,
) -> Result<(Telemetry, Option<CameraStatus>), DeviceError> {
    let telemetry = client.telemetry()?;
    Ok((telemetry, if of_camera { Some(client.camera(CameraChange::default())?) } else { None }))
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

    /// Greets and prepares a device that was restarted, and counts it; leaves another one as it is.
    fn resume<T: Transport>(&mut self, client: &mut Client<T>) -> anyhow::Result<()> {
        match client.telemetry() {
            Err(DeviceError::Refused(Refusal::NoHello)) => {
                self.restarts += 1;
                let info = client.hello()?;
                self.prepare(client, &info)
            }
            other => Ok(other.map(|_| ())?),
        }
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
#[path = "stream_tests.rs"]
mod tests;
