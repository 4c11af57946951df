//! Numbers as people read them.

/// Most decimals that are shown.
const MOST: usize = 15;

/// A value with a fixed number of decimals. A zero has no sign, whatever it was rounded from.
///
/// ```
/// assert_eq!(ommatidia_session::fixed(-0.04, 1), "0.0");
/// ```
pub fn fixed(value: f64, decimals: usize) -> String {
    let text = format!("{value:.decimals$}");
    match text.strip_prefix('-') {
        Some(size) if size.chars().all(|c| matches!(c, '0' | '.')) => size.into(),
        _ => text,
    }
}

/// A value with at most `decimals` decimals; zeros at its end are left out, and so is the sign of a zero.
///
/// ```
/// use ommatidia_session::trimmed;
/// assert_eq!([trimmed(134.39999999999998, 3), trimmed(-0.0, 3), trimmed(20.0, 3)], ["134.4", "0", "20"]);
/// ```
pub fn trimmed(value: f64, decimals: usize) -> String {
    let text = fixed(value, decimals);
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').into() } else { text }
}

/// A value and its standard error, of one unit, with at least `least` decimals, and more where the error would read as
/// zero.
///
/// ```
/// use ommatidia_session::with_error;
/// assert_eq!(with_error(0.404, 0.0084, 3), "0.404 +- 0.008");
/// assert_eq!(with_error(0.00463, 0.00047, 3), "0.0046 +- 0.0005");
/// ```
pub fn with_error(value: f64, sigma: f64, least: usize) -> String {
    let decimals = decimals(sigma, least);
    format!("{} +- {sigma:.decimals$}", fixed(value, decimals))
}

/// As [`with_error`], with a sign in front of positive values, too.
pub fn with_error_signed(value: f64, sigma: f64, least: usize) -> String {
    let plus = if value < 0.0 { "" } else { "+" };
    format!("{plus}{}", with_error(value, sigma, least))
}

/// Decimals that show the first digit of an error.
fn decimals(sigma: f64, least: usize) -> usize {
    let first = -sigma.abs().log10().floor();
    // Of an error of 0, and of one that is no number, nothing more is to be shown.
    if first.is_finite() { (first.max(0.0) as usize).clamp(least, MOST.max(least)) } else { least }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_never_reads_as_zero() {
        for (sigma, least, text) in
            [(0.0004, 3, "1.0000 +- 0.0004"), (0.00099, 2, "1.0000 +- 0.0010"), (3.0, 1, "1.0 +- 3.0")]
        {
            assert_eq!(with_error(1.0, sigma, least), text);
        }
        assert_eq!(with_error(2.0, 0.0, 2), "2.00 +- 0.00");
        assert_eq!(with_error(2.0, f64::NAN, 0), "2 +- NaN");
        assert_eq!(with_error_signed(-0.25, 0.1, 2), "-0.25 +- 0.10");
        assert_eq!(with_error_signed(0.25, 0.1, 1), "+0.2 +- 0.1");
    }

    #[test]
    fn a_zero_has_no_sign() {
        assert_eq!([fixed(-0.0, 0), fixed(-0.4, 0), fixed(-0.6, 0), fixed(-0.004, 2)], ["0", "0", "-1", "0.00"]);
    }
}
