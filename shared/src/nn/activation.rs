//! Activation functions.

use crate::num::sigmoid_slice;

/// An activation function, applied to a sum before it is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Activation {
    /// `x`.
    Linear,
    /// `max(x, 0)`. A negative zero becomes zero.
    Relu,
    /// `1 / (1 + e^-x)`, see [`crate::num::sigmoid`].
    Sigmoid,
}

impl Activation {
    /// Applies the activation to one row of sums.
    #[inline(always)]
    pub fn apply(self, row: &mut [f32]) {
        match self {
            Self::Linear => {}
            Self::Relu => row.iter_mut().for_each(|x| *x = if *x > 0.0 { *x } else { 0.0 }),
            Self::Sigmoid => sigmoid_slice(row),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_values() {
        let mut row = [-2.0, -0.0, 0.0, 3.5];
        Activation::Relu.apply(&mut row);
        assert_eq!(row.map(f32::to_bits), [0.0_f32, 0.0, 0.0, 3.5].map(f32::to_bits));
        Activation::Linear.apply(&mut row);
        assert_eq!(row, [0.0, 0.0, 0.0, 3.5]);
        Activation::Sigmoid.apply(&mut row);
        assert_eq!(row[0], 0.5);
        assert!((row[3] - 0.970_687_8).abs() < 2e-4);
    }
}
