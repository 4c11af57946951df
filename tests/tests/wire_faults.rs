//! A line that loses, repeats and flips bytes slows the conversation down and changes no bit of the result.
#![allow(clippy::unwrap_used)]

mod networks;

use half::f16;
use networks::{DENSE, TAPPED};
use ommatidia::device::{
    Client, DeviceError, FaultyLine, LineFaults, Loopback, LoopbackConfig, RetryPolicy, Scope, Transport, reference,
};
use ommatidia_shared::blob::BlobError;
use ommatidia_shared::wire::{
    CameraChange, Packet, Refusal, Reply, Request, SCHEMA_KEY, Telemetry, Transfer, VERSION, encode, pack,
};
use std::time::Duration;

const QUICK: RetryPolicy =
    RetryPolicy { first: Duration::from_millis(10), longest: Duration::from_millis(400), attempts: 200 };

/// Two frames through the dense network over `line`.
fn converse<T: Transport>(line: T) -> (Vec<Vec<f16>>, Telemetry, T) {
    let (mut client, _) = Client::connect_with(line, QUICK, QUICK).unwrap();
    client.send_blob(networks::network(&DENSE, 1).bytes(), &mut |_| {}).unwrap();
    let mut objects = Vec::new();
    for (id, frame) in (1..).zip(networks::frames(&DENSE, 2, 1)) {
        client.send_frame(&frame).unwrap();
        let report = client.reconstruct(id, Scope::default()).unwrap();
        objects.push(client.fetch(&report).unwrap());
    }
    let telemetry = client.telemetry().unwrap();
    (objects, telemetry, client.into_line())
}

fn loopback() -> Loopback {
    Loopback::start(LoopbackConfig::default()).unwrap()
}

fn expected() -> Vec<Vec<f16>> {
    reference(&networks::network(&DENSE, 1), networks::frames(&DENSE, 2, 1).as_slice().into()).unwrap()
}

fn check(lose: f64, repeat: f64, flip: f64) {
    let line = FaultyLine::new(loopback(), LineFaults { lose, repeat, flip, seed: 7, ..LineFaults::default() });
    let (objects, telemetry, line) = converse(line);
    assert_eq!(objects, expected());
    assert!(line.damaged > 10, "{} damaged bytes prove nothing", line.damaged);
    assert!(telemetry.dropped_packets > 0, "{telemetry:?}");
    assert_eq!(telemetry.runs, 2, "a repeated request ran a frame again");
}

#[test]
fn a_clean_line_needs_no_second_attempt() {
    let (objects, telemetry, _) = converse(loopback());
    assert_eq!(objects, expected());
    assert_eq!(telemetry.dropped_packets, 0);
}

#[test]
fn lost_bytes() {
    check(3e-4, 0.0, 0.0);
}

#[test]
fn repeated_bytes() {
    check(0.0, 3e-4, 0.0);
}

#[test]
fn flipped_bits() {
    check(0.0, 0.0, 3e-4);
}

#[test]
fn all_at_once() {
    check(1e-4, 1e-4, 1e-4);
}

/// Sends every packet twice, like a bridge that retransmits by itself.
struct Doubled(Loopback);

impl Transport for Doubled {
    fn send(&mut self, bytes: &[u8]) -> Result<(), DeviceError> {
        self.0.send(bytes)?;
        self.0.send(bytes)
    }

    fn receive(&mut self, buffer: &mut [u8], patience: Duration) -> Result<usize, DeviceError> {
        self.0.receive(buffer, patience)
    }
}

#[test]
fn requests_that_come_twice_are_done_once() {
    let (objects, telemetry, _) = converse(Doubled(loopback()));
    assert_eq!(objects, expected());
    assert_eq!(telemetry.runs, 2);
    assert!(telemetry.repeated_requests > 10, "{telemetry:?}");
}

