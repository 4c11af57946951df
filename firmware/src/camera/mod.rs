//! Image sensors over `embedded-hal`.

mod fresh;
pub mod mt9v032;

pub use fresh::is_fresh;
pub use mt9v032::{Mt9v032, Window};
