//! A rough estimate of what objects hold outside of a region.

use crate::fit::model::Model;
use ndarray::{Array2, Zip};
use ommatidia_model::forward::ForwardError;
use ommatidia_model::richardson_lucy::RichardsonLucy;
use ommatidia_physics::effects::Chain;
use rayon::prelude::*;

/// Accelerated iterations of Richardson-Lucy.
const ITERATIONS: usize = 10;
/// Response below which a pixel is dead.
const DEAD: f32 = 0.1;

/// What objects hold outside of a region, [object rows, object cols]: the specimens by the calibrated optics alone, or
/// nothing where all of the sensor is used. It shapes what falls on the region by the tails of PSFs and from afar, such
/// as the light of a halo. `light_e` are the frames without their dark signal, electrons, [sensor rows, sensor cols].
///
/// # Errors
/// The frames do not have the shape of the instrument's.
pub(super) fn beside(
    model: &Model<'_>,
    frames: &[usize],
    light_e: &[Array2<f32>],
) -> Result<Vec<Array2<f32>>, ForwardError> {
    let (operator, noise) = (model.forward.operator(), model.forward.noise());
    if !model.seen.is_part() {
        return Ok(vec![Array2::zeros(operator.object_shape()); frames.len()]);
    }
    let even = Array2::ones(operator.sensor_shape());
    let response = model.forward.on_sensor(even, &Chain::default(), &model.forward.context());
    let solver = RichardsonLucy::new(operator.clone(), noise)?;
    let of_frame = |(k, light_e): (&usize, &Array2<f32>)| {
        let cx = model.context(*k, None);
        let electrons = (cx.exposure_ms / model.exposure_ms * cx.illumination / noise.gain_dn_per_e) as f32;
        // DN at the exposure of the calibration, as the operator gives it.
        let light = |e: &f32, response: &f32| if *response > DEAD { e / (response * electrons) } else { 0.0 };
        let light_dn = Zip::from(light_e).and(&response).map_collect(light);
        solver.accelerated(light_dn.view(), ITERATIONS).map_err(ForwardError::from)
    };
    frames.par_iter().zip(light_e).map(of_frame).collect()
}
