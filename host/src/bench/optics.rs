//! Light of objects on the sensor, point by point, each point with its own PSF.

use super::config::{BenchConfig, OpticsConfig};
use super::error::BenchError;
use super::foci::{Foci, Focus, Kept, Point};
use super::lens::Lens;
use crate::effects::{Chain, FrameContext, Ray, RayShift};
use crate::optics::{MicrolensArray, Psf, PsfScratch, Pupil, PupilConfig};
use crate::session::ObjectGrid;
use ndarray::{Array2, Array3, Axis, s};
use rayon::prelude::*;

/// Object rows of one task. The bands are summed in a fixed order, so the number of threads does not change any bit.
const BAND_ROWS: usize = 8;

/// The optics of the virtual instrument.
#[derive(Debug)]
pub(super) struct VirtualOptics {
    pupil: Pupil,
    array: MicrolensArray,
    lenses: Vec<Lens>,
    grid: ObjectGrid,
    sensor: [usize; 2],
    /// Tangent of the field angle for which the configuration states aberrations.
    reference_tangent: f64,
    half_response_tangent: f64,
    distortion_px: f64,
    /// Defocus of a source at 1 um from the focal plane, waves rms.
    waves_per_um: f64,
}

/// Working memory for PSFs; each thread needs its own.
#[derive(Debug)]
pub(super) struct Work {
    scratch: PsfScratch,
    psf: Psf,
}

#[cfg(test)]
impl Work {
    /// The PSF of the last call of [`VirtualOptics::focus`].
    pub(super) fn psf(&self) -> &Psf {
        &self.psf
    }
}

/// How effects move chief rays in one frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct Moves<'a> {
    pub effects: &'a Chain,
    pub cx: &'a FrameContext<'a>,
}

impl Moves<'_> {
    fn of(&self, ray: &Ray) -> RayShift {
        self.effects.shift_ray(ray, &FrameContext { lens: ray.lens, ..*self.cx })
    }
}

/// A point source.
#[derive(Clone, Copy, Debug)]
pub(super) struct PointSource<'a> {
    pub point: Point,
    /// Light of the source through a lens straight above it, electrons.
    pub flux_e: f64,
    /// Stored foci that include the point.
    pub kept: Option<Kept<'a>>,
}

/// Light that objects emit.
#[derive(Clone, Copy, Debug)]
pub(super) struct Emission<'a> {
    /// Objects, each [object rows, object cols].
    pub objects: &'a [Array2<f32>],
    /// Light of one unit of an object pixel through a lens straight above it, electrons.
    pub unit_e: f64,
    /// Depth of the objects, um.
    pub z_um: f64,
    /// Stored foci of the object pixels at that depth, row by row.
    pub kept: Option<&'a Foci>,
}

impl VirtualOptics {
    /// Builds the lenses and plans their pupil.
    ///
    /// # Errors
    /// A number of the configuration is impossible, or the aperture is wider than the distance of the lenses.
    pub(super) fn build(config: &BenchConfig) -> Result<Self, BenchError> {
        let optics = &config.optics;
        let array = MicrolensArray {
            object_distance_um: optics.object_distance_um,
            magnification: config.true_magnification(),
            pixel_pitch_um: config.sensor.pixel_pitch_um,
        };
        let pupil = PupilConfig {
            wavelength_um: optics.wavelength_um,
            aperture_um: optics.aperture_um,
            distance_um: array.image_distance_um(),
            soft_edge: optics.soft_edge,
            pixel_um: config.sensor.pixel_pitch_um,
            oversampling: optics.oversampling,
            field_px: optics.psf_field_px,
        };
        let lens_pitch_um = config.array.pitch_px * config.sensor.pixel_pitch_um / (1.0 + optics.magnification);
        if config.array.rows * config.array.cols > 1 && optics.aperture_um > lens_pitch_um {
            return Err(BenchError::Config {
                field: "optics.aperture_um",
                expected: format!("at most the distance between lenses, {lens_pitch_um:.1} um"),
                found: optics.aperture_um.to_string(),
            });
        }
        let grid = config.manifest().object;
        let corner_um = (grid.rows as f64).hypot(grid.cols as f64) / 2.0 * grid.pixel_um;
        let lenses = (0..config.array.rows).flat_map(|i| (0..config.array.cols).map(move |j| (i, j)));
        Ok(Self {
            pupil: pupil.build()?,
            array,
            lenses: lenses.map(|(i, j)| Lens::manufacture(config, &array, i, j)).collect(),
            grid,
            sensor: [config.sensor.rows, config.sensor.cols],
            reference_tangent: corner_um / optics.object_distance_um,
            half_response_tangent: optics.half_response_tangent,
            distortion_px: optics.distortion_px,
            waves_per_um: defocus_per_um(optics),
        })
    }

