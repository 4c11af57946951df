//! What a demo hid from the loop, and whether it was found.

use super::words;
use maud::{Markup, html};
use serde_json::Value;

/// A box that gives the answer away.
pub fn hidden(told: &Value) -> Markup {
    let text = |key: &str| told[key].as_str().unwrap_or("");
    let name = words::param(text("param"));
    let unit = |u: String| if u.is_empty() { u } else { format!(" {u}") };
    let strength = told["strength"].as_f64().map_or(String::new(), words::number);
    html! {
        aside.told {
            p { b { "A test with a known answer. " } "After its calibration the virtual instrument was changed: "
                b { (words::name(text("id"))) ", " (name) " = " (strength) } ". The loop was given a new session and the old instrument, and was not told. "
                @match (told["value"].as_f64(), told["sigma"].as_f64()) {
                    (Some(v), Some(s)) => { "It found " b { (name) " = " (words::plus_minus(v, s)) (unit(words::unit(text("unit")))) } "." }
                    _ => {
                        "It did not name it"
                        @if !text("found").is_empty() { ", and took " b { (words::name(text("found"))) } " for it" }
                        @if told["among"] == true { "; the true one is among those that it says it cannot rule out" }
                        "."
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn the_answer_is_given_away_whether_found_or_not() {
        let mut told = json!({ "id": "array_shift", "param": "row_px", "strength": 0.25, "value": 0.2512, "sigma": 0.0015, "unit": "px" });
        let page = hidden(&told).into_string();
        assert!(page.contains("array shift, row = 0.25") && page.contains("row = 0.2512 ± 0.0015 px"), "{page}");
        told["value"] = Value::Null;
        told["found"] = "defocus".into();
        assert!(hidden(&told).into_string().contains("did not name it, and took <b>defocus</b>"));
    }
}
