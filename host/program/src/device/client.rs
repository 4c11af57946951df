//! The host's end of the serial protocol: sends requests, waits for replies, and retries.

use super::error::DeviceError;
use super::scope::Scope;
use super::transport::Transport;
use half::f16;
use ommatidia_shared::wire::frame::decode;
use ommatidia_shared::wire::{
    CHUNK, CameraChange, CameraStatus, Deframer, FrameFrom, Info, MAX_PACKET, Packet, Reply, Request, RunReport,
    SCHEMA_KEY, Telemetry, Transfer, VERSION, checksum, encode, pack,
};
use std::collections::VecDeque;
use std::time::{Duration, Instant};

/// How long to wait for a reply, and how often to send a request.
#[derive(Clone, Copy, Debug)]
pub struct RetryPolicy {
    /// Wait before the second attempt; each later wait is twice as long.
    pub first: Duration,
    /// The longest wait.
    pub longest: Duration,
    /// Attempts.
    pub attempts: u32,
}

impl RetryPolicy {
    /// For requests that the device answers at once.
    pub const SHORT: Self = Self { first: Duration::from_millis(500), longest: Duration::from_secs(4), attempts: 12 };
    /// For reconstructions and commits.
    pub const LONG: Self = Self { first: Duration::from_secs(5), longest: Duration::from_secs(60), attempts: 15 };
}

/// The host's end of the serial protocol, over any [`Transport`].
pub struct Client<T> {
    line: T,
    seq: u16,
    deframer: Box<Deframer<MAX_PACKET>>,
    short: RetryPolicy,
    long: RetryPolicy,
    /// Bytes received and not yet decoded.
    pending: VecDeque<u8>,
    /// Checksum of the frame that was sent last.
    frame_crc: u32,
}

impl<T: Transport> Client<T> {
    /// Connects: sends the hello and checks version and schema.
    ///
    /// # Errors
    /// The device does not answer or has another protocol version.
    pub fn connect(line: T) -> Result<(Self, Info), DeviceError> {
        Self::connect_with(line, RetryPolicy::SHORT, RetryPolicy::LONG)
    }

    /// Connects with other waiting times: `short` for requests that are answered at once, `long` for reconstructions.
    ///
    /// # Errors
    /// The device does not answer or has another protocol version.
    pub fn connect_with(line: T, short: RetryPolicy, long: RetryPolicy) -> Result<(Self, Info), DeviceError> {
        let mut client = Self::over(line, short, long);
        let info = client.hello()?;
        Ok((client, info))
    }

    /// A client that has not connected yet; [`Self::hello`] connects it.
    pub fn over(line: T, short: RetryPolicy, long: RetryPolicy) -> Self {
        let deframer = Box::new(Deframer::new());
        Self { line, seq: 0, deframer, short, long, pending: VecDeque::new(), frame_crc: 0 }
    }

    /// Sends the hello again, after the device was reset or the line was interrupted.
    ///
    /// # Errors
    /// The device does not answer or has another protocol version.
    pub fn hello(&mut self) -> Result<Info, DeviceError> {
        let hello = Request::Hello { version: VERSION, schema: SCHEMA_KEY };
        self.ask(hello, self.short, |reply| match reply {
            Reply::Hello(info) => Some(info),
            _ => None,
        })
    }

    /// The line.
    pub fn line(&self) -> &T {
        &self.line
    }

    /// Gives the line back.
    pub fn into_line(self) -> T {
        self.line
    }

    /// Sends a network file and commits it; `progress` is called with the number of bytes that have arrived.
    ///
    /// # Errors
    /// The device refuses it or stops answering.
    pub fn send_blob(&mut self, bytes: &[u8], progress: &mut dyn FnMut(usize)) -> Result<(), DeviceError> {
        self.transfer(Transfer::Blob, bytes, progress)?;
        self.ask(Request::Commit, self.long, done)
    }

