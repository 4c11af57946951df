//! Object -> frame: the optics of an instrument, then its effects, in physical order.
//!
//! ```text
//! object -> each lens -> chief rays -> light on the sensor -> (Poisson) -> charge -> (reading) -> DN
//! ```
//! Without the two random draws in brackets the result is the expected frame. [`Forward`] is planned once and used for
//! many frames. [`Forward::scene`] keeps the image of an object through each lens, so that effects can be tried on it
//! one after another.
//!
//! ```
//! use ndarray::Array2;
//! use ommatidia_model::forward::Forward;
//!
//! let instrument = ommatidia_model::testing::instrument([9, 11], [30, 33], 5, 3);
//! let forward = Forward::new(&instrument)?;
//! let context = forward.context();
//!
//! // Without light the expected frame is the black level.
//! let dark = forward.expected_dn(Array2::zeros((9, 11)).view(), &context)?;
//! assert!(dark.iter().all(|dn| *dn == 64.0));
//!
//! // Expected electrons are linear in the object.
//! let one = forward.expected_e(Array2::ones((9, 11)).view(), &context)?;
//! let two = forward.expected_e(Array2::from_elem((9, 11), 2.0).view(), &context)?;
//! assert!((two.sum() / one.sum() - 2.0).abs() < 1e-5);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod error;
mod foci;
mod growth;
mod moved;
mod predict;
mod scene_light;
mod sensor_maps;
mod shift_map;
mod warp;
mod wavefront;

pub use error::ForwardError;
pub use foci::Foci;
pub use predict::{Depth, PredictError, PredictRequest, Predicted, Predictor};
pub use scene_light::SceneLight;

use crate::instrument::Instrument;
use crate::psf::{ChiefRays, LensImage, LowRankOperator, OperatorConfig};
use growth::{Calibrated, Growth};
use ndarray::{Array2, ArrayView2, Zip};
use ommatidia_physics::effects::{Chain, FrameContext, Layout, Stage};
use ommatidia_physics::noise::{NoiseModel, ROUNDING_DN2, draw_electrons};
use ommatidia_physics::optics::MicrolensArray;
use rand::Rng;
use scene_light::Images;
use std::sync::{Arc, OnceLock};
use wavefront::{Changes, Kept};

/// The forward model of one instrument at one depth.
#[derive(Clone, Debug)]
pub struct Forward {
    /// One operator for each planned depth: all depths of the instrument, or a single one.
    planes: Vec<LowRankOperator>,
    /// Depths of the planes, um.
    depths_um: Vec<f64>,
    /// Index of the plane of the object.
    plane: usize,
    /// Made when an effect first lets PSFs grow.
    growth: Arc<OnceLock<Growth>>,
    calibrated: Arc<Calibrated>,
    /// Changes by wavefronts that effects add.
    changes: Changes,
    geometry: ChiefRays,
    /// Where the axis of each lens meets the sensor, [row, col], px.
    axes_px: Vec<[f64; 2]>,
    layout: Layout,
    object_pixel_um: f64,
    pixel_pitch_um: f64,
    /// Mean wavelength of the light; None: not stated.
    wavelength_um: Option<f64>,
    effects: Chain,
    noise: NoiseModel,
    offset_dn: Option<Array2<f32>>,
    reading_dn2: Option<Array2<f32>>,
    response: Option<Array2<f32>>,
    exposure_ms: f64,
}

impl Forward {
    /// Plans the model at the depth nearest to 0 um.
    ///
    /// # Errors
    /// The tables of the instrument disagree, or it names an effect that does not exist.
    pub fn new(instrument: &Instrument) -> Result<Self, ForwardError> {
        let depth = instrument.psf.depth_nearest(0.0);
        Self::with_config(instrument, OperatorConfig { depth, ..OperatorConfig::default() })
    }

