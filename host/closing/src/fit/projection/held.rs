//! Estimated specimens, as a state holds them.

use super::projector::Projector;
use ndarray::Array2;
use std::sync::Arc;

/// For each frame the standard deviation of the noise, DN, [sensor rows, sensor cols]; None: not estimated.
pub(in crate::fit) type Sigmas = Vec<Option<Array2<f32>>>;

/// Estimated specimens, and what takes them out of the frames.
pub struct Specimens {
    /// For each frame its specimen, [object rows, object cols]; None: not estimated.
    pub(in crate::fit) objects: Vec<Option<Array2<f32>>>,
    pub(in crate::fit) projector: Arc<Projector>,
    /// For each frame the standard deviation of the noise, DN, [sensor rows, sensor cols]; None: not estimated.
    pub(in crate::fit) sigmas: Arc<Sigmas>,
    /// Mean square that noise alone leaves of a pixel after the projection, in units of its variance: for each frame,
    /// for each spatial block.
    pub(in crate::fit) expected: Vec<Vec<f64>>,
}

impl std::fmt::Debug for Specimens {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Specimens({})", self.objects.iter().flatten().count())
    }
}

impl Specimens {
    /// The estimated specimen of frame `k`.
    pub(crate) fn object(&self, k: usize) -> Option<&Array2<f32>> {
        self.objects.get(k)?.as_ref()
    }

    /// The standard deviation of the noise of frame `k`, DN. It is the same under every state of a model.
    pub(crate) fn sigma(&self, k: usize) -> Option<&Array2<f32>> {
        self.sigmas.get(k)?.as_ref()
    }

    /// Takes out of images what a change of the specimen can make.
    pub(crate) fn remove(&self, images: &mut [&mut Array2<f32>]) {
        self.projector.remove(images);
    }

    /// Mean square that noise alone leaves of a pixel of a block of frame `k`, in units of its variance.
    pub(crate) fn expected(&self, k: usize, block: usize) -> f64 {
        self.expected.get(k).and_then(|of| of.get(block)).copied().unwrap_or(1.0)
    }
}
