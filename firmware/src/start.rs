//! How the program was started.

use ommatidia_shared::wire::StartCause;

/// How the program was started.
#[derive(Clone, Copy, Debug)]
pub struct Start {
    /// Why.
    pub cause: StartCause,
    /// Number of starts since the power came on, this one included.
    pub count: u32,
    /// Whether the last starts ended in faults, one after the other.
    pub keeps_faulting: bool,
    /// To be called when a run has ended: earlier faults no longer count.
    pub settled: fn(),
}
