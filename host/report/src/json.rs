//! What JSON is: figures that a verb printed, or a file that the program keeps beside others.

use serde_json::Value;

/// Fields by which JSON without the name of a verb is recognised, and what it is.
const KNOWN: [(&[&str], &str); 14] = [
    (&["error"], "the error of a command"),
    (&["bit_exact"], "figures of `device run`"),
    (&["hidden"], "the effect that `demo` hid"),
    (&["resolution"], "figures of `resolution`"),
    (&["ablation"], "figures of `ablate`"),
    (&["entrants", "bouts"], "figures of `arena`"),
    (&["source", "role", "max_dn"], "what `import` found in each recording"),
    (&["count", "shard_pairs", "provenance"], "the plan of a data set of `simulate`"),
    (&["axes_um", "unit_e", "config"], "what a session of `bench` truly is"),
    (&["method", "sums", "part"], "the plan of a reconstruction in parts"),
    (&["planned", "summary", "sessions"], "figures of `study`"),
    (&["opening", "nulls", "strengths"], "the size of a study"),
    (&["of", "cannot", "of_kinds"], "sensitivities of a study"),
    (&["opened", "programs"], "how often the sealed seeds of `study` were opened"),
];

/// What JSON of this program is; None: it is of another one. A list is what its first entry is.
///
/// ```
/// let figures = serde_json::json!({ "verb": "calibrate", "rank": 9 });
/// assert_eq!(ommatidia_report::json_name(&figures).as_deref(), Some("figures of `calibrate`"));
/// ```
pub fn json_name(json: &Value) -> Option<String> {
    let first = json.as_array().map_or(Some(json), |all| all.first())?;
    if let Some(verb) = first["verb"].as_str() {
        return Some(format!("figures of `{verb}`"));
    }
    let has = |fields: &&[&str]| fields.iter().all(|name| first.get(name).is_some());
    KNOWN.iter().find(|(fields, _)| has(fields)).map(|(_, name)| name.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn json_of_this_program_is_named_and_other_json_is_not() {
        let found = json!([{ "source": "a", "role": "scene", "max_dn": 7.0 }]);
        assert!(json_name(&found).is_some_and(|name| name.contains("`import`")));
        assert!(json_name(&json!({ "error": { "message": "x" } })).is_some_and(|name| name.contains("error")));
        for other in [json!({ "a": 1 }), json!([]), json!([1, 2]), json!(3)] {
            assert_eq!(json_name(&other), None);
        }
    }
}
