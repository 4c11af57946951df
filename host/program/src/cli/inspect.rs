//! `inspect`: describes a file.

use super::common::{Outcome, Run};
use anyhow::{Context, bail};
use ommatidia_closing::{self, Closing, Dependence, Effect};
use ommatidia_model::dataset::{DataSetPlan, PLAN_FILE};
use ommatidia_session::artifact;
use ommatidia_session::import::{set_interval_s, times_of};
use ommatidia_session::kind::FileKind;
use ommatidia_session::stack::folder_of_recording;
use ommatidia_session::{FrameReader, Session, with_error};
use ommatidia_shared::blob::Network;
use serde_json::{Value, json};
use std::fmt::Write;
use std::path::{Path, PathBuf};

/// Options of `inspect`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Instrument, checkpoint, evaluation, account of a closed loop, widths, network file, session folder, data-set
    /// folder, stack of frames, or JSON that a command printed
    artifact: PathBuf,
}

/// Runs the verb.
///
/// # Errors
/// The file cannot be read, is damaged or of no known kind.
pub fn run(args: &Args, _run: &Run) -> anyhow::Result<Outcome> {
    let path = &args.artifact;
    let json = match FileKind::of(path)? {
        FileKind::Artifact(_) => of_artifact(path)?,
        FileKind::Blob => of_blob(path)?,
        FileKind::Session => of_session(path)?,
        FileKind::Stack => of_stack(path)?,
        FileKind::Json => {
            let text = std::fs::read(path).with_context(|| path.display().to_string())?;
            let figures: Value = serde_json::from_slice(&text)
                .with_context(|| format!("{}: begins as JSON, but is damaged or cut short", path.display()))?;
            let what = ommatidia_report::json_name(&figures).unwrap_or_else(|| "JSON of an unknown kind".into());
            json!({ "kind": "json", "what": what, "figures": figures })
        }
        FileKind::Folder if path.join(PLAN_FILE).exists() => of_data_set(path)?,
        FileKind::Folder if folder_of_recording(path).is_some() || FrameReader::open(path).is_ok() => of_stack(path)?,
        found @ (FileKind::Folder
        | FileKind::Manifest
        | FileKind::Page
        | FileKind::Picture
        | FileKind::Tensors
        | FileKind::Unknown) => {
            bail!(
                "{}: expected an artifact, a network file, a session, a data set, a stack or JSON, found {found}{}",
                path.display(),
                found.advice()
            )
        }
    };
    let mut text = format!("{}\n", path.display());
    // The body of an account is long: the text shows a summary, the JSON all of it.
    let mut shown = json.clone();
    if json["kind"] == ommatidia_closing::account::KIND
        && let Some(fields) = shown.as_object_mut()
    {
        let closing: Closing = serde_json::from_value(json["body"]["closing"].clone())
            .with_context(|| format!("{}: the account is damaged", path.display()))?;
        fields.insert("body".into(), summary(&closing));
    }
    // Figures may be long: what they are stands first.
    if let Some(fields) = shown.as_object_mut().filter(|fields| fields.get("kind").is_some_and(|kind| kind == "json")) {
        for name in ["kind", "what"] {
            entry(&mut text, name, &fields.remove(name).unwrap_or_default(), 1);
        }
    }
    list(&mut text, &shown, 1);
    Ok(Outcome { json, text })
}

