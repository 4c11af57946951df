//! Image sensors over `embedded-hal`.

pub mod mt9v032;

pub use mt9v032::{Mt9v032, Window};
