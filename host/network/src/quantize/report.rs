//! Size of a network file, and its quality on the held-out frames of the checkpoint.

use super::QuantizeError;
use super::bank::PlannedBank;
use crate::methods::{FloatNetwork, Reconstruct};
use crate::network_file::NetworkFile;
use crate::train::{Checkpoint, FilterMask};
use crate::watch::{WatchFigures, WatchMaps};
use ommatidia_model::metrics::{Case, compare};
use ommatidia_shared::blob::{Header, MemoryPlan, Size};
use ommatidia_shared::device::Footprint;
use serde::Serialize;
use std::path::Path;

/// Mean figures over the held-out frames.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Quality {
    /// Peak signal-to-noise ratio, dB.
    pub psnr_db: f64,
    /// Structural similarity.
    pub ssim: f64,
}

/// Quality of the network after one step of quantization.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Step {
    /// The step: `float`, `taps` or `blocks`, `file`; for a file in integers `halves` before it.
    pub step: &'static str,
    /// Quality after the step.
    #[serde(flatten)]
    pub quality: Quality,
}

/// Sizes of a network file, and the network's quality before and after.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct QuantizeReport {
    /// Length of the file, bytes.
    pub file_bytes: usize,
    /// Filters in the file, bytes: spectra, or blocks of lags with their index.
    #[serde(rename = "spectra_bytes")]
    pub filter_bytes: usize,
    /// Size of the spectra of all filters without pruning, bytes.
    pub dense_filter_bytes: usize,
    /// Weights of the enhancement network in the file, bytes.
    pub rcan_bytes: usize,
    /// The model of the PSFs that predicts frames for later passes, bytes; 0 for one pass.
    pub predictor_bytes: usize,
    /// Number of passes.
    pub passes: usize,
    /// Fast scratch memory of a device, bytes.
    pub fast_bytes: u32,
    /// Bulk memory of a device, bytes.
    pub bulk_bytes: u32,
    /// Raw frame, bytes.
    pub frame_bytes: u32,
    /// Reconstruction, bytes.
    pub object_bytes: u32,
    /// Upper bound of the program's variables and stack, bytes.
    pub program_bytes: u32,
    /// Total memory of a device, bytes: scratch, bulk, frame, reconstruction, program.
    pub ram_bytes: u64,
    /// Side of the transforms, pixels.
    pub tile: u16,
    /// Number of taps of the filters.
    pub taps: usize,
    /// Number of blocks of lags that the filters are pruned to; 0 where the file holds spectra.
    pub blocks: usize,
    /// Side of a block, lags; 0 where the file holds spectra.
    pub block_side: usize,
    /// Fraction of the filters' energy that is kept.
    pub energy_kept: f64,
    /// The filters are multiplied by 2 to this power.
    pub scale_log2: i32,
    /// Number of held-out frames that the figures are means over.
    pub frames: usize,
    /// Quality after each step.
    pub steps: Vec<Step>,
    /// Peak signal-to-noise ratio of the float network minus that of the file, dB.
    pub loss_db: f64,
    /// The same of the file in halves minus that of this file in integers, dB.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub loss_to_halves_db: Option<f64>,
    /// What the watch on the optics is worth.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub watch: Option<WatchFigures>,
}

/// A file that was made, and the lengths of its parts.
pub(super) struct MadeFile<'a> {
    /// Header of the file.
    pub header: &'a Header,
    /// The whole file.
    pub bytes: &'a [u8],
    /// Length of the filters and their index, bytes.
    pub filter_bytes: usize,
    /// Length of the weights of the enhancement network, bytes.
    pub rcan_bytes: usize,
    /// Length of the model that predicts frames, bytes.
    pub predictor_bytes: usize,
    /// The watch on the optics.
    pub watch: Option<&'a WatchMaps>,
}

impl QuantizeReport {
    /// `halves`: the same network in halves, for a file in integers.
    pub(super) fn new(
        checkpoint: &Checkpoint,
        bank: &PlannedBank,
        file: &MadeFile<'_>,
        halves: Option<Vec<u8>>,
    ) -> Result<Self, QuantizeError> {
        let MadeFile { header, bytes, filter_bytes, rcan_bytes, predictor_bytes, watch } = *file;
        let cases = &checkpoint.cases;
        let mut steps = Vec::new();
        let mut add = |step, method: &dyn Reconstruct| -> Result<f64, QuantizeError> {
            let quality = judge(method, cases)?;
            steps.push(Step { step, quality });
            Ok(quality.psnr_db)
        };
        let float = add("float", &FloatNetwork::new(checkpoint)?)?;
        if let Some(mask) = &bank.mask {
            let mut pruned = checkpoint.clone();
            pruned.weights.extend(bank.filters.clone());
            let step = if matches!(mask, FilterMask::Taps { .. }) { "taps" } else { "blocks" };
            add(step, &FloatNetwork::new(&pruned)?)?;
        }
        let blocks = header.bank.blocks;
        let network = &checkpoint.body.network;
        let read = |bytes: &[u8]| {
            NetworkFile::from_bytes(Path::new("network file"), bytes)
                .map_err(|error| QuantizeError::Case { index: 0, detail: error.to_string() })
        };
        let halves = halves.map(|bytes| add("halves", &read(&bytes)?)).transpose()?;
        let quantized = add("file", &read(bytes)?)?;
        Ok(Self {
            file_bytes: bytes.len(),
            filter_bytes,
            dense_filter_bytes: 2 * network.channels * network.filter_size * (network.filter_size + 2),
            rcan_bytes,
            predictor_bytes,
            passes: network.passes(),
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
            loss_db: float - quantized,
            loss_to_halves_db: halves.map(|halves| halves - quantized),
            watch: watch.map(|watch| {
                let noise = &checkpoint.body.noise;
                watch.figures(noise.saturation_dn - noise.black_level_dn)
            }),
        })
    }
}

/// Memory that a device needs for a network, bytes, its program included.
pub(super) fn ram_bytes(header: &Header) -> u64 {
    let MemoryPlan { fast_bytes, bulk_bytes } = header.memory;
    let planes = [header.frame, header.object].map(plane_bytes);
    [fast_bytes, bulk_bytes, planes[0], planes[1], Footprint::MOST_RAM].into_iter().map(u64::from).sum()
}

/// Size of an image on the device, bytes: two bytes a pixel.
fn plane_bytes(size: Size) -> u32 {
    2 * u32::from(size.rows) * u32::from(size.cols)
}

/// Mean figures of a method over `cases`.
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
