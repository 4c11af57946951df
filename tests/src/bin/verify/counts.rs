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
}
