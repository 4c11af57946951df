//! From a raw frame to the normalised frame that networks take.

use ndarray::ArrayView2;
use ommatidia_physics::sensor::{FrameError, FrameInput};

/// Lower bound of the maximum that filter outputs are divided by, so that frames without light stay finite.
pub(super) const DARK: f32 = 1e-12;

/// A raw frame, DN, [frame rows, frame cols], as networks take it: checked, corrected, and divided by its maximum; in C
/// order.
///
/// # Errors
/// The frame has another shape, or a value is not finite.
pub fn normalised(input: &FrameInput, frame_dn: ArrayView2<'_, f32>) -> Result<Vec<f32>, FrameError> {
    let light: Vec<f32> = input.light_dn(frame_dn)?.iter().copied().collect();
    Ok(normalise(&light))
}

/// Light above black divided by its maximum; negative values stay negative. A frame without light is returned as it is.
///
/// ```
/// use ommatidia_network::train::normalise;
///
/// assert_eq!(normalise(&[-1.0, 4.0, 2.0]), [-0.25, 1.0, 0.5]);
/// ```
pub fn normalise(light_dn: &[f32]) -> Vec<f32> {
    let max = light_dn.iter().copied().fold(0.0, f32::max);
    let scale = if max > 0.0 { 1.0 / max } else { 1.0 };
    light_dn.iter().map(|&v| v * scale).collect()
}
