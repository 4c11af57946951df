//! The program `ommatidia`: the command line, and the link to devices.
//!
//! | module | contents |
//! |---|---|
//! | [`cli`] | one verb a file: parse, call the library, print |
//! | [`device`] | serial link, emulator, flash, live view, frame rates, injected faults |

pub mod cli;
pub mod device;
