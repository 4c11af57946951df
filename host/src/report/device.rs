//! Figures of `device run`, and the sizes of a network file.

use super::page::{Key, Numbers, pairs};
use super::scenes::bytes;
use super::training::{sentence, short};
use maud::{Markup, html};
use ommatidia_shared::blob::Header;
use serde_json::Value;

/// The table of what `device run` printed with `--json`.
pub fn device(json: &Value, numbers: &mut Numbers) -> Markup {
    let mut rows: Vec<(String, Markup)> = Vec::new();
    if let Some(board) = json["board"].as_str() {
        rows.push(("Board".into(), html! { (board) }));
    }
    if let Some(exact) = json["bit_exact"].as_bool() {
        rows.push(("Outputs equal to the host’s, bit for bit".into(), html! { (if exact { "yes" } else { "no" }) }));
    }
    if let Some(n) = json["instructions"].as_u64() {
        rows.push(("Instructions per frame".into(), html! { (grouped(n)) }));
    }
    for (key, name) in [("ram_bytes", "RAM"), ("flash_bytes", "Flash"), ("stack_bytes", "Stack")] {
        if let Some(n) = json[key].as_u64() {
            rows.push((name.into(), html! { (bytes(n)) }));
        }
    }
    let known = ["board", "bit_exact", "instructions", "ram_bytes", "flash_bytes", "stack_bytes"];
    let simple = |v: &Value| !v.is_null() && !v.is_array() && !v.is_object();
    let others = json.as_object().into_iter().flatten().filter(|(k, v)| !known.contains(&k.as_str()) && simple(v));
    for (key, value) in others {
        rows.push(match (key.strip_suffix("_bytes"), value.as_u64()) {
            (Some(what), Some(n)) => (sentence(what), html! { (bytes(n)) }),
            _ => (sentence(key), html! { (short(value)) }),
        });
    }
    let table = numbers.table(
        "Firmware.",
        "Figures of a run of the firmware, as the device and its host reported \
        them.",
        pairs(&rows),
    );
    html! { div { (table) } }
}

/// The table of a network file: its sizes and the memory that it needs on a device.
pub fn blob(header: &Header, file_bytes: u64, numbers: &mut Numbers) -> Markup {
    let (bank, rcan) = (&header.bank, &header.rcan);
    let rows = [
        ("File".to_string(), html! { (bytes(file_bytes)) }),
        ("Raw frame".into(), html! { (header.frame.rows) " × " (header.frame.cols) }),
        ("Reconstruction".into(), html! { (header.object.rows) " × " (header.object.cols) }),
        (
            "Filter bank".into(),
            match bank.blocks {
                None => {
                    html! { (bank.channels) " filters, " (bank.taps.len()) " blocks of " (bank.tile) " × " (bank.tile) }
                }
                Some(blocks) => html! {
                    (bank.channels) " filters of " (bank.tile) " × " (bank.tile) ", pruned to "
                    (blocks.count) " blocks of " (blocks.side) " × " (blocks.side)
                },
            },
        ),
        ("Enhancement".into(), html! { (rcan.width) " features, " (rcan.groups) " × " (rcan.blocks) " blocks" }),
        ("Fast memory".into(), html! { (bytes(u64::from(header.memory.fast_bytes))) }),
        ("Bulk memory".into(), html! { (bytes(u64::from(header.memory.bulk_bytes))) }),
    ];
    let text = format!(
        "Network “{}”, made from checkpoint {}. Weights are stored in half precision.",
        header.name, header.checkpoint
    );
    html! { div { (numbers.table("Network file.", &text, pairs(&rows))) } }
}

/// Key figures of a run.
pub fn keys(json: &Value) -> Vec<Key> {
    let mut keys = Vec::new();
    if let Some(exact) = json["bit_exact"].as_bool() {
        let differ = json["differing_bits"].as_u64().map(grouped);
        let value = differ.unwrap_or_else(|| if exact { "0".into() } else { "some".into() });
        let note = json["board"].as_str().unwrap_or("").to_string();
        keys.push(Key {
            name: "Bits that differ between device and host".into(),
            value,
            unit: "",
            note,
            holds: Some(exact),
        });
    }
    if let Some(n) = json["instructions"].as_u64() {
        let value = super::picture::number(n as f64 / 1e6);
        keys.push(Key { name: "Instructions per frame".into(), value, unit: "million", ..Key::default() });
    }
    if let (Some(ram), Some(flash)) = (json["ram_bytes"].as_u64(), json["flash_bytes"].as_u64()) {
        let note = format!("flash {}", bytes(flash));
        keys.push(Key { name: "Memory of the device".into(), value: bytes(ram), note, ..Key::default() });
    }
    keys
}

/// An integer in groups of three digits.
fn grouped(n: u64) -> String {
    let digits = n.to_string();
    let groups: Vec<&[u8]> = digits.as_bytes().rchunks(3).rev().collect();
    groups.iter().map(|g| String::from_utf8_lossy(g)).collect::<Vec<_>>().join("\u{202f}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn digits_stand_in_groups() {
        assert_eq!([1, 1234, 12_345_678].map(grouped), ["1", "1\u{202f}234", "12\u{202f}345\u{202f}678"]);
    }

    #[test]
    fn a_run_that_is_not_exact_is_shown_as_failed() {
        let keys = keys(&serde_json::json!({"bit_exact": false, "board": "mps2-an500"}));
        assert!(keys[0].holds == Some(false) && keys[0].value == "some");
    }
}
