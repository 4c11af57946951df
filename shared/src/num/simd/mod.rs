//! The widest vector unit that the machine has, chosen once at run time.
//!
//! A kernel is written once over [`Vector`]s of independent outputs and compiled for each instruction set. No form reorders
//! an operation or drops a rounding: all give the same bits.

#[cfg(target_arch = "x86_64")]
mod x86;

/// Independent numbers that are computed side by side.
pub trait Vector: Copy {
    /// How many.
    const LEN: usize;

    /// The same number in every place.
    fn splat(x: f32) -> Self;

    /// The first [`Self::LEN`] numbers of a slice; panics where it is shorter.
    fn load(from: &[f32]) -> Self;

    /// Into the first [`Self::LEN`] numbers of a slice; panics where it is shorter.
    fn store(self, to: &mut [f32]);

    /// `self + a * b` where the caller knows every product to be exact, as those of two widened halves are: with one rounding or
    /// with two, whichever is faster, the bits are the same.
    fn add_exact(self, a: Self, b: Self) -> Self;
}

/// A loop nest that shall be compiled for each instruction set. Mark `run` and all that it calls `#[inline(always)]`.
pub trait Kernel {
    /// What the kernel returns.
    type Output;
    /// Does the work.
    fn run<V: Vector>(self) -> Self::Output;
}

/// Proof of which instruction set is there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Simd(Level);

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Level {
    Portable,
    #[cfg(target_arch = "x86_64")]
    Avx2Fma,
}

/// What the compiler may assume on every machine: SSE2 on x86-64, no vectors on a Cortex-M.
type Portable = [f32; if cfg!(target_arch = "arm") { 2 } else { 4 }];

impl Simd {
    /// What every machine of the target has.
    pub const PORTABLE: Self = Self(Level::Portable);

    /// Asks the processor.
    pub fn detect() -> Self {
        #[cfg(target_arch = "x86_64")]
        if x86::detected() {
            return Self(Level::Avx2Fma);
        }
        Self::PORTABLE
    }

    /// Runs a kernel in the form for this instruction set.
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
