#![allow(clippy::unwrap_used)]
use super::*;
use ndarray::{Array1, Array2, Array3, Array4, Array5};
use ommatidia_model::metrics::Figures;
use ommatidia_model::testing;
use ommatidia_network::evaluate::{MethodFigures, Ring, Summary};
use ommatidia_session::artifact::{Header as ArtifactHeader, Provenance, Tensors};
use ommatidia_session::{ArrayGeometry, ObjectGrid, SensorSpec};
use serde_json::json;

const SIDE: usize = 48;

/// Nine lenses whose foci widen outwards.
fn instrument() -> Instrument {
    let mut i = testing::instrument([SIDE, SIDE], [120, 120], 15, 2);
    i.manifest.name = "Synthetic".into();
    i.manifest.array = ArrayGeometry::grid(3, 3, 30.0);
    i.geometry.anchors_px = (0..9).map(|l| [30.0 * (l / 3) as f64 + 29.5, 30.0 * (l % 3) as f64 + 29.5]).collect();
    i.geometry.dead = (0..9).map(|l| l == 8).collect();
    let spot = |r: usize, c: usize, s: f32| {
        let (y, x) = (r as f32 - 7.0, c as f32 - 7.0);
        (-(y * y + x * x) / (2.0 * s * s)).exp() / (s * s)
    };
    i.psf.basis =
        Array4::from_shape_fn((9, 2, 15, 15), |(l, k, r, c)| spot(r, c, 1.0 + 0.1 * l as f32 + 1.5 * k as f32));
    i.psf.coefficients = Array5::from_shape_fn((9, 2, 1, 5, 6), |(_, k, _, r, c)| {
        let off = ((r as f32 - 2.0).powi(2) + (c as f32 - 2.5).powi(2)) / 10.0;
        if k == 0 { 1.0 - off } else { 4.0 * off }
    });
    let at = |i: usize| [(i / 13) as f32 * 3.9, (i % 13) as f32 * 3.9];
    let off = |i: usize| (at(i)[0] - 23.5).hypot(at(i)[1] - 23.5);
    i.diagnostics.positions_px = Array2::from_shape_fn((169, 2), |(b, k)| at(b)[k]);
    i.diagnostics.pcc = Array1::from_shape_fn(169, |b| (-(off(b) / 25.0).powi(2)).exp());
    i.diagnostics.singular_values =
        Array2::from_shape_fn((9, 60), |(l, k)| 10.0 * (-0.2 * k as f32).exp() * (1.0 + 0.03 * l as f32 * k as f32));
    i.diagnostics.error_by_rank = Array2::from_shape_fn((8, 3), |(k, c)| match c {
        0 => [1.0f32, 2.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0][k],
        1 => 0.3 * (-0.5 * k as f32).exp(),
        _ => 0.3 * (-0.45 * k as f32).exp() + 0.002,
    });
    i.diagnostics.photon_transfer = Array2::from_shape_fn((10, 3), |(k, c)| {
        let mean = 300.0 * k as f32;
        [mean, 0.4 * mean + 0.6 + 3.0 * (k as f32).sin(), 0.4 * mean + 0.6][c]
    });
    i
}

