//! The device at its end of a line.

use super::io::{FrameSink, FrameSource, Monitor};
use super::machine::Device;
use crate::flash::MappedFlash;
use crate::wire::frame::decode;
use crate::wire::{Deframer, MAX_PACKET, Packet, Refusal, Reply, Request, encode};
use embedded_io::{Read, Write};

/// Why [`serve`] returned.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// The host asked the program to end.
    Quit,
    /// The line was closed.
    Closed,
}

/// The device's end of a line: its buffers and the sequence number of the last request. It has about 5 KB: keep it off
/// the stack.
#[derive(Debug)]
pub struct Line {
    deframer: Deframer<MAX_PACKET>,
    out: [u8; MAX_PACKET],
    last: Option<u16>,
}

/// What a byte from the line led to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step<'a> {
    /// It ended no packet that gets an answer.
    Nothing,
    /// Bytes to send.
    Answer(&'a [u8]),
    /// Bytes to send, then end.
    Quit(&'a [u8]),
}

impl Line {
    /// A line on which nothing was sent yet: the device waits to be greeted.
    pub const fn new() -> Self {
        Self { deframer: Deframer::new(), out: [0; MAX_PACKET], last: None }
    }

    /// Takes a byte from the line. Where it ends a request, `device` handles that request.
    pub fn push<F: MappedFlash, S: FrameSource, K: FrameSink, M: Monitor>(
        &mut self,
        byte: u8,
        device: &mut Device<'_, F, S, K, M>,
    ) -> Step<'_> {
        let packet = match self.deframer.push(byte) {
            Ok(None) => return Step::Nothing,
            Ok(Some(bytes)) => decode::<Packet<Request<'_>>>(bytes),
            Err(error) => Err(error),
        };
        let Packet { seq, body } = match packet {
            Ok(packet) => packet,
            Err(error) => {
                device.count_dropped(Some(error));
                return Step::Nothing;
            }
        };
        if !matches!(body, Request::Hello { .. }) {
            // A host that has not greeted this program spoke with the one before a restart, and must know of it.
            let Some(last) = self.last else {
                let body = Reply::Refused(Refusal::NoHello);
                return encode(&Packet { seq, body }, &mut self.out).map_or(Step::Nothing, Step::Answer);
            };
            // The half of the numbers behind the last one are late copies of requests that were answered.
            let ahead = seq.wrapping_sub(last);
            if ahead == 0 {
                device.count_repeated();
            } else if ahead > u16::MAX / 2 {
                device.count_dropped(None);
                return Step::Nothing;
            }
        }
        self.last = Some(seq);
        let reply = Packet { seq, body: device.handle(body) };
        match (encode(&reply, &mut self.out), body) {
            (Ok(bytes), Request::Quit) => Step::Quit(bytes),
            (Ok(bytes), _) => Step::Answer(bytes),
            // Cannot happen, as no reply is longer than the buffer. The host would ask again.
            (Err(_), _) => Step::Nothing,
        }
    }
}

impl Default for Line {
    fn default() -> Self {
        Self::new()
    }
}

/// Answers requests until the host asks the program to end or the line closes.
///
/// # Errors
/// Those of `link`.
pub fn serve<L: Read + Write, F: MappedFlash, S: FrameSource, K: FrameSink, M: Monitor>(
    link: &mut L,
    line: &mut Line,
    device: &mut Device<'_, F, S, K, M>,
) -> Result<End, L::Error> {
    let mut bytes = [0; 64];
    loop {
        let count = link.read(&mut bytes)?;
        if count == 0 {
            return Ok(End::Closed);
        }
        device.alive();
        for byte in bytes.get(..count).unwrap_or_default() {
            match line.push(*byte, device) {
                Step::Nothing => {}
                Step::Answer(answer) => link.write_all(answer)?,
                Step::Quit(answer) => {
                    link.write_all(answer)?;
                    link.flush()?;
                    return Ok(End::Quit);
                }
            }
        }
    }
}