    /// Anchor (row, col) of each lens without effects, sensor pixels.
    pub(super) fn anchors_px(&self) -> Vec<[f64; 2]> {
        self.lenses.iter().map(|l| l.anchor_px).collect()
    }

    /// Allocates working memory.
    pub(super) fn work(&self) -> Work {
        Work { scratch: self.pupil.scratch(), psf: Psf::default() }
    }

    /// The chief ray of the point at (y, x) um through lens `l` by Eq. 1 of Yang et al. (2024), as effects see it.
    fn ray(&self, l: usize, at_um: [f64; 2]) -> Ray {
        let lens = &self.lenses[l];
        let scale = self.array.magnification / self.array.pixel_pitch_um;
        let centre = self.sensor.map(|n| (n as f64 - 1.0) / 2.0);
        Ray {
            lens: l,
            object_um: at_um,
            field_px: at_um.map(|v| v * scale),
            axis_px: [0, 1].map(|k| (at_um[k] - lens.axis_um[k]) * scale),
            anchor_px: [0, 1].map(|k| lens.anchor_px[k] - centre[k]),
            pixel_pitch_um: self.array.pixel_pitch_um,
        }
    }

    /// Computes the PSF of a point through lens `l` into `work`, with the chief ray as effects move it.
    pub(super) fn focus(&self, l: usize, point: Point, moves: Moves<'_>, work: &mut Work) -> Focus {
        let (lens, at_um) = (&self.lenses[l], point.at_um);
        let tangents = self.array.tangents(lens.axis_um, at_um);
        let h = tangents.map(|t| t / self.reference_tangent);
        let square = h[0] * h[0] + h[1] * h[1];
        let moved = moves.of(&self.ray(l, at_um));
        let ray = self.array.chief_ray_px(lens.anchor_px, at_um);
        let ray = [0, 1].map(|k| ray[k] + self.distortion_px * square * h[k] + moved.px[k]);
        let centre = ray.map(f64::round);
        let shift = [ray[0] - centre[0], ray[1] - centre[1]];
        let mut wavefront = lens.wavefront(h);
        wavefront.coefficient[3] += self.waves_per_um * (point.z_um + moved.z_um);
        self.pupil.psf(&wavefront, shift, &mut work.scratch, &mut work.psf);
        let tangent = tangents[0].hypot(tangents[1]);
        let cos4 = (1.0 + tangent * tangent).powi(-2);
        let response = 1.0 / (1.0 + (tangent / self.half_response_tangent).powi(4));
        Focus { centre: centre.map(|c| c as i64), transmission: cos4 * response }
    }

    /// Foci of points through lens `l` without effects.
    pub(super) fn foci(&self, l: usize, points: &[Point]) -> Foci {
        let side = self.pupil.config().field_px;
        let mut foci =
            Foci { side, focus: vec![Focus::default(); points.len()], share: vec![0.0; points.len() * side * side] };
        let (effects, cx) = (Chain::default(), FrameContext::default());
        let at_rest = Moves { effects: &effects, cx: &cx };
        let parts = foci.focus.par_iter_mut().zip(foci.share.par_chunks_exact_mut(side * side));
        parts.zip(points).for_each_init(
            || self.work(),
            |work, ((focus, share), point)| {
                *focus = self.focus(l, *point, at_rest, work);
                share.copy_from_slice(&work.psf.share);
            },
        );
        foci
    }

