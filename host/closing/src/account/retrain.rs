//! Fine-tuning of a network on a closed instrument: the interface by which the program that can train joins the loop.

use ommatidia_model::instrument::Instrument;
use ommatidia_session::Session;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Reconstruction before and after fine-tuning, on held-out scenes.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Retrained {
    /// Scenes that were reconstructed.
    pub frames: Vec<usize>,
    /// Steps of fine-tuning.
    pub steps: u64,
    /// Mean PSNR of the network before, dB.
    pub psnr_db_before: f64,
    /// Mean PSNR of the network that was fine-tuned on the closed instrument, dB.
    pub psnr_db_after: f64,
    /// Mean SSIM before.
    pub ssim_before: f64,
    /// Mean SSIM after.
    pub ssim_after: f64,
    /// The control: the network after the same steps on the instrument as it was. Only what the closed instrument gains
    /// beyond it is owed to the loop.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub control: Option<Control>,
}

/// Reconstruction by a network that was fine-tuned on the instrument before the loop.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Control {
    /// Mean PSNR, dB.
    pub psnr_db: f64,
    /// Mean SSIM.
    pub ssim: f64,
}

/// An instrument with its file.
#[derive(Clone, Copy, Debug)]
pub struct Filed<'a> {
    /// The instrument.
    pub instrument: &'a Instrument,
    /// Its file, for the provenance of a checkpoint.
    pub file: &'a Path,
}

/// What a fine-tuning needs.
#[derive(Clone, Copy, Debug)]
pub struct RetrainRequest<'a> {
    /// Session whose scenes, with known objects, judge both networks.
    pub session: &'a Session,
    /// The closed instrument, on which the network is fine-tuned.
    pub closed: Filed<'a>,
    /// The instrument before, on which the control is fine-tuned; None: no control.
    pub before: Option<Filed<'a>>,
    /// Checkpoint of the network before.
    pub checkpoint: &'a Path,
    /// Checkpoint to write.
    pub output: &'a Path,
    /// Scenes that judge: indices in the first scene stack with known objects. None of them took part in a fit.
    pub held_out_frames: &'a [usize],
    /// Steps of fine-tuning.
    pub steps: u64,
    /// Seed of all random draws.
    pub seed: u64,
}

/// Fine-tunes networks. The crate that knows networks implements it; closing the loop needs only this interface.
pub trait Retrain {
    /// Fine-tunes the network, writes it to `request.output` and compares the two on the held-out scenes, with the
    /// control if there is one. Calls `progress` with the number of steps that are done, of all fine-tunings together.
    ///
    /// # Errors
    /// The checkpoint has another size than the instrument, a file cannot be read or written, or the session has no
    /// scene with a known object.
    fn retrain(&self, request: &RetrainRequest<'_>, progress: &mut dyn FnMut(u64)) -> anyhow::Result<Retrained>;
}
