//! How old a frame may be.

/// Longest time from the start of a capture to its use, microseconds. A capture and a reconstruction take less, so that
/// frames in a row are never captured twice; a frame that waited for its turn any longer shows the past.
const FRESH_US: u32 = 2_000_000;

/// Whether a frame whose capture was started at `began_us` may be used at `now_us`. Clocks wrap at 32 bits.
pub const fn is_fresh(began_us: u32, now_us: u32) -> bool {
    now_us.wrapping_sub(began_us) <= FRESH_US
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_that_waited_for_a_minute_is_old() {
        assert!(is_fresh(5, 5) && is_fresh(u32::MAX - 10, 900_000));
        assert!(!is_fresh(0, 60_000_000) && !is_fresh(u32::MAX - 10, 60_000_000));
    }
}
