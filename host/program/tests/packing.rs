//! Frames of the demo's virtual instrument, packed for the line to a device.
#![allow(clippy::unwrap_used)]

use ommatidia_bench::BenchConfig;
use ommatidia_session::{Role, Session};
use ommatidia_shared::wire::{CHUNK, Unpacker, pack};

/// Noise cannot be packed. What is left must be less than the twelve bits that a pixel has, which anybody can send.
#[test]
fn noisy_frames_take_less_than_their_twelve_bits_a_pixel() {
    // The demo's instrument, with few frames of each kind.
    let mut config = BenchConfig::default();
    (config.scan.rows, config.scan.cols) = (1, 1);
    (config.stacks.dark_frames, config.stacks.flat_frames, config.stacks.scene_frames) = (2, 2, 2);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("demo");
    config.build(&[]).unwrap().measure(&path, 1, |_| ()).unwrap();
    let session = Session::open(&path).unwrap();
    for role in [Role::Dark, Role::Flat, Role::Scene] {
        let stack = session.stacks().iter().find(|stack| stack.role() == role).unwrap();
        let frame = stack.frames().unwrap().read(0).unwrap();
        let codes: Vec<u16> = frame.iter().map(|value| *value as u16).collect();
        let (mut at, mut bytes, mut packets) = (0, 0, 0);
        let mut out = vec![0; CHUNK];
        while at < codes.len() {
            let (pixels, used) = pack(&codes[at..], &mut out);
            assert!(Unpacker::new(&out[..used]).take(pixels).eq(codes[at..at + pixels].iter().copied()));
            (at, bytes, packets) = (at + pixels, bytes + used, packets + 1);
        }
        let raw = 2 * codes.len();
        println!(
            "{role:?}: {} pixels, {raw} bytes as they are, {bytes} packed in {packets} packets: {:.2} bits a pixel",
            codes.len(),
            8.0 * bytes as f64 / codes.len() as f64
        );
        assert!(4 * bytes < 3 * raw, "{role:?}: {bytes} of {raw}");
    }
}
