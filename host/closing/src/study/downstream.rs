//! What closing the loop is worth to the picture: a network that was fine-tuned on the closed instrument beside one
//! that was fine-tuned on the true instrument.
//!
//! Both start from one network, trained on the calibrated instrument, and take the same steps on the same scenes; both
//! reconstruct frames of another session of the changed instrument. The true instrument is the calibrated one with the
//! injected effects at their true values.

use super::networks::Networks;
use super::subject::Subject;
use crate::{Filed, RetrainRequest, Retrained};
use ommatidia_bench::VirtualInstrument;
use ommatidia_model::instrument::Instrument;
use ommatidia_physics::effects::EffectSetting;
use ommatidia_session::artifact::Provenance;
use serde::{Deserialize, Serialize};

/// Steps of fine-tuning.
const FINE_STEPS: u64 = 1000;

/// Mean PSNR of reconstructions of held-out scenes, dB.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Reconstruction {
    /// Of the network that was trained on the calibrated instrument.
    pub before_db: f64,
    /// Fine-tuned on the closed instrument.
    pub closed_db: f64,
    /// Fine-tuned on the true instrument.
    pub truth_db: f64,
}

/// What is compared with the true instrument.
pub struct Comparison<'a> {
    /// The instrument under study.
    pub subject: &'a Subject,
    /// Its bench with the injected effects, which measures the scenes.
    pub bench: &'a VirtualInstrument,
    /// The closed instrument.
    pub closed: &'a Instrument,
    /// The injected effects.
    pub injected: &'a [EffectSetting],
    /// Seed of all random draws.
    pub seed: u64,
}

/// Compares the two fine-tuned networks on another session of the changed bench.
///
/// # Errors
/// A file cannot be written, or a training fails.
pub fn compare(networks: &dyn Networks, case: &Comparison<'_>) -> anyhow::Result<Reconstruction> {
    let Comparison { subject, bench, closed, injected, seed } = *case;
    let folder = tempfile::tempdir()?;
    let session = subject.session(bench, &folder.path().join("session"), seed ^ 0xd015)?;
    let frames: Vec<usize> = (0..subject.config.stacks.scene_frames).collect();
    let tuned = |name: &str, instrument: &Instrument| -> anyhow::Result<Retrained> {
        let [file, network] = ["instrument", "network"].map(|suffix| folder.path().join(format!("{name}.{suffix}")));
        instrument.write(&file, Provenance::new("study", seed, &injected))?;
        let request = RetrainRequest {
            session: &session,
            closed: Filed { instrument, file: &file },
            before: None,
            checkpoint: &subject.network,
            output: &network,
            held_out_frames: &frames,
            steps: FINE_STEPS,
            seed,
        };
        networks.retrain(&request, &mut |_| {})
    };
    let truth = Instrument { effects: injected.to_vec(), ..subject.instrument.clone() };
    let (closed, truth) = (tuned("closed", closed)?, tuned("true", &truth)?);
    Ok(Reconstruction {
        before_db: closed.psnr_db_before,
        closed_db: closed.psnr_db_after,
        truth_db: truth.psnr_db_after,
    })
}
