//! Memory of the firmware on a board.

use super::error::DeviceError;
use super::firmware::Firmware;
use super::run::run;
use super::runtime::Runtime;
use half::f16;
use ommatidia_network::network_file::NetworkFile;
use ommatidia_shared::blob::{Bank, Header, MemoryPlan, Rcan, Sensor, Size, Tap, Weights};
use ommatidia_shared::pipeline::Pipeline;
use serde::Serialize;

/// Memory of the firmware on a board, without the buffers of the network.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Footprint {
    /// Code and constants, bytes.
    pub image_bytes: u32,
    /// Variables, bytes.
    pub static_bytes: u32,
    /// Deepest stack so far, bytes.
    pub stack_bytes: u32,
}

/// Runs a small network on the emulated board and reads the memory use from its telemetry.
///
/// # Errors
/// QEMU is missing, or the program fails.
pub fn footprint(app: &Firmware) -> Result<Footprint, DeviceError> {
    let (blob, frame) = small_network()?;
    let telemetry = run(&Runtime::Qemu(app.clone()), &blob, [frame].as_slice().into(), None, &mut |_| {})?.telemetry;
    let (image_bytes, static_bytes, stack_bytes) =
        (telemetry.image_bytes, telemetry.static_bytes, telemetry.stack_bytes);
    Ok(Footprint { image_bytes, static_bytes, stack_bytes })
}

/// A network with every operator in it, all weights zero, and a frame for it: how deep the stack gets does not depend
/// on the sizes.
pub(super) fn small_network() -> Result<(NetworkFile, Vec<u16>), DeviceError> {
    let mut header = Header {
        name: Default::default(),
        checkpoint: Default::default(),
        frame: Size { rows: 16, cols: 16 },
        object: Size { rows: 8, cols: 8 },
        sensor: Sensor { black_level_dn: 64.0, saturation_dn: 4095, has_offset_map: true, has_gain_map: true },
        bank: Bank { tile: 16, step: 16, channels: 2, taps: tap(0).chain(tap(1)).collect(), blocks: None },
        rcan: Rcan { width: 4, groups: 1, blocks: 1, reduction: 2 },
        memory: MemoryPlan { fast_bytes: 0, bulk_bytes: 0 },
        integers: None,
        passes: None,
        watch: None,
    };
    header.memory = Pipeline::plan(&header).map_err(DeviceError::Pipeline)?;
    let lens = header.section_lens().map_err(|source| {
        let path = "the small network".into();
        ommatidia_network::network_file::NetworkFileError::Format { path, source }
    })?;
    let zeros = vec![f16::ZERO; lens.filters.max(lens.rcan).max(lens.offset_dn).max(lens.inverse_gain) as usize];
    let weights = Weights {
        filters: &zeros[..lens.filters as usize],
        index: &[],
        rcan: &zeros[..lens.rcan as usize],
        offset_dn: Some(&zeros[..lens.offset_dn as usize]),
        inverse_gain: Some(&zeros[..lens.inverse_gain as usize]),
        convolutions: None,
        predictor: &[],
        watch: Default::default(),
    };
    Ok((NetworkFile::new(&header, &weights)?, vec![100; 256]))
}

fn tap(channel: u8) -> impl Iterator<Item = Tap> {
    std::iter::once(Tap { channel, dy: 0, dx: 0 })
}
