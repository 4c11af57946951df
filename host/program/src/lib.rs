//! The program `ommatidia`: the command line, and the link to devices.
//!
//! | module | contents |
//! |---|---|
//! | [`cli`] | one verb a file: parse, call the library, print |
//! | [`http`] | a small web server for browsers of this computer |
//! | [`view`] | files in the browser: pictures, instruments, residuals, data sets, reconstructions |
//! | [`device`] | serial link, emulator, flash, live view, frame rates, injected faults |

pub mod cli;
pub mod device;
pub mod http;
pub mod view;
