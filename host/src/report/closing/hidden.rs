//! The effect that a demo injected without the knowledge of the search, and whether it was found.

use super::words;
use maud::{Markup, html};
use serde_json::Value;

/// A box with the injected effect and the result. `hidden` is the JSON of `Hidden::outcome`.
pub fn hidden(hidden: &Value) -> Markup {
    let text = |key: &str| hidden[key].as_str().unwrap_or("");
    let name = words::param(text("param"));
    let unit = |u: String| if u.is_empty() { u } else { format!(" {u}") };
    let strength = hidden["strength"].as_f64().map_or(String::new(), words::number);
    html! {
        aside.answer {
            p { b { "A test with a known answer. " } "After its calibration the virtual instrument was changed: "
                b { (words::name(text("id"))) ", " (name) " = " (strength) }
                ". The search had a new session and the old instrument, but not this information. "
                @match (hidden["value"].as_f64(), hidden["sigma"].as_f64()) {
                    (Some(v), Some(s)) => {
                        "It found " b { (name) " = " (words::plus_minus(v, s)) (unit(words::unit(text("unit")))) } "."
                    }
                    _ => {
                        "It did not identify the effect"
                        @if !text("found").is_empty() { " and reported " b { (words::name(text("found"))) } " instead" }
                        @if hidden["among"] == true { "; the true effect is in the list of those that it cannot \
                                                       distinguish from it" }
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
    fn the_box_names_the_effect_whether_it_was_found_or_not() {
        let mut injected = json!({
            "id": "array_shift", "param": "row_px", "strength": 0.25, "value": 0.2512, "sigma": 0.0015, "unit": "px",
        });
        let page = hidden(&injected).into_string();
        assert!(page.contains("array shift, row = 0.25") && page.contains("row = 0.2512 ± 0.0015 px"), "{page}");
        injected["value"] = Value::Null;
        injected["found"] = "defocus".into();
        assert!(
            hidden(&injected).into_string().contains("did not identify the effect and reported <b>defocus</b> instead")
        );
    }
}
