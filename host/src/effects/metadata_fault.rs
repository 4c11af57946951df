//! Metadata fault: the frame is correct, but the session's record of it is not.
//!
//! `exposure_factor` is the true exposure over the written one. `swapped_with_next`: the truths of the frame and of the
//! next one are exchanged. `flip_rows` and `flip_cols`: the written truth is upside down, or mirrored left to right.
//! `frame` is the index of the frame in its stack; -1 stands for all frames (exchanged are 0 with 1, 2 with 3, ...).
//! Flags are on from 1/2. With the same parameters, the bench writes a wrong record and the model corrects it.

use super::context::{FrameContext, Record};
use super::descriptor::{Descriptor, Lookalike, Param, Stage};
use super::effect::Effect;
use super::evidence::{Evidence, EvidenceFrame};

/// The effect; its formula is in the documentation of the module.
pub(super) struct MetadataFault;

const fn flag(name: &'static str) -> Param {
    Param::strength(name, "0 or 1", 1.0, 0.0, 1.0)
}

static DESCRIPTOR: Descriptor = Descriptor {
    id: "metadata_fault",
    stage: Stage::Record,
    summary: "wrong exposure, or truth flipped or exchanged with the next: the record is wrong, not the frame",
    params: &[
        Param::strength("exposure_factor", "1", 0.01, 0.001, 1000.0).off_at(1.0),
        flag("swapped_with_next"),
        flag("flip_rows"),
        flag("flip_cols"),
        Param::choice("frame", "1", -1.0, [-1.0, 1e9]),
    ],
    lookalikes: &[
        Lookalike { id: "stage_scale", separate_by: "check the units and axes in the session's tables" },
        Lookalike {
            id: "exposure_offset",
            separate_by: "two exposures: an exposure offset matters less in the longer one",
        },
        Lookalike { id: "lamp_drift", separate_by: "the frames before and after: a lamp drift is gradual" },
    ],
};

impl Effect for MetadataFault {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn on_record(&self, p: &[f64], record: &mut Record, cx: &FrameContext<'_>) {
        let every = p[4] < 0.0;
        let which = p[4].max(0.0) as usize;
        if p[1] >= 0.5 {
            record.truth = exchanged(record.truth, if every { None } else { Some(which) }, record.frames);
        }
        if every || cx.frame == which {
            record.exposure_factor *= p[0];
            record.flip_rows ^= p[2] >= 0.5;
            record.flip_cols ^= p[3] >= 0.5;
        }
    }

    /// All frames, and each of the two frames that fit worst.
    fn guess(&self, evidence: &Evidence<'_>) -> Vec<Vec<f64>> {
        let misfit = |f: &EvidenceFrame<'_>| -> f64 {
            f.residual_dn.iter().zip(&f.weight).map(|(r, w)| f64::from(r * r * w)).sum()
        };
        let mut worst: Vec<(f64, usize)> = evidence.frames.iter().map(|f| (misfit(f), f.cx.frame)).collect();
        worst.sort_by(|a, b| b.0.total_cmp(&a.0));
        let frames = worst.into_iter().take(2).map(|(_, frame)| frame as f64);
        std::iter::once(-1.0).chain(frames).map(|frame| vec![1.0, 0.0, 0.0, 0.0, frame]).collect()
    }
}

/// Index of frame `i` after `which` and the next frame are exchanged; with `None`, after each even frame and the next
/// are. The last frame has no next.
fn exchanged(i: usize, which: Option<usize>, frames: usize) -> usize {
    let first = which.unwrap_or(i - i % 2);
    if first + 1 >= frames {
        i
    } else if i == first {
        first + 1
    } else if i == first + 1 {
        first
    } else {
        i
    }
}
