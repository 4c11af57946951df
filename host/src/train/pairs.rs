//! Training pairs, and where they come from.

use ndarray::Array2;

/// One training pair.
#[derive(Clone, Debug, PartialEq)]
pub struct Pair {
    /// Object, [object rows, object cols], >= 0, in any unit.
    pub object: Array2<f32>,
    /// Expected charge that the object causes on the sensor, electrons, [frame rows, frame cols]; noise-free.
    pub expected_e: Array2<f32>,
}

/// A set of training pairs.
pub trait PairSource: Sync {
    /// Number of pairs.
    fn len(&self) -> usize;

    /// Whether the set is empty.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The pair at `index` < `len()`; every call with the same index returns the same pair.
    ///
    /// # Errors
    /// The pair cannot be read or simulated.
    fn pair(&self, index: usize) -> Result<Pair, Box<dyn std::error::Error + Send + Sync>>;
}

/// Pairs in memory.
impl PairSource for Vec<Pair> {
    fn len(&self) -> usize {
        self.as_slice().len()
    }

    fn pair(&self, index: usize) -> Result<Pair, Box<dyn std::error::Error + Send + Sync>> {
        self.get(index).cloned().ok_or_else(|| format!("there are {} pairs", self.as_slice().len()).into())
    }
}

impl std::fmt::Debug for dyn PairSource + '_ {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} pairs", self.len())
    }
}
