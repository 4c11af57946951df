//! The line loses, repeats and flips bytes, repeats packets, and goes away for a while.

use super::desk::Network;
use super::{Row, Tally};
use crate::device::{Client, DeviceError, Faults, Faulty, Patience, Scope, Transport, flash};
use half::f16;
use ommatidia_shared::device::{Arenas, Device, Line, RamFrame, RamObject, Silent, Step};
use ommatidia_shared::flash::RamFlash;
use std::time::Duration;

/// Conversations of each kind, each with a network and frames of its own.
const CONVERSATIONS: u64 = 20;
const FRAMES: u32 = 4;
/// As often as a host may begin a frame or a network anew.
const AGAIN: u32 = 1000;

/// The kinds of faults, by name.
fn kinds() -> [(&'static str, Faults); 7] {
    let none = Faults::default();
    [
        ("bytes are lost", Faults { lose: 1e-3, ..none }),
        ("bytes come twice", Faults { repeat: 1e-3, ..none }),
        ("bits flip", Faults { flip: 1e-3, ..none }),
        ("packets come twice", Faults { resend: 0.3, ..none }),
        ("the line is away for 3,000 bytes", Faults { outage: 2e-4, outage_bytes: 3000, ..none }),
        (
            "the line is away for 60,000 bytes, longer than the host asks",
            Faults { outage: 4e-5, outage_bytes: 60_000, ..none },
        ),
        (
            "all of these",
            Faults { lose: 2e-4, repeat: 2e-4, flip: 2e-4, resend: 0.05, outage: 2e-5, outage_bytes: 10_000, seed: 0 },
        ),
    ]
}

/// Networks and frames over lines with faults of every kind.
pub(super) fn lines() -> Result<Vec<Row>, DeviceError> {
    kinds().into_iter().map(|(name, faults)| line(name, faults)).collect()
}

fn line(name: &'static str, faults: Faults) -> Result<Row, DeviceError> {
    let mut tally = Tally::default();
    for seed in 0..CONVERSATIONS {
        let network = Network::new(seed)?;
        let mut memory = Memory::new();
        let line = Faulty::new(memory.line(), Faults { seed, ..faults });
        let patience = Patience { first: Duration::from_secs(1), longest: Duration::from_secs(1), attempts: 12 };
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

/// Opens the conversation, however often it takes.
fn connect<T: Transport>(
    line: T,
    patience: Patience,
) -> Result<(Client<T>, ommatidia_shared::wire::Info), DeviceError> {
    let mut client = Client::over(line, patience, patience);
    let info = again(&mut client, Client::hello)?;
    Ok((client, info))
}

/// Does what may fail when the line is away; when it does, says hello and does it again.
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

/// What a device on a line without time needs.
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
            flash: vec![0; super::desk::FLASH / size_of::<u128>()],
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

/// A device that answers before `send` returns: what happens on this line does not depend on time.
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
