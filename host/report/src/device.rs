//! Figures of `device run`, and the sizes of a network file.

use super::page::{Key, Numbers, pairs};
use super::scenes::{bytes, seconds};
use maud::{Markup, html};
use ommatidia_shared::blob::{FeatureBits, Header, Integers};
use serde_json::Value;

/// The table of what `device run` printed with `--json`.
pub fn device(json: &Value, numbers: &mut Numbers) -> Markup {
    let mut rows: Vec<(String, Markup)> = Vec::new();
    let here = on_host(json);
    let board = match (json["board"].as_str(), json["emulator"].as_str()) {
        _ if here => "not run on a device: the firmware’s logic ran on the computer".to_string(),
        (Some(board), Some(emulator)) => format!("{board}, emulated by {emulator}"),
        (board, _) => board.unwrap_or("–").into(),
    };
    rows.push(("Board".into(), html! { (board) }));
    if let (Some(exact), false) = (json["bit_exact"].as_bool(), here) {
        rows.push(("Outputs equal to the host’s, bit for bit".into(), html! { (if exact { "yes" } else { "no" }) }));
    }
    match (json["instructions"].as_u64(), json["uncounted"].as_str()) {
        (Some(n), _) => rows.push(("Instructions per frame".into(), html! { (grouped(n)) })),
        (None, Some(why)) => rows.push(("Instructions per frame".into(), html! { "not counted: " (why) })),
        _ => {}
    }
    // Of a run on the host, memory and line are those of the computer.
    let of_any = ["frames", "held", "blob_bytes", "frame_bytes", "object_bytes"];
    for (key, name) in NAMES.into_iter().filter(|(key, _)| !here || of_any.contains(key)) {
        let value = &json[key];
        rows.extend(match (value.as_u64(), value.as_f64()) {
            (Some(n), _) if key.ends_with("_bytes") => Some((name.to_string(), html! { (bytes(n)) })),
            (Some(n), _) => Some((name.into(), html! { (grouped(n)) })),
            (_, Some(s)) if key.contains("seconds") => Some((name.into(), html! { (seconds(s)) })),
            _ => None,
        });
    }
    if let (Some(mean), Some(worst)) = (json["held_psnr_db"]["mean"].as_f64(), json["held_psnr_db"]["worst"].as_f64()) {
        let text = format!("{mean:.1} dB, at worst {worst:.1} dB");
        rows.push(("PSNR of approximate against exact frames".into(), html! { (text) }));
    }
    let (title, text) = match here {
        true => (
            "Not run on a device.",
            "The firmware’s logic ran on the computer that also made the reference: that their bits agree says nothing \
             about a device.",
        ),
        false => ("Firmware.", "Figures of a run of the firmware, as the device and its host reported them."),
    };
    html! { div { (numbers.table(title, text, pairs(&rows))) } }
}

/// What `device run` prints, and what the table calls it.
const NAMES: [(&str, &str); 18] = [
    ("held_instructions", "Instructions per frame with the field held"),
    ("frames", "Frames"),
    ("held", "Frames with the field held"),
    ("ram_bytes", "Memory in use"),
    ("flash_bytes", "Flash in use"),
    ("image_bytes", "Program"),
    ("blob_bytes", "Network file"),
    ("static_bytes", "Variables"),
    ("stack_bytes", "Deepest stack"),
    ("fast_bytes", "Fast memory used, of all that the board has"),
    ("bulk_bytes", "Bulk memory used"),
    ("frame_bytes", "Raw frame"),
    ("object_bytes", "Reconstruction"),
    ("differing_bits", "Bits that differ"),
    ("repeated_requests", "Requests repeated on the line"),
    ("dropped_packets", "Packets dropped on the line"),
    ("upload_seconds", "Time of the upload"),
    ("seconds_per_frame", "Time per frame, transfers included"),
];

/// Whether no device took part. Earlier versions have only the board's name, `host`.
pub fn on_host(json: &Value) -> bool {
    json["ran_on"].as_str().or(json["board"].as_str()) == Some("host")
}

/// The table of a network file: its sizes and the memory that it needs on a device.
pub fn blob(header: &Header, file_bytes: u64, numbers: &mut Numbers) -> Markup {
    let (bank, rcan) = (&header.bank, &header.rcan);
    let passes = header.passes.as_ref();
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
        (
            "Passes".into(),
            match passes {
                None => html! { "1" },
                Some(p) => html! {
                    (p.later + 1) "; frames are predicted with " (p.terms) " terms of " (p.corners.len()) " lenses, "
                    (p.window) " × " (p.window) " pixels each"
                },
            },
        ),
        (
            "Convolutions of the enhancement".into(),
            match header.integers {
                None => html! { "half precision" },
                Some(Integers { features: FeatureBits::Sixteen, .. }) => {
                    html! { "integers: weights of 8 bits, features of 16" }
                }
                Some(Integers { features: FeatureBits::Eight, .. }) => {
                    html! { "integers: weights and features of 8 bits" }
                }
            },
        ),
        ("Fast memory needed at least".into(), html! { (bytes(u64::from(header.memory.fast_bytes))) }),
        ("Bulk memory needed".into(), html! { (bytes(u64::from(header.memory.bulk_bytes))) }),
    ];
    let text = format!(
        "Network “{}”, made from checkpoint {}. {} With more fast memory than it \
         needs at least, a board runs it faster.",
        header.name,
        header.checkpoint,
        match header.integers {
            None => "Weights are stored in half precision.",
            Some(_) => "Filters and channel attention are stored in half precision.",
        }
    );
    html! { div { (numbers.table("Network file.", &text, pairs(&rows))) } }
}

/// Key figures of a run.
pub fn keys(json: &Value) -> Vec<Key> {
    let mut keys = Vec::new();
    if on_host(json) {
        let (value, note) = ("not run".to_string(), "the firmware’s logic ran on the computer".to_string());
        keys.push(Key { name: "On a device".into(), value, note, ..Key::default() });
        return keys;
    }
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

    #[test]
    fn a_run_on_the_host_is_no_run_on_a_device() {
        let run = |place| serde_json::json!({"bit_exact": true, "differing_bits": 0, "board": "host", "ran_on": place});
        for json in [run("host".into()), run(Value::Null)] {
            let keys = keys(&json);
            assert!(keys.len() == 1 && keys[0].value == "not run" && keys[0].holds.is_none());
            let table = device(&json, &mut Numbers::default()).into_string();
            assert!(table.contains("Not run on a device.") && !table.contains("bit for bit"), "{table}");
            assert!(!table.contains("Bits that differ"), "{table}");
        }
        // A board may have any name.
        assert_eq!(keys(&run("board".into()))[0].holds, Some(true));
    }

    #[test]
    fn every_row_has_a_name_for_readers() {
        let json = serde_json::json!({"bit_exact": true, "board": "mps2-an500", "ran_on": "emulator", "emulator":
            "QEMU 10.0.2", "fast_bytes": 262_144, "seconds_per_frame": 1.04, "field_ages": [0, 0], "uncounted":
            "QEMU 10.0.2 counts no instructions: no plugins"});
        let table = device(&json, &mut Numbers::default()).into_string();
        for text in ["mps2-an500, emulated by QEMU 10.0.2", "Fast memory used", "256 KiB", "1.04 s", "not counted: "] {
            assert!(table.contains(text), "{text}: {table}");
        }
        assert!(!table.contains('_'), "{table}");
    }
}