    /// Sends a raw frame: sensor codes, DN, row by row.
    ///
    /// # Errors
    /// The device refuses it or stops answering.
    pub fn send_frame(&mut self, codes: &[u16]) -> Result<(), DeviceError> {
        let bytes: Vec<u8> = codes.iter().flat_map(|code| code.to_le_bytes()).collect();
        self.frame_crc = checksum(&bytes);
        self.ask(Request::Begin { what: Transfer::Frame, len: bytes.len() as u32 }, self.short, done)?;
        let (mut at, mut packed) = (0, vec![0; CHUNK]);
        while at < codes.len() {
            let offset = 2 * at as u32;
            let (pixels, len) = pack(&codes[at..codes.len().min(at + usize::from(u16::MAX))], &mut packed);
            // Packed where that is shorter, and as they are where it is not.
            let request = if 2 * pixels > len {
                at += pixels;
                Request::Packed { offset, pixels: pixels as u16, data: &packed[..len] }
            } else {
                let end = codes.len().min(at + CHUNK / 2);
                let data = &bytes[2 * at..2 * end];
                at = end;
                Request::Chunk { what: Transfer::Frame, offset, data }
            };
            let end = 2 * at as u32;
            self.ask(request, self.short, |reply| match reply {
                Reply::Received { offset } if offset == end => Some(()),
                _ => None,
            })?;
        }
        Ok(())
    }

    /// Reconstructs the frame that was sent last, as run `id`.
    ///
    /// # Errors
    /// The device refuses, stops answering, or reconstructed another frame than the one that was sent last.
    pub fn reconstruct(&mut self, id: u32, scope: Scope) -> Result<RunReport, DeviceError> {
        let report = self.run(id, FrameFrom::Host, scope)?;
        same(report.frame_crc, self.frame_crc, "frame", id)?;
        Ok(report)
    }

    /// Has the device's camera expose a frame, and reconstructs it.
    ///
    /// # Errors
    /// The device refuses or stops answering.
    pub fn reconstruct_live(&mut self, id: u32, scope: Scope) -> Result<RunReport, DeviceError> {
        self.run(id, FrameFrom::Camera, scope)
    }

    fn run(&mut self, id: u32, frame: FrameFrom, scope: Scope) -> Result<RunReport, DeviceError> {
        let Scope { region, hold } = scope;
        let asked = |report: &RunReport| {
            region.is_none_or(|region| region == report.region)
                && report.field_age <= hold
                && report.capture.is_some() == (frame == FrameFrom::Camera)
        };
        self.ask(Request::Run { id, frame, region, hold }, self.long, |reply| match reply {
            Reply::Ran(report) if asked(&report) => Some(report),
            _ => None,
        })
    }

    /// Changes settings of the device's camera; returns the settings in force.
    ///
    /// # Errors
    /// The device has no camera, refuses a setting, or stops answering.
    pub fn camera(&mut self, change: CameraChange) -> Result<CameraStatus, DeviceError> {
        self.ask(Request::Camera(change), self.short, |reply| match reply {
            Reply::Camera(status) => Some(status),
            _ => None,
        })
    }

    /// Fetches the reconstruction of a run: half-precision values, row by row.
    ///
    /// # Errors
    /// The device refuses or stops answering, or the checksum of the bytes does not match the device's.
    pub fn fetch(&mut self, report: &RunReport) -> Result<Vec<f16>, DeviceError> {
        let total = report.len as usize;
        let mut bytes = Vec::with_capacity(total);
        while bytes.len() < total {
            let len = (total - bytes.len()).min(self.line.answer_len()).min(CHUNK);
            let request = Request::Read { id: report.id, offset: bytes.len() as u32, len: len as u16 };
            let chunk = self.ask(request, self.short, |reply| match reply {
                Reply::Data { data, .. } if data.len() == len => Some(data.to_vec()),
                _ => None,
            })?;
            bytes.extend(chunk);
        }
        same(report.object_crc, checksum(&bytes), "reconstruction", report.id)?;
        Ok(bytes.as_chunks().0.iter().map(|half| f16::from_le_bytes(*half)).collect())
    }

    /// Telemetry of the device.
    ///
    /// # Errors
    /// The device stops answering.
    pub fn telemetry(&mut self) -> Result<Telemetry, DeviceError> {
        self.ask(Request::Telemetry, self.short, |reply| match reply {
            Reply::Telemetry(telemetry) => Some(telemetry),
            _ => None,
        })
    }