    /// Whether the chief rays of all object pixels are the same in two frames.
    pub(super) fn same_rays(&self, effects: &Chain, a: &FrameContext<'_>, b: &FrameContext<'_>) -> bool {
        let moves = |cx, ray: &Ray| Moves { effects, cx }.of(ray);
        (0..self.lenses.len()).all(|l| {
            let mut points = (0..self.grid.rows).flat_map(|r| (0..self.grid.cols).map(move |c| (r, c)));
            points.all(|(r, c)| {
                let ray = self.ray(l, self.position_um(r, c));
                moves(a, &ray) == moves(b, &ray)
            })
        })
    }

    /// Adds the light of one point through lens `l` to `image`, electrons.
    pub(super) fn add_point(
        &self,
        l: usize,
        source: &PointSource<'_>,
        moves: Moves<'_>,
        work: &mut Work,
        image: &mut Array2<f32>,
    ) {
        let (focus, share) = self.focus_or_kept(l, source.point, source.kept, moves, work);
        let light = (source.flux_e * focus.transmission) as f32;
        self.each_row(focus, share, |r, c, shares| {
            let mut row = image.slice_mut(s![r, c..c + shares.len()]);
            row.iter_mut().zip(shares).for_each(|(v, share)| *v += light * share);
        });
    }