    /// Plans the model at the depth `config.depth`.
    ///
    /// # Errors
    /// The tables of the instrument disagree, it names an effect that does not exist, or there is no such depth.
    pub fn with_config(instrument: &Instrument, config: OperatorConfig) -> Result<Self, ForwardError> {
        let effects = Chain::build(&instrument.effects, Layout::of(&instrument.manifest))?;
        let all = effects.acts_at(Stage::Geometry);
        Self::plan(instrument, effects, config, all)
    }

    /// Plans the model at every depth, so that effects can move sources in depth.
    ///
    /// # Errors
    /// The tables of the instrument disagree, or it names an effect that does not exist.
    pub fn with_all_depths(instrument: &Instrument, config: OperatorConfig) -> Result<Self, ForwardError> {
        let effects = Chain::build(&instrument.effects, Layout::of(&instrument.manifest))?;
        Self::plan(instrument, effects, config, true)
    }

    fn plan(instrument: &Instrument, effects: Chain, config: OperatorConfig, all: bool) -> Result<Self, ForwardError> {
        let (manifest, depths) = (&instrument.manifest, &instrument.psf.node_depths_um);
        let used = if all { 0..depths.len() } else { config.depth..config.depth + 1 };
        let plane = |depth| {
            LowRankOperator::plan(instrument.optics(), &instrument.geometry, OperatorConfig { depth, ..config })
        };
        Ok(Self {
            planes: used.clone().map(plane).collect::<Result<_, _>>()?,
            plane: config.depth - used.start,
            depths_um: used.filter_map(|d| depths.get(d).copied()).collect(),
            growth: Arc::default(),
            calibrated: Arc::new(Calibrated {
                psf: instrument.psf.clone(),
                rays: instrument.geometry.clone(),
                object: [manifest.object.rows, manifest.object.cols],
                sensor: [manifest.sensor.rows, manifest.sensor.cols],
                config,
                pupils: instrument.pupils.clone(),
            }),
            changes: Changes::default(),
            geometry: instrument.geometry.clone(),
            axes_px: axes_px(instrument),
            layout: Layout::of(manifest),
            object_pixel_um: manifest.object.pixel_um,
            pixel_pitch_um: manifest.sensor.pixel_pitch_um,
            wavelength_um: manifest.optics.wavelength_um,
            effects,
            noise: instrument.noise,
            offset_dn: instrument.offset_dn.clone(),
            reading_dn2: instrument.reading_dn2.clone(),
            response: instrument.response.clone(),
            exposure_ms: instrument.psf.exposure_ms,
        })
    }

    /// The optical operator without effects: light in DN above black at the exposure of the calibration.
    pub fn operator(&self) -> &LowRankOperator {
        &self.planes[self.plane]
    }

    /// Depth of the planned plane, um.
    pub fn depth_um(&self) -> f64 {
        self.depths_um[self.plane]
    }

    /// The noise model of the calibration.
    pub fn noise(&self) -> &NoiseModel {
        &self.noise
    }

    /// The noise model as changed by `effects`.
    pub fn noise_with(&self, effects: &Chain) -> NoiseModel {
        let mut noise = self.noise;
        effects.on_noise(&mut noise);
        noise
    }

    /// Variance of the reading of each pixel, rounding included, DN^2, [sensor rows, sensor cols]; None where the noise
    /// model holds for all pixels.
    pub fn reading_dn2(&self) -> Option<&Array2<f32>> {
        self.reading_dn2.as_ref()
    }

    /// The effects of the instrument.
    pub fn effects(&self) -> &Chain {
        &self.effects
    }

    /// The sizes on which the parameters of effects depend.
    pub fn layout(&self) -> Layout {
        self.layout
    }

