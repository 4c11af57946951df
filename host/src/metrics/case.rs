//! A frame whose object is known.

use ndarray::Array2;

/// A raw frame and its known object: what a reconstruction method is tuned or judged on.
#[derive(Clone, Debug)]
pub struct Case {
    /// Raw frame, DN, [sensor rows, sensor cols].
    pub frame_dn: Array2<f32>,
    /// The object that the frame shows, in any unit, [object rows, object cols].
    pub truth: Array2<f32>,
}
