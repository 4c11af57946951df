//! The image of a lens as effects on chief rays move it: displaced, out of focus, and with PSFs of another size.

use super::growth::{Growth, less_stretch};
use super::shift_map::{Shifts, shift_map};
use super::{Forward, SceneLight, warp};
use crate::psf::LensImage;
use crate::psf::nodes::Taps;
use ndarray::{Array2, Zip};
use ommatidia_physics::effects::{Chain, FrameContext, Ray, RayShift, Stage};
use ommatidia_physics::interpolation::shifted;

/// Iterations for the place that a displaced focus comes from: the third term of a slope of 5 % is a ten-thousandth.
const ITERATIONS: usize = 2;
/// Growth of PSFs below which nothing is computed: effects that displace all foci alike leave rounding errors.
const LEAST_GROWTH: f64 = 1e-7;
/// Growth of PSFs above which its square counts, too: below, the square changes less than a thousandth of the peak.
const BENDS: f64 = 0.01;

impl Forward {
    /// The image of one lens, electrons, displaced by the effects that act on chief rays.
    pub(super) fn moved(
        &self,
        scene: &SceneLight,
        lens: usize,
        effects: &Chain,
        cx: &FrameContext<'_>,
    ) -> Option<LensImage> {
        let electrons = (cx.exposure_ms / self.exposure_ms * cx.illumination / self.noise.gain_dn_per_e) as f32;
        let here = self.image(scene, self.plane, lens)?;
        let mut image = LensImage { origin: here.origin, light: here.light.mapv(|v| v * electrons) };
        let [dy, dx] = scene.shift_px;
        let own = self.depths_um[self.plane];
        let z = scene.z_um.unwrap_or(own);
        if !effects.acts_at(Stage::Geometry) && [dy, dx] == [0.0, 0.0] && z == own {
            return Some(image);
        }
        let shape = image.light.dim();
        let shifts = self.shifts(lens, &image, effects, &FrameContext { lens, ..*cx }).displaced([dy, dx]);
        // A single plane holds for all depths.
        if self.planes.len() > 1 && shifts.any(|s| z + s.z_um != own) {
            self.refocus(scene, lens, (effects, cx), &shifts.over(shape), (&mut image, electrons));
        }
        if let Some(change) = self.wavefront_change(scene, lens, effects, cx) {
            image.light.scaled_add(electrons, &change.light);
        }
        match shifts {
            // It neither grows PSFs nor stretches the image.
            Shifts::Even(shift) if shift.growth == 0.0 => {
                if shift.px != [0.0, 0.0] {
                    image.light = shifted(&image.light, shift.px);
                }
            }
            shifts => {
                let mut shifts = shifts.into_map(shape);
                self.grow(scene, lens, &mut shifts, (&mut image, electrons));
                if shifts.iter().any(|s| s.px != [0.0, 0.0]) {
                    image.light = warp::warp(&image.light, &shifts.mapv(|s| s.px));
                }
            }
        }
        Some(image)
    }