    /// The context of a frame as in the calibration: its exposure, illumination 1, time 0.
    pub fn context(&self) -> FrameContext<'_> {
        FrameContext {
            exposure_ms: self.exposure_ms,
            illumination: 1.0,
            anchors_px: &self.geometry.anchors_px,
            axes_px: &self.axes_px,
            pixel_pitch_um: self.pixel_pitch_um,
            full_scale_e: self.noise.full_scale_e(),
            black_level_dn: self.noise.black_level_dn,
            gain_dn_per_e: self.noise.gain_dn_per_e,
            ..FrameContext::default()
        }
    }

    /// Expected photo-electrons before the Poisson draw, [sensor rows, sensor cols], for an object
    /// [object rows, object cols] in the session's light unit.
    ///
    /// # Errors
    /// The object has the wrong shape, or a non-finite or negative value.
    pub fn expected_e(&self, object: ArrayView2<'_, f32>, cx: &FrameContext<'_>) -> Result<Array2<f32>, ForwardError> {
        let scene = self.scene(object, &self.effects, cx)?;
        Ok(self.light_e(&scene, &self.effects, cx))
    }

    /// The image of an object through each lens, with the effects that act on its emission.
    ///
    /// # Errors
    /// The object has the wrong shape, or a non-finite or negative value.
    pub fn scene(
        &self,
        object: ArrayView2<'_, f32>,
        effects: &Chain,
        cx: &FrameContext<'_>,
    ) -> Result<SceneLight, ForwardError> {
        if let Some(((row, col), found)) = object.indexed_iter().find(|(_, v)| !(v.is_finite() && **v >= 0.0)) {
            return Err(ForwardError::Object { row, col, found: *found });
        }
        let mut emitted = object.to_owned();
        effects.on_object(&mut emitted, cx);
        let images = self.images(self.plane, &emitted)?;
        let mut planes = vec![Images::new(); self.planes.len()];
        planes[self.plane] = images.into();
        Ok(SceneLight {
            planes,
            emitted,
            growth: Default::default(),
            changes: Kept::images(),
            to_planes: Kept::new(self.planes.len()),
            shift_px: [0.0; 2],
            z_um: None,
        })
    }

    /// The images of what an object emits through the lenses, for sources in one of the planes.
    fn images(&self, plane: usize, emitted: &Array2<f32>) -> Result<Vec<Option<LensImage>>, ForwardError> {
        let mut lenses = vec![None; self.layout.lenses];
        self.planes[plane].each_lens(emitted.view(), |l, image| lenses[l] = Some(image))?;
        Ok(lenses)
    }

    /// Makes what is missing of a scene's images in all planes. A scene that another model predicts with needs this: it
    /// would make them of its own PSFs.
    pub fn make_all_planes(&self, scene: &SceneLight) {
        for plane in 0..self.planes.len() {
            let _ = self.in_plane(scene, plane);
        }
    }

    /// The image of a scene through a lens, for sources in one of the planes. None: the lens is dead.
    fn image<'s>(&self, scene: &'s SceneLight, plane: usize, lens: usize) -> Option<&'s LensImage> {
        self.in_plane(scene, plane)?.get(lens)?.as_ref()
    }

    /// The images of a scene for sources in one of the planes, by lens.
    fn in_plane<'s>(&self, scene: &'s SceneLight, plane: usize) -> Option<&'s Vec<Option<LensImage>>> {
        let images = scene.planes.get(plane)?;
        // No lock is held while threads share out the work: another thread may do the same work, and its result counts.
        if images.get().is_none() {
            // An object of another shape was refused when its scene was made.
            let _ = images.set(self.images(plane, &scene.emitted).ok()?);
        }
        images.get()
    }

    /// The image of a point source of unit light at the fractional object pixel `at_px` = [row, col].
    ///
    /// # Errors
    /// The position lies outside the object.
    pub fn point(&self, at_px: [f64; 2], effects: &Chain, cx: &FrameContext<'_>) -> Result<SceneLight, ForwardError> {
        let [rows, cols] = self.operator().object_shape();
        let whole = at_px.map(|v| v.round().max(0.0) as usize);
        let mut object = Array2::zeros((rows, cols));
        object[[whole[0].min(rows - 1), whole[1].min(cols - 1)]] = 1.0;
        let scene = self.scene(object.view(), effects, cx)?;
        Ok(SceneLight { shift_px: [0, 1].map(|a| at_px[a] - whole[a] as f64), ..scene })
    }

    /// Expected electrons of a scene, [sensor rows, sensor cols], with `effects` of all stages from the chief rays on.
    pub fn light_e(&self, scene: &SceneLight, effects: &Chain, cx: &FrameContext<'_>) -> Array2<f32> {
        self.on_sensor(self.sum_e(scene, effects, cx), effects, cx)
    }

    /// Electrons of all lenses of a scene, [sensor rows, sensor cols], with the effects of stages `Geometry` and
    /// `Lens`.
    pub fn sum_e(&self, scene: &SceneLight, effects: &Chain, cx: &FrameContext<'_>) -> Array2<f32> {
        let mut light = Array2::zeros(self.operator().sensor_shape());
        let per_lens = effects.acts_at(Stage::Lens);
        for l in 0..self.layout.lenses {
            if per_lens {
                light += &self.lens_e(scene, l, effects, cx);
            } else if let Some(image) = self.moved(scene, l, effects, cx) {
                image.add_to(&mut light);
            }
        }
        light
    }

    /// Electrons of one lens of a scene, [sensor rows, sensor cols], with the effects of stages `Geometry` and `Lens`.
    pub fn lens_e(&self, scene: &SceneLight, lens: usize, effects: &Chain, cx: &FrameContext<'_>) -> Array2<f32> {
        let mut whole = Array2::zeros(self.operator().sensor_shape());
        if let Some(image) = self.moved(scene, lens, effects, cx) {
            image.add_to(&mut whole);
            effects.on_lens(&mut whole, &FrameContext { lens, ..*cx });
        }
        whole
    }

    /// Applies the effects that act on the light on the sensor, and the response of its pixels, to `light_e`
    /// (electrons, the sum of all lenses).
    pub fn on_sensor(&self, mut light_e: Array2<f32>, effects: &Chain, cx: &FrameContext<'_>) -> Array2<f32> {
        effects.on_light(&mut light_e, cx);
        if let Some(response) = &self.response {
            light_e *= response;
        }
        light_e
    }

    /// The expected frame, DN, [sensor rows, sensor cols]: no noise, no rounding; clipped at saturation.
    ///
    /// # Errors
    /// The object has the wrong shape, or a non-finite or negative value.
    pub fn expected_dn(&self, object: ArrayView2<'_, f32>, cx: &FrameContext<'_>) -> Result<Array2<f32>, ForwardError> {
        Ok(self.frame_dn(self.expected_e(object, cx)?, &self.effects, cx))
    }

    /// The expected frame, DN, of expected electrons `light_e`: no noise, no rounding; clipped at saturation.
    pub fn frame_dn(&self, light_e: Array2<f32>, effects: &Chain, cx: &FrameContext<'_>) -> Array2<f32> {
        let mut charge = light_e;
        effects.on_charge(&mut charge, cx);
        let mut frame = self.to_dn(charge, effects, cx);
        let top = self.noise.saturation_dn as f32;
        frame.mapv_inplace(|v| v.min(top));
        frame
    }

    /// A noisy frame drawn for expected electrons `light_e` (from [`Forward::expected_e`]): integer DN, 0 to
    /// saturation.
    pub fn draw_dn(&self, light_e: Array2<f32>, cx: &FrameContext<'_>, rng: &mut impl Rng) -> Array2<f32> {
        self.draw_with(light_e, &self.effects, cx, rng)
    }

    /// As [`Forward::draw_dn`], with `effects` in place of those of the instrument.
    pub fn draw_with(
        &self,
        mut light_e: Array2<f32>,
        effects: &Chain,
        cx: &FrameContext<'_>,
        rng: &mut impl Rng,
    ) -> Array2<f32> {
        let noise = self.noise_with(effects);
        let read = self.reading_e(&noise);
        // More electrons for the same DN: the gain alone is wrong, not the light.
        let more = (self.noise.gain_dn_per_e / noise.gain_dn_per_e) as f32;
        if more != 1.0 {
            light_e *= more;
        }
        match read {
            Reading::Common(read) if !effects.acts_at(Stage::Charge) => draw_in_place(&mut light_e, read, rng),
            read => {
                draw_in_place(&mut light_e, 0.0, rng);
                effects.on_charge(&mut light_e, cx);
                let mut reading = Array2::zeros(light_e.dim());
                match read {
                    Reading::Common(read) => draw_in_place(&mut reading, read, rng),
                    Reading::ByPixel(read) => {
                        draw_in_place(&mut reading, 1.0, rng);
                        reading *= &read;
                    }
                }
                light_e += &reading;
            }
        }
        if more != 1.0 {
            light_e /= more;
        }
        let mut frame = self.to_dn(light_e, effects, cx);
        effects.on_reading(&mut frame, cx, rng);
        let top = self.noise.saturation_dn as f32;
        frame.mapv_inplace(|v| v.round().clamp(0.0, top));
        frame
    }

    /// Read noise, electrons rms, under the noise model `noise`; for each pixel where pixels differ.
    fn reading_e(&self, noise: &NoiseModel) -> Reading {
        let Some(map) = &self.reading_dn2 else { return Reading::Common(noise.read_noise_e as f32) };
        // An effect on the noise scales that of all pixels.
        let scale = noise.read_noise_e / self.noise.read_noise_e / self.noise.gain_dn_per_e;
        Reading::ByPixel(map.mapv(|v| (scale * (f64::from(v) - ROUNDING_DN2).max(0.0).sqrt()) as f32))
    }

    /// Converts charge in electrons to DN, before rounding and clipping.
    pub fn to_dn(&self, mut charge_e: Array2<f32>, effects: &Chain, cx: &FrameContext<'_>) -> Array2<f32> {
        let (gain, black) = (self.noise.gain_dn_per_e as f32, self.noise.black_level_dn as f32);
        charge_e.mapv_inplace(|q| black + gain * q);
        if let Some(offset) = &self.offset_dn {
            Zip::from(&mut charge_e).and(offset).for_each(|v, o| *v += o);
        }
        effects.on_electronics(&mut charge_e, cx);
        charge_e
    }
}

