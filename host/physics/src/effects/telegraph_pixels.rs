//! Telegraph pixels: a few pixels jump between two levels from frame to frame (random telegraph noise).
//!
//! In a `share` of the pixels `y -> y + amplitude_dn (b - 1/2)` with b = 0 or 1, each with probability 1/2 in every
//! frame: the traps of these pixels change their state faster than frames follow each other. The expected frame does
//! not change. Source: Janesick et al., Proc. SPIE 6276, 62760M, 2006. Pixels with such noise show in repeats: a few
//! differences are much larger than the noise, and the fourth moment of all differences exceeds that of normal noise.

use super::context::FrameContext;
use super::descriptor::{Descriptor, Lookalike, Param, Stage};
use super::effect::Effect;
use super::evidence::{Evidence, EvidenceFrame};
use ndarray::Array2;
use ommatidia_session::{Role, rng};
use rand::{Rng, RngExt};

/// The effect; its formula is in the documentation of the module.
pub(super) struct TelegraphPixels;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "telegraph_pixels",
    stage: Stage::Electronics,
    summary: "y + amplitude (b - 1/2) in a share of the pixels, b a random bit of each frame: they jump between \
              two levels",
    params: &[
        // A trap holds one electron near the gate of the amplifier: hundreds of DN are another fault.
        Param::square("amplitude_dn", "DN", 4.0, 1000.0),
        Param::shape("share", "1", 0.003, 0.001, [1e-5, 0.1], &[0.0003, 0.001, 0.003, 0.01]),
        Param::choice("seed", "1", 1.0, [0.0, 1e9]),
    ],
    lookalikes: &[
        Lookalike {
            id: "noise_scale",
            separate_by: "histogram of differences of two darks: a wrong gain or read noise has no wings",
        },
        Lookalike { id: "hot_pixels", separate_by: "many darks at one exposure: hot pixels keep their level" },
        Lookalike { id: "dsnu", separate_by: "many darks: an offset is the same in every one of them" },
    ],
};

/// A difference of two repeats is a jump beyond so many of its standard deviations: of 5 10^8 normal numbers one is.
const JUMP: f64 = 6.0;
/// Jumps must lie so many standard deviations off in the middle (median): all of them are counted then.
const ALL: f64 = 8.0;
/// Number of jumps that this takes in all frames.
const FEW: usize = 6;

/// Pairs of repeats count whose noise is at most so many times that of the quietest: in brighter light jumps drown.
const QUIET: f64 = 1.3;

/// Share of the pixels that jump between two levels; None: jumps do not stand out of the noise. In one of two pairs of
/// repeats such a pixel has the same level in both.
fn jumping(evidence: &Evidence<'_>) -> Option<f64> {
    let even = |f: &&EvidenceFrame<'_>| matches!(f.cx.role, Role::Dark | Role::Flat);
    let frames: Vec<&EvidenceFrame<'_>> = evidence.frames.iter().filter(even).collect();
    // Of each pair the standard deviation of the noise, DN, and the absolute differences, DN.
    let mut pairs: Vec<(f64, Vec<f64>)> = Vec::new();
    let mut k = 0;
    while let Some(pair) = frames.get(k..k + 2) {
        let [a, b] = [&pair[0].cx, &pair[1].cx];
        if a.role != b.role || a.exposure_ms != b.exposure_ms || a.illumination != b.illumination {
            k += 1;
            continue;
        }
        k += 2;
        let change = &pair[1].residual_dn - &pair[0].residual_dn;
        let used = change.iter().zip(&pair[0].weight).filter(|(_, w)| **w > 0.0);
        let (mut far, mut variance) = (Vec::new(), 0.0);
        for (d, w) in used {
            far.push(f64::from(d.abs()));
            variance += 2.0 / f64::from(*w);
        }
        let (middle, n) = (far.len() / 2, far.len() as f64);
        if far.is_empty() {
            continue;
        }
        // The noise may be a little larger than the model has it, and that of few codes has no smooth median.
        let (_, median, _) = far.select_nth_unstable_by(middle, f64::total_cmp);
        let sigma = (*median / MEDIAN).max((variance / n).sqrt());
        pairs.push((sigma, far));
    }
    let least = pairs.iter().map(|(sigma, _)| *sigma).fold(f64::INFINITY, f64::min);
    pairs.retain(|(sigma, _)| *sigma <= QUIET * least);
    let pixels: usize = pairs.iter().map(|(_, far)| far.len()).sum();
    let in_sigmas = pairs.iter().flat_map(|(sigma, far)| far.iter().map(move |d| d / sigma));
    let mut jumps: Vec<f64> = in_sigmas.filter(|z| *z > JUMP).collect();
    jumps.sort_by(f64::total_cmp);
    let median = jumps.get(jumps.len() / 2)?;
    (jumps.len() >= FEW && *median > ALL).then(|| 2.0 * jumps.len() as f64 / pixels as f64)
}

/// Median of the absolute value of a normal number of variance 1.
const MEDIAN: f64 = 0.674_490;
impl Effect for TelegraphPixels {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn on_reading(&self, p: &[f64], frame_dn: &mut Array2<f32>, _cx: &FrameContext<'_>, rng: &mut dyn Rng) {
        if p[0] == 0.0 || frame_dn.is_empty() {
            return;
        }
        let (rows, cols) = frame_dn.dim();
        // The same pixels in every frame.
        let mut places = rng::stream(p[2].max(0.0) as u64, "effects/telegraph_pixels", 0);
        let number = (p[1] * frame_dn.len() as f64).ceil() as usize;
        for _ in 0..number.min(frame_dn.len()) {
            let at = [places.random_range(0..rows), places.random_range(0..cols)];
            let sign = if rng.next_u32() & 1 == 0 { -0.5 } else { 0.5 };
            frame_dn[at] += (p[0] * sign) as f32;
        }
    }

    /// The share of the pixels that jump, where jumps stand out of the noise. The variance shows amplitude^2 share
    /// alone.
    fn guess(&self, evidence: &Evidence<'_>) -> Vec<Vec<f64>> {
        jumping(evidence).into_iter().map(|share| vec![0.0, share.clamp(1e-5, 0.1), 1.0]).collect()
    }

    fn makes_wings(&self) -> bool {
        true
    }

    fn noise_only(&self) -> bool {
        true
    }
}
