//! Streams frames through a device. Frames that arrive while the device is busy are dropped and counted.

use super::client::Client;
use super::error::DeviceError;
use super::flash::upload;
use super::runtime::Runtime;
use super::scope::Scope;
use super::transport::Transport;
use half::f16;
use ommatidia_network::network_file::NetworkFile;
use ommatidia_shared::wire::{CameraChange, CameraStatus, Capture, Refusal, RunReport, Telemetry};
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
    /// Of the reconstructed frames, those that are approximate (statistics of the field held from an earlier frame).
    pub held: usize,
    /// Wall time of all frames.
    pub took: Duration,
    /// Figures of the device at the end.
    pub telemetry: Telemetry,
    /// The frame since which the optics have moved, by the watch of the device; `None` without an alarm, or where it is
    /// from before this stream.
    pub moved_since: Option<usize>,
    /// Of a camera: its settings and figures at the end, and the frames between the first and the last one taken that
    /// were not taken.
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

/// Streams frames through the device; `show` receives each reconstruction as it arrives, and none is kept.
///
/// # Errors
/// The device cannot be started, refuses a request, or fails on several consecutive frames; or `show` fails.
pub fn stream(
    runtime: &Runtime,
    state: Option<&Path>,
    blob: &NetworkFile,
    mut feed: FrameFeed<'_>,
    show: &mut dyn FnMut(&StreamedFrame) -> anyhow::Result<()>,
) -> anyhow::Result<StreamReport> {
    let (mut client, info) = Client::connect(runtime.start(None, state)?)?;
    let of_camera = match feed.source {
        Frames::Camera(_) if !info.live => {
            return Err(DeviceError::NoCamera { board: runtime.place().board(&info.board) }.into());
        }
        Frames::Camera(change) => {
            fits(&client.camera(change)?, blob)?;
            true
        }
        Frames::Stack(_) => false,
    };
    upload(&mut client, &info, blob, &mut |_| {})?;
    let start = Instant::now();
    let (mut reconstructed, mut held, mut failed, mut in_a_row) = (0, 0, 0, 0);
    let (mut next, mut first_missed) = (0, 0);
    // A board that went on since an earlier stream still holds its last run, and would give it again for the same
    // number. A frame that is sent ends that; one of the camera does not.
    let first_id: u32 = if of_camera { rand::random() } else { 1 };
    let mut captures: Option<[Capture; 2]> = None;
    while next < feed.len {
        let frame = feed.due(next, start);
        match feed.one(&mut client, frame, first_id.wrapping_add(frame as u32)) {
            Ok((report, object)) => {
                in_a_row = 0;
                captures = report.capture.map(|last| [captures.map_or(last, |[first, _]| first), last]).or(captures);
                let dropped_before = (frame - first_missed) / feed.nth;
                let dropped = frame / feed.nth - reconstructed;
                let field_frame = report.field_id.wrapping_sub(first_id) as usize;
                show(&StreamedFrame {
                    frame,
                    at: start.elapsed(),
                    dropped_before,
                    dropped,
                    field_frame,
                    report,
                    object,
                })?;
                (reconstructed, first_missed) = (reconstructed + 1, frame + feed.nth);
                held += usize::from(report.field_age > 0);
            }
            Err(error) if in_a_row + 1 < FAILURES && lost(&error) => {
                (failed, in_a_row) = (failed + 1, in_a_row + 1);
                client.hello()?;
            }
            Err(error) => return Err(error),
        }
        next = frame + feed.nth;
    }
    let took = start.elapsed();
    let telemetry = client.telemetry()?;
    let moved_since = telemetry.watch.alarm.map(|alarm| alarm.since.wrapping_sub(first_id) as usize);
    let moved_since = moved_since.filter(|frame| *frame < next);
    let camera = if of_camera { Some(client.camera(CameraChange::default())?) } else { None };
    client.quit().wait()?;
    let missed = captures.map_or(0, |[first, last]| {
        let places = last.number.wrapping_sub(first.number).saturating_add(1);
        places.saturating_sub(reconstructed as u32)
    });
    let camera = camera.map(|status| (status, missed));
    let (board, dropped) = (info.board.as_str().into(), feed.len.div_ceil(feed.nth) - reconstructed);
    Ok(StreamReport { board, reconstructed, dropped, failed, held, took, telemetry, moved_since, camera })
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

/// A frame that was damaged or lost is not shown; the next one comes.
fn lost(error: &anyhow::Error) -> bool {
    matches!(error.downcast_ref(), Some(DeviceError::Damaged { .. } | DeviceError::Silent { .. }))
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
    use super::*;

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
