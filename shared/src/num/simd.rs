//! The widest vector unit that the machine has, chosen once at run time.
//!
//! Kernels are written for fixed-size arrays of independent outputs; the compiler turns them into vector code for the
//! features that it may assume. On x86-64 that would be SSE2 only, so [`Simd::run`] compiles each kernel a second time for
//! AVX2. Neither form fuses or reorders an operation: both give the same bits.

/// A loop nest that shall be compiled for each instruction set. Mark `run` and all that it calls `#[inline(always)]`.
pub trait Kernel {
    /// What the kernel returns.
    type Output;
    /// Does the work.
    fn run(self) -> Self::Output;
}

/// Proof of which instruction set is there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Simd(Level);

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Level {
    Portable,
    #[cfg(target_arch = "x86_64")]
    Avx2,
}

impl Simd {
    /// What every machine of the target has.
    pub const PORTABLE: Self = Self(Level::Portable);

    /// Asks the processor.
    pub fn detect() -> Self {
        #[cfg(target_arch = "x86_64")]
        if x86::has_avx2() {
            return Self(Level::Avx2);
        }
        Self::PORTABLE
    }

    /// Runs a kernel in the form for this instruction set.
    #[inline(always)]
    pub fn run<K: Kernel>(self, kernel: K) -> K::Output {
        match self.0 {
            Level::Portable => kernel.run(),
            #[cfg(target_arch = "x86_64")]
            Level::Avx2 => x86::run_avx2(kernel),
        }
    }
}

#[cfg(target_arch = "x86_64")]
#[allow(unsafe_code)]
mod x86 {
    use super::Kernel;
    use core::arch::x86_64::{__cpuid, __cpuid_count, _xgetbv};

    const OSXSAVE: u32 = 1 << 27;
    const AVX: u32 = 1 << 28;
    const AVX2: u32 = 1 << 5;
    /// The operating system saves xmm and ymm registers.
    const XCR0_YMM: u64 = 0b110;

    /// Intel SDM vol. 1, 14.3 "Detection of Intel AVX instructions" and 14.7.1.
    pub(super) fn has_avx2() -> bool {
        if __cpuid(0).eax < 7 || __cpuid(1).ecx & (OSXSAVE | AVX) != OSXSAVE | AVX {
            return false;
        }
        // SAFETY: OSXSAVE is set, so XGETBV exists.
        let saved = unsafe { xcr0() };
        saved & XCR0_YMM == XCR0_YMM && __cpuid_count(7, 0).ebx & AVX2 != 0
    }

    #[target_feature(enable = "xsave")]
    fn xcr0() -> u64 {
        // SAFETY: register 0 exists wherever XGETBV does.
        unsafe { _xgetbv(0) }
    }

    #[inline(always)]
    pub(super) fn run_avx2<K: Kernel>(kernel: K) -> K::Output {
        // SAFETY: `Level::Avx2` is made only where `has_avx2` said yes.
        unsafe { with_avx2(kernel) }
    }

    #[target_feature(enable = "avx2")]
    fn with_avx2<K: Kernel>(kernel: K) -> K::Output {
        kernel.run()
    }
}