#[test]
fn a_dead_line_is_reported() {
    let line = FaultyLine::new(loopback(), LineFaults { lose: 1.0, seed: 1, ..LineFaults::default() });
    let few = RetryPolicy { attempts: 3, ..QUICK };
    let error = Client::connect_with(line, few, few).map(|_| ()).unwrap_err();
    assert!(matches!(error, DeviceError::Silent { attempts: 3, .. }), "{error}");
}

fn refusal(result: Result<(), DeviceError>) -> Refusal {
    match result.unwrap_err() {
        DeviceError::Refused(refusal) => refusal,
        other => panic!("{other}"),
    }
}

#[test]
fn a_network_that_needs_more_memory_is_refused_by_the_bytes_that_miss() {
    let needed = networks::header(&DENSE).memory;
    let config = LoopbackConfig { bulk_bytes: needed.bulk_bytes as usize - 10, ..LoopbackConfig::default() };
    let (mut client, _) = Client::connect(Loopback::start(config).unwrap()).unwrap();
    let refusal = refusal(client.send_blob(networks::network(&DENSE, 1).bytes(), &mut |_| {}));
    let Refusal::Blob(BlobError::Memory { needed: found, available }) = refusal else { panic!("{refusal}") };
    assert_eq!(found, needed);
    assert_eq!(needed.bulk_bytes - available.bulk_bytes, 10);
    assert!(refusal.to_string().ends_with("0 and 10 missing"), "{refusal}");
}

#[test]
fn a_damaged_network_is_refused_and_the_device_lives_on() {
    let (mut client, _) = Client::connect(loopback()).unwrap();
    let good = networks::network(&TAPPED, 1);
    let mut bytes = good.bytes().to_vec();
    bytes[700] ^= 4;
    assert!(matches!(refusal(client.send_blob(&bytes, &mut |_| {})), Refusal::Blob(BlobError::Crc { .. })));
    assert_eq!(refusal(client.reconstruct(1, Scope::default()).map(|_| ())), Refusal::NoNetwork);
    client.send_blob(good.bytes(), &mut |_| {}).unwrap();
    let short = refusal(client.reconstruct(1, Scope::default()).map(|_| ()));
    assert!(matches!(short, Refusal::Incomplete { what: Transfer::Frame, .. }), "{short}");
    client.send_frame(&[64; 20]).unwrap();
    let wrong = refusal(client.reconstruct(1, Scope::default()).map(|_| ()));
    assert_eq!(wrong, Refusal::FrameLength { expected: 2 * 50 * 44, found: 40 });
    client.send_frame(&networks::frames(&TAPPED, 1, 1)[0]).unwrap();
    client.reconstruct(1, Scope::default()).unwrap();
}

#[test]
fn what_does_not_fit_is_refused_before_it_is_sent() {
    // Two slots, each of a mark and a sector, and two unused sectors.
    let config = LoopbackConfig { flash_bytes: 6 * 4096, ..LoopbackConfig::default() };
    let (mut client, info) = Client::connect(Loopback::start(config).unwrap()).unwrap();
    assert_eq!(info.blob_bytes, 4096);
    let blob = networks::network(&DENSE, 1);
    let needed = blob.bytes().len() as u32;
    assert_eq!(
        refusal(client.send_blob(blob.bytes(), &mut |_| {})),
        Refusal::NoRoom { what: Transfer::Blob, needed, available: 4096 }
    );
}

/// The answer to one request, which is sent once.
fn ask(line: &mut Loopback, seq: u16, body: Request<'_>) -> Option<String> {
    let mut out = [0; 4096];
    line.send(encode(&Packet { seq, body }, &mut out).unwrap()).unwrap();
    let mut buffer = [0; 4096];
    let count = line.receive(&mut buffer, Duration::from_millis(300)).unwrap();
    let mut packet = buffer[..count].to_vec();
    packet.retain(|byte| *byte != 0);
    let reply: Packet<Reply<'_>> = ommatidia_shared::wire::frame::decode(&mut packet).ok()?;
    assert_eq!(reply.seq, seq);
    Some(format!("{:?}", reply.body))
}

