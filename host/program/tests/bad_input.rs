//! Bad input, file by file: each fault is refused with an error that names the file, what was expected and found, and
//! what to do; nothing is left behind.
#![allow(clippy::unwrap_used)]

mod common;

use common::{Fault, TinySession, ommatidia, refused};
use ndarray::Array3;
use ommatidia_network::quantize::{QuantizeConfig, quantize};
use ommatidia_network::train::{Checkpoint, Preset, weights};
use ommatidia_physics::noise::NoiseModel;
use ommatidia_session::stack;
use std::path::Path;

fn calibrate_refuses(session: &TinySession, words: &[&str]) {
    let output = session.beside("instrument.omi");
    let (path, out) = (session.path(), output.display().to_string());
    refused(&["calibrate", path.to_str().unwrap(), "-o", &out], Some(&output), words);
}

fn replace(bytes: Vec<u8>, from: &str, to: &str) -> Vec<u8> {
    let text = String::from_utf8(bytes).unwrap();
    assert!(text.contains(from), "the test looks for `{from}`");
    text.replace(from, to).into_bytes()
}

#[test]
fn missing_frames_are_refused() {
    let session = TinySession::new(Fault::None);
    std::fs::remove_file(session.path().join("bead.npy")).unwrap();
    calibrate_refuses(&session, &["bead.npy", "check its name"]);
}

#[test]
fn truncated_frames_are_refused() {
    let session = TinySession::new(Fault::None);
    session.edit("bead.npy", |b| b[..b.len() - 1].to_vec());
    calibrate_refuses(&session, &["bead.npy", "expected", "found", "cut short"]);
}

#[test]
fn frames_of_another_shape_are_refused() {
    let session = TinySession::new(Fault::None);
    session.edit("session.toml", |b| replace(b, "rows = 80", "rows = 96"));
    calibrate_refuses(&session, &[".npy", "shape", "expected", "found"]);
}

#[test]
fn frames_of_another_type_are_refused() {
    let session = TinySession::new(Fault::None);
    session.edit("bead.npy", |mut b| {
        let at = b.windows(3).position(|w| w == b"<u2").unwrap();
        b[at..at + 3].copy_from_slice(b"<i2");
        b
    });
    calibrate_refuses(&session, &["bead.npy", "sample type", "expected", "found"]);
}

#[test]
fn another_format_version_is_refused() {
    let session = TinySession::new(Fault::None);
    session.edit("session.toml", |b| replace(b, "format = 1", "format = 2"));
    calibrate_refuses(&session, &["session.toml", "format", "expected 1", "found 2"]);
}

#[test]
fn an_unknown_key_is_refused() {
    let session = TinySession::new(Fault::None);
    session.edit("session.toml", |b| replace(b, "bit_depth", "bit_dept"));
    calibrate_refuses(&session, &["session.toml", "bit_dept"]);
}

#[test]
fn a_missing_table_column_is_refused() {
    let session = TinySession::new(Fault::None);
    session.edit("bead.csv", |b| replace(b, "x_um", "east"));
    calibrate_refuses(&session, &["bead.csv", "x_um"]);
}

#[test]
fn a_position_that_is_no_number_is_refused() {
    let session = TinySession::new(Fault::None);
    session.edit("bead.csv", |b| replace(b, "\n3,", "\n3,nan\n"));
    calibrate_refuses(&session, &["bead.csv"]);
}

#[test]
fn frames_that_hold_no_numbers_are_refused() {
    let session = TinySession::new(Fault::None);
    // The same frames as float32, one pixel of frame 7 being NaN.
    session.edit("bead.npy", |b| {
        let header = 10 + usize::from(u16::from_le_bytes([b[8], b[9]]));
        let mut out = b[..header].to_vec();
        let at = out.windows(3).position(|w| w == b"<u2").unwrap();
        out[at..at + 3].copy_from_slice(b"<f4");
        let codes = b[header..].chunks_exact(2).map(|c| f32::from(u16::from_le_bytes([c[0], c[1]])));
        out.extend(codes.enumerate().flat_map(|(i, v)| if i == 7 * 6400 + 5 { f32::NAN } else { v }.to_le_bytes()));
        out
    });
    calibrate_refuses(&session, &["bead.npy", "7", "finite"]);
}

