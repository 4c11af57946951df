//! Frames as the codes that a sensor delivers and a device receives.

use super::FrameError;
use super::input::check_shape;
use ndarray::ArrayView2;

/// The sensor codes of a raw frame, DN, of `shape` [rows, cols]: row by row, each value rounded to the nearest code.
///
/// ```
/// use ndarray::array;
/// use ommatidia_host::sensor::sensor_codes;
///
/// assert_eq!(sensor_codes(array![[64.0, 64.6]].view(), [1, 2])?, [64, 65]);
/// let error = sensor_codes(array![[64.0, -2.0]].view(), [1, 2]).unwrap_err().to_string();
/// assert!(error.starts_with("raw frame, row 0, column 1: expected a sensor code from 0 to 65535 DN, found -2"));
/// # Ok::<(), ommatidia_host::sensor::FrameError>(())
/// ```
///
/// # Errors
/// The frame has another shape, or a value is not between 0 and 65535 DN (or not a number).
pub fn sensor_codes(frame_dn: ArrayView2<'_, f32>, shape: [usize; 2]) -> Result<Vec<u16>, FrameError> {
    check_shape(frame_dn, shape)?;
    let code = |((row, col), &found): ((usize, usize), &f32)| {
        let rounded = found.round();
        let is_code = (0.0..=f32::from(u16::MAX)).contains(&rounded);
        if is_code { Ok(rounded as u16) } else { Err(FrameError::Code { row, col, found }) }
    };
    frame_dn.indexed_iter().map(code).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::array;

    #[test]
    fn values_outside_the_range_of_codes_are_refused() {
        for bad in [-0.6f32, 65_535.6, f32::NAN, f32::INFINITY] {
            let refused = sensor_codes(array![[1.0, 2.0], [3.0, bad]].view(), [2, 2]);
            assert!(matches!(refused, Err(FrameError::Code { row: 1, col: 1, .. })), "{bad}: {refused:?}");
        }
        assert_eq!(sensor_codes(array![[-0.4, 65_535.4]].view(), [1, 2]), Ok(vec![0, 65_535]));
        let shape = sensor_codes(array![[1.0]].view(), [1, 2]);
        assert_eq!(shape, Err(FrameError::Shape { expected: [1, 2], found: [1, 1] }));
    }
}
