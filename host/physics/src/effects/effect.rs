//! The trait that every effect implements, and the setting of an effect in an instrument.

use super::context::{FrameContext, Ray, RayShift, Record};
use super::descriptor::Descriptor;
use super::evidence::Evidence;
use super::table::Table;
use crate::noise::NoiseModel;
use crate::optics::Wavefront;
use ndarray::Array2;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// An effect. It overrides the hook of its stage; `p` holds its parameters in the order of [`Descriptor::expanded`].
///
/// With every strength at its `off` value, a hook must not change any bit of its argument.
pub trait Effect: Send + Sync {
    /// Name, stage, parameters and lookalikes of the effect.
    fn descriptor(&self) -> &'static Descriptor;

    /// Stage `Object`: changes the emitted light, [object rows, object cols].
    fn on_object(&self, _p: &[f64], _object: &mut Array2<f32>, _cx: &FrameContext<'_>) {}
    /// Stage `Geometry`: displacement of a focus, or of its source, from the calibrated position. The forward model
    /// asks for every fourth pixel and interpolates: laws are polynomials of at most the third degree in the place of
    /// the ray, or as smooth.
    fn shift_ray(&self, _p: &[f64], _ray: &Ray, _cx: &FrameContext<'_>) -> RayShift {
        RayShift::default()
    }
    /// Stage `Geometry`: what is added to the wavefront in the pupil of a lens, for the source of a chief ray, waves
    /// rms. Foci keep their centroids. It has no influence where no pupil explains the calibrated PSFs.
    fn wavefront(&self, _p: &[f64], _ray: &Ray, _cx: &FrameContext<'_>) -> Wavefront {
        Wavefront::default()
    }
    /// Stage `Geometry`: defocus that the pupil of lens `cx.lens` has beyond what was fitted to its PSFs, waves rms. It
    /// changes no PSF by itself, only how PSFs change with an added wavefront.
    fn misjudged_defocus(&self, _p: &[f64], _cx: &FrameContext<'_>) -> f64 {
        0.0
    }
    /// Stage `Lens`: changes the light through lens `cx.lens`, [sensor rows, sensor cols], expected electrons.
    fn on_lens(&self, _p: &[f64], _image_e: &mut Array2<f32>, _cx: &FrameContext<'_>) {}
    /// Stage `Light`: changes the light through all lenses, [sensor rows, sensor cols], expected electrons.
    fn on_light(&self, _p: &[f64], _light_e: &mut Array2<f32>, _cx: &FrameContext<'_>) {}
    /// Stage `Charge`: changes the collected charge, [sensor rows, sensor cols], electrons.
    fn on_charge(&self, _p: &[f64], _charge_e: &mut Array2<f32>, _cx: &FrameContext<'_>) {}
    /// Stage `Electronics`: changes the frame, [sensor rows, sensor cols], DN with black level.
    fn on_electronics(&self, _p: &[f64], _frame_dn: &mut Array2<f32>, _cx: &FrameContext<'_>) {}
    /// Stage `Electronics`, in noisy frames only: adds noise that is not in the noise model. The expected frame does
    /// not change.
    fn on_reading(&self, _p: &[f64], _frame_dn: &mut Array2<f32>, _cx: &FrameContext<'_>, _rng: &mut dyn rand::Rng) {}
    /// Any stage: changes the noise model of the sensor.
    fn on_noise(&self, _p: &[f64], _noise: &mut NoiseModel) {}
    /// Stage `Record`: a wrong entry of the session about a frame.
    fn on_record(&self, _p: &[f64], _record: &mut Record, _cx: &FrameContext<'_>) {}

    /// How the table acts, for effects that vary irregularly from pixel to pixel. The chain applies the table.
    fn table(&self) -> Option<Table> {
        None
    }
    /// Draws a table for injection: [sensor rows, sensor cols], [rows, 1] or [1, cols].
    fn draw_table(&self, _p: &[f64], _sensor: [usize; 2]) -> Array2<f32> {
        Array2::zeros((1, 1))
    }
    /// Whether the effect depends on the previous frame.
    fn needs_previous(&self) -> bool {
        false
    }
    /// Whether the effect follows the pixel grid. No specimen does, so such an effect shows even in unknown specimens.
    fn is_of_the_grid(&self) -> bool {
        false
    }
    /// Whether the effect is as smooth over the sensor as the light of a lamp. Flats do not show it, since the smooth
    /// part of their light belongs to the lamp.
    fn is_as_smooth_as_a_lamp(&self) -> bool {
        false
    }
    /// Whether the effect is one of the record of bead scans: other frames neither show it nor suffer from it.
    fn is_of_bead_scans(&self) -> bool {
        false
    }
    /// Whether the effect is one of the truths of a session: no instrument has it.
    fn is_of_truths(&self) -> bool {
        false
    }
    /// Whether the effect changes only the noise, never the expected frame.
    fn noise_only(&self) -> bool {
        false
    }
    /// Whether the effect gives the noise wings: a few differences of repeats are far larger than the others. Where
    /// repeats show none, larger noise is no sign of it.
    fn makes_wings(&self) -> bool {
        false
    }
    /// Whether the effect acts on values that hold their noise already, and stretches or shrinks it.
    fn bends_noise(&self) -> bool {
        false
    }
    /// Start values for fits, each with all parameters: shapes as the residuals suggest, strengths at `off`. Empty: the
    /// fit starts from the grid of values in [`Kind::Shape`](super::Kind::Shape).
    fn guess(&self, _evidence: &Evidence<'_>) -> Vec<Vec<f64>> {
        Vec::new()
    }
    /// Chooses among parameter values that a session cannot distinguish because its unknown light level compensates the
    /// difference. Changes `p` and returns the factor on the light that compensates the change. `live`: which lenses
    /// show light; the values of others are nothing.
    fn gauge(&self, _p: &mut [f64], _live: &[bool]) -> f64 {
        1.0
    }
    /// Number of independent candidates from which [`guess`](Effect::guess) selects, for a sensor of [rows, cols] and
    /// `frames` frames. With many candidates, noise alone makes one look good; tests correct for that.
    fn chances(&self, _sensor: [usize; 2], _frames: usize) -> f64 {
        1.0
    }
}

/// An effect that is switched on: its id and its parameters by name, as stored in an instrument file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EffectSetting {
    /// Id of the effect.
    pub id: String,
    /// Parameters by name; others have their `off` value.
    pub params: BTreeMap<String, f64>,
    /// Estimated table, a tensor of the instrument file; `None`: the table is drawn from the parameters.
    #[serde(skip)]
    pub table: Option<Array2<f32>>,
}

impl EffectSetting {
    /// An effect with parameters (name, value) and without an estimated table.
    pub fn new(id: &str, params: &[(&str, f64)]) -> Self {
        Self { id: id.into(), params: params.iter().map(|(n, v)| ((*n).into(), *v)).collect(), table: None }
    }
}