/// The main figures of an account.
fn summary(c: &Closing) -> Value {
    let effect = |e: &Effect| {
        let most = e.params.iter().filter(|v| v.sigma > 0.0).max_by(|a, b| {
            let stands_out = |v: &ommatidia_closing::Value| (v.value / v.sigma).abs();
            stands_out(a).total_cmp(&stands_out(b))
        });
        let value =
            most.map_or(String::new(), |v| format!(", {} = {} {}", v.name, with_error(v.value, v.sigma, 4), v.unit));
        format!("{} ({:.1} sigma){}", e.id, e.z, value.trim_end_matches(" 1"))
    };
    let strongest = |all: &[Dependence]| {
        let most = all.iter().map(|d| d.z).fold(0.0, f64::max);
        let strong = all.iter().filter(|d| d.z > 4.0).count();
        format!("{most:.1} sigma at most, {strong} of {} covariates beyond 4", all.len())
    };
    let both = |before: f64, after: f64| match (before.is_finite(), after.is_finite()) {
        (true, true) => format!("{before:.4} -> {after:.4}"),
        _ => "not judged: no frame shows light that is known".into(),
    };
    let mut figures = json!({
        "session": c.session,
        "chi2 / pixel": both(c.before.chi2_ndf, c.after.chi2_ndf),
        "NRMSE": both(c.before.nrmse, c.after.nrmse),
        "held-out frames": c.held_out_frames,
        "structure before": strongest(&c.dependences_before),
        "structure after": strongest(&c.dependences_after),
        "effects": c.effects.len(),
        "not found": c.rejected.len(),
        "verdict": c.verdict.words(),
        "nearest, not the cause": c.nearest.iter().map(|n| n.id.as_str()).collect::<Vec<_>>().join(", "),
        "catalogue incomplete": c.catalogue_incomplete,
        "faults of the record": c.faults.len(),
    });
    for (i, e) in c.effects.iter().enumerate() {
        figures[format!("effect {}", i + 1)] = effect(e).into();
    }
    figures
}

fn of_artifact(path: &Path) -> anyhow::Result<Value> {
    let header = artifact::inspect(path)?;
    let tensors: Vec<Value> =
        artifact::shapes(path)?.into_iter().map(|(name, shape)| json!({ "name": name, "shape": shape })).collect();
    let bytes = std::fs::metadata(path).map(|m| m.len()).unwrap_or(0);
    Ok(json!({
        "kind": header["kind"], "version": header["version"], "bytes": bytes, "provenance": header["provenance"],
        "body": header["body"], "tensors": tensors,
    }))
}

fn of_blob(path: &Path) -> anyhow::Result<Value> {
    let bytes = std::fs::read(path).with_context(|| path.display().to_string())?;
    let network = Network::decode(&bytes)
        .map_err(|e| anyhow::anyhow!("{}: {e}; quantize the checkpoint again", path.display()))?;
    let header = serde_json::to_value(network.header())?;
    Ok(json!({
        "kind": "blob", "version": u16::from_le_bytes([bytes[8], bytes[9]]), "bytes": bytes.len(), "header": header,
        "memory": { "fast": ommatidia_report::bytes(network.header().memory.fast_bytes.into()), "bulk":
            ommatidia_report::bytes(network.header().memory.bulk_bytes.into()) },
    }))
}

fn of_session(path: &Path) -> anyhow::Result<Value> {
    let session = Session::open(path)?;
    let manifest = serde_json::to_value(session.manifest())?;
    let frames =
        session.stacks().iter().map(|s| json!({ "role": s.entry().role, "file": s.entry().file, "frames": s.len() }));
    Ok(json!({ "kind": "session", "manifest": manifest, "stacks": frames.collect::<Vec<_>>() }))
}

fn of_data_set(path: &Path) -> anyhow::Result<Value> {
    let plan = serde_json::to_value(DataSetPlan::read(path)?)?;
    let entries = std::fs::read_dir(path).with_context(|| path.display().to_string())?;
    let names = entries.flatten().map(|entry| entry.file_name().to_string_lossy().into_owned());
    let shards = names.filter(|name| name.starts_with("shard-") && name.ends_with(".safetensors")).count();
    Ok(json!({ "kind": "dataset", "plan": plan, "shards": shards }))
}

