//! The light of a frame's object behind the optics, and how it changes if every PSF is wider.
//!
//! A displacement d(x) of the object moves an image q -> q + d. Where d is a scale s, that would widen the PSFs with
//! the image, by a factor 1 + s that no truth can cause. With H a PSF over p = q - x, its widening is
//! ```text
//! H(p / (1 + s)) / (1 + s)^2 = H(p) - s G(p) + O(s^2),   G = div(p H)
//! ```
//! so that s times the image under the PSFs G takes it back.

use ndarray::{Array4, Axis, Zip};
use ommatidia_model::forward::SceneLight;
use ommatidia_model::instrument::Instrument;

/// The light of an object behind the optics.
#[derive(Clone, Debug)]
pub struct Scene {
    /// Under the PSFs of the instrument.
    pub light: SceneLight,
    /// Under the PSFs `G`; None: the place of the object is exact.
    pub(super) wider: Option<SceneLight>,
}

/// The instrument with the PSFs `G` in place of its own.
pub(super) fn widening(instrument: &Instrument) -> Instrument {
    let mut it = Instrument { effects: Vec::new(), replicates: Vec::new(), ..instrument.clone() };
    it.psf.basis = divergence(&instrument.psf.basis);
    it
}

/// `div(p H)` of the last two axes of `basis`, with p from the centre of the window; zero outside. Derivatives are
/// central differences of fourth order.
fn divergence(basis: &Array4<f32>) -> Array4<f32> {
    const WEIGHTS: [f32; 5] = [1.0 / 12.0, -8.0 / 12.0, 0.0, 8.0 / 12.0, -1.0 / 12.0];
    let mut out = Array4::zeros(basis.dim());
    for axis in [2, 3] {
        Zip::from(basis.lanes(Axis(axis))).and(out.lanes_mut(Axis(axis))).for_each(|from, mut to| {
            let centre = (from.len() as f32 - 1.0) / 2.0;
            for (i, out) in to.iter_mut().enumerate() {
                for (k, weight) in WEIGHTS.iter().enumerate() {
                    let Some(value) = (i + k).checked_sub(2).and_then(|j| Some((j, from.get(j)?))) else { continue };
                    *out += weight * (value.0 as f32 - centre) * value.1;
                }
            }
        });
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wider_gaussian_is_the_gaussian_less_its_divergence() {
        let gaussian = |sigma: f32| {
            Array4::from_shape_fn((1, 1, 21, 21), |(_, _, r, c)| {
                let square = (r as f32 - 10.0).powi(2) + (c as f32 - 10.0).powi(2);
                (-square / (2.0 * sigma * sigma)).exp() / (sigma * sigma)
            })
        };
        let (before, after) = (gaussian(2.0), gaussian(2.02));
        let predicted = &before - &(0.01 * &divergence(&before));
        let norm = |a: &Array4<f32>| a.iter().map(|v| v * v).sum::<f32>().sqrt();
        assert!(norm(&(&predicted - &after)) < 0.05 * norm(&(&before - &after)));
    }
}
