//! `evaluate`: methods side by side on scenes of known truth.

use super::common::{in_json, left_out, odd_scenes, warn};
use super::files::{Content, Files};
use super::{Outcome, Run};
use anyhow::{Context, ensure};
use ndarray::{Array3, Axis};
use ommatidia_model::forward::Forward;
use ommatidia_model::instrument::Instrument;
use ommatidia_model::metrics::{
    FrameBackground, PredictionFigures, SensorNoise, add_background, in_sigmas, prediction_figures,
};
use ommatidia_model::psf::OperatorConfig;
use ommatidia_network::evaluate::{Evaluation, MethodFigures, Predicted, Scenes, Source, Summary, judge};
use ommatidia_network::methods::{MethodKind, Reconstruct, frame_range, title};
use ommatidia_report::{bytes, seconds};
use ommatidia_session::artifact::Provenance;
use ommatidia_session::kind::FileKind;
use ommatidia_session::{Session, stack, with_error};
use std::fmt::Write;
use std::path::{Path, PathBuf};

/// Options of `evaluate`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Folder of a session with scene stacks that have a truth
    session: PathBuf,
    /// Checkpoint, network file, or instrument (may be given again)
    #[arg(long = "with", value_name = "FILE", required_unless_present = "stacks")]
    with: Vec<PathBuf>,
    /// Methods to make from an instrument
    #[arg(long, value_name = "METHOD", value_delimiter = ',', default_value = "wiener,central")]
    methods: Vec<MethodKind>,
    /// Finished reconstructions from another program, one for each scene frame (may be given again)
    #[arg(long = "stack", value_name = "NAME=FILE", value_parser = named_stack)]
    stacks: Vec<(String, PathBuf)>,
    /// Judge the first N scenes only
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    frames: Option<u64>,
    /// Number of scenes whose pictures are kept for the report
    #[arg(long, value_name = "N", default_value_t = 3)]
    pictures: usize,
    /// File for figures and pictures, for `report`
    #[arg(short, long, value_name = "EVALUATION")]
    output: Option<PathBuf>,
}

fn named_stack(text: &str) -> Result<(String, PathBuf), String> {
    let parts = text.split_once('=').filter(|(name, file)| !name.is_empty() && !file.is_empty());
    let (name, file) = parts.ok_or("expected NAME=FILE")?;
    Ok((name.into(), file.into()))
}

/// A method or a stack, with its name in the table.
pub(super) struct Entry {
    pub(super) name: String,
    pub(super) source: PathBuf,
    pub(super) from: EntrySource,
}

/// chi-squared per pixel from which on frames and truths disagree more than a calibration errs.
const DISAGREES: f64 = 5.0;

/// Source of an entry's reconstructions.
pub(super) enum EntrySource {
    /// A method to run.
    Method(Box<dyn Reconstruct>),
    /// Finished reconstructions, [frames, object rows, object cols].
    Stack(Array3<f32>),
}

impl Args {
    /// What the verb reads and writes.
    pub fn files(&self) -> Files {
        Files::reading([&self.session])
            .and_reading(&self.with)
            .and_reading(self.stacks.iter().map(|(_, file)| file))
            .writing(&self.output, Content::artifact("evaluation"))
    }
}