    /// Ends the program where it can end, and gives the line back. A missing reply is not an error.
    pub fn quit(mut self) -> T {
        if !self.line.ends() {
            return self.line;
        }
        let once = RetryPolicy { attempts: 2, ..self.short };
        let _ = self.ask(Request::Quit, once, done);
        self.line
    }

    fn transfer(&mut self, what: Transfer, bytes: &[u8], progress: &mut dyn FnMut(usize)) -> Result<(), DeviceError> {
        self.ask(Request::Begin { what, len: bytes.len() as u32 }, self.short, done)?;
        let mut at = 0;
        while at < bytes.len() {
            let data = &bytes[at..bytes.len().min(at + CHUNK)];
            let end = (at + data.len()) as u32;
            let request = Request::Chunk { what, offset: at as u32, data };
            self.ask(request, self.short, |reply| match reply {
                Reply::Received { offset } if offset == end => Some(()),
                _ => None,
            })?;
            at += data.len();
            progress(at);
        }
        Ok(())
    }

    /// Sends a request until the reply with the same number arrives; `read` extracts the expected reply.
    fn ask<R>(
        &mut self,
        request: Request<'_>,
        patience: RetryPolicy,
        mut read: impl FnMut(Reply<'_>) -> Option<R>,
    ) -> Result<R, DeviceError> {
        self.seq = self.seq.wrapping_add(1);
        let seq = self.seq;
        let mut out = vec![0; MAX_PACKET];
        let packet = encode(&Packet { seq, body: request }, &mut out)
            .map_err(|e| DeviceError::Unexpected { request: name(&request), found: e.to_string() })?;
        let mut wait = patience.first;
        for _ in 0..patience.attempts {
            self.line.send(packet)?;
            let answer = self.answer(seq, wait, |reply| match reply {
                Reply::Refused(refusal) => Err(DeviceError::Refused(refusal)),
                reply => {
                    let found = format!("{reply:.40?}");
                    read(reply).ok_or_else(|| DeviceError::Unexpected { request: name(&request), found })
                }
            })?;
            if let Some(answer) = answer {
                return answer;
            }
            wait = (2 * wait).min(patience.longest);
        }
        Err(DeviceError::Silent { request: name(&request), attempts: patience.attempts })
    }

    /// Waits for the answer `seq` for at most `wait`; damaged packets and answers to earlier requests are dropped.
    fn answer<R>(
        &mut self,
        seq: u16,
        wait: Duration,
        mut read: impl FnMut(Reply<'_>) -> R,
    ) -> Result<Option<R>, DeviceError> {
        let deadline = Instant::now() + wait;
        loop {
            while let Some(byte) = self.pending.pop_front() {
                let Ok(Some(packet)) = self.deframer.push(byte) else { continue };
                if let Ok(Packet { seq: found, body }) = decode::<Packet<Reply<'_>>>(packet)
                    && found == seq
                {
                    return Ok(Some(read(body)));
                }
            }
            let left = deadline.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return Ok(None);
            }
            let mut buffer = [0; 4096];
            let count = self.line.receive(&mut buffer, left)?;
            if count == 0 && self.line.silent() {
                return Ok(None);
            }
            self.pending.extend(&buffer[..count]);
        }
    }
}

/// Two ends of a transfer agree.
fn same(expected: u32, found: u32, what: &'static str, id: u32) -> Result<(), DeviceError> {
    if expected == found { Ok(()) } else { Err(DeviceError::Damaged { what, id, expected, found }) }
}

fn done(reply: Reply<'_>) -> Option<()> {
    matches!(reply, Reply::Done).then_some(())
}

/// The request without its data.
fn name(request: &Request<'_>) -> String {
    match request {
        Request::Chunk { what, offset, .. } => format!("chunk of {what:?} at {offset}"),
        Request::Packed { offset, .. } => format!("packed chunk of Frame at {offset}"),
        other => format!("{other:?}"),
    }
}
