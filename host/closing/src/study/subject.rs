//! One instrument under study: its bench, its calibration, and the sensitivity of its sessions.
//!
//! It is small, so that a session takes seconds: 3 x 3 lenses on 98 x 98 pixels. All sessions of an instrument are
//! compared with one calibration, from a session of its own; such sessions belong together in every interval.

use super::foreign::{FOREIGN, Foreign};
use super::instruments::{self, Kind};
use super::networks::{self, Networks};
use super::sensitivity::{Sensitivities, Sensitivity};
use super::sessions::Holds;
use super::size::{Question, Size};
use crate::{Budget, CloseOptions, Observations, close};
use anyhow::Context;
use ommatidia_bench::{BenchConfig, VirtualInstrument};
use ommatidia_model::calibrate::{CalibrateConfig, calibrate};
use ommatidia_model::instrument::Instrument;
use ommatidia_physics::effects::Effect;
use ommatidia_session::artifact::Provenance;
use ommatidia_session::{Role, Session};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Sessions without an effect that determine the sensitivity.
const NULLS: u64 = 3;

/// An instrument under study.
pub struct Subject {
    /// Kind of the instrument, for tables.
    pub kind: Kind,
    /// The bench without effects; its foci are reused for all sessions.
    pub bench: VirtualInstrument,
    /// The configuration of its sessions.
    pub config: BenchConfig,
    /// Its calibration.
    pub instrument: Instrument,
    /// How well its sessions determine each effect.
    pub sensitivities: Sensitivities,
    /// Checkpoint of a network trained on it, if the study needs one.
    pub network: PathBuf,
}

/// A session to close is shorter than one for calibration.
fn shorter(config: &BenchConfig) -> BenchConfig {
    let mut c = config.clone();
    c.stacks.dark_frames = 4;
    c.stacks.flat_frames = 2;
    c
}

impl Subject {
    /// Builds instrument `n`, calibrates it and measures the sensitivity of its sessions. Results in `dir` from an
    /// earlier run are reused.
    ///
    /// # Errors
    /// The folder cannot be written, or the instrument cannot be calibrated.
    pub fn prepare(n: u64, size: &Size, dir: &Path, networks: &dyn Networks) -> anyhow::Result<Self> {
        let seed = size.seed;
        let whole = instruments::config(size, n)?;
        let config = shorter(&whole);
        // Foci are kept for instruments that are built like another one.
        let bench = config.build_like(&config.build(&[])?, &[])?;
        let file = dir.join(format!("instrument-{n}.instrument"));
        let instrument = match Instrument::read(&file) {
            Ok(instrument) => instrument,
            Err(_) => {
                let instrument = calibrated(&whole, (seed << 20) + n, &bench)?;
                instrument.write(&file, Provenance::new("study", seed, &whole))?;
                instrument
            }
        };
        let network = dir.join(format!("network-{n}.checkpoint"));
        // The questions that need a network are asked of the first instrument.
        if n == 0 && size.asks(Question::Reconstruction) && !network.is_file() {
            networks::train(networks, &instrument, &file, seed, &network).with_context(|| format!("network {n}"))?;
        }
        let kind = instruments::kind(size, n);
        let mut subject = Self { kind, bench, config, instrument, sensitivities: Sensitivities::default(), network };
        let file = dir.join(format!("sensitivity-{n}.json"));
        subject.sensitivities = match Self::known(n, dir) {
            Some(known) => known,
            None => {
                let found = subject
                    .look(seed, if size.quota.is_some() { 1 } else { NULLS }, size.is_of_unknown_specimens())
                    .with_context(|| format!("instrument {n}"))?;
                ommatidia_session::artifact::write_whole(&file, &serde_json::to_vec_pretty(&found)?)?;
                found
            }
        };
        Ok(subject)
    }

    /// The sensitivity of the sessions of instrument `n`, as a study in `dir` has measured it.
    pub fn known(n: u64, dir: &Path) -> Option<Sensitivities> {
        let bytes = std::fs::read(dir.join(format!("sensitivity-{n}.json"))).ok()?;
        serde_json::from_slice(&bytes).ok()
    }

    /// Measures a whole session with a bench of this build.
    ///
    /// # Errors
    /// The folder cannot be written.
    pub fn session(&self, bench: &VirtualInstrument, dir: &Path, seed: u64) -> anyhow::Result<Session> {
        Holds::Whole.measure(bench, dir, seed)
    }

