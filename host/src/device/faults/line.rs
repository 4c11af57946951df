//! Faults of the serial line: lost, repeated and flipped bytes, repeated packets, interruptions.

use super::tally::{Row, Tally};
use super::test_device::Network;
use crate::device::client::{Client, RetryPolicy};
use crate::device::error::DeviceError;
use crate::device::faulty_line::{FaultyLine, LineFaults};
use crate::device::flash;
use crate::device::scope::Scope;
use crate::device::transport::Transport;
use half::f16;
use ommatidia_shared::device::{Arenas, Device, Line, RamFrame, RamObject, Silent, Step};
use ommatidia_shared::flash::RamFlash;
use std::time::Duration;

/// Conversations of each kind, each with a network and frames of its own.
const CONVERSATIONS: u64 = 20;
const FRAMES: u32 = 4;
/// How often the host may restart a frame or a network.
const AGAIN: u32 = 1000;

/// The kinds of faults, by name.
fn kinds() -> [(&'static str, LineFaults); 7] {
    let none = LineFaults::default();
    [
        ("bytes are lost", LineFaults { lose: 1e-3, ..none }),
        ("bytes are repeated", LineFaults { repeat: 1e-3, ..none }),
        ("bits flip", LineFaults { flip: 1e-3, ..none }),
        ("packets are repeated", LineFaults { resend: 0.3, ..none }),
        ("the line is interrupted for 3,000 bytes", LineFaults { outage: 2e-4, outage_bytes: 3000, ..none }),
        (
            "the line is interrupted for 60,000 bytes, longer than the host retries",
            LineFaults { outage: 4e-5, outage_bytes: 60_000, ..none },
        ),
        (
            "all of these",
            LineFaults {
                lose: 2e-4,
                repeat: 2e-4,
                flip: 2e-4,
                resend: 0.05,
                outage: 2e-5,
                outage_bytes: 10_000,
                seed: 0,
            },
        ),
    ]
}

/// Sends networks and frames over lines with faults of every kind.
pub(super) fn lines() -> Result<Vec<Row>, DeviceError> {
    kinds().into_iter().map(|(name, faults)| line(name, faults)).collect()
}

fn line(name: &'static str, faults: LineFaults) -> Result<Row, DeviceError> {
    let mut tally = Tally::default();
    for seed in 0..CONVERSATIONS {
        let network = Network::new(seed)?;
        let mut memory = Memory::new();
        let line = FaultyLine::new(memory.line(), LineFaults { seed, ..faults });
        let patience = RetryPolicy { first: Duration::from_secs(1), longest: Duration::from_secs(1), attempts: 12 };
        let (mut client, info) = connect(line, patience)?;
        let sent = again(&mut client, |client| flash::upload(client, &info, &network.blob, &mut |_| {}));
        tally.blobs_lost += u64::from(sent.is_err());
        for id in 1..=FRAMES {
            let object = again(&mut client, |client| {
                client.send_frame(&network.frame)?;
                let report = client.reconstruct(id, Scope::default())?;
                client.fetch(&report)
            });
            match object {
                Ok(object) => tally.wrong += u64::from(object != network.object),
                Err(_) => tally.frames_lost += 1,
            }
        }
        let line = client.into_line();
        tally.tried += line.faults;
        tally.seen += line.faults;
    }
    let how = format!("{CONVERSATIONS} networks and {} frames", CONVERSATIONS * u64::from(FRAMES));
    Ok(tally.row(&format!("on the line, {name}"), &how))
}

/// Connects, with as many attempts as it takes.
fn connect<T: Transport>(
    line: T,
    patience: RetryPolicy,
) -> Result<(Client<T>, ommatidia_shared::wire::Info), DeviceError> {
    let mut client = Client::over(line, patience, patience);
    let info = again(&mut client, Client::hello)?;
    Ok((client, info))
}

/// Repeats `work`, after a new hello, while it fails because the line was interrupted.
fn again<T: Transport, R>(
    client: &mut Client<T>,
    mut work: impl FnMut(&mut Client<T>) -> Result<R, DeviceError>,
) -> Result<R, DeviceError> {
    let mut result = work(client);
    for _ in 0..AGAIN {
        if !matches!(result, Err(DeviceError::Silent { .. } | DeviceError::Refused(_))) {
            break;
        }
        if client.hello().is_ok() {
            result = work(client);
        }
    }
    result
}

/// Memory of a simulated device.
struct Memory {
    flash: Vec<u128>,
    frame: Vec<u16>,
    object: Vec<f16>,
    fast: Vec<f32>,
    bulk: Vec<f16>,
}

impl Memory {
    fn new() -> Self {
        Self {
            flash: vec![0; super::test_device::FLASH / size_of::<u128>()],
            frame: vec![0; 4096],
            object: vec![f16::ZERO; 4096],
            fast: vec![0.0; 4096],
            bulk: vec![f16::ZERO; 32 << 10],
        }
    }

    fn line(&mut self) -> Direct<'_> {
        let arenas = Arenas { fast: &mut self.fast, bulk: &mut self.bulk };
        let flash = RamFlash::new(bytemuck::cast_slice_mut(&mut self.flash));
        let (source, sink) = (RamFrame::new(&mut self.frame), RamObject::new(&mut self.object));
        let device = Device::new("desk", flash, source, sink, arenas, Silent);
        Direct { device, line: Box::new(Line::new()), answers: Vec::new() }
    }
}

/// A device that answers before `send` returns, so that the conversation does not depend on time.
struct Direct<'m> {
    device: Device<'m, RamFlash<'m>, RamFrame<'m>, RamObject<'m>, Silent>,
    line: Box<Line>,
    answers: Vec<u8>,
}

impl Transport for Direct<'_> {
    fn send(&mut self, bytes: &[u8]) -> Result<(), DeviceError> {
        for byte in bytes {
            if let Step::Answer(answer) | Step::Quit(answer) = self.line.push(*byte, &mut self.device) {
                self.answers.extend(answer);
            }
        }
        Ok(())
    }

    fn receive(&mut self, buffer: &mut [u8], _patience: Duration) -> Result<usize, DeviceError> {
        let count = self.answers.len().min(buffer.len());
        buffer[..count].copy_from_slice(&self.answers[..count]);
        self.answers.drain(..count);
        Ok(count)
    }

    fn silent(&self) -> bool {
        self.answers.is_empty()
    }
}
