//! The host's end of the conversation: ask, wait, ask again.

use super::{DeviceError, Scope, Transport};
use half::f16;
use ommatidia_shared::wire::frame::decode;
use ommatidia_shared::wire::{
    CHUNK, Deframer, Info, MAX_PACKET, Packet, Reply, Request, RunReport, SCHEMA_KEY, Telemetry, Transfer, VERSION,
    checksum, encode,
};
use std::collections::VecDeque;
use std::time::{Duration, Instant};

/// How long to wait for an answer, and how often to ask.
#[derive(Clone, Copy, Debug)]
pub struct Patience {
    /// Wait before the second attempt; each later wait is twice as long.
    pub first: Duration,
    /// The longest wait.
    pub longest: Duration,
    /// Attempts.
    pub attempts: u32,
}

impl Patience {
    /// For what the device does at once.
    pub const SHORT: Self = Self { first: Duration::from_millis(500), longest: Duration::from_secs(4), attempts: 12 };
    /// For a reconstruction.
    pub const LONG: Self = Self { first: Duration::from_secs(5), longest: Duration::from_secs(60), attempts: 15 };
}

/// The host's end of a line.
pub struct Client<T> {
    line: T,
    seq: u16,
    deframer: Box<Deframer<MAX_PACKET>>,
    short: Patience,
    long: Patience,
    /// Bytes received and not yet looked at.
    pending: VecDeque<u8>,
    /// Checksum of the frame that was sent last.
    frame_crc: u32,
}

impl<T: Transport> Client<T> {
    /// Opens the conversation.
    ///
    /// # Errors
    /// The device is silent or speaks another version.
    pub fn connect(line: T) -> Result<(Self, Info), DeviceError> {
        Self::connect_with(line, Patience::SHORT, Patience::LONG)
    }

    /// Opens the conversation with other waiting times: `short` for what is done at once, `long` for reconstructions.
    ///
    /// # Errors
    /// The device is silent or speaks another version.
    pub fn connect_with(line: T, short: Patience, long: Patience) -> Result<(Self, Info), DeviceError> {
        let mut client = Self::over(line, short, long);
        let info = client.hello()?;
        Ok((client, info))
    }

    /// A conversation that [`Self::hello`] is to open.
    pub fn over(line: T, short: Patience, long: Patience) -> Self {
        let deframer = Box::new(Deframer::new());
        Self { line, seq: 0, deframer, short, long, pending: VecDeque::new(), frame_crc: 0 }
    }

    /// Begins the conversation anew, after the device or the line was away.
    ///
    /// # Errors
    /// The device is silent or speaks another version.
    pub fn hello(&mut self) -> Result<Info, DeviceError> {
        let hello = Request::Hello { version: VERSION, schema: SCHEMA_KEY };
        self.ask(hello, self.short, |reply| match reply {
            Reply::Hello(info) => Some(info),
            _ => None,
        })
    }

    /// The line, for tests that count what it did.
    pub fn line(&self) -> &T {
        &self.line
    }

    /// The line.
    pub fn into_line(self) -> T {
        self.line
    }

    /// Sends a network file and has it checked; `progress` hears how many bytes have arrived.
    ///
    /// # Errors
    /// The device refuses it or falls silent.
    pub fn send_blob(&mut self, bytes: &[u8], progress: &mut dyn FnMut(usize)) -> Result<(), DeviceError> {
        self.transfer(Transfer::Blob, bytes, progress)?;
        self.ask(Request::Commit, self.long, done)
    }

    /// Sends a raw frame, codes row by row.
    ///
    /// # Errors
    /// The device refuses it or falls silent.
    pub fn send_frame(&mut self, codes: &[u16]) -> Result<(), DeviceError> {
        let bytes: Vec<u8> = codes.iter().flat_map(|code| code.to_le_bytes()).collect();
        self.frame_crc = checksum(&bytes);
        self.transfer(Transfer::Frame, &bytes, &mut |_| {})
    }

    /// Has the frame that was sent last reconstructed as run `id`.
    ///
    /// # Errors
    /// The device refuses, falls silent, or reconstructed another frame than the last that was sent.
    pub fn reconstruct(&mut self, id: u32, scope: Scope) -> Result<RunReport, DeviceError> {
        let report = self.reconstruct_live(id, scope)?;
        same(report.frame_crc, self.frame_crc, "frame", id)?;
        Ok(report)
    }

    /// The same for the frame that the device's camera sees, where no frame was sent since the last run.
    ///
    /// # Errors
    /// The device refuses or falls silent.
    pub fn reconstruct_live(&mut self, id: u32, scope: Scope) -> Result<RunReport, DeviceError> {
        let Scope { region, hold } = scope;
        let asked =
            |report: &RunReport| region.is_none_or(|region| region == report.region) && report.field_age <= hold;
        self.ask(Request::Run { id, region, hold }, self.long, |reply| match reply {
            Reply::Ran(report) if asked(&report) => Some(report),
            _ => None,
        })
    }

    /// Fetches the reconstruction of a run.
    ///
    /// # Errors
    /// The device refuses or falls silent, or its bytes are not those that it computed.
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

    /// Figures of the device.
    ///
    /// # Errors
    /// The device falls silent.
    pub fn telemetry(&mut self) -> Result<Telemetry, DeviceError> {
        self.ask(Request::Telemetry, self.short, |reply| match reply {
            Reply::Telemetry(telemetry) => Some(telemetry),
            _ => None,
        })
    }

    /// Has the program end, where a program can. That it ends without an answer is no failure.
    pub fn quit(mut self) -> T {
        if !self.line.ends() {
            return self.line;
        }
        let once = Patience { attempts: 2, ..self.short };
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

    /// Asks until the answer with the same number comes; `read` takes what it expects of it.
    fn ask<R>(
        &mut self,
        request: Request<'_>,
        patience: Patience,
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
        other => format!("{other:?}"),
    }
}
