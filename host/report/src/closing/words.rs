//! Names, numbers and units for readers.

use super::super::picture::raised;
use ommatidia_closing::{Closing, Dependence, JudgedOn};

/// Name of an effect from its id.
pub fn name(id: &str) -> String {
    let word = |w| match w {
        "prnu" => "PRNU",
        "dsnu" => "DSNU",
        "adc" => "ADC",
        w => w,
    };
    id.split('_').map(word).collect::<Vec<_>>().join(" ")
}

/// Name of a parameter, without the unit, which follows its value.
pub fn param(name: &str) -> String {
    let units = ["px", "px2", "um", "dn", "e", "s", "ms", "mrad"];
    let words: Vec<&str> = name.split('_').collect();
    let kept = words.iter().enumerate().filter(|(i, w)| *i == 0 || words[i - 1] == "per" || !units.contains(*w));
    kept.map(|(_, w)| *w).collect::<Vec<_>>().join(" ")
}

/// Significance.
pub fn sigma(z: f64) -> String {
    match z.abs() {
        a if a >= 100.0 => format!("{z:.0}\u{a0}σ"),
        _ => format!("{:.1}\u{a0}σ", z + 0.0),
    }
}

/// Significance of a test; a lower limit beyond about 36 standard deviations, where the probability underflows.
pub fn evidence(d: &Dependence) -> String {
    if d.p < 1e-280 { format!(">\u{a0}{:.0}\u{a0}σ", d.z.floor()) } else { sigma(d.z) }
}

/// Order of tests: most significant first; equal ones by the range of the residual over the covariate.
pub fn strongest_first(a: &Dependence, b: &Dependence) -> std::cmp::Ordering {
    let spread = |d: &Dependence| {
        let ends = d.mean.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |r, m| (r.0.min(*m), r.1.max(*m)));
        (ends.1 - ends.0).max(0.0)
    };
    b.z.total_cmp(&a.z).then(spread(b).total_cmp(&spread(a)))
}

/// A unit for readers; empty for "1".
pub fn unit(unit: &str) -> String {
    match unit {
        "1" => String::new(),
        u => u.replace("^2", "²").replace("^-2", "⁻²").replace("um", "µm").replace("e-", "e⁻"),
    }
}

/// A value and its error, both to the second significant digit of the error.
pub fn plus_minus(value: f64, error: f64) -> String {
    if !(error > 0.0 && error.is_finite() && value.is_finite()) {
        return super::super::picture::number(value);
    }
    let size = value.abs().max(error).log10().floor() as i32;
    let power = if (-3..5).contains(&size) { 0 } else { size };
    let scale = 10f64.powi(power);
    let decimals = (1 - (error / scale).log10().floor() as i32).clamp(0, 7) as usize;
    let (v, e) = (value / scale, error / scale);
    let text = match power {
        0 => format!("{v:.decimals$} ± {e:.decimals$}"),
        _ => format!("({v:.decimals$} ± {e:.decimals$}) × 10{}", raised(power)),
    };
    text.replace('-', "−")
}

/// A number, with a power of ten if it is very large or small.
pub fn number(value: f64) -> String {
    let size = value.abs().log10().floor();
    if value == 0.0 || (-3.0..5.0).contains(&size) || !size.is_finite() {
        return super::super::picture::number(value);
    }
    format!("{:.1} × 10{}", value / 10f64.powf(size), raised(size as i32))
}

/// A list in a sentence: "a, b and c".
pub fn list(items: &[String], last: &str) -> String {
    match items {
        [] => String::new(),
        [one] => one.clone(),
        [first @ .., end] => format!("{} {last} {end}", first.join(", ")),
    }
}

/// Squared correlation from which two signatures are similar.
pub const ALIKE: f64 = 0.5;

/// The data that the figures are computed from.
pub fn held_out(c: &Closing) -> String {
    match (c.held_out_frames.len(), c.held_out_blocks) {
        (n, _) if c.judged_on == JudgedOn::Even && n > 0 => format!("{n} held-out flats and darks"),
        (_, [n, of]) if c.judged_on == JudgedOn::SelfConsistency => {
            format!("{n} of {of} blocks of each frame, which the specimen as the other blocks show it predicts")
        }
        (n, _) if c.own_beads => format!("{n} bead frames that the calibration has read"),
        (1, _) => "1 held-out frame".into(),
        (n, _) if n > 1 => format!("{n} held-out frames"),
        (_, [n, of]) => format!("{n} of {of} blocks held out"),
    }
}

/// The text with a capital first letter.
pub fn capital(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or(String::new(), |first| first.to_uppercase().chain(letters).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_have_two_figures() {
        assert_eq!(plus_minus(0.40213, 0.00432), "0.4021 ± 0.0043");
        assert_eq!(plus_minus(-12.3, 0.96), "−12.30 ± 0.96");
        assert_eq!(plus_minus(2.0e-5, 3.0e-6), "(2.00 ± 0.30) × 10⁻⁵");
        assert_eq!(plus_minus(123_456.0, 2345.0), "(1.235 ± 0.023) × 10⁵");
        assert_eq!(plus_minus(3.0, 0.0), "3");
        assert_eq!((number(2.5e-12).as_str(), number(0.5).as_str()), ("2.5 × 10⁻¹²", "0.5"));
    }

    #[test]
    fn sentences_list_what_they_hold() {
        let of = |n: &[&str]| list(&n.iter().map(|s| (*s).to_string()).collect::<Vec<_>>(), "and");
        assert_eq!([of(&[]), of(&["a"]), of(&["a", "b", "c"])], ["", "a", "a, b and c"]);
        assert_eq!(["sigma_px", "row_px_3", "rate_per_s", "dn"].map(param), ["sigma", "row 3", "rate per s", "dn"]);
        assert_eq!(
            (name("charge_diffusion"), unit("1"), unit("px^2")),
            ("charge diffusion".into(), String::new(), "px²".into())
        );
    }
}