fn evaluation() -> Evaluation {
    let blob = |r: usize, c: usize, y: f32, x: f32, s: f32| {
        (-((r as f32 - y).powi(2) + (c as f32 - x).powi(2)) / (2.0 * s * s)).exp()
    };
    let truth = |p: usize, r: usize, c: usize, s: f32| {
        let p = p as f32;
        blob(r, c, 24.0 + p, 20.0, s)
            + 0.6 * blob(r, c, 6.0, 40.0 - p, s)
            + 0.8 * blob(r, c, 40.0, 8.0, s)
            + 0.5 * blob(r, c, 26.0, 30.0, 2.0 * s)
    };
    let method = |name: &str, psnr_db: f64, seconds: Option<f64>| MethodFigures {
        name: name.into(),
        source: "network.safetensors".into(),
        psnr_db,
        psnr_db_std: 1.2,
        ssim: psnr_db / 40.0,
        nrmse: 3.0 / psnr_db,
        pcc: 0.9,
        seconds_per_frame: seconds,
        peak_bytes: seconds.map(|_| 123_000_000),
        frames: vec![Figures { psnr_db, ..Figures::default() }; 8],
        spectra: Vec::new(),
        field: (0..6)
            .map(|i| Ring {
                inner_um: 30.0 * i as f64,
                outer_um: 30.0 * (i + 1) as f64,
                pixels: 100,
                nrmse: 0.1,
                psnr_db: psnr_db - i as f64,
            })
            .collect(),
    };
    let stack = |s: f32| Array3::from_shape_fn((2, SIDE, SIDE), |(p, r, c)| 50.0 * truth(p, r, c, s));
    Evaluation {
        summary: Summary {
            session: "Synthetic".into(),
            sensor: SensorSpec { rows: 120, cols: 120, pixel_pitch_um: 1.85, bit_depth: 12 },
            object: ObjectGrid { rows: SIDE, cols: SIDE, pixel_um: 2.8 },
            frames: 8,
            pictured: vec![0, 5],
            methods: vec![
                method("svfouriernet", 29.1, Some(0.021)),
                method("svfouriernet-blob", 29.08, Some(0.3)),
                method("device", 29.08, None),
                method("wiener", 24.0, Some(0.004)),
                method("central", 19.0, Some(0.0002)),
            ],
            prediction: Some(PredictionFiguresFixture::get()),
        },
        raw_dn: Array3::from_shape_fn((2, 120, 120), |(p, r, c)| {
            64.0 + (0..9)
                .map(|l| 400.0 * truth(p, (r + 100 - 30 * (l / 3)) % 100, (c + 100 - 30 * (l % 3)) % 100, 1.5))
                .sum::<f32>()
        }),
        predicted: Some(ommatidia_network::evaluate::Predicted {
            frames_dn: Array3::from_elem((2, 120, 120), 80.0),
            residual_sigma: Array3::from_shape_fn((2, 120, 120), |(_, r, c)| (r as f32 - c as f32) / 40.0),
        }),
        truths: stack(1.5),
        reconstructions: vec![stack(1.6), stack(1.6), stack(1.6), stack(2.2), stack(3.5)],
    }
}

struct PredictionFiguresFixture;

impl PredictionFiguresFixture {
    fn get() -> ommatidia_model::metrics::PredictionFigures {
        ommatidia_model::metrics::PredictionFigures {
            frames: 8,
            scale: 1.0003,
            nrmse: 0.0042,
            pcc: 0.99996,
            chi2_ndf: 1.012,
            chi2_ndf_expected: 1.002,
            lit_pixels: 123_456,
            background: Some(ommatidia_model::metrics::FrameBackground {
                mean_e: [3.0, 1.0, -2.0],
                sigma_e: [0.02, 0.05, 0.05],
                added: true,
                nrmse_without: 0.05,
                chi2_ndf_without: 1.4,
            }),
            by_radius: (0..8u32)
                .map(|i| ommatidia_model::metrics::ResidualRing {
                    inner_px: 10.0 * f64::from(i),
                    outer_px: 10.0 * f64::from(i + 1),
                    pixels: 1000,
                    chi2_ndf: 1.0 + 0.01 * f64::from(i),
                    bias: 1e-4 * f64::from(i),
                })
                .collect(),
        }
    }
}