/// Where the axis of each lens meets the sensor, [row, col], px.
fn axes_px(instrument: &Instrument) -> Vec<[f64; 2]> {
    let (geometry, pixel_pitch_um) = (&instrument.geometry, instrument.manifest.sensor.pixel_pitch_um);
    let [rows, cols] = Layout::of(&instrument.manifest).sensor;
    let centre = [rows, cols].map(|n| (n as f64 - 1.0) / 2.0);
    let magnification = geometry.magnification;
    // The distance to the object does not enter where an axis meets it.
    let optics = MicrolensArray { object_distance_um: 1.0, magnification, pixel_pitch_um };
    let scale = magnification / pixel_pitch_um;
    let axis = |anchor: &[f64; 2]| {
        let um = optics.axis_um(*anchor, centre);
        [0, 1].map(|a| anchor[a] + um[a] * scale)
    };
    geometry.anchors_px.iter().map(axis).collect()
}

/// Read noise, electrons rms.
enum Reading {
    Common(f32),
    /// One value for each pixel, [sensor rows, sensor cols].
    ByPixel(Array2<f32>),
}

fn draw_in_place(values: &mut Array2<f32>, read_noise_e: f32, rng: &mut impl Rng) {
    if let Some(values) = values.as_slice_mut() {
        draw_electrons(values, read_noise_e, rng);
    }
}

#[cfg(test)]
mod tests;
