//! Sessions as people have them, measured by the independent virtual instrument: what `close` finds in each, and what
//! it says that it cannot find.
#![allow(clippy::unwrap_used)]

mod kinds;
mod lamp;
mod own;
mod registration;
mod truths;

use ommatidia_bench::{ArrayConfig, BenchConfig, ScanConfig, VirtualInstrument};
use ommatidia_closing::study::sessions::Holds;
use ommatidia_closing::{Account, Budget, CloseOptions, Closing, Observations, close};
use ommatidia_model::calibrate::{CalibrateConfig, calibrate};
use ommatidia_model::instrument::Instrument;
use ommatidia_physics::effects::EffectSetting;
use ommatidia_session::{MANIFEST, Session};
use std::path::Path;
use std::sync::OnceLock;

/// A small array with four lenses, and its calibration. The rank is fixed: its search takes most of the time.
struct Subject {
    config: BenchConfig,
    bench: VirtualInstrument,
    instrument: Instrument,
    /// A calibration that lets the PSFs vary too little over the field.
    poor: Instrument,
}

fn subject() -> &'static Subject {
    static SUBJECT: OnceLock<Subject> = OnceLock::new();
    SUBJECT.get_or_init(|| {
        let mut config = BenchConfig::default();
        (config.sensor.rows, config.sensor.cols) = (124, 124);
        config.array = ArrayConfig { rows: 2, cols: 2, ..config.array };
        (config.object.rows, config.object.cols) = (56, 56);
        config.scan = ScanConfig { rows: 11, cols: 11, ..config.scan };
        let bench = config.build(&[]).unwrap();
        let folder = tempfile::tempdir().unwrap();
        bench.measure(&folder.path().join("calibration"), 1, |_| ()).unwrap();
        let session = Session::open(folder.path().join("calibration")).unwrap();
        let of_rank = |rank| {
            let config = CalibrateConfig { rank: Some(rank), ..CalibrateConfig::default() };
            calibrate(&session, &config, || {}).unwrap().instrument
        };
        let (instrument, poor) = (of_rank(10), of_rank(1));
        config.stacks.scene_frames = 8;
        (config.stacks.dark_frames, config.stacks.flat_frames) = (4, 2);
        Subject { config, bench, instrument, poor }
    })
}

/// Measures a session of a kind with effects, into `dir`; `seed` is that of its scenes and its noise.
fn measured(holds: Holds, effects: &[EffectSetting], dir: &Path, seed: u64) -> Session {
    let Subject { config, bench, .. } = subject();
    let bench = holds.config(config).build_like(bench, effects).unwrap();
    holds.measure(&bench, dir, seed).unwrap()
}

/// Adds lines to the entry of the scenes in a session's manifest.
fn with_lines(dir: &Path, lines: &str) -> Session {
    let file = dir.join(MANIFEST);
    let text = std::fs::read_to_string(&file).unwrap();
    let truth = "truth = \"scene_truth.npy\"";
    assert!(text.contains(truth), "{text}");
    std::fs::write(&file, text.replace(truth, &format!("{truth}\n{lines}"))).unwrap();
    Session::open(dir).unwrap()
}

/// As [`accounted`], without its maps.
fn closed(session: &Session) -> Closing {
    accounted(session).closing
}

/// Closes the loop on a session, and prints what was found.
fn accounted(session: &Session) -> Account {
    accounted_by(&subject().instrument, session)
}

/// As [`accounted`], by another instrument.
fn accounted_by(instrument: &Instrument, session: &Session) -> Account {
    let mut seen = Observations::read(session, &Budget::default()).unwrap();
    let options = CloseOptions { seed: 1, ..CloseOptions::default() };
    let account = close(instrument, &mut seen, &options, |_| ()).unwrap().account;
    let closing = &account.closing;
    for e in &closing.effects {
        eprintln!("{} (z = {:.1}): {}", e.id, e.z, e.description);
    }
    for n in &closing.nearest {
        eprintln!("like {} (z = {:.1}): {}", n.id, n.z, n.why);
    }
    closing.notes.iter().for_each(|n| eprintln!("note: {n}"));
    eprintln!("{:?}: {:?} -> {:?}", closing.verdict, closing.before, closing.after);
    account
}

/// Ids of the effects with a name.
fn names(closing: &Closing) -> Vec<&str> {
    closing.effects.iter().filter(|e| e.known).map(|e| e.id.as_str()).collect()
}
