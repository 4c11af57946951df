//! Errors of optical configurations.

use thiserror::Error;

/// A number of an optical configuration is impossible.
#[derive(Clone, Debug, PartialEq, Error)]
#[error("{field}: expected {expected}, found {found}; correct the configuration")]
pub struct OpticsError {
    /// The field.
    pub field: &'static str,
    /// What was expected.
    pub expected: String,
    /// What was found.
    pub found: f64,
}

impl OpticsError {
    /// Rejects a number that is not finite and above zero.
    pub(super) fn unless_positive(field: &'static str, value: f64) -> Result<(), Self> {
        if value.is_finite() && value > 0.0 {
            return Ok(());
        }
        Err(Self { field, expected: "a number above zero".into(), found: value })
    }
}
