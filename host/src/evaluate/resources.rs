//! Time and memory of a method.

use std::time::Instant;

/// Runs `work` and gives its result, the seconds that it took, and the peak of the process's resident memory meanwhile, bytes.
///
/// The memory is that of the whole process (what a machine must have), from the kernel's high-water mark, which is reset before.
/// None where the system does not tell.
pub fn measured<T>(work: impl FnOnce() -> T) -> (T, f64, Option<u64>) {
    reset_peak();
    let start = Instant::now();
    let result = work();
    let seconds = start.elapsed().as_secs_f64();
    (result, seconds, peak_bytes())
}

/// Resets the high-water mark (Linux 4.0 on; `man 5 proc`, `/proc/pid/clear_refs`). Where it cannot be, the mark stays the larger one.
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
        let (value, seconds, peak) = measured(|| vec![1u8; 1 << 24].iter().map(|&v| u64::from(v)).sum::<u64>());
        assert!(value == 1 << 24 && seconds >= 0.0);
        assert!(peak.is_none_or(|p| p > 1 << 20));
    }
}
