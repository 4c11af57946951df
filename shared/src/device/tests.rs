//! Conversations with a device in memory.
#![allow(clippy::unwrap_used)]

extern crate std;

use super::{Arenas, Device, Line, RamFrame, RamObject, Silent, Step};
use crate::flash::{RAM_SECTOR, RamFlash};
use crate::wire::frame::decode;
use crate::wire::{MAX_PACKET, Packet, Refusal, Reply, Request, SCHEMA_KEY, Transfer, VERSION, encode};
use half::f16;
use std::vec;
use std::vec::Vec;

const HELLO: Request<'_> = Request::Hello { version: VERSION, schema: SCHEMA_KEY };

type Desk<'m> = Device<'m, RamFlash<'m>, RamFrame<'m>, RamObject<'m>, Silent>;

/// Calls `work` with a device that was just started.
fn on_a_desk<R>(work: impl FnOnce(&mut Desk<'_>) -> R) -> R {
    let (mut flash, mut frame, mut object) = (vec![0xff; 8 * RAM_SECTOR], vec![0; 64], vec![f16::ZERO; 64]);
    let arenas = Arenas { fast: &mut [], bulk: &mut [] };
    let (source, sink) = (RamFrame::new(&mut frame), RamObject::new(&mut object));
    work(&mut Device::new("desk", RamFlash::new(&mut flash), source, sink, arenas, Silent))
}

/// Sends a request over the line; `read` gets the reply.
fn ask<R>(
    line: &mut Line,
    device: &mut Desk<'_>,
    seq: u16,
    body: Request<'_>,
    read: impl FnOnce(Reply<'_>) -> R,
) -> Option<R> {
    let mut out = [0; MAX_PACKET];
    for byte in encode(&Packet { seq, body }, &mut out).unwrap() {
        if let Step::Answer(answer) = line.push(*byte, device) {
            let mut packet: Vec<u8> = answer.iter().copied().filter(|byte| *byte != 0).collect();
            let reply: Packet<Reply<'_>> = decode(&mut packet).unwrap();
            assert_eq!(reply.seq, seq);
            return Some(read(reply.body));
        }
    }
    None
}

#[test]
fn a_device_that_was_not_greeted_refuses_everything_else() {
    on_a_desk(|device| {
        let mut line = Line::new();
        let mut refused =
            |seq, request| ask(&mut line, device, seq, request, |r| r == Reply::Refused(Refusal::NoHello));
        assert_eq!(refused(7, Request::Telemetry), Some(true));
        assert_eq!(refused(8, Request::Camera(Default::default())), Some(true));
        assert_eq!(refused(8, Request::Camera(Default::default())), Some(true), "again");
        assert_eq!(refused(9, HELLO), Some(false));
        assert_eq!(refused(10, Request::Telemetry), Some(false));
        assert_eq!(refused(8, Request::Telemetry), None, "a late copy");
    });
}

#[test]
fn a_repeated_beginning_drops_no_frame_and_another_one_does() {
    on_a_desk(|device| {
        let begin = |len| Request::Begin { what: Transfer::Frame, len };
        let chunk = Request::Chunk { what: Transfer::Frame, offset: 0, data: &[1, 0] };
        // After each request: frames that were begun and will not be reconstructed.
        let steps = [(begin(8), 0), (begin(8), 0), (chunk, 0), (chunk, 0), (begin(8), 1), (begin(8), 1), (begin(6), 2)];
        for (i, (request, dropped)) in steps.into_iter().enumerate() {
            let reply = device.handle(request);
            assert!(matches!(reply, Reply::Done | Reply::Received { offset: 2 }), "step {i}");
            let Reply::Telemetry(telemetry) = device.handle(Request::Telemetry) else { panic!("step {i}") };
            assert_eq!(telemetry.dropped_frames, dropped, "step {i}");
        }
    });
}
