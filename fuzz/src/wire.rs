//! Arbitrary bytes on the line: packets are dropped, or hold messages that can be encoded and decoded again.

use ommatidia_shared::wire::frame::decode;
use ommatidia_shared::wire::{Deframer, MAX_PACKET, Packet, Reply, Request, encode};

/// Tries one input. Panics where the module's claim does not hold.
pub fn try_input(data: &[u8]) {
    let mut deframer = Box::new(Deframer::<MAX_PACKET>::new());
    for byte in data {
        let Ok(Some(packet)) = deframer.push(*byte) else { continue };
        let mut copy = packet.to_vec();
        let _ = decode::<Packet<Request<'_>>>(packet);
        let _ = decode::<Packet<Reply<'_>>>(&mut copy);
    }
    // Past the checksum: whatever postcard makes of the bytes can be sent, arrives, and is the same.
    if let Ok((request, _)) = postcard::take_from_bytes::<Packet<Request<'_>>>(data) {
        let mut out = vec![0; MAX_PACKET];
        let Ok(bytes) = encode(&request, &mut out) else { return };
        let mut packet = bytes[1..bytes.len() - 1].to_vec();
        assert_eq!(decode::<Packet<Request<'_>>>(&mut packet), Ok(request));
    }
    if let Ok((reply, _)) = postcard::take_from_bytes::<Packet<Reply<'_>>>(data) {
        let mut out = vec![0; MAX_PACKET];
        let _ = encode(&reply, &mut out);
        let _ = format!("{reply:?}");
    }
}
