//! The table of mistakes, `docs/mistakes.md`: what somebody does wrong, and what the program then prints.
//!
//! Every row of the page is run. A row holds if the exit code is right, the printed text has the key words that a
//! person needs, and no file that was there before has changed; a command that failed must leave no new file either.
//! The page
//! must show what was printed, apart from the digits of numbers. To write the page again after a change:
//! `OMMATIDIA_RENEW=1 cargo test --release -p ommatidia --test mistakes -- --test-threads 1`.
#![allow(clippy::unwrap_used)]

#[path = "../common/mod.rs"]
mod common;
mod devices;
mod disks;
mod files;
mod frames;
mod intervals;
mod networks;
mod rights;
mod sessions;
mod space;
mod table;
mod views;

use table::{Mistake, hold};
