//! A simulated device whose flash keeps its content while the power is off.

use super::flash::{ECC_WORD, Fault, FaultyFlash, SECTOR};
use crate::device::error::DeviceError;
use crate::device::run::reference;
use half::f16;
use ommatidia_network::network_file::NetworkFile;
use ommatidia_session::rng;
use ommatidia_shared::blob::{Bank, Header, MemoryPlan, Rcan, Sensor, Size, Tap, Weights};
use ommatidia_shared::device::{Arenas, Device, Footprint, Monitor, RamFrame, RamObject};
use ommatidia_shared::pipeline::Pipeline;
use ommatidia_shared::wire::{CHUNK, FrameFrom, Refusal, Reply, Request, StartCause, Telemetry, Transfer};
use rand::RngExt;

const SIDE: u16 = 34;
const OBJECT: u16 = 16;
/// Two slots of a mark and three sectors each, and two unused sectors.
pub(super) const FLASH: usize = (2 * 4 + 2) * SECTOR;
const FAST: usize = 16 << 10;
const BULK: usize = 64 << 10;

/// The device under test.
pub(super) type DeviceUnderTest<'a, 'm> = Device<'a, &'a mut FaultyFlash<'m>, RamFrame<'a>, RamObject<'a>, Starts>;

/// Whether the last starts of a device ended in faults.
#[derive(Clone, Copy, Debug)]
pub(super) struct Starts {
    faulting: bool,
}

impl Monitor for Starts {
    fn alive(&mut self) {}
    fn run_begins(&mut self) {}
    fn run_ends(&mut self) -> Option<u32> {
        None
    }
    fn footprint(&self) -> Footprint {
        Footprint::default()
    }
    fn temperature_cdeg(&mut self) -> Option<i16> {
        None
    }
    fn start_cause(&self) -> StartCause {
        if self.faulting { StartCause::Fault } else { StartCause::Power }
    }
    fn keeps_faulting(&self) -> bool {
        self.faulting
    }
}

/// A network, a frame, and the host's reconstruction of that frame.
#[derive(Debug)]
pub(super) struct Network {
    pub blob: NetworkFile,
    pub frame: Vec<u16>,
    pub object: Vec<f16>,
}

impl Network {
    /// A small network, over two sectors long, with weights drawn under `seed`.
    pub fn new(seed: u64) -> Result<Self, DeviceError> {
        let mut header = Header {
            name: format!("network {seed}").parse().unwrap_or_default(),
            checkpoint: Default::default(),
            frame: Size { rows: SIDE, cols: SIDE },
            object: Size { rows: OBJECT, cols: OBJECT },
            sensor: Sensor { black_level_dn: 64.0, saturation_dn: 4095, has_offset_map: true, has_gain_map: true },
            bank: Bank {
                tile: 16,
                step: 8,
                channels: 1,
                taps: [Tap { channel: 0, dy: 0, dx: 0 }].into_iter().collect(),
                blocks: None,
            },
            rcan: Rcan { width: 2, groups: 1, blocks: 1, reduction: 2 },
            memory: MemoryPlan { fast_bytes: 0, bulk_bytes: 0 },
            integers: None,
            passes: None,
            watch: None,
        };
        header.memory = Pipeline::plan(&header).map_err(DeviceError::Pipeline)?;
        let mut rng = rng::stream(seed, "faults", 0);
        let mut draw = |len: u64, centre: f32| -> Vec<f16> {
            (0..len).map(|_| f16::from_f32(centre + rng.random_range(-0.4..0.4f32))).collect()
        };
        let lens = header.section_lens().map_err(|e| DeviceError::Refused(Refusal::Blob(e)))?;
        let sections =
            [draw(lens.filters, 0.1), draw(lens.rcan, 0.0), draw(lens.offset_dn, 0.0), draw(lens.inverse_gain, 1.0)];
        let [filters, rcan, offset, gain] = &sections;
        let weights = Weights {
            filters,
            index: &[],
            rcan,
            offset_dn: Some(offset),
            inverse_gain: Some(gain),
            convolutions: None,
            predictor: &[],
            watch: Default::default(),
        };
        let blob = NetworkFile::new(&header, &weights)?;
        let mut rng = rng::stream(seed, "frame", 0);
        let frame: Vec<u16> = (0..usize::from(SIDE) * usize::from(SIDE)).map(|_| rng.random_range(40..=4095)).collect();
        let object = reference(&blob, std::slice::from_ref(&frame).into())?.pop().unwrap_or_default();
        Ok(Self { blob, frame, object })
    }
}

/// Content of a flash, and which of its words cannot be read.
pub(super) type Saved = (Vec<u128>, Option<Vec<bool>>);

