//! Measures a session: darks, flats, a bead scan, and scenes with their truth.

use super::error::BenchError;
use super::instrument::{Draw, Summary, VirtualInstrument};
use super::stacks::CALIBRATION_ROLES;
use super::truth::{BenchTruth, TRUTH_FILE};
use ommatidia_session::{Existing, MANIFEST, Role, SessionWriter};
use std::collections::BTreeMap;
use std::path::Path;

/// Whether a file of this name belongs to a session of the virtual instrument: nothing else may be lost with its
/// folder.
pub fn virtual_session(name: &str) -> bool {
    let of_stack = |name: &str| ["dark", "flat", "bead", "scene"].iter().any(|role| name.starts_with(role));
    let (_, suffix) = name.rsplit_once('.').unwrap_or(("", ""));
    name == MANIFEST || name == TRUTH_FILE || (of_stack(name) && matches!(suffix, "npy" | "tif" | "csv"))
}

impl VirtualInstrument {
    /// Number of frames of a whole session.
    pub fn frames(&self) -> usize {
        self.counts().values().sum()
    }

    fn counts(&self) -> BTreeMap<&'static str, usize> {
        let (stacks, scan) = (&self.config.stacks, &self.config.scan);
        BTreeMap::from([
            ("dark", stacks.dark_frames * self.config.dark_exposures_ms().len()),
            ("flat", stacks.flat_levels.len() * stacks.flat_frames * self.config.flat_exposures_ms().len()),
            ("bead", scan.rows * scan.cols * scan.depths_um.len()),
            ("scene", self.config.scene_count()),
        ])
    }

    /// Measures a session into folder `target`, which appears complete or not at all. `seed` selects noise and scenes;
    /// `done` is called with the number of newly measured frames. An existing virtual session is replaced.
    ///
    /// # Errors
    /// `target` exists and is not a virtual session, or it cannot be written.
    pub fn measure(&self, target: &Path, seed: u64, done: impl Fn(usize) + Sync) -> Result<Summary, BenchError> {
        self.measure_some(target, seed, &[Role::Dark, Role::Flat, Role::Bead, Role::Scene], done)
    }

    /// As [`VirtualInstrument::measure`], but only the stacks of some roles, each with the same bits as in a whole
    /// session.
    ///
    /// # Errors
    /// As [`VirtualInstrument::measure`].
    pub fn measure_some(
        &self,
        target: &Path,
        seed: u64,
        roles: &[Role],
        done: impl Fn(usize) + Sync,
    ) -> Result<Summary, BenchError> {
        let mut writer = SessionWriter::create(target, &self.config.manifest(), Existing::ReplaceIfHas(TRUTH_FILE))?;
        let has = |role: Role| roles.contains(&role);
        let mut bead_peak_e = 0.0;
        for role in CALIBRATION_ROLES.into_iter().filter(|r| has(*r)) {
            let peak_e = self.stack(&mut writer, Draw { role, seed }, &done)?;
            if role == Role::Bead {
                bead_peak_e = peak_e;
            }
        }
        let scene_peak_e = if has(Role::Scene) { self.specimens(&mut writer, seed, &done)? } else { 0.0 };
        writer.extra(TRUTH_FILE, self.truth(seed)?.as_bytes())?;
        writer.finish()?;
        let mut frames = self.counts();
        frames.retain(|name, _| roles.iter().any(|r| r.name() == *name));
        Ok(Summary { frames, bead_peak_e, scene_peak_e, full_scale_e: self.config.full_scale_e() })
    }

    /// The ground truth of the session, as JSON.
    fn truth(&self, seed: u64) -> Result<String, BenchError> {
        let per_row = |v: Vec<[f64; 2]>| v.chunks(self.config.array.cols).map(<[_]>::to_vec).collect();
        let truth = BenchTruth {
            program: concat!("ommatidia ", env!("CARGO_PKG_VERSION")).into(),
            seed,
            gain_dn_per_e: self.config.sensor.gain_dn_per_e,
            read_noise_e: self.config.sensor.read_noise_e,
            black_level_dn: self.config.sensor.black_level_dn,
            anchors_px: per_row(self.anchors_px.clone()),
            magnification: self.config.true_magnification(),
            axes_um: per_row(self.optics.axes_um()),
            unit_e: self.config.scan.bead_e,
            effects: self.settings.clone(),
            config: self.config.clone(),
        };
        let json = serde_json::to_string_pretty(&truth);
        json.map_err(|e| BenchError::Syntax { path: TRUTH_FILE.into(), detail: e.to_string() })
    }
}
