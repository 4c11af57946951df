//! Bounds of strided columns, checked once before a loop without checks.

/// Checks that `halves` hold `len` groups of four pairs at this stride. Panics otherwise.
#[inline(always)]
pub(super) fn check(halves: usize, stride: usize, len: usize) {
    assert!(stride >= 8 && halves + stride >= len * stride + 8, "{halves} halves are too few");
}
