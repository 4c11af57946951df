//! AVX2 with FMA (Intel since 2013, AMD since 2015).
#![allow(unsafe_code)]

use core::arch::x86_64::{
    __cpuid, __cpuid_count, __m256, __m256i, _mm256_add_epi32, _mm256_fmadd_ps, _mm256_loadu_ps, _mm256_loadu_si256,
    _mm256_madd_epi16, _mm256_set1_epi32, _mm256_set1_ps, _mm256_storeu_ps, _mm256_storeu_si256, _xgetbv,
};

use super::{Kernel, PairSums, Vector};

// CPUID 1, ecx.
const FMA: u32 = 1 << 12;
const OSXSAVE: u32 = 1 << 27;
const AVX: u32 = 1 << 28;
// CPUID 7.0, ebx.
const AVX2: u32 = 1 << 5;
/// The operating system saves xmm and ymm registers.
const XCR0_YMM: u64 = 0b110;

/// Intel SDM vol. 1, sections 14.5.3 and 14.7.1: detection of FMA and of AVX2.
pub(super) fn detected() -> bool {
    let needed = FMA | OSXSAVE | AVX;
    if __cpuid(0).eax < 7 || __cpuid(1).ecx & needed != needed {
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

/// Called only with `Level::Avx2Fma`, which exists only where [`detected`] returned true.
#[inline(always)]
pub(super) fn run<K: Kernel>(kernel: K) -> K::Output {
    // SAFETY: the processor has the features, see above.
    unsafe { with_features(kernel) }
}

#[target_feature(enable = "avx2,fma")]
fn with_features<K: Kernel>(kernel: K) -> K::Output {
    kernel.run::<Eight>()
}

/// Eight numbers in a ymm register. The type is private to this module and used by [`with_features`] only. So the
/// processor has the features where its methods run.
#[derive(Clone, Copy)]
struct Eight(__m256);

impl Vector for Eight {
    const LEN: usize = 8;

    type Sums = EightSums;

    #[inline(always)]
    fn splat(x: f32) -> Self {
        // SAFETY: see the type.
        Self(unsafe { _mm256_set1_ps(x) })
    }

    #[inline(always)]
    fn load(from: &[f32]) -> Self {
        let from = &from[..8];
        // SAFETY: see the type; eight numbers are there, and the load may be unaligned.
        Self(unsafe { _mm256_loadu_ps(from.as_ptr()) })
    }

    #[inline(always)]
    fn store(self, to: &mut [f32]) {
        let to = &mut to[..8];
        // SAFETY: see the type; there is room for eight numbers, and the store may be unaligned.
        unsafe { _mm256_storeu_ps(to.as_mut_ptr(), self.0) }
    }

    #[inline(always)]
    fn add_exact(self, a: Self, b: Self) -> Self {
        // SAFETY: see the type.
        Self(unsafe { _mm256_fmadd_ps(a.0, b.0, self.0) })
    }
}

/// Eight integers in a ymm register, as [`Eight`].
#[derive(Clone, Copy)]
pub(super) struct EightSums(__m256i);

impl PairSums for EightSums {
    const LEN: usize = 8;

    #[inline(always)]
    fn splat(x: i32) -> Self {
        // SAFETY: see `Eight`.
        Self(unsafe { _mm256_set1_epi32(x) })
    }

    #[inline(always)]
    fn add_pairs(self, from: &[i16], [even, odd]: [i16; 2]) -> Self {
        let from = &from[..16];
        let weights = i32::from(odd) << 16 | i32::from(even) & 0xffff;
        // SAFETY: see `Eight`; sixteen numbers are there, and the load may be unaligned.
        unsafe {
            let from = _mm256_loadu_si256(from.as_ptr().cast());
            Self(_mm256_add_epi32(self.0, _mm256_madd_epi16(from, _mm256_set1_epi32(weights))))
        }
    }

    #[inline(always)]
    fn store(self, to: &mut [i32]) {
        let to = &mut to[..8];
        // SAFETY: see `Eight`; there is room for eight numbers, and the store may be unaligned.
        unsafe { _mm256_storeu_si256(to.as_mut_ptr().cast(), self.0) }
    }
}
