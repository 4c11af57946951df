//! A rough estimate of what objects hold outside of a region.

use super::estimate::LEAST;
use crate::fit::model::Model;
use ndarray::{Array2, Zip};
use ommatidia_model::psf::OperatorError;
use ommatidia_physics::effects::Chain;
use rayon::prelude::*;

/// Iterations of Richardson-Lucy: nothing but light from afar depends on the estimate.
const ITERATIONS: usize = 10;

/// What objects hold where they are not unknown, [object rows, object cols]: dark if all of it is unknown, else the
/// specimens by the calibrated optics alone. It shapes what falls on a region from afar, such as the light of a halo.
pub(super) fn beside(model: &Model<'_>, frames: &[usize], light_e: &[Array2<f32>], floor_e2: f32) -> Vec<Array2<f32>> {
    let operator = model.forward.operator();
    let [rows, cols] = operator.object_shape();
    if !model.seen.is_part() {
        return vec![Array2::zeros((rows, cols)); frames.len()];
    }
    let (noise, cx) = (model.forward.noise(), model.forward.context());
    let response =
        model.forward.on_sensor(Array2::ones((model.seen.sensor[0], model.seen.sensor[1])), &Chain::default(), &cx);
    let of_frame = |(k, light_e): (&usize, &Array2<f32>)| {
        let cx = model.context(*k, None);
        let electrons = cx.exposure_ms / model.exposure_ms * cx.illumination / noise.gain_dn_per_e;
        let sensed = &response * electrons as f32;
        let used =
            model.seen.frames[*k].measured.mapv(|dn| f32::from(u8::from(f64::from(dn) < 0.99 * noise.saturation_dn)));
        let back = |frame: Array2<f32>| operator.adjoint((frame * &sensed).view());
        let mut object = Array2::ones((rows, cols));
        let seen = back(used.clone())?;
        let least = seen.iter().fold(0.0f32, |m, v| m.max(*v)) * LEAST;
        for _ in 0..ITERATIONS {
            let mut ratio = operator.apply(object.view())? * &sensed;
            Zip::from(&mut ratio).and(light_e).and(&used).for_each(|r, y, u| {
                *r = u * (y + floor_e2).max(0.0) / (r.max(0.0) + floor_e2);
            });
            Zip::from(&mut object).and(&back(ratio)?).and(&seen).for_each(|x, b, s| {
                *x = if *s > least { *x * b.max(0.0) / s } else { 0.0 };
            });
        }
        Ok::<_, OperatorError>(object)
    };
    // The operator fits the frames: the model was planned for them.
    let found = frames.par_iter().zip(light_e).map(of_frame);
    found.map(|object| object.unwrap_or_else(|_| Array2::zeros((rows, cols)))).collect()
}