    /// Focus and PSF of a point: the stored ones, unless there are none or an effect moves its chief ray.
    fn focus_or_kept<'a>(
        &self,
        l: usize,
        point: Point,
        kept: Option<Kept<'a>>,
        moves: Moves<'_>,
        work: &'a mut Work,
    ) -> (Focus, &'a [f32]) {
        if let Some(found) = kept.and_then(|k| k.foci.get(k.index))
            && moves.of(&self.ray(l, point.at_um)) == RayShift::default()
        {
            return found;
        }
        let focus = self.focus(l, point, moves, work);
        (focus, &work.psf.share)
    }

    /// Calls `put(row, first col, shares)` for each row of the PSF on the sensor.
    fn each_row(&self, focus: Focus, share: &[f32], mut put: impl FnMut(usize, usize, &[f32])) {
        let side = self.pupil.config().field_px;
        let first = focus.centre.map(|c| c - (side / 2) as i64);
        let seen = |a: usize| {
            let end = (self.sensor[a] as i64 - first[a]).clamp(0, side as i64) as usize;
            ((-first[a]).clamp(0, side as i64) as usize).min(end)..end
        };
        let (rows, cols) = (seen(0), seen(1));
        if cols.is_empty() {
            return;
        }
        let place = |a: usize, i: usize| (first[a] + i as i64) as usize;
        for i in rows {
            put(place(0, i), place(1, cols.start), &share[i * side..(i + 1) * side][cols.clone()]);
        }
    }

    /// Light of objects through lens `l`, [object, sensor rows, sensor cols], electrons.
    ///
    /// Each object pixel is a point at its centre. Its PSF is taken from the stored foci, or computed once for all
    /// objects.
    pub(super) fn lens_images(&self, l: usize, emission: &Emission<'_>, moves: Moves<'_>) -> Array3<f32> {
        let mut images = Array3::zeros((emission.objects.len(), self.sensor[0], self.sensor[1]));
        let bands: Vec<usize> = (0..self.grid.rows).step_by(BAND_ROWS).collect();
        // Few bands exist at a time, so memory does not grow with the object.
        for group in bands.chunks(2 * rayon::current_num_threads()) {
            let lights: Vec<Band> = group
                .par_iter()
                .map_init(|| self.work(), |work, first| self.band(l, *first, emission, moves, work))
                .collect();
            for band in lights {
                let rows = band.first_row..band.first_row + band.light.len_of(Axis(1));
                let mut part = images.slice_mut(s![.., rows, ..]);
                part += &band.light;
            }
        }
        images
    }

    fn band(&self, l: usize, first: usize, emission: &Emission<'_>, moves: Moves<'_>, work: &mut Work) -> Band {
        let objects = emission.objects;
        let rows = first..(first + BAND_ROWS).min(self.grid.rows);
        let mut band = self.empty_band(l, &rows, objects.len(), moves);
        let [band_rows, cols] = [band.light.len_of(Axis(1)), self.sensor[1]];
        let Some(pixels) = band.light.as_slice_mut() else { return band };
        let mut values = vec![0.0f32; objects.len()];
        for r in rows {
            for c in 0..self.grid.cols {
                let mut lit = false;
                for (value, object) in values.iter_mut().zip(objects) {
                    *value = object[[r, c]];
                    lit |= *value != 0.0;
                }
                if !lit {
                    continue;
                }
                let kept = emission.kept.map(|foci| Kept { foci, index: r * self.grid.cols + c });
                let point = Point { at_um: self.position_um(r, c), z_um: emission.z_um };
                let (focus, share) = self.focus_or_kept(l, point, kept, moves, work);
                let unit = (emission.unit_e * focus.transmission) as f32;
                for (k, value) in values.iter().enumerate().filter(|(_, v)| **v != 0.0) {
                    let light = unit * value;
                    self.each_row(focus, share, |row, col, shares| {
                        let start = (k * band_rows + row - band.first_row) * cols + col;
                        let line = &mut pixels[start..start + shares.len()];
                        line.iter_mut().zip(shares).for_each(|(v, share)| *v += light * share);
                    });
                }
            }
        }
        band
    }

    /// An empty band of the sensor rows that the foci of some object rows can reach.
    fn empty_band(&self, l: usize, rows: &std::ops::Range<usize>, objects: usize, moves: Moves<'_>) -> Band {
        let ray = |r: usize| self.array.chief_ray_px(self.lenses[l].anchor_px, self.position_um(r, 0))[0];
        // A focus reaches half the field. The distortion grows with the cube of the field: it is largest at a corner.
        let corners = [rows.start, rows.end - 1].map(|r| [0, self.grid.cols - 1].map(|c| self.position_um(r, c)));
        let cube = |at| {
            let [y, x] = self.array.tangents(self.lenses[l].axis_um, at);
            (y.hypot(x) / self.reference_tangent).powi(3)
        };
        let farthest = corners.as_flattened().iter().map(|at| cube(*at)).fold(0.0, f64::max);
        // Shifts by effects are smooth over the field: largest at the ends of the rows or on the axis.
        let middle = self.position_um(rows.start, self.grid.cols / 2);
        let moved = |at: &[f64; 2]| moves.of(&self.ray(l, *at)).px[0].abs();
        let pushed = corners.as_flattened().iter().chain([&middle]).map(moved).fold(0.0, f64::max);
        let reach =
            self.pupil.config().field_px as f64 / 2.0 + self.distortion_px.abs() * farthest + 2.0 + 2.0 * pushed;
        let clip = |v: f64| v.clamp(0.0, self.sensor[0] as f64) as usize;
        let (low, high) = (clip(ray(rows.start) - reach), clip(ray(rows.end - 1) + reach + 1.0));
        Band { first_row: low, light: Array3::zeros((objects, high - low, self.sensor[1])) }
    }

    /// Stage position (y, x) of the centre of an object pixel, um.
    pub(super) fn position_um(&self, r: usize, c: usize) -> [f64; 2] {
        let along = |i: usize, n: usize| (i as f64 - (n as f64 - 1.0) / 2.0) * self.grid.pixel_um;
        [along(r, self.grid.rows), along(c, self.grid.cols)]
    }

    /// Number of lenses.
    pub(super) fn lenses(&self) -> usize {
        self.lenses.len()
    }

    /// Object position on each lens's axis, um.
    pub(super) fn axes_um(&self) -> Vec<[f64; 2]> {
        self.lenses.iter().map(|l| l.axis_um).collect()
    }
}

/// Defocus per distance from the focal plane, waves rms per um: a source nearer to the lens by z has a path longer by
/// `z NA^2 / 2` at the rim of the pupil; the rms of Noll's Z_4 is `1 / (2 sqrt 3)` of that (Born & Wolf, section 9.2).
fn defocus_per_um(optics: &OpticsConfig) -> f64 {
    let na = optics.aperture_um / 2.0 / optics.object_distance_um;
    na * na / 2.0 / optics.wavelength_um / (2.0 * 3f64.sqrt())
}

/// Light of some object rows on the sensor rows that it can reach.
struct Band {
    first_row: usize,
    light: Array3<f32>,
}
