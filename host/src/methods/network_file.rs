//! A network file as a method: the host runs the very pipeline of the device.

use super::Reconstruct;
use crate::network_file::NetworkFile;
use ndarray::{Array2, ArrayView2};
use ommatidia_shared::num::widen;

impl Reconstruct for NetworkFile {
    fn name(&self) -> &str {
        "svfouriernet-blob"
    }

    /// Values are rounded to sensor codes, as a device receives them; a value that is not a code is refused.
    fn reconstruct(&self, frame_dn: ArrayView2<'_, f32>) -> anyhow::Result<Array2<f32>> {
        let output = self.run(&self.codes(frame_dn)?)?;
        let object = self.header()?.object;
        let shape = (usize::from(object.rows), usize::from(object.cols));
        Ok(Array2::from_shape_vec(shape, output.into_iter().map(widen).collect())?)
    }
}