/// Runs the verb.
///
/// # Errors
/// A file cannot be read, does not fit the session or is of the wrong kind, or the output cannot be written.
pub fn run(args: &Args, run: &Run) -> anyhow::Result<Outcome> {
    let session = Session::open(&args.session)?;
    let mut scenes = Scenes::of(&session, args.frames.map(|n| n as usize))?;
    let manifest = session.manifest();
    let entries = entries(&args.with, &args.methods, &args.stacks, run, &scenes.places())?;
    let ranges = args.with.iter().map(|path| frame_range(path)).collect::<anyhow::Result<Vec<_>>>()?;
    let mut warnings = odd_scenes(&session, ranges.into_iter().flatten().next())?;
    warnings.extend(left_out(&session));
    let pictured = pictured(scenes.count(), args.pictures);
    let bar = run.progress((entries.len() * scenes.count()) as u64, "evaluate");
    let mut evaluation = Evaluation {
        raw_dn: Array3::zeros((pictured.len(), manifest.sensor.rows, manifest.sensor.cols)),
        truths: Array3::zeros((pictured.len(), manifest.object.rows, manifest.object.cols)),
        predicted: None,
        reconstructions: Vec::new(),
        summary: Summary {
            session: manifest.name.clone(),
            sensor: manifest.sensor,
            object: manifest.object,
            frames: scenes.count(),
            pictured: pictured.clone(),
            methods: Vec::new(),
            prediction: None,
        },
    };
    for (p, &i) in pictured.iter().enumerate() {
        let case = scenes.case(i)?;
        evaluation.raw_dn.index_axis_mut(Axis(0), p).assign(&case.frame_dn);
        evaluation.truths.index_axis_mut(Axis(0), p).assign(&case.truth);
    }
    for entry in &entries {
        let source = match &entry.from {
            EntrySource::Method(method) => Source::Method(method.as_ref()),
            EntrySource::Stack(stack) => Source::Stack(stack),
        };
        let count = scenes.count();
        let judged = judge(&source, &manifest.object, count, &pictured, |i| scenes.case(i), || bar.inc(1));
        let (mut figures, pictures) = judged.with_context(|| entry.source.display().to_string())?;
        (figures.name, figures.source) = (entry.name.clone(), entry.source.display().to_string());
        evaluation.summary.methods.push(figures);
        evaluation.reconstructions.push(pictures);
    }
    let mut predictions = Vec::new();
    for path in &args.with {
        if is_instrument(path)? {
            let most = if predictions.is_empty() { &pictured[..] } else { &[] };
            let (figures, predicted) = prediction(path, &mut scenes, most)?;
            evaluation.summary.prediction.get_or_insert_with(|| figures.clone());
            evaluation.predicted.get_or_insert(predicted);
            predictions.push((path.as_path(), figures));
        }
    }
    bar.finish_and_clear();
    warnings.extend(warn(predictions.iter().filter(|(_, p)| p.chi2_ndf > DISAGREES).map(|(path, p)| {
        format!(
            "{}: does not predict the frames from their truths (chi2/ndf {:.0}): either has changed, or records are \
             wrong. `ommatidia residual {} --instrument {}` looks for exchanged, turned and displaced truths and wrong \
             exposures",
            path.display(),
            p.chi2_ndf,
            args.session.display(),
            path.display()
        )
    })));
    evaluation.sort();
    if let Some(output) = &args.output {
        evaluation.write(output, provenance(args, run, &session)?)?;
    }
    let mut outcome = outcome(args, &evaluation.summary, &predictions);
    outcome.json["warnings"] = serde_json::json!(warnings);
    Ok(outcome)
}

/// The entries to judge: networks, methods made from instruments, stacks. Stacks hold reconstructions of all scene
/// frames; `places` says which of them are judged.
pub(super) fn entries(
    with: &[PathBuf],
    methods: &[MethodKind],
    stacks: &[(String, PathBuf)],
    run: &Run,
    places: &[usize],
) -> anyhow::Result<Vec<Entry>> {
    let frames = places.iter().map(|place| place + 1).max().unwrap_or(0);
    let mut entries: Vec<Entry> = Vec::new();
    for path in with {
        let instrument = is_instrument(path)?;
        let kinds = if instrument { methods.to_vec() } else { vec![MethodKind::default_for(path)?] };
        for kind in kinds.into_iter().filter(|k| !instrument || k.needs_instrument()) {
            let method = kind.open(path, run.seed)?;
            entries.push(Entry { name: method.name().into(), source: path.clone(), from: EntrySource::Method(method) });
        }
    }
    for (name, path) in stacks {
        let objects = stack::read(path)?;
        let found = objects.len_of(Axis(0));
        ensure!(
            found >= frames,
            "{}: expected {frames} objects, one for each scene frame, found {found}",
            path.display()
        );
        entries.push(Entry {
            name: name.clone(),
            source: path.clone(),
            from: EntrySource::Stack(objects.select(Axis(0), places)),
        });
    }
    ensure!(
        !entries.is_empty(),
        "--methods: expected methods that are made from an instrument, such as wiener or central, found none"
    );
    make_names_unique(&mut entries);
    Ok(entries)
}

