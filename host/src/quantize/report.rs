//! What making the network file cost, seen on the held-out frames of the checkpoint.

use super::QuantizeError;
use super::bank::PlannedBank;
use crate::evaluate::{Case, compare};
use crate::methods::{Blob, FloatNetwork, Reconstruct};
use crate::train::{Checkpoint, Support};
use ommatidia_shared::blob::{Header, MemoryPlan, Size};
use ommatidia_shared::device::Footprint;
use serde::Serialize;

/// Mean figures over the held-out frames.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Quality {
    /// Peak signal-to-noise ratio, dB.
    pub psnr_db: f64,
    /// Structural similarity.
    pub ssim: f64,
}

/// The network after one step on its way to the device.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Step {
    /// What was done.
    pub step: &'static str,
    /// How good the network is after it.
    #[serde(flatten)]
    pub quality: Quality,
}

/// What a network file is and what it cost.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct QuantizeReport {
    /// Length of the file.
    pub file_bytes: usize,
    /// Of this, the filters: spectra, or blocks of lags with their index.
    #[serde(rename = "spectra_bytes")]
    pub filter_bytes: usize,
    /// What the spectra of all filters would take, none pruned.
    pub dense_filter_bytes: usize,
    /// Of this, weights of the enhancement.
    pub rcan_bytes: usize,
    /// Fast scratch that it needs.
    pub fast_bytes: u32,
    /// Bulk memory that it needs.
    pub bulk_bytes: u32,
    /// Raw frame.
    pub frame_bytes: u32,
    /// Reconstruction.
    pub object_bytes: u32,
    /// Variables and stack of the program, at most.
    pub program_bytes: u32,
    /// All of the device's memory: scratch, bulk, frame, reconstruction, program.
    pub ram_bytes: u64,
    /// Side of the transforms, pixels.
    pub tile: u16,
    /// Taps of the filters.
    pub taps: usize,
    /// Blocks of lags that the filters are pruned to; 0 where the file holds spectra.
    pub blocks: usize,
    /// Side of a block, lags; 0 where the file holds spectra.
    pub block_side: usize,
    /// Part of the filters' energy that is kept.
    pub energy_kept: f64,
    /// The filters are multiplied by two to this power.
    pub scale_log2: i32,
    /// Held-out frames that the figures are means over.
    pub frames: usize,
    /// The network after each step.
    pub steps: Vec<Step>,
    /// Peak signal-to-noise ratio of the float network minus that of the file, dB.
    pub loss_db: f64,
}

impl QuantizeReport {
    pub(super) fn new(
        checkpoint: &Checkpoint,
        bank: &PlannedBank,
        header: &Header,
        bytes: &[u8],
        [filter_bytes, rcan_bytes]: [usize; 2],
    ) -> Result<Self, QuantizeError> {
        let cases = &checkpoint.cases;
        let mut steps = Vec::new();
        let mut add = |step, method: &dyn Reconstruct| -> Result<f64, QuantizeError> {
            let quality = judge(method, cases)?;
            steps.push(Step { step, quality });
            Ok(quality.psnr_db)
        };
        let float = add("float", &FloatNetwork::new(checkpoint)?)?;
        if let Some(support) = &bank.support {
            let mut pruned = checkpoint.clone();
            pruned.weights.extend(bank.filters.clone());
            let step = if matches!(support, Support::Taps { .. }) { "taps" } else { "blocks" };
            add(step, &FloatNetwork::new(&pruned)?)?;
        }
        let blocks = header.bank.blocks;
        let network = &checkpoint.body.network;
        let refused = |error: anyhow::Error| QuantizeError::Case { index: 0, detail: error.to_string() };
        let file = add("file", &Blob::new(bytes.to_vec()).map_err(|e| refused(e.into()))?)?;
        Ok(Self {
            file_bytes: bytes.len(),
            filter_bytes,
            dense_filter_bytes: 2 * network.channels * network.filter_size * (network.filter_size + 2),
            rcan_bytes,
            fast_bytes: header.memory.fast_bytes,
            bulk_bytes: header.memory.bulk_bytes,
            frame_bytes: plane_bytes(header.frame),
            object_bytes: plane_bytes(header.object),
            program_bytes: Footprint::MOST_RAM,
            ram_bytes: ram_bytes(header),
            tile: header.bank.tile,
            taps: header.bank.taps.len(),
            blocks: blocks.map_or(0, |b| b.count.into()),
            block_side: blocks.map_or(0, |b| b.side.into()),
            energy_kept: bank.energy_kept,
            scale_log2: bank.scale_log2,
            frames: cases.len(),
            steps,
            loss_db: float - file,
        })
    }
}

/// Memory that a device needs for a network, bytes, its program included.
pub(super) fn ram_bytes(header: &Header) -> u64 {
    let MemoryPlan { fast_bytes, bulk_bytes } = header.memory;
    let planes = [header.frame, header.object].map(plane_bytes);
    [fast_bytes, bulk_bytes, planes[0], planes[1], Footprint::MOST_RAM].into_iter().map(u64::from).sum()
}

/// Two bytes a pixel.
fn plane_bytes(size: Size) -> u32 {
    2 * u32::from(size.rows) * u32::from(size.cols)
}

/// Mean figures of a method.
fn judge(method: &dyn Reconstruct, cases: &[Case]) -> Result<Quality, QuantizeError> {
    let mut mean = Quality { psnr_db: 0.0, ssim: 0.0 };
    for (index, case) in cases.iter().enumerate() {
        let refused = |detail: String| QuantizeError::Case { index, detail };
        let found = method.reconstruct(case.frame_dn.view()).map_err(|e| refused(e.to_string()))?;
        let figures = compare(found.view(), case.truth.view()).map_err(|e| refused(e.to_string()))?;
        mean.psnr_db += figures.psnr_db / cases.len() as f64;
        mean.ssim += figures.ssim / cases.len() as f64;
    }
    Ok(mean)
}
