//! The decomposition of one lens's bead windows.

use super::planes::Plane;
use crate::linalg::NotConverged;
use crate::psf::decompose::{Decomposition, decompose, fill};
use crate::psf::windows::LensWindows;
use ndarray::{Array1, Array2, Axis, s};

/// Rank of the model that fills in unmeasured pixels before windows are averaged.
const FILL_TERMS: usize = 16;

/// The fitted model of one lens.
#[derive(Clone, Debug)]
pub struct LensFit {
    /// Basis and coefficients at the beads.
    pub decomposition: Decomposition,
    /// Indices of the fitted beads, in the order of the coefficients.
    pub beads: Vec<usize>,
}

/// Decomposes the windows of one lens at `beads` (indices) into at most `max_rank` terms.
///
/// # Errors
/// The windows hold non-finite values.
pub fn fit_lens(windows: &LensWindows, beads: &[usize], max_rank: usize) -> Result<LensFit, NotConverged> {
    let light = windows.light_dn.select(Axis(0), beads);
    let known = windows.known.as_ref().map(|k| k.select(Axis(0), beads));
    let rank = max_rank.min(beads.len());
    let decomposition = decompose(light.view(), known.as_ref().map(|k| k.view()), sigma(windows).view(), rank)?;
    Ok(LensFit { decomposition, beads: beads.to_vec() })
}

/// Standard deviation of the noise of each pixel [px]; 1 where the noise model gives none.
pub(super) fn sigma(windows: &LensWindows) -> Array1<f32> {
    let floor = 1e-6 * windows.variance_dn2.iter().fold(0.0f64, |m, v| m.max(*v));
    windows.variance_dn2.mapv(|v| if floor > 0.0 { v.max(floor).sqrt() as f32 } else { 1.0 })
}

/// The windows of a lens, their unmeasured pixels filled in by the first `rank` terms.
pub(super) fn filled(w: &LensWindows, fit: Option<&LensFit>, rank: usize) -> LensWindows {
    let (Some(known), Some(fit)) = (&w.known, fit) else { return w.clone() };
    let model = fit.decomposition.windows(rank);
    let mut light_dn = w.light_dn.clone();
    for (row, bead) in fit.beads.iter().enumerate() {
        let pixels = light_dn.row_mut(*bead).into_iter().zip(known.row(*bead)).zip(model.row(row));
        pixels.filter(|((_, k), _)| !**k).for_each(|((v, _), m)| *v = *m);
    }
    LensWindows { light_dn, known: None, variance_dn2: w.variance_dn2.clone() }
}

/// The mean PSF of each plane, with constant coefficients: the shift-invariant model.
///
/// Unmeasured pixels are filled in first, as for the low-rank model; otherwise the mean of a pixel would cover some
/// beads only.
pub(super) fn mean_psf(windows: &LensWindows, planes: &[Plane]) -> Result<LensFit, NotConverged> {
    let (count, px) = (planes.iter().map(|p| p.beads.len()).sum(), windows.light_dn.ncols());
    let mut basis = Array2::<f32>::zeros((planes.len(), px));
    let mut coefficients = Array2::zeros((count, planes.len()));
    let mut singular_values = Vec::new();
    let mut row = 0;
    for (k, plane) in planes.iter().enumerate() {
        let mut light = windows.light_dn.select(Axis(0), &plane.beads);
        if let Some(known) = windows.known.as_ref().map(|k| k.select(Axis(0), &plane.beads)) {
            fill(&mut light, known.view(), sigma(windows).view(), FILL_TERMS)?;
        }
        let mean = light.mean_axis(Axis(0)).unwrap_or_else(|| Array1::zeros(light.ncols()));
        let norm = mean.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>().sqrt().max(f64::MIN_POSITIVE);
        basis.row_mut(k).assign(&mean.mapv(|v| (f64::from(v) / norm) as f32));
        coefficients.slice_mut(s![row..row + plane.beads.len(), k]).fill(norm);
        row += plane.beads.len();
        singular_values.push(norm * (plane.beads.len() as f64).sqrt());
    }
    let beads = planes.iter().flat_map(|p| p.beads.clone()).collect();
    Ok(LensFit {
        decomposition: Decomposition { basis, coefficients, singular_values, gram: Array2::zeros((0, 0)) },
        beads,
    })
}
