//! The data cache, and the memory that it must leave alone.
#![allow(unsafe_code)] // registers

use super::memory::dma_range;
use crate::board::guard::ON_WITH_DEFAULT_MAP;
use core::ops::Range;
use cortex_m::Peripherals;
use cortex_m::asm::{dsb, isb};

/// Size of the region without a cache, as a power of two: 512 KB, which holds all of SRAM 1 to 3.
const REGION_LOG2: u32 = 19;
/// Attributes of the region (Arm DDI 0403, B3.5.9): not executable, all may read and write, normal memory that is
/// shared and not cached.
const UNCACHED: u32 = 1 << 28 | 0b011 << 24 | 0b001 << 19 | 1 << 18;
/// Number of the region.
const REGION: u32 = 0;

/// Turns both caches on. The memory that DMA writes is not cached.
pub(super) fn enable(core: &mut Peripherals) {
    let base = dma_range().start.addr() as u32;
    // SAFETY: nothing uses the region yet, and its attributes change only how it is reached.
    unsafe {
        core.MPU.ctrl.write(0);
        core.MPU.rnr.write(REGION);
        core.MPU.rbar.write(base);
        core.MPU.rasr.write(UNCACHED | (REGION_LOG2 - 1) << 1 | 1);
        core.MPU.ctrl.write(ON_WITH_DEFAULT_MAP);
    }
    dsb();
    isb();
    core.SCB.enable_icache();
    core.SCB.enable_dcache(&mut core.CPUID);
}

/// Drops what the cache holds of flash that has changed. The range begins and ends at a word of the flash, 32 bytes,
/// which is a line of the cache.
pub(super) fn forget(range: Range<usize>) {
    // SAFETY: flash is never written through the cache as memory, so no line of it holds anything else.
    unsafe { Peripherals::steal().SCB.invalidate_dcache_by_address(range.start, range.len()) };
}