    /// Moves the sources of the image of a lens in depth, between the planes of the scan. Electrons: those of a DN.
    ///
    /// Pupils, where they explain how PSFs change with depth, say how the light changes from the planned plane to the
    /// depth of each source. What they leave of the change to the other planes is interpolated over depth; without them
    /// all of it is.
    fn refocus(
        &self,
        scene: &SceneLight,
        lens: usize,
        (effects, cx): (&Chain, &FrameContext<'_>),
        shifts: &Array2<RayShift>,
        (image, electrons): (&mut LensImage, f32),
    ) {
        let Some(LensImage { light: here, .. }) = self.image(scene, self.plane, lens) else { return };
        let own = self.depth_um();
        let z = scene.z_um.unwrap_or(own);
        let pupils = self.pupils_between_depths();
        let taps = shifts.mapv(|s| Taps::at(&self.depths_um, z + s.z_um));
        let is_used = |p: &usize| *p != self.plane && taps.iter().any(|t| t.weight_of(*p) != 0.0);
        for p in (0..self.planes.len()).filter(is_used) {
            let Some(other) = self.image(scene, p, lens) else { continue };
            let mut left = &other.light - here;
            let to_plane =
                |pupils| self.depth_change(scene, &scene.to_planes, (pupils, lens), |_| self.depths_um[p] - own);
            if let Some(change) = pupils.and_then(to_plane) {
                left -= &change.light;
            }
            Zip::from(&mut image.light).and(&left).and(&taps).for_each(|v, left, taps| {
                *v += taps.weight_of(p) * electrons * left;
            });
        }
        let cx = FrameContext { lens, ..*cx };
        let place = |at: [f64; 2]| z - own + effects.shift_ray(&self.ray(lens, self.image_of(lens, at)), &cx).z_um;
        if let Some(change) = pupils.and_then(|p| self.depth_change(scene, &scene.changes, (p, lens), place)) {
            image.light.scaled_add(electrons, &change.light);
        }
    }

    /// Lets the PSFs in the image of a lens grow as shifts ask for, about their foci. Electrons: those of a DN.
    fn grow(
        &self,
        scene: &SceneLight,
        lens: usize,
        shifts: &mut Array2<RayShift>,
        (image, electrons): (&mut LensImage, f32),
    ) {
        let grows = shifts.iter().any(|s| s.growth != 0.0);
        less_stretch(shifts);
        let most = shifts.iter().fold(0.0f64, |m, s| m.max(s.growth.abs()));
        if most < LEAST_GROWTH {
            return;
        }
        // No lock is held while threads share out the work: another thread may do the same work, and its result counts.
        if self.growth.get().is_none()
            && let Some(growth) = Growth::plan(&self.calibrated)
        {
            let _ = self.growth.set(growth);
        }
        let Some(growth) = self.growth.get() else { return };
        for (order, images) in scene.growth.iter().enumerate() {
            if order == 1 && most < BENDS {
                continue;
            }
            if images.get().is_none() {
                let _ = images.set(growth.images(order, scene.emitted.view()));
            }
            let Some(by) = images.get().and_then(|lenses| lenses.get(lens)?.as_ref()) else { continue };
            Zip::from(&mut image.light).and(&by.light).and(&*shifts).for_each(|v, d, s| {
                let share = if order == 0 { s.growth } else { 0.5 * s.growth * s.growth };
                *v += share as f32 * electrons * d;
            });
        }
        if grows {
            growth.about_foci(lens, shifts, self.calibrated.psf.basis.dim().2 / 2);
        }
    }

    /// The displacement of the chief ray that ends on each pixel of a lens's image.
    fn shifts(&self, lens: usize, image: &LensImage, effects: &Chain, cx: &FrameContext<'_>) -> Shifts {
        let of = |at: [f64; 2]| effects.shift_ray(&self.ray(lens, at), cx);
        shift_map(image.light.dim(), |from_first| {
            let at = [0, 1].map(|a| image.origin[a] as f64 + from_first[a]);
            // Effects say where a focus goes. What ends on this pixel comes from where it has not been displaced yet:
            // q = x + d(x), solved for x by iteration, whose error falls by the slope of d each time.
            let mut shift = of(at);
            for _ in 0..ITERATIONS {
                let before = shift;
                shift = of([0, 1].map(|a| at[a] - before.px[a]));
                if shift.px == before.px {
                    break;
                }
            }
            shift
        })
    }

    /// The chief ray that ends at a place of the sensor, (row, col) px.
    pub(super) fn ray(&self, lens: usize, at: [f64; 2]) -> Ray {
        let anchor = self.geometry.anchors_px[lens];
        let centre = self.operator().sensor_shape().map(|n| (n as f64 - 1.0) / 2.0);
        let scale = self.geometry.magnification / self.pixel_pitch_um;
        let axis = self.axes_px[lens];
        let corner = self.image_of(lens, [0.0; 2]);
        let object = self.operator().object_shape().map(|n| (n as f64 - 1.0) / 2.0);
        let object_um = [0, 1].map(|a| (at[a] - corner[a] - object[a]) * self.object_pixel_um);
        let field_px = object_um.map(|v| v * scale);
        Ray {
            lens,
            object_um,
            field_px,
            axis_px: [0, 1].map(|a| field_px[a] + anchor[a] - axis[a]),
            anchor_px: [anchor[0] - centre[0], anchor[1] - centre[1]],
            pixel_pitch_um: self.pixel_pitch_um,
            px_per_um: scale,
        }
    }

    /// Where the image of an object pixel lies, (row, col) sensor px: one object pixel is one sensor pixel of the
    /// image, and its anchor is a rounded one.
    pub(super) fn image_of(&self, lens: usize, object_px: [f64; 2]) -> [f64; 2] {
        let anchor = self.geometry.anchors_px[lens];
        let object = self.operator().object_shape().map(|n| (n as f64 - 1.0) / 2.0);
        [0, 1].map(|a| (anchor[a] - object[a]).round() + object_px[a])
    }
}