#[test]
fn another_version_and_late_copies_are_turned_away() {
    let mut line = loopback();
    let other = ask(&mut line, 9, Request::Hello { version: VERSION + 1, schema: SCHEMA_KEY }).unwrap();
    assert!(other.starts_with("Refused(Version"), "{other}");
    let other = ask(&mut line, 9, Request::Hello { version: VERSION, schema: 1 }).unwrap();
    assert!(other.starts_with("Refused(Schema"), "{other}");
    let begin = Request::Begin { what: Transfer::Frame, len: 8 };
    assert_eq!(ask(&mut line, 10, begin).unwrap(), "Done");
    let chunk = |offset, data| Request::Chunk { what: Transfer::Frame, offset, data };
    assert_eq!(ask(&mut line, 11, chunk(0, &[1; 4])).unwrap(), "Received { offset: 4 }");
    assert_eq!(ask(&mut line, 10, begin), None, "a late copy must not begin the transfer again");
    assert_eq!(ask(&mut line, 11, chunk(0, &[1; 4])).unwrap(), "Received { offset: 4 }");
    let gap = ask(&mut line, 12, chunk(6, &[1; 2])).unwrap();
    assert!(gap.starts_with("Refused(OutOfOrder { expected: 4, found: 6"), "{gap}");
    let past = ask(&mut line, 13, chunk(4, &[1; 5])).unwrap();
    assert!(past.starts_with("Refused(PastEnd"), "{past}");
    assert_eq!(ask(&mut line, 14, chunk(2, &[1; 6])).unwrap(), "Received { offset: 8 }");
}

#[test]
fn packed_pixels_arrive_and_those_that_are_not_there_are_refused() {
    let mut line = loopback();
    assert!(ask(&mut line, 0, Request::Hello { version: VERSION, schema: SCHEMA_KEY }).is_some());
    assert_eq!(ask(&mut line, 1, Request::Begin { what: Transfer::Frame, len: 400 }).unwrap(), "Done");
    let pixels: Vec<u16> = (0..200).map(|i| 1000 + i % 7).collect();
    let mut out = [0; 300];
    let (count, len) = pack(&pixels, &mut out);
    assert_eq!(count, 200);
    let packed = |offset, pixels, len: usize| Request::Packed { offset, pixels, data: &out[..len] };
    let cut = ask(&mut line, 2, packed(0, 200, len / 2)).unwrap();
    assert!(cut.starts_with("Refused(Packed { expected: 200, found: "), "{cut}");
    assert!(ask(&mut line, 3, packed(0, 201, len)).unwrap().starts_with("Refused(PastEnd"));
    assert!(ask(&mut line, 4, packed(2, 100, len)).unwrap().starts_with("Refused(OutOfOrder"));
    assert_eq!(ask(&mut line, 5, packed(0, 120, len)).unwrap(), "Received { offset: 240 }");
    // Again, and more of them.
    assert_eq!(ask(&mut line, 6, packed(0, 120, len)).unwrap(), "Received { offset: 240 }");
    assert_eq!(ask(&mut line, 7, packed(0, 200, len)).unwrap(), "Received { offset: 400 }");
}

/// Requests for a device whose camera is not there.
#[test]
fn a_device_without_a_camera_refuses_its_settings_and_frames() {
    let (mut client, _) = Client::connect(loopback()).unwrap();
    assert_eq!(refusal(client.camera(CameraChange::default()).map(|_| ())), Refusal::NoCamera);
    client.send_blob(networks::network(&TAPPED, 1).bytes(), &mut |_| {}).unwrap();
    assert_eq!(refusal(client.reconstruct_live(1, Scope::default()).map(|_| ())), Refusal::NoCamera);
}
