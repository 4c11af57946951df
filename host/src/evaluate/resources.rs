//! Time and memory of a method.

use std::time::Instant;

/// A result, and what computing it took.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Measured<T> {
    /// The result.
    pub result: T,
    /// Wall time, s.
    pub seconds: f64,
    /// Peak resident memory of the whole process during the work, bytes; None on systems that do not report it.
    pub peak_bytes: Option<u64>,
}

/// Runs `work` and measures its time and memory. The memory is the kernel's high-water mark of the process, which is
/// reset before.
///
/// ```
/// use ommatidia_host::evaluate::measured;
///
/// let run = measured(|| 2 + 2);
/// assert!(run.result == 4 && run.seconds < 1.0);
/// ```
pub fn measured<T>(work: impl FnOnce() -> T) -> Measured<T> {
    reset_peak();
    let start = Instant::now();
    let result = work();
    let seconds = start.elapsed().as_secs_f64();
    Measured { result, seconds, peak_bytes: peak_bytes() }
}

/// Resets the high-water mark (since Linux 4.0; `man 5 proc`, `/proc/pid/clear_refs`). If that fails, the mark also
/// covers the time before.
fn reset_peak() {
    let _ = std::fs::write("/proc/self/clear_refs", "5");
}

/// `VmHWM`, the peak of the resident set, bytes.
fn peak_bytes() -> Option<u64> {
    parse_peak(&std::fs::read_to_string("/proc/self/status").ok()?)
}

fn parse_peak(status: &str) -> Option<u64> {
    let line = status.lines().find_map(|l| l.strip_prefix("VmHWM:"))?;
    let kib: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kib * 1024)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_peak_is_read_from_the_status() {
        assert_eq!(parse_peak("Name:\tx\nVmHWM:\t  12345 kB\nVmRSS:\t 1 kB\n"), Some(12_345 * 1024));
        assert_eq!(parse_peak("Name:\tx\n"), None);
    }

    #[test]
    fn the_result_comes_through() {
        let Measured { result: value, seconds, peak_bytes: peak } =
            measured(|| vec![1u8; 1 << 24].iter().map(|&v| u64::from(v)).sum::<u64>());
        assert!(value == 1 << 24 && seconds >= 0.0);
        assert!(peak.is_none_or(|p| p > 1 << 20));
    }
}