    fn look(&self, seed: u64, nulls: u64, of_unknown: bool) -> anyhow::Result<Sensitivities> {
        let mut out = self.determined(Holds::Whole, seed, nulls)?;
        if of_unknown {
            for holds in Holds::UNKNOWN {
                out.of_kinds.insert(holds, self.determined(holds, seed, nulls)?);
            }
            return Ok(out);
        }
        for foreign in &FOREIGN {
            let d = foreign.descriptor();
            let sigma = self.noise_alone(foreign, d.params[0].step, seed)?;
            let (param, unit) = (d.params[0].name.into(), d.params[0].unit.into());
            out.of.insert(d.id.into(), Sensitivity { param, unit, sigma });
        }
        Ok(out)
    }

    /// How well sessions of a kind determine each effect of the catalogue: the standard errors that `close` states
    /// where the effect is absent, medians of `nulls` sessions.
    fn determined(&self, holds: Holds, seed: u64, nulls: u64) -> anyhow::Result<Sensitivities> {
        let mut sigmas: BTreeMap<String, (String, String, Vec<f64>)> = BTreeMap::new();
        let mut out = Sensitivities::default();
        let bench = holds.config(&self.config).build_like(&self.bench, &[])?;
        for i in 0..nulls {
            let folder = tempfile::tempdir()?;
            let session = holds.measure(&bench, &folder.path().join("session"), (seed << 20) + 77_000 + i)?;
            let mut seen = Observations::read(&session, &Budget::default())?;
            let options = CloseOptions { session_name: "null", seed, ..CloseOptions::default() };
            let closed = close(&self.instrument, &mut seen, &options, |_| {})?;
            for r in closed.account.closing.rejected {
                let entry = sigmas.entry(r.id).or_insert_with(|| (r.param, r.unit, Vec::new()));
                entry.2.extend(r.sigma.filter(|s| *s > 0.0 && s.is_finite()));
            }
        }
        for (id, (param, unit, mut values)) in sigmas {
            values.sort_by(f64::total_cmp);
            match values.get(values.len() / 2) {
                Some(sigma) => {
                    out.of.insert(id, Sensitivity { param, unit, sigma: *sigma });
                }
                None => out.cannot.push(id),
            }
        }
        Ok(out)
    }

    /// Standard error of the strength of a foreign effect from the noise of the scenes alone, with the light level
    /// fitted too.
    ///
    /// Of noise, the standard error of its variance: with a variance `v` in units of that of the model, the information
    /// of a pixel is `v^2 / 2` (Gaussian likelihood).
    fn noise_alone(&self, foreign: &'static Foreign, step: f64, seed: u64) -> anyhow::Result<f64> {
        let frames = |bench: &VirtualInstrument| -> anyhow::Result<Vec<ndarray::Array2<f32>>> {
            let folder = tempfile::tempdir()?;
            let dir = folder.path().join("session");
            bench.measure_some(&dir, (seed << 20) + 76_999, &[Role::Scene], |_| {})?;
            let session = Session::open(&dir)?;
            let stack = session.stacks().first().context("no scene was measured")?;
            let mut reader = stack.expected()?.context("the bench wrote no noise-free frames")?;
            (0..stack.len()).map(|i| Ok(reader.read(i)?)).collect()
        };
        let noise = &self.instrument.noise;
        if foreign.noise_only() {
            let information = |frame: &ndarray::Array2<f32>| -> f64 {
                let of = |v: &f32| {
                    let light_dn = (f64::from(*v) - noise.black_level_dn).max(0.0);
                    let added = foreign.added_variance_dn2(light_dn).unwrap_or(0.0);
                    0.5 * (added / noise.variance_dn2(f64::from(*v))).powi(2)
                };
                frame.iter().map(of).sum()
            };
            let information: f64 = frames(&self.bench)?.iter().map(information).sum();
            return Ok(information.max(1e-12).powf(-0.25));
        }
        let with = self.config.build_like(&self.bench, &[])?.with_foreign(foreign, vec![step])?;
        let (clean, changed) = (frames(&self.bench)?, frames(&with)?);
        let (mut dd, mut ds, mut ss) = (0.0, 0.0, 0.0);
        for (a, b) in clean.iter().zip(&changed) {
            for (a, b) in a.iter().zip(b) {
                let (d, s) = (f64::from(b - a) / step, f64::from(*a) - noise.black_level_dn);
                let w = 1.0 / noise.variance_dn2(f64::from(*a));
                dd += w * d * d;
                ds += w * d * s;
                ss += w * s * s;
            }
        }
        Ok(1.0 / (dd - ds * ds / ss).max(1e-12).sqrt())
    }
}

fn calibrated(config: &BenchConfig, seed: u64, like: &VirtualInstrument) -> anyhow::Result<Instrument> {
    let folder = tempfile::tempdir()?;
    let dir = folder.path().join("calibration");
    config.build_like(like, &[])?.measure(&dir, seed, |_| {})?;
    Ok(calibrate(&Session::open(&dir)?, &CalibrateConfig::default(), || {})?.instrument)
}