fn of_stack(path: &Path) -> anyhow::Result<Value> {
    let reader = FrameReader::open(path)?;
    let scale = reader.scale();
    // The heads of files may state another rate than that of the recording.
    let by_times = times_of(&reader).ok().flatten().and_then(|times| times.interval_s);
    let interval_s = by_times.map_or_else(|| set_interval_s(&reader), |s| Ok(Some(s)))?;
    Ok(json!({
        "kind": "stack", "frames": reader.len(), "rows": reader.rows(), "cols": reader.cols(),
        "samples": reader.samples().name(),
        // As files and timestamps say; null where they do not.
        "pixel_um": scale.pixel_um, "interval_s": interval_s,
    }))
}

/// Values of more than this many characters are cut short in the text; `--json` holds them whole.
const WIDTH: usize = 96;
/// So are lists of more than this many entries.
const MOST: usize = 40;

/// The fields of a JSON value as an indented list.
fn list(text: &mut String, value: &Value, depth: usize) {
    for (name, value) in value.as_object().into_iter().flatten() {
        entry(text, name, value, depth);
    }
}

/// A JSON value with its name: objects one field a line, objects in lists on a line each where they fit on one.
fn entry(text: &mut String, name: &str, value: &Value, depth: usize) {
    let indent = 2 * depth;
    // Writing to a string cannot fail.
    let _ = match value {
        Value::Object(fields) if !fields.is_empty() => {
            let _ = writeln!(text, "{:indent$}{name}:", "");
            list(text, value, depth + 1);
            Ok(())
        }
        Value::Array(items) if items.iter().any(Value::is_object) => {
            let _ = writeln!(text, "{:indent$}{name}: {}", "", items.len());
            for (i, item) in items.iter().take(MOST).enumerate() {
                match line(item) {
                    whole if whole.chars().count() > WIDTH => entry(text, &i.to_string(), item, depth + 1),
                    whole => drop(writeln!(text, "{:indent$}  {whole}", "")),
                }
            }
            let more = items.len().saturating_sub(MOST);
            if more > 0 { writeln!(text, "{:indent$}  and {more} more", "") } else { Ok(()) }
        }
        other => writeln!(text, "{:indent$}{name}: {}", "", short(&line(other))),
    };
}

/// A value on one line, without the quotes of JSON.
fn line(value: &Value) -> String {
    match value {
        Value::String(s) => s.clone(),
        Value::Null => "-".into(),
        Value::Array(items) => format!("[{}]", items.iter().map(line).collect::<Vec<_>>().join(", ")),
        Value::Object(fields) => {
            fields.iter().map(|(name, value)| format!("{name} {}", line(value))).collect::<Vec<_>>().join(", ")
        }
        other => other.to_string(),
    }
}

fn short(line: &str) -> String {
    match line.char_indices().nth(WIDTH) {
        Some((cut, _)) => format!("{}...", &line[..cut]),
        None => line.into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_header_reads_as_a_list() {
        let mut text = String::new();
        let value = json!({ "kind": "x", "body": { "size": [2, 3], "name": null }, "tensors": [{ "name": "a",
            "shape": [1] }] });
        list(&mut text, &value, 1);
        assert_eq!(text, "  body:\n    name: -\n    size: [2, 3]\n  kind: x\n  tensors: 1\n    name a, shape [1]\n");
    }

    #[test]
    fn a_long_entry_of_a_list_is_shown_field_by_field() {
        let mut text = String::new();
        let long =
            json!({ "assigned": "each file begins at its own row ".repeat(3).trim(), "torn": [{ "frame": 50 }] });
        list(&mut text, &json!({ "recordings": [long, { "torn": [] }] }), 0);
        assert!(text.starts_with("recordings: 2\n  0:\n    assigned: each file"), "{text}");
        assert!(text.ends_with("    torn: 1\n      frame 50\n  torn []\n"), "{text}");
        let mut text = String::new();
        list(&mut text, &json!({ "all": vec![json!({ "a": 1 }); 42] }), 0);
        assert!(text.ends_with("  a 1\n  and 2 more\n"), "{text}");
    }

    #[test]
    fn long_lines_are_cut_between_characters() {
        assert_eq!(short(&"µ".repeat(200)).chars().count(), WIDTH + 3);
        assert_eq!(short("abc"), "abc");
    }
}