/// Memory of a device; only the flash keeps its content.
pub(super) struct TestDevice {
    flash: Vec<u128>,
    /// With error correction: which words cannot be read.
    unreadable: Option<Vec<bool>>,
    frame: Vec<u16>,
    object: Vec<f16>,
    fast: Vec<f32>,
    bulk: Vec<f16>,
    /// The next start comes after three that ended in faults.
    pub faulting: bool,
    /// Steps of the flash while the device was on last.
    pub steps: u64,
    /// The power failed while the device was on last.
    pub cut: bool,
}

impl TestDevice {
    pub fn new(ecc: bool) -> Self {
        Self {
            flash: vec![0; FLASH / size_of::<u128>()],
            unreadable: ecc.then(|| vec![false; FLASH / ECC_WORD]),
            frame: vec![0; usize::from(SIDE) * usize::from(SIDE)],
            object: vec![f16::ZERO; usize::from(OBJECT) * usize::from(OBJECT)],
            fast: vec![0.0; FAST / size_of::<f32>()],
            bulk: vec![f16::ZERO; BULK / size_of::<f16>()],
            faulting: false,
            steps: 0,
            cut: false,
        }
    }

    /// A copy of the flash.
    pub fn save(&self) -> Saved {
        (self.flash.clone(), self.unreadable.clone())
    }

    /// Restores a copy of the flash.
    pub fn restore(&mut self, (flash, unreadable): &Saved) {
        self.flash.copy_from_slice(flash);
        self.unreadable.clone_from(unreadable);
    }

    /// Makes a word of the flash unreadable while the power is off.
    pub fn spoil(&mut self, word: usize) {
        self.unreadable.iter_mut().for_each(|unreadable| unreadable[word] = true);
    }

    /// Flips a bit of the flash while the power is off.
    pub fn flip(&mut self, bit: usize) {
        bytemuck::cast_slice_mut::<_, u8>(&mut self.flash)[bit / 8] ^= 1 << (bit % 8);
    }

    /// Switches the device on with an injected fault, calls `work`, and switches it off.
    pub fn power_on<R>(&mut self, fault: Fault, seed: u64, work: impl FnOnce(&mut DeviceUnderTest<'_, '_>) -> R) -> R {
        let rng = rng::stream(seed, "faulty flash", 0);
        let memory = bytemuck::cast_slice_mut(&mut self.flash);
        let mut flash = FaultyFlash::new(memory, self.unreadable.as_deref_mut(), fault, rng);
        let arenas = Arenas { fast: &mut self.fast, bulk: &mut self.bulk };
        let (source, sink) = (RamFrame::new(&mut self.frame), RamObject::new(&mut self.object));
        let mut device = Device::new("desk", &mut flash, source, sink, arenas, Starts { faulting: self.faulting });
        let result = work(&mut device);
        drop(device);
        (self.steps, self.cut) = (flash.steps, flash.dead);
        result
    }
}

/// Sends bytes as a network file and has them committed.
pub(super) fn upload(device: &mut DeviceUnderTest<'_, '_>, bytes: &[u8]) -> Result<(), Refusal> {
    transfer(device, Transfer::Blob, bytes)?;
    accepted(&device.handle(Request::Commit))
}

/// Whether the device's reconstruction of the network's frame equals the host's.
pub(super) fn reconstructs(device: &mut DeviceUnderTest<'_, '_>, network: &Network) -> bool {
    let frame: Vec<u8> = network.frame.iter().flat_map(|code| code.to_le_bytes()).collect();
    if transfer(device, Transfer::Frame, &frame).is_err() {
        return false;
    }
    let Reply::Ran(report) = device.handle(Request::Run { id: 1, frame: FrameFrom::Host, region: None, hold: 0 })
    else {
        return false;
    };
    let request = Request::Read { id: 1, offset: 0, len: report.len as u16 };
    let expected: Vec<u8> = network.object.iter().flat_map(|half| half.to_le_bytes()).collect();
    matches!(device.handle(request), Reply::Data { data, .. } if data == expected)
}

/// Telemetry of the device.
pub(super) fn telemetry(device: &mut DeviceUnderTest<'_, '_>) -> Telemetry {
    match device.handle(Request::Telemetry) {
        Reply::Telemetry(telemetry) => telemetry,
        _ => Telemetry::default(),
    }
}

fn transfer(device: &mut DeviceUnderTest<'_, '_>, what: Transfer, bytes: &[u8]) -> Result<(), Refusal> {
    accepted(&device.handle(Request::Begin { what, len: bytes.len() as u32 }))?;
    let mut offset = 0;
    for data in bytes.chunks(CHUNK) {
        accepted(&device.handle(Request::Chunk { what, offset, data }))?;
        offset += data.len() as u32;
    }
    Ok(())
}

fn accepted(reply: &Reply<'_>) -> Result<(), Refusal> {
    match reply {
        Reply::Refused(refusal) => Err(refusal.clone()),
        _ => Ok(()),
    }
}
