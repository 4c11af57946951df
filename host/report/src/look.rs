//! Which colours a picture gets: the rules that a report and the browser's view share.

use super::colour::ColourMap;
use super::picture::Scale;
use ndarray::ArrayView2;
use ommatidia_session::ArrayGeometry;

/// Columns in which pictures of all lenses are laid out: those of the grid, or nearly as many as rows.
pub fn tile_columns(array: &ArrayGeometry) -> usize {
    match array.lenses_px {
        None => array.cols.max(1),
        Some(_) => (array.lenses() as f64).sqrt().ceil().max(1.0) as usize,
    }
}

/// What a picture shows, which decides its colours and their range.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Look {
    /// A raw frame.
    Raw,
    /// Light of an object: truth or reconstruction.
    Light,
    /// A residual, standard deviations.
    Residual,
    /// One value for each pixel of the sensor.
    Map,
}

/// Ends of the colour scale of residuals, standard deviations.
pub const RESIDUAL_LIMIT: f64 = 4.0;

/// The scale of every residual, whatever its values: two of them are compared by eye.
pub fn residuals() -> Scale {
    Scale::linear(-RESIDUAL_LIMIT, RESIDUAL_LIMIT, ColourMap::Diverging)
}

impl Look {
    /// Colours and their range for one picture.
    ///
    /// Raw frames and maps go from the 1st to the 99.8th percentile, so that neither a defect nor a glint sets the
    /// scale. Light goes from 0 (the 1st percentile, if that is negative) to the 99.7th percentile. Where so few pixels
    /// are lit, the end is the maximum. Residuals have one range.
    pub fn scale(self, image: ArrayView2<'_, f32>) -> Scale {
        let mut values: Vec<f32> = image.iter().copied().filter(|v| v.is_finite()).collect();
        let mut at = |q: f64| percentile(&mut values, q);
        let low = at(0.01);
        let (low, high, map) = match self {
            Self::Raw => (low, at(0.998), ColourMap::Grey),
            Self::Map => (low, at(0.998), ColourMap::Viridis),
            Self::Light => (low.min(0.0), at(0.997), ColourMap::Inferno),
            Self::Residual => return residuals(),
        };
        Scale::linear(low, if high > low { high } else { at(1.0) }, map)
    }
}

/// The value that a share `q` of the values does not exceed; 0 of no values.
fn percentile(values: &mut [f32], q: f64) -> f64 {
    let at = (q * values.len().saturating_sub(1) as f64) as usize;
    if values.is_empty() { 0.0 } else { f64::from(*values.select_nth_unstable_by(at, f32::total_cmp).1) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array2;

    #[test]
    fn neither_a_defect_nor_a_glint_sets_the_scale() {
        let mut image = Array2::from_shape_fn((50, 40), |(r, c)| (40 * r + c) as f32);
        (image[[3, 3]], image[[9, 9]], image[[0, 0]]) = (1e9, -1e9, f32::NAN);
        let of = |look: Look, image: &Array2<f32>| {
            let Scale { low, high, .. } = look.scale(image.view());
            [low, high]
        };
        let [low, high] = of(Look::Raw, &image);
        assert!((15.0..25.0).contains(&low) && (1990.0..2000.0).contains(&high), "{low} {high}");
        // One lit pixel of 2000.
        let mut dark = Array2::zeros((50, 40));
        dark[[7, 7]] = 5.0;
        assert_eq!(of(Look::Light, &dark), [0.0, 5.0]);
        assert_eq!(of(Look::Light, &Array2::zeros((0, 0))), [0.0, 0.0]);
        assert_eq!(of(Look::Residual, &dark), [-4.0, 4.0]);
    }
}
