//! A study of how far `close` can be trusted: many sessions of the virtual instrument with undeclared effects are
//! closed, and the found effects are compared with the injected ones.
//!
//! [`plan`] lists the cases and [`shard`] divides them among computers; [`instruments`] says which instruments there
//! are, of families whose optics share nothing, and [`sealed`] counts how often those are looked at that no threshold
//! is set on. [`subject`] is one instrument under study, [`sensitivity`] how well its sessions determine each effect,
//! and [`ranges`] how strong an effect can be; [`sessions`] are the kinds of sessions. [`trial`] runs a case;
//! [`record`] stores its outcome, one line per session, so that an interrupted study resumes; [`summary`] computes the
//! figures with [`intervals`] and [`ranks`], and [`text`] and
//! [`unknown`] render the page. [`downstream`] measures the effect on
//! reconstructions, with the [`networks`] that the program brings. [`foreign`] holds effects outside the catalogue.
//!
//! ```
//! use ommatidia_closing::study::{plan::cases, size::{Question, Size}};
//! use ommatidia_closing::study::sensitivity::{Sensitivities, Sensitivity};
//!
//! // Sessions that determine the strength of vignetting to 0.001.
//! let sensitivity = Sensitivity { param: "v".into(), unit: "1".into(), sigma: 0.001 };
//! let known = Sensitivities { of: [("vignetting".to_string(), sensitivity)].into(), ..Sensitivities::default() };
//!
//! let questions = vec![Question::Null, Question::Single];
//! let size = Size { instruments: 1, nulls: 2, strengths: vec![10.0], questions, ..Size::default() };
//! let cases = cases(&size, &[Some(known)]);
//! assert_eq!(cases.len(), 3);
//! let single = cases.iter().find(|case| case.question == Question::Single).unwrap();
//! assert_eq!(single.key, "single/vignetting/10/0/0");
//! assert!((single.injected[0].value - 0.01).abs() < 1e-12);
//! ```

pub mod downstream;
pub mod foreign;
pub mod instruments;
pub mod intervals;
pub mod networks;
pub mod plan;
pub mod ranges;
pub mod ranks;
pub mod record;
pub mod run;
pub mod sealed;
pub mod sensitivity;
pub mod sessions;
pub mod shard;
pub mod size;
pub mod subject;
pub mod summary;
pub mod text;
pub mod trial;
pub mod unknown;

#[cfg(test)]
mod tests;