/// A page of every kind of artifact.
fn page() -> String {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    instrument().write(&path("instrument.safetensors"), Provenance::new("calibrate", 1, &())).unwrap();
    evaluation().write(&path("evaluation.safetensors"), Provenance::new("evaluate", 1, &())).unwrap();
    let curve: Vec<Value> = (0..40)
        .map(|i| {
            json!({"step": 20 * i, "train_loss": 0.3 * (-0.1 * f64::from(i)).exp() + 0.05, "validation_loss":
            0.3 * (-0.09 * f64::from(i)).exp() + 0.06, "psnr_db": 15.0 + f64::from(i).sqrt() * 2.0})
        })
        .collect();
    let body =
        json!({"curve": curve, "best_step": 780, "network": {"frame": [214, 214], "object": [96, 96], "channels": 6}});
    let header =
        ArtifactHeader { kind: "checkpoint".into(), version: 1, provenance: Provenance::new("train", 1, &()), body };
    artifact::write(&path("network.safetensors"), &header, &Tensors::new()).unwrap();
    let device = json!({"bit_exact": true, "instructions": 123_456_789u64, "ram_bytes": 1_500_000u64, "flash_bytes":
        400_000u64, "stack_bytes": 6_000u64, "board": "mps2-an500 (QEMU)"});
    std::fs::write(path("device.json"), device.to_string()).unwrap();
    let names = ["instrument.safetensors", "evaluation.safetensors", "network.safetensors", "device.json"];
    let paths: Vec<PathBuf> = names.iter().map(|n| path(n)).collect();
    render(&paths).unwrap()
}

#[test]
fn the_page_shows_every_artifact_and_asks_the_network_for_nothing() {
    let page = page();
    if let Ok(f) = std::env::var("OMM_PAGE") {
        std::fs::write(f, &page).unwrap();
    }
    for text in [
        "Scene 5.",
        "Methods side by side",
        "Quality across the field",
        "Point-spread functions",
        "Spatial variance",
        "Low-rank model",
    ] {
        assert!(page.contains(text), "{text} is missing");
    }
    for text in ["Photon transfer", "Training.", "Firmware.", "written by ommatidia", "+5.10", "mps2-an500"] {
        assert!(page.contains(text), "{text} is missing");
    }
    for address in ["http://", "https://", "src=\"/", "url("] {
        let foreign = page.replace("http://www.w3.org/", "").contains(address);
        assert!(!foreign, "the page refers to {address}");
    }
    assert_eq!(page.matches("<img").count(), page.matches("alt=\"").count());
    // A caption inside a table that scrolls is cut off on a narrow screen.
    assert!(!page.contains("<caption") && page.contains("<p class=\"caption\" id=\"table-1\">"));
}

#[test]
fn reconstructions_of_a_host_are_not_called_those_of_a_device() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    evaluation().write(&path("evaluation.safetensors"), Provenance::new("evaluate", 1, &())).unwrap();
    let run = |place: &str| {
        let json = json!({"bit_exact": true, "differing_bits": 0, "board": "mps2-an500", "ran_on": place});
        std::fs::write(path("device.json"), json.to_string()).unwrap();
        render(&[path("evaluation.safetensors"), path("device.json")]).unwrap()
    };
    let (here, there) = (run("host"), run("emulator"));
    assert!(there.contains("SV-FourierNet, device") && there.contains("On the device"));
    assert!(!here.contains("SV-FourierNet, device") && !here.contains("On the device"));
    assert!(here.contains("SV-FourierNet, not on a device") && here.contains("Not run on a device"));
}

#[test]
fn what_is_no_artifact_is_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("notes.txt");
    std::fs::write(&path, "hello").unwrap();
    let error = render(&[path]).unwrap_err().to_string();
    assert!(error.contains("notes.txt") && error.contains("an unknown file"), "{error}");
}

#[test]
fn an_instrument_without_a_bead_scan_says_that_only_the_sensor_is_modelled() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("sensor.instrument");
    let instrument = testing::instrument([9, 11], [30, 33], 5, 1);
    assert!(instrument.sensor_only());
    instrument.write(&path, Provenance::default()).unwrap();
    assert!(render(&[path]).unwrap().contains("only the sensor is modelled"));
}