#[test]
fn a_bead_outside_the_field_is_refused() {
    calibrate_refuses(&TinySession::new(Fault::Outside(6)), &["bead", "6", "outside"]);
}

#[test]
fn a_saturated_bead_frame_is_refused() {
    calibrate_refuses(&TinySession::new(Fault::Saturated(12)), &["bead", "12", "saturat"]);
}

#[test]
fn a_dead_lens_is_named_and_the_others_are_calibrated() {
    let session = TinySession::new(Fault::DeadLens(2));
    let (path, output) = (session.path(), session.beside("instrument.omi"));
    let run =
        ommatidia(&["calibrate", path.to_str().unwrap(), "-o", output.to_str().unwrap(), "--json"]).output().unwrap();
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
    let json: serde_json::Value = serde_json::from_slice(&run.stdout).unwrap();
    assert_eq!(json["dead_lenses"], serde_json::json!([2]), "{json}");
    assert!(json["gain_dn_per_e"].as_f64().is_some_and(|g| (g - 0.5).abs() < 0.02 * 0.5), "{json}");
    assert!(output.is_file());
}

#[test]
fn a_file_of_another_kind_is_refused() {
    let session = TinySession::new(Fault::None);
    let (output, frames) = (session.beside("out.npy"), session.path().join("bead.npy"));
    let frames = frames.to_str().unwrap();
    refused(
        &["predict", frames, frames, "-o", output.to_str().unwrap()],
        Some(&output),
        &["bead.npy", "expected an artifact", "found a stack of frames"],
    );
}

/// Writes the network file of a small untrained network for frames of 20 x 20 pixels.
fn network_file(path: &Path) {
    let network = Preset::Nano.network([20, 20], [8, 8]);
    let weights = weights::random(&network, 1);
    let checkpoint = Checkpoint::untrained(network, NoiseModel::nominal(), Preset::Nano.training(1e4, 1), weights);
    std::fs::write(path, quantize(&checkpoint, "", &QuantizeConfig::default()).unwrap().bytes).unwrap();
}

/// The same bad frame is refused with the same words, whether the host or a device reconstructs it.
#[test]
fn values_that_are_not_sensor_codes_are_refused_by_host_and_device() {
    let folder = tempfile::tempdir().unwrap();
    let [network, frames, output] = ["net.omm", "frames.npy", "out.npy"].map(|name| folder.path().join(name));
    network_file(&network);
    let mut values = Array3::from_elem((2, 20, 20), 70.0f32);
    for bad in [-2.0, 70_000.0] {
        values[[1, 3, 7]] = bad;
        stack::write(&frames, values.view()).unwrap();
        let [network, frames, out] = [&network, &frames, &output].map(|path| path.to_str().unwrap());
        let found = format!("found {bad}");
        let words =
            ["frames.npy", "frame 1", "row 3", "column 7", "from 0 to 65535 DN", &found, "as the sensor delivers"];
        refused(&["reconstruct", frames, "-o", out, "--with", network], Some(&output), &words);
        refused(&["device", "run", "--with", network, "--frames", frames, "-o", out], Some(&output), &words);
    }
}

#[test]
fn a_full_disk_leaves_nothing() {
    let session = TinySession::new(Fault::None);
    let path = session.path();
    refused(
        &["calibrate", path.to_str().unwrap(), "-o", "/dev/full/instrument.omi"],
        None,
        &["/dev/full/instrument.omi"],
    );
}

#[test]
fn usage_errors_have_their_own_exit_code() {
    for args in [&["calibrate"][..], &["no-such-verb"], &["calibrate", "x", "-o", "y", "--no-such-option"]] {
        assert_eq!(ommatidia(args).output().unwrap().status.code(), Some(2), "{args:?}");
    }
}
