//! Frames in, reconstructions out, at the rate that holds: what comes faster is dropped, counted and told.

use super::{Client, DeviceError, Runtime, Transport, View, upload};
use crate::blob::BlobFile;
use half::f16;
use ommatidia_shared::wire::{RunReport, Telemetry};
use std::path::Path;
use std::time::{Duration, Instant};

/// So many frames one after the other may fail before the stream ends.
const FAILURES: u32 = 3;

/// A frame that was reconstructed.
#[derive(Clone, Debug)]
pub struct StreamedFrame {
    /// Its number in the source.
    pub frame: usize,
    /// When its reconstruction was there, since the stream began.
    pub at: Duration,
    /// Frames of the source that were dropped since the one before.
    pub dropped_before: usize,
    /// What the run saw.
    pub report: RunReport,
    /// The reconstruction, row by row.
    pub object: Vec<f16>,
}

/// What a stream came to.
#[derive(Clone, Debug)]
pub struct StreamReport {
    /// Board that the device says it is.
    pub board: String,
    /// Frames that were reconstructed, in their order.
    pub frames: Vec<StreamedFrame>,
    /// Frames of the source that were not: they came too fast, or the line lost them.
    pub dropped: usize,
    /// Of these, frames that failed on the line.
    pub failed: usize,
    /// Wall time of all frames.
    pub took: Duration,
    /// Figures of the device at the end.
    pub telemetry: Telemetry,
}

/// Where frames come from: `read` gives frame number `n` of `len`, codes row by row; `fps` come in a second, or each when the one
/// before is done.
pub struct FrameFeed<'a> {
    /// Number of frames.
    pub len: usize,
    /// Frames a second; `None` waits for the device.
    pub fps: Option<f64>,
    /// Gives a frame.
    pub read: &'a mut dyn FnMut(usize) -> anyhow::Result<Vec<u16>>,
}

/// Streams a feed through the device and shows it on `view`.
///
/// # Errors
/// The device cannot be started, refuses, or fails on several frames in a row.
pub fn stream(
    runtime: &Runtime,
    state: Option<&Path>,
    blob: &BlobFile,
    feed: FrameFeed<'_>,
    view: &View,
) -> anyhow::Result<StreamReport> {
    let (mut client, info) = Client::connect(runtime.start(None, state)?)?;
    upload(&mut client, &info, blob, &mut |_| {})?;
    let size = blob.network()?.header.object;
    let start = Instant::now();
    let (mut frames, mut failed, mut in_a_row) = (Vec::<StreamedFrame>::new(), 0, 0);
    let mut next = 0;
    while next < feed.len {
        let frame = due(&feed, next, start);
        let dropped_before = frame - frames.last().map_or(0, |last| last.frame + 1);
        match one(&mut client, &(feed.read)(frame)?, frame as u32 + 1) {
            Ok((report, object)) => {
                in_a_row = 0;
                let shown = StreamedFrame { frame, at: start.elapsed(), dropped_before, report, object };
                view.show(&shown, [size.rows.into(), size.cols.into()], frame - frames.len());
                frames.push(shown);
            }
            // A frame that was damaged or lost is not shown; the next one comes.
            Err(DeviceError::Damaged { .. } | DeviceError::Silent { .. }) if in_a_row + 1 < FAILURES => {
                (failed, in_a_row) = (failed + 1, in_a_row + 1);
                client.hello()?;
            }
            Err(error) => return Err(error.into()),
        }
        next = frame + 1;
    }
    let took = start.elapsed();
    let telemetry = client.telemetry()?;
    client.quit().wait()?;
    let (board, dropped) = (info.board.as_str().into(), feed.len - frames.len());
    Ok(StreamReport { board, frames, dropped, failed, took, telemetry })
}

/// The newest frame that has come, `next` at the earliest; waits for `next` where it has not.
fn due(feed: &FrameFeed<'_>, next: usize, start: Instant) -> usize {
    let Some(fps) = feed.fps else { return next };
    let comes = Duration::from_secs_f64(next as f64 / fps);
    std::thread::sleep(comes.saturating_sub(start.elapsed()));
    let newest = (start.elapsed().as_secs_f64() * fps) as usize;
    newest.clamp(next, feed.len - 1)
}

fn one<T: Transport>(client: &mut Client<T>, codes: &[u16], id: u32) -> Result<(RunReport, Vec<f16>), DeviceError> {
    client.send_frame(codes)?;
    let report = client.reconstruct(id)?;
    let object = client.fetch(&report)?;
    Ok((report, object))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_comes_too_fast_is_passed_over_and_what_comes_later_is_waited_for() {
        let mut read = |_| Ok(Vec::new());
        let feed = FrameFeed { len: 10, fps: Some(100.0), read: &mut read };
        let start = Instant::now().checked_sub(Duration::from_millis(45)).unwrap();
        assert!(due(&feed, 0, start) >= 4);
        assert_eq!(due(&feed, 9, start), 9);
        assert!(start.elapsed() >= Duration::from_millis(90));
        let feed = FrameFeed { fps: None, ..feed };
        assert_eq!(due(&feed, 3, start), 3);
    }
}
