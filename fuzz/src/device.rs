//! Arbitrary requests in any order, on a flash with arbitrary content: the device answers each, and the active network
//! is always complete.

use half::f16;
use ommatidia_shared::blob::Network;
use ommatidia_shared::device::{Arenas, Clock, Device, Line, RamObject, Silent, VirtualCamera};
use ommatidia_shared::flash::{RAM_SECTOR, RamFlash};
use ommatidia_shared::wire::{CameraChange, Reply, Request};
use std::cell::Cell;

const FLASH: usize = 8 * RAM_SECTOR;

thread_local! {
    /// A clock that goes on only while the device waits.
    static NOW_US: Cell<u64> = const { Cell::new(0) };
}
/// Waits take no time.
const CLOCK: Clock =
    Clock { now_us: || NOW_US.get(), pause: || NOW_US.set(NOW_US.get().wrapping_add(1 << 13) % (1 << 50)) };

/// Tries one input. Panics where the module's claim does not hold.
pub fn try_input(data: &[u8]) {
    // The first byte determines how much of the input is in the flash at the start.
    let Some((split, data)) = data.split_first() else { return };
    let (content, mut requests) = data.split_at(data.len() * usize::from(*split) / 512);
    let mut flash = vec![0u128; FLASH / 16];
    bytemuck::cast_slice_mut::<_, u8>(&mut flash)[..content.len().min(FLASH)]
        .copy_from_slice(&content[..content.len().min(FLASH)]);
    let (mut frame, mut object) = (vec![0u16; 2048], vec![f16::ZERO; 2048]);
    let (mut fast, mut bulk) = (vec![0f32; 4096], vec![f16::ZERO; 16 << 10]);
    let arenas = Arenas { fast: &mut fast, bulk: &mut bulk };
    let flash = RamFlash::new(bytemuck::cast_slice_mut(&mut flash));
    let camera = VirtualCamera::new(&mut frame, [16, 16], CLOCK);
    let mut device = Device::new("fuzz", flash, camera, RamObject::new(&mut object), arenas, Silent);
    let mut line = Box::new(Line::new());
    for byte in requests {
        line.push(*byte, &mut device);
    }
    while let Ok((request, rest)) = postcard::take_from_bytes::<Request<'_>>(requests) {
        if let (Reply::Ran(report), Request::Run { hold, .. }) = (device.handle(request), request) {
            assert!(report.len > 0 && report.field_age <= hold);
        }
        requests = rest;
    }
    // Settings in force can be asked for again, and are within their limits.
    if let Reply::Camera(status) = device.handle(Request::Camera(CameraChange::default())) {
        let (set, limits) = (status.settings, status.limits);
        assert!(set.region.pixels() <= 2048);
        assert!((limits.exposure_us.least..=limits.exposure_us.most).contains(&set.exposure_us));
        let again = CameraChange::to(set);
        let Reply::Camera(after) = device.handle(Request::Camera(again)) else { panic!("refused: {again:?}") };
        assert_eq!(after.settings, set);
    } else {
        panic!("no camera");
    }
    if let Reply::Telemetry(telemetry) = device.handle(Request::Telemetry) {
        assert_eq!(
            telemetry.slots.iter().flatten().filter(|slot| slot.runs).count() == 0,
            telemetry.network.is_empty()
        );
    }
    let _ = Network::decode(content);
}
