//! What a view of a buffer refuses.

/// The length of a buffer does not fit a shape.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ShapeError {
    /// Elements that the shape needs.
    pub expected: usize,
    /// Elements that the buffer has.
    pub found: usize,
}

impl core::fmt::Display for ShapeError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "the shape needs {} elements, the buffer has {}", self.expected, self.found)
    }
}

impl core::error::Error for ShapeError {}
