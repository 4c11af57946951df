//! The chapter on a closed loop: residual maps, tests of the residual, effects that were found, upper limits of the
//! others.

mod effects;
mod hidden;
mod lenses;
mod limits;
mod maps;
mod panels;
mod plan;
mod specimens;
mod story;
#[cfg(test)]
mod tests;
mod words;

pub use words::plus_minus;

pub use hidden::hidden;
pub use maps::smoothed;

use super::ReportError;
use super::page::{self, Key, Numbers};
use maud::{Markup, html};
use ommatidia_closing::{Account, Closing, Dependence, JudgedOn, Verdict};
use ommatidia_model::instrument::Instrument;

/// Which verb wrote the account.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Asked {
    /// `residual`: no search for effects; before and after are the same.
    Residual,
    /// `close`: with a search for effects.
    Close,
}

/// The chapter. The instrument gives the places of the lenses, if it is among the inputs.
///
/// # Errors
/// A picture cannot be encoded.
pub fn chapter(
    account: &Account,
    asked: Asked,
    instrument: Option<&Instrument>,
    numbers: &mut Numbers,
) -> Result<Markup, ReportError> {
    let c = &account.closing;
    Ok(html! {
        (story::faults(c))
        (page::keys(&keys(c, asked)))
        (story::story(c, asked))
        (specimens::specimens(account, asked, instrument, numbers)?)
        (maps::maps(account, asked, numbers)?)
        (panels::panels(c, asked, numbers))
        @if asked == Asked::Close { (effects::table(c, instrument, numbers)) (limits::limits(c, numbers)) }
        (plan::plan(c, numbers))
        @if let Some(i) = instrument { (lenses::maps(account, asked, i, numbers)?) }
    })
}

/// The key figures.
fn keys(c: &Closing, asked: Asked) -> Vec<Key> {
    let both = |before: String, after: String| match asked {
        Asked::Close => format!("{before} → {after}"),
        Asked::Residual => before,
    };
    let key = |name: &str, value: String, note: String, holds: Option<bool>| Key {
        name: name.into(),
        value,
        unit: "",
        note,
        holds,
    };
    let (b, a) = (c.before, c.after);
    let mut keys = if c.judged_on == JudgedOn::Nothing {
        let note = "nobody knows the specimen: only what follows the pixel grid was looked for";
        vec![key("χ², NRMSE", "not judged".into(), note.into(), None)]
    } else {
        vec![
            key(
                "χ² per pixel",
                both(format!("{:.3}", b.chi2_ndf), format!("{:.3}", a.chi2_ndf)),
                format!("{}; noise alone: 1", words::held_out(c)),
                None,
            ),
            key(
                "NRMSE",
                format!("{} %", both(format!("{:.2}", 100.0 * b.nrmse), format!("{:.2}", 100.0 * a.nrmse))),
                "of the same data; includes the noise".into(),
                None,
            ),
        ]
    };
    let worst = |all: &[Dependence]| {
        all.iter().min_by(|a, b| words::strongest_first(a, b)).map_or(String::new(), words::evidence)
    };
    if !c.dependences_before.is_empty() {
        keys.push(key(
            "Structure in the residual",
            both(worst(&c.dependences_before), worst(&c.dependences_after)),
            format!("the strongest of {} tests", c.dependences_before.len()),
            None,
        ));
    }
    if asked == Asked::Close {
        let found = story::added(c).count();
        let names: Vec<String> = story::added(c).map(|e| words::name(&e.id)).collect();
        let note = match found {
            0 => format!("of {} tested", c.rejected.len()),
            _ => names.join(", "),
        };
        keys.push(key("Effects found", found.to_string(), note, None));
    }
    let left = story::significant(&c.dependences_after);
    let (verdict, note, holds) = match (c.catalogue_incomplete, asked, left.first()) {
        _ if c.verdict == Verdict::NotThisModel => {
            ("not this one", "most of the residual is left".to_string(), Some(false))
        }
        (true, Asked::Close, _) => {
            ("incomplete", "the residual has structure that no known effect explains".into(), Some(false))
        }
        (true, Asked::Residual, _) => ("incomplete", "the residual has structure: run close".into(), Some(false)),
        // Significant, and smaller than what the search counts as structure.
        (false, _, Some(d)) => {
            let (what, z) = (d.covariate.words(), words::evidence(d));
            ("nearly complete", format!("a trace of structure is left: {what}, {z}"), None)
        }
        (false, _, None) => ("complete", "no test finds structure in the residual".into(), Some(true)),
    };
    keys.push(key("The model", verdict.into(), note, holds));
    keys
}
