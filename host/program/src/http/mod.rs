//! A small web server for the pages of this program, which only browsers of this computer reach.
//!
//! Pages are read, never changed: the only methods are GET and HEAD, and no request has a body. [`Request`] is what a
//! browser asks for, [`Answer`] what it gets, [`serve`] listens. A request is refused unless it comes over a loopback
//! address and names this computer as its host: so no page of another site can read these pages by a name of its own
//! that leads here.

mod answer;
mod request;
mod server;

pub use answer::{Answer, Status};
pub use request::Request;
pub use server::serve;
