//! How badly bead frames are predicted that a refit has not seen, without their noise.
//!
//! The errors of the windows that the model is fitted to lack one part: each window was moved by a fraction of a pixel
//! to show its bead at the centre of an object pixel. What is finer than two pixels of a sharp focus is aliased, and
//! depends on where the pixels lie; it is lost there, and again where a bead between two pixels is predicted. So the
//! focus is predicted at its place and compared with the frame itself.

use super::replicates::groups;
use crate::bead::{BeadError, BeadScan, corner};
use crate::instrument::Instrument;
use crate::psf::LowRankPsf;
use crate::psf::fit::Plane;
use crate::psf::shift::shifted;
use ndarray::Array2;
use ommatidia_physics::noise::NoiseModel;
use ommatidia_session::Cut;

/// About so many frames of a scan are predicted.
const FRAMES: usize = 64;

/// NRMSE without noise of bead frames, each predicted by the replicate that has not seen it, at its own brightness. 0
/// without replicates.
///
/// # Errors
/// A frame cannot be read.
pub(super) fn error(instrument: &Instrument, scan: &mut BeadScan, planes: &[Plane]) -> Result<f64, BeadError> {
    let count = instrument.replicates.len();
    if count == 0 {
        return Ok(0.0);
    }
    let groups = groups(planes, count);
    let step = scan.beads.len().div_ceil(FRAMES).max(1);
    let mut sums = Sums::default();
    for n in (step / 2..scan.beads.len()).step_by(step) {
        let (frame, cut) = scan.cut_light_dn(n)?;
        let bead = Predicted { instrument, psf: &instrument.replicates[groups[n]], scan, n };
        sums.add(&bead.pixels(&frame, cut.as_ref()), scan.noise());
    }
    Ok(sums.nrmse())
}

/// A bead, and the PSFs that predict it.
struct Predicted<'a> {
    instrument: &'a Instrument,
    psf: &'a LowRankPsf,
    scan: &'a BeadScan,
    n: usize,
}

impl Predicted<'_> {
    /// The measured pixels in the windows of all foci: light, DN, and the predicted light in any unit.
    fn pixels(&self, frame: &Array2<f32>, cut: Option<&Cut>) -> Vec<[f64; 2]> {
        let (bead, geometry) = (&self.scan.beads[self.n], &self.instrument.geometry);
        let [rows, cols] = [self.instrument.manifest.object.rows, self.instrument.manifest.object.cols];
        let whole = [bead.at_px[0].clamp(0.0, rows as f64 - 1.0), bead.at_px[1].clamp(0.0, cols as f64 - 1.0)];
        let whole = whole.map(f64::round);
        let depth = self.psf.depth_nearest(bead.z_um);
        let mut pixels = Vec::new();
        for lens in (0..geometry.dead.len()).filter(|l| !geometry.dead[*l]) {
            let window = self.psf.window(lens, whole, depth).mapv(|v| v as f32);
            let here = shifted(window.view(), [0, 1].map(|a| bead.at_px[a] - whole[a]), 0);
            let half = (window.nrows() / 2) as isize;
            let first = corner(&self.instrument.manifest, geometry, lens);
            for ((r, c), v) in here.indexed_iter() {
                let at = [
                    first[0] + whole[0] as isize + r as isize - half,
                    first[1] + whole[1] as isize + c as isize - half,
                ];
                let [Ok(row), Ok(col)] = at.map(usize::try_from) else { continue };
                let measured = cut.is_none_or(|cut| cut.holds(row, col));
                match frame.get((row, col)) {
                    Some(y) if y.is_finite() && measured && self.scan.useful([row, col]) => {
                        pixels.push([f64::from(*y), f64::from(*v)]);
                    }
                    _ => {}
                }
            }
        }
        pixels
    }
}

/// Sums over frames, DN^2.
#[derive(Default)]
struct Sums {
    /// Squared differences, without what noise makes of them.
    excess: f64,
    /// Squares of the predicted light.
    light: f64,
}

impl Sums {
    /// Adds the pixels of a frame; its brightness is the one that fits best.
    fn add(&mut self, pixels: &[[f64; 2]], noise: &NoiseModel) {
        let product = |i: usize, j: usize| pixels.iter().map(|p| p[i] * p[j]).sum::<f64>();
        let scale = product(0, 1) / product(1, 1).max(f64::MIN_POSITIVE);
        for [y, v] in pixels {
            let expected = scale * v;
            self.excess += (y - expected).powi(2) - noise.variance_dn2(noise.black_level_dn + expected);
            self.light += expected * expected;
        }
    }

    fn nrmse(&self) -> f64 {
        if self.light > 0.0 { (self.excess / self.light).max(0.0).sqrt() } else { 0.0 }
    }
}
