//! Instruments and sessions for the tests of all packages. None of it is used by the program.

mod instrument;
mod square_array;
mod testbed;

pub use instrument::{instrument, smooth};
pub use square_array::square_array;
pub use testbed::Testbed;