/// Adds the file to names that occur twice, as in `wiener@b.safetensors`, and a number if that is still not unique.
fn make_names_unique(entries: &mut [Entry]) {
    let all: Vec<String> = entries.iter().map(|e| e.name.clone()).collect();
    for i in 0..entries.len() {
        if all.iter().filter(|n| **n == all[i]).count() < 2 {
            continue;
        }
        let file = entries[i].source.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let name = format!("{}@{file}", all[i]);
        let twice = entries[..i].iter().any(|e| e.name == name);
        entries[i].name = if twice { format!("{name}#{i}") } else { name };
    }
}

fn is_instrument(path: &Path) -> anyhow::Result<bool> {
    Ok(matches!(FileKind::of(path)?, FileKind::Artifact(kind) if kind == "instrument"))
}

/// Indices of at most `most` scenes, spread evenly over `count`.
fn pictured(count: usize, most: usize) -> Vec<usize> {
    let n = most.min(count);
    (0..n).map(|i| i * count / n).collect()
}

/// Figures of an instrument's prediction of the scenes, and the predictions of the pictured ones.
fn prediction(path: &Path, scenes: &mut Scenes, pictured: &[usize]) -> anyhow::Result<(PredictionFigures, Predicted)> {
    let instrument = Instrument::read(path)?;
    let depth = instrument.psf.depth_nearest(0.0);
    let forward = Forward::with_config(&instrument, OperatorConfig::exact(depth))?;
    let count = scenes.count();
    let noise = forward.noise_with(forward.effects());
    let sensor =
        SensorNoise { noise: &noise, offset_dn: instrument.offset_dn.as_ref(), reading_dn2: forward.reading_dn2() };
    let figures = prediction_figures(count, sensor, |i, light| scenes.comparison(i, &forward, light));
    let figures = figures.with_context(|| path.display().to_string())?;
    let size = (pictured.len(), instrument.manifest.sensor.rows, instrument.manifest.sensor.cols);
    let mut predicted = Predicted { frames_dn: Array3::zeros(size), residual_sigma: Array3::zeros(size) };
    for (p, i) in pictured.iter().enumerate() {
        let mut frames = scenes.comparison(*i, &forward, figures.scale)?;
        if let Some(b) = figures.background.filter(|b| b.added) {
            let plane_dn = b.mean_e.map(|e| e * noise.gain_dn_per_e);
            add_background(&mut frames.predicted, &plane_dn, noise.saturation_dn);
        }
        let residual = in_sigmas(frames.measured.view(), frames.predicted.view(), sensor)?;
        predicted.residual_sigma.index_axis_mut(Axis(0), p).assign(&residual);
        predicted.frames_dn.index_axis_mut(Axis(0), p).assign(&frames.predicted);
    }
    Ok((figures, predicted))
}

fn provenance(args: &Args, run: &Run, session: &Session) -> anyhow::Result<Provenance> {
    let config = serde_json::json!({ "methods": args.methods, "frames": args.frames, "pictures": args.pictures });
    let mut provenance = Provenance::new("evaluate", run.seed, &config).with_input(&session.manifest_path())?;
    for path in args.with.iter().chain(args.stacks.iter().map(|(_, path)| path)) {
        provenance = provenance.with_input(path)?;
    }
    Ok(provenance)
}

