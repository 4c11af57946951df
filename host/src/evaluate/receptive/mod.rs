//! Effective receptive fields (W. Luo et al., NeurIPS 2016; Yang et al. 2024, section 2E): the gradient of one
//! reconstructed pixel with respect to the frame, averaged over frames, beside the PSF of that pixel; and the learned
//! filters in real space, beside pseudo-inverses of calibrated PSFs.

mod artifact;
mod compute;
mod images;
mod kernels;
#[cfg(test)]
mod tests;

pub use artifact::{FieldPoint, FilterFigures, KIND, ReceptiveFields, Summary, VERSION};
pub use compute::receptive_fields;
pub use images::middle;
