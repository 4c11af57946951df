//! What the verbs answer about files that are not what they wanted, and about the files of this program.
#![allow(clippy::unwrap_used)]

mod common;

use common::{Fault, TinySession, contents, ommatidia, refused};
use ndarray::Array3;
use ommatidia_session::stack;
use serde_json::Value;
use std::path::Path;

/// A session of scenes alone, by `import`, and the folder that holds it.
fn scenes() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let frame = |(f, r, c): (usize, usize, usize)| 40.0 + ((31 * f + 7 * r + 3 * c) % 50) as f32;
    stack::write(&folder.path().join("video.npy"), Array3::from_shape_fn((30, 24, 32), frame).view()).unwrap();
    let (video, session) = (folder.path().join("video.npy"), folder.path().join("session"));
    run(&["import", &text(&video), "-o", &text(&session), "--exposure-ms", "10"]);
    folder
}

fn text(path: &Path) -> String {
    path.display().to_string()
}

/// What a command prints on standard output; it must succeed.
fn run(args: &[&str]) -> String {
    let output = ommatidia(args).output().unwrap();
    assert!(output.status.success(), "{args:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

fn json(args: &[&str]) -> Value {
    serde_json::from_str(&run(&[args, &["--json"]].concat())).unwrap()
}

#[test]
fn the_json_of_this_program_is_named_and_shown() {
    let folder = scenes();
    let at = |name: &str| text(&folder.path().join(name));
    let before = contents(&folder.path().join("session"));
    // Byte 8 of the output of `inspect` is that of a safetensors file.
    let printed = run(&["inspect", &at("session"), "--json"]);
    for (name, content, what) in [
        ("inspected", printed.as_str(), "figures of `inspect`"),
        ("shifted", "{\"body\":{\"array\": 1}, \"verb\": \"check\"}", "figures of `check`"),
        ("other", "{\"a\": [1, 2]}", "JSON of an unknown kind"),
    ] {
        std::fs::write(at(name), content).unwrap();
        let found = json(&["inspect", &at(name)]);
        assert_eq!((found["kind"].as_str(), found["what"].as_str()), (Some("json"), Some(what)), "{name}");
        assert_eq!(found["figures"], serde_json::from_str::<Value>(content).unwrap(), "{name}");
        assert!(run(&["inspect", &at(name)]).contains(what));
        run(&["report", &at(name), "-o", &at("page.html"), "--force"]);
    }
    // A list, and every field of its entries.
    let shown = run(&["inspect", &at("session/import.json")]);
    assert!(
        shown.contains("what: what `import` found") && shown.contains("max_dn: ") && shown.contains("torn: "),
        "{shown}"
    );
    std::fs::write(at("cut"), &printed[..40]).unwrap();
    refused(&["inspect", &at("cut")], None, &["begins as JSON, but is damaged or cut short"]);
    // An error names itself, and findings that are errors name their verb.
    let error = ommatidia(&["check", &at("nothing"), "--json"]).output().unwrap().stdout;
    std::fs::write(at("error"), error).unwrap();
    assert_eq!(json(&["inspect", &at("error")])["what"], "the error of a command");
    assert_eq!(contents(&folder.path().join("session")), before);
}

#[test]
fn what_is_no_session_is_said_to_be_none() {
    let folder = scenes();
    let at = |name: &str| text(&folder.path().join(name));
    std::fs::create_dir(at("recording")).unwrap();
    stack::write(Path::new(&at("recording/0.tif")), Array3::ones((2, 3, 4)).view()).unwrap();
    refused(&["check", &at("recording")], None, &["recording", "a folder with a session.toml", "`ommatidia import`"]);
    refused(&["check", &at("video.npy")], None, &["video.npy", "found a file", "`ommatidia import`"]);
    let error = ommatidia(&["check", &at("nothing")]).output().unwrap().stderr;
    let error = String::from_utf8(error).unwrap();
    assert!(error.contains("nothing: cannot be opened") && !error.contains("session.toml"), "{error}");
    for verb in ["inspect", "check", "report"] {
        refused(
            &[verb, &at("session/session.toml")],
            None,
            &["session.toml", "the manifest of a session; name its folder"],
        );
    }
}

#[test]
fn a_picture_is_drawn_of_any_session_and_a_report_of_any_recording() {
    let folder = scenes();
    let at = |name: &str| text(&folder.path().join(name));
    let out = run(&["check", &at("session"), "-o", &at("mean.png")]);
    assert!(out.contains("mean.png (no bead scan to draw: the mean of 24 frames of"), "{out}");
    let decoder = png::Decoder::new(std::io::BufReader::new(std::fs::File::open(at("mean.png")).unwrap()));
    let mut reader = decoder.read_info().unwrap();
    assert_eq!((reader.info().height / 24, reader.info().width / 32), (31, 31));
    let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
    reader.next_frame(&mut pixels).unwrap();
    assert!(pixels.iter().any(|v| *v > 150) && pixels.iter().any(|v| *v < 60));
    let beads = TinySession::new(Fault::None);
    let out = run(&["check", &text(&beads.path()), "-o", &text(&beads.beside("foci.png"))]);
    assert!(out.trim_end().ends_with("foci.png"), "{out}");
    std::fs::create_dir(at("recording")).unwrap();
    for name in ["recording/0.tif", "recording/1.tif"] {
        stack::write(Path::new(&at(name)), Array3::from_shape_fn((2, 3, 4), |(_, r, c)| (r + c) as f32).view())
            .unwrap();
    }
    run(&["report", &at("recording"), "-o", &at("recording.html")]);
    assert!(std::fs::read_to_string(at("recording.html")).unwrap().contains("4 frames of 3 × 4 pixels"));
}

#[test]
fn values_that_are_given_are_used_or_a_note_says_why_not() {
    let folder = scenes();
    let at = |name: &str| text(&folder.path().join(name));
    // Also where they are those that would be used without the options.
    for (name, given) in [("default", ["1", "2"]), ("other", ["0.5", "7"])] {
        let session = at("session");
        let args = ["calibrate", &session, "-o", &at(name), "--gain", given[0], "--read-noise", given[1]];
        let found = json(&args);
        let [gain, read_noise] = given.map(|v| v.parse::<f64>().unwrap());
        assert_eq!((found["gain_dn_per_e"].as_f64(), found["read_noise_e"].as_f64()), (Some(gain), Some(read_noise)));
        assert!(!found["notes"].to_string().contains("--"), "{}", found["notes"]);
        let out = run(&[&args[..], &["--force"]].concat());
        assert_eq!(out.matches("   given").count(), 2, "{out}");
    }
    let session = TinySession::new(Fault::None);
    let (path, out) = (text(&session.path()), text(&session.beside("instrument")));
    let found = json(&["calibrate", &path, "-o", &out, "--replicates", "0", "--gain", "3", "--read-noise", "9"]);
    let notes = found["notes"].to_string();
    assert!(notes.contains("the gain that was given, 3 DN/e-, is not used: the flats"), "{notes}");
    assert!(notes.contains("the read noise that was given, 9 e-, is not used: the darks"), "{notes}");
}