fn outcome(args: &Args, summary: &Summary, predictions: &[(&Path, PredictionFigures)]) -> Outcome {
    let methods: serde_json::Map<String, serde_json::Value> =
        summary.methods.iter().map(|m| (m.name.clone(), serde_json::to_value(m).unwrap_or_default())).collect();
    let json = serde_json::json!({
        "session": summary.session, "frames": summary.frames, "methods": methods,
        "prediction": summary.prediction, "evaluation": args.output.as_ref().map(in_json),
        "predictions": predictions.iter().map(|(path, figures)| {
            serde_json::json!({ "instrument": in_json(path), "figures": figures })
        }).collect::<Vec<_>>(),
    });
    let mut text = table(&summary.methods);
    for (path, p) in predictions {
        let by = if predictions.len() > 1 { format!(" by {}", path.display()) } else { String::new() };
        // Writing to a string cannot fail.
        let _ = writeln!(
            text,
            "\npredicted frames{by}: NRMSE {:.2} %, PCC {:.5}, chi2/ndf {:.3} over {} lit pixels (scale {:.4})",
            100.0 * p.nrmse,
            p.pcc,
            p.chi2_ndf,
            p.lit_pixels,
            p.scale
        );
        // A background says nothing where frames and truths disagree.
        let background = p.background.filter(|_| p.chi2_ndf <= DISAGREES);
        text.push_str(&background.map_or_else(String::new, |b| background_line(&b)));
    }
    if let Some(output) = &args.output {
        let _ = writeln!(text, "evaluation: {}", output.display());
    }
    Outcome { json, text }
}

/// What was fitted beyond the light of the objects.
fn background_line(b: &FrameBackground) -> String {
    let ([level, row, col], sigma) = (b.mean_e, b.sigma_e[0]);
    if !b.added {
        let found = with_error(level, sigma, 3);
        return format!("no background added: {found} e- a pixel is too little to matter\n");
    }
    format!(
        "background of the scene frames, fitted and added to the prediction: {} e- a pixel \
         ({row:+.2} e- from the first to the last row, {col:+.2} e- from the first to the last column); without it \
         NRMSE {:.2} %, chi2/ndf {:.3}\n",
        with_error(level, sigma, 2),
        100.0 * b.nrmse_without,
        b.chi2_ndf_without
    )
}

/// The methods as a table, best first.
pub(super) fn table(methods: &[MethodFigures]) -> String {
    let names: Vec<String> = methods.iter().map(|m| title(&m.name)).collect();
    let width = names.iter().map(|n| n.chars().count()).max().unwrap_or(0).max(6);
    let mut text = format!(
        "{:width$}  {:>14}  {:>6}  {:>6}  {:>6}  {:>10}  {:>10}\n",
        "method", "PSNR (dB)", "SSIM", "NRMSE", "PCC", "time/frame", "memory"
    );
    for (m, name) in methods.iter().zip(names) {
        let _ = writeln!(
            text,
            "{name:width$}  {:>7.2} ± {:>4.2}  {:>6.3}  {:>6.3}  {:>6.3}  {:>10}  {:>10}",
            m.psnr_db,
            m.psnr_db_std,
            m.ssim,
            m.nrmse,
            m.pcc,
            m.seconds_per_frame.map_or("-".into(), seconds),
            m.peak_bytes.map_or("-".into(), bytes)
        );
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_are_spread() {
        assert_eq!(pictured(12, 3), [0, 4, 8]);
        assert_eq!(pictured(2, 3), [0, 1]);
        assert_eq!(pictured(5, 0), Vec::<usize>::new());
    }

    #[test]
    fn names_that_occur_twice_carry_their_file() {
        let entry = |name: &str, path: &str| Entry {
            name: name.into(),
            source: path.into(),
            from: EntrySource::Stack(Array3::zeros((0, 0, 0))),
        };
        let mut entries =
            [entry("wiener", "x/a.st"), entry("central", "x/a.st"), entry("wiener", "b.st"), entry("wiener", "y/b.st")];
        make_names_unique(&mut entries);
        assert_eq!(entries.map(|e| e.name), ["wiener@a.st", "central", "wiener@b.st", "wiener@b.st#3"]);
    }

    #[test]
    fn stacks_have_names() {
        assert_eq!(named_stack("device=out.npy"), Ok(("device".into(), "out.npy".into())));
        assert!(named_stack("out.npy").is_err() && named_stack("=out.npy").is_err());
    }
}
