//! How many tests and checks passed, failed, or were skipped.

use std::fmt;
use std::ops::AddAssign;

/// Counts of tests and checks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    pub passed: u64,
    pub failed: u64,
    pub skipped: u64,
}

impl Counts {
    /// One check that either holds or does not.
    pub fn check(holds: bool) -> Self {
        Self { passed: holds.into(), failed: (!holds).into(), skipped: 0 }
    }

    /// Adds the counts of one line of the test runner, `test result: ok. 3 passed; 0 failed; 1 ignored; ...`.
    pub fn add_line(&mut self, line: &str) {
        let Some(result) = line.trim_start().strip_prefix("test result:") else { return };
        let count = |what: &str| -> u64 {
            result
                .split(['.', ';'])
                .filter_map(|part| part.trim().strip_suffix(what)?.trim().parse().ok())
                .next()
                .unwrap_or(0)
        };
        *self += Self { passed: count("passed"), failed: count("failed"), skipped: count("ignored") };
    }

    /// Adds the counts of pytest's last line, `1 failed, 12 passed, 3 skipped in 2.1s`.
    pub fn add_pytest_line(&mut self, line: &str) {
        let line = line.trim_matches(['=', ' ']);
        let Some((counts, time)) = line.rsplit_once(" in ") else { return };
        if time.split([' ', 's']).next().is_none_or(|seconds| seconds.parse::<f64>().is_err()) {
            return;
        }
        for part in counts.split(", ") {
            let Some((count, what)) = part.split_once(' ') else { return };
            let Ok(count) = count.parse::<u64>() else { return };
            match what {
                "passed" => self.passed += count,
                "failed" | "error" | "errors" => self.failed += count,
                "skipped" => self.skipped += count,
                _ => {}
            }
        }
    }

    /// The counts of a line that [`Counts`] has written, `12 passed, 0 failed, 3 skipped`.
    pub fn of_total(line: &str) -> Option<Self> {
        let mut parts = line.trim().split(", ");
        let mut count = |what: &str| parts.next()?.strip_suffix(what)?.trim().parse().ok();
        let all = Self { passed: count("passed")?, failed: count("failed")?, skipped: count("skipped")? };
        parts.next().is_none().then_some(all)
    }

    /// Moves `n` tests that returned early, and said so, from passed to skipped.
    pub fn skip(&mut self, n: u64) {
        self.passed = self.passed.saturating_sub(n);
        self.skipped += n;
    }
}

impl AddAssign for Counts {
    fn add_assign(&mut self, other: Self) {
        self.passed += other.passed;
        self.failed += other.failed;
        self.skipped += other.skipped;
    }
}

impl fmt::Display for Counts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} passed, {} failed, {} skipped", self.passed, self.failed, self.skipped)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_runner_line_is_counted_and_any_other_is_not() {
        let mut counts = Counts::default();
        counts.add_line(
            "test result: FAILED. 12 passed; 3 failed; 1 ignored; 0 measured; 5 filtered out; finished in 0.1s",
        );
        counts.add_line("test foo::bar ... ok");
        assert_eq!(counts, Counts { passed: 12, failed: 3, skipped: 1 });
        counts.skip(2);
        assert_eq!(counts.to_string(), "10 passed, 3 failed, 3 skipped");
    }

    #[test]
    fn a_total_is_read_as_it_is_written() {
        let counts = Counts { passed: 12, failed: 3, skipped: 1 };
        assert_eq!(Counts::of_total(&counts.to_string()), Some(counts));
        for other in ["", "12 passed", "12 passed, 3 failed", "-- lints: 1 passed, 0 failed, 0 skipped (3 s)"] {
            assert_eq!(Counts::of_total(other), None, "{other}");
        }
    }

    #[test]
    fn the_last_line_of_pytest_is_counted_and_any_other_is_not() {
        let mut counts = Counts::default();
        counts.add_pytest_line("SKIPPED [2] test_readers.py:10: torch is not installed in this environment");
        counts.add_pytest_line("1 failed, 12 passed, 3 skipped, 2 warnings, 1 error in 72.10s (0:01:12)");
        assert_eq!(counts, Counts { passed: 12, failed: 2, skipped: 3 });
        counts.add_pytest_line("===== 4 passed in 0.50s =====");
        assert_eq!(counts.passed, 16);
    }
}
