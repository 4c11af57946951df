//! Choice of the vector instruction set at run time.
//!
//! A kernel is written once over [`Vector`]s of independent outputs and compiled for each instruction set. No version
//! reorders operations or drops a rounding, so all give the same bits.

#[cfg(target_arch = "x86_64")]
mod x86;

/// Independent numbers that are computed side by side.
pub trait Vector: Copy {
    /// Number of elements.
    const LEN: usize;

    /// A vector with the same number in every element.
    fn splat(x: f32) -> Self;

    /// Loads the first [`Self::LEN`] numbers of a slice. Panics where it is shorter.
    fn load(from: &[f32]) -> Self;

    /// Stores to the first [`Self::LEN`] numbers of a slice. Panics where it is shorter.
    fn store(self, to: &mut [f32]);

    /// Sums of integers, with their own number of elements.
    type Sums: PairSums;

    /// `self + a * b`. Every product must be exact, as those of two widened halves are. One rounding and two then give
    /// the same bits, and the faster form is used.
    fn add_exact(self, a: Self, b: Self) -> Self;
}

/// Independent sums of products of integers that are computed side by side. None may overflow.
pub trait PairSums: Copy {
    /// Number of elements.
    const LEN: usize;

    /// Sums that begin with the same number.
    fn splat(x: i32) -> Self;

    /// Adds `from[2 i] weights[0] + from[2 i + 1] weights[1]` to element i. Panics where `from` has less than two
    /// numbers for each element.
    fn add_pairs(self, from: &[i16], weights: [i16; 2]) -> Self;

    /// Stores to the first [`Self::LEN`] numbers of a slice. Panics where it is shorter.
    fn store(self, to: &mut [i32]);
}

/// A loop nest that is compiled for each instruction set. `run` and all functions that it calls must be
/// `#[inline(always)]`.
pub trait Kernel {
    /// What the kernel returns.
    type Output;
    /// Runs the loops.
    fn run<V: Vector>(self) -> Self::Output;
}

/// Proof that the machine has an instruction set.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Simd(Level);

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Level {
    Portable,
    #[cfg(target_arch = "x86_64")]
    Avx2Fma,
}

/// Vectors that the compiler may assume on every machine: SSE2 on x86-64, none on a Cortex-M.
type Portable = [f32; if cfg!(target_arch = "arm") { 2 } else { 4 }];

impl Simd {
    /// The instruction set of every machine of the target.
    pub const PORTABLE: Self = Self(Level::Portable);

    /// The best instruction set of this processor.
    pub fn detect() -> Self {
        #[cfg(target_arch = "x86_64")]
        if x86::detected() {
            return Self(Level::Avx2Fma);
        }
        Self::PORTABLE
    }

    /// Runs the version of a kernel for this instruction set.
    #[inline(always)]
    pub fn run<K: Kernel>(self, kernel: K) -> K::Output {
        match self.0 {
            Level::Portable => kernel.run::<Portable>(),
            #[cfg(target_arch = "x86_64")]
            Level::Avx2Fma => x86::run(kernel),
        }
    }
}

impl<const N: usize> Vector for [f32; N] {
    const LEN: usize = N;

    type Sums = [i32; N];

    #[inline(always)]
    fn splat(x: f32) -> Self {
        [x; N]
    }

    #[inline(always)]
    fn load(from: &[f32]) -> Self {
        core::array::from_fn(|i| from[i])
    }

    #[inline(always)]
    fn store(self, to: &mut [f32]) {
        to[..N].copy_from_slice(&self);
    }

    #[inline(always)]
    fn add_exact(self, a: Self, b: Self) -> Self {
        core::array::from_fn(|i| self[i] + a[i] * b[i])
    }
}

impl<const N: usize> PairSums for [i32; N] {
    const LEN: usize = N;

    #[inline(always)]
    fn splat(x: i32) -> Self {
        [x; N]
    }

    #[inline(always)]
    fn add_pairs(self, from: &[i16], [even, odd]: [i16; 2]) -> Self {
        let from = &from[..2 * N];
        core::array::from_fn(|i| {
            let products = [i32::from(from[2 * i]) * i32::from(even), i32::from(from[2 * i + 1]) * i32::from(odd)];
            self[i] + (products[0] + products[1])
        })
    }

    #[inline(always)]
    fn store(self, to: &mut [i32]) {
        to[..N].copy_from_slice(&self);
    }
}
