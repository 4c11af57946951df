//! Log lines over a debug probe, with the feature `probe`; nothing without it.

/// Logs a line by `defmt`'s rules.
#[cfg(feature = "probe")]
macro_rules! info {
    ($($argument:tt)*) => { defmt::info!($($argument)*) };
}

/// Does nothing: without a probe there is no log.
#[cfg(not(feature = "probe"))]
macro_rules! info {
    ($($argument:tt)*) => {};
}

pub(crate) use info;
