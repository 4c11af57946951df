//! Files in the browser: `ommatidia view`.
//!
//! [`Listing`] finds what the arguments name, [`Site`] answers a browser. A file is opened as a `source`: a
//! description, and pictures that are read one at a time (`stack`, `session`, `tensors`, `pairs`). Two things are
//! computed: the PSFs at a place (`psf`) and reconstructions (`reconstruct`). Colours, their ranges and the style sheet
//! are those of `ommatidia_report`, which also renders what is no picture.

mod facts;
mod listing;
mod pairs;
mod pixels;
mod psf;
mod reconstruct;
mod session;
mod site;
mod source;
mod stack;
mod tensors;

pub use listing::{Entry, Kind, Listing};
pub use site::Site;
