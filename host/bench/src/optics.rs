//! Light of objects on the sensor, point by point, each point with its own PSF.

use super::config::BenchConfig;
use super::error::BenchError;
use super::family::change::Change;
use super::family::{self, Lenses, Moved, Work};
use super::foci::{Foci, Focus, Kept, Point};
use ndarray::{Array2, Array3, Axis, s};
use ommatidia_physics::effects::{Chain, EffectSetting, FrameContext, Ray};
use ommatidia_session::ObjectGrid;
use rayon::prelude::*;

/// Object rows of one task. The bands are summed in a fixed order, so the number of threads does not change any bit.
const BAND_ROWS: usize = 8;

/// The optics of the virtual instrument: the lenses of a family between an object and a sensor.
#[derive(Debug)]
pub(super) struct VirtualOptics {
    family: Box<dyn Lenses>,
    grid: ObjectGrid,
    sensor: [usize; 2],
}

/// How effects move chief rays in one frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct Moves<'a> {
    pub effects: &'a Chain,
    pub cx: &'a FrameContext<'a>,
}

impl Moves<'_> {
    fn of(&self, ray: &Ray) -> Moved {
        let cx = FrameContext { lens: ray.lens, ..*self.cx };
        Moved { shift: self.effects.shift_ray(ray, &cx), wavefront: self.effects.wavefront(ray, &cx) }
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
    /// Builds the lenses.
    ///
    /// # Errors
    /// A number of the configuration is impossible, or the aperture is wider than the distance of the lenses.
    pub(super) fn build(config: &BenchConfig) -> Result<Self, BenchError> {
        let optics = &config.optics;
        let lens_pitch_um = config.array.pitch_px * config.sensor.pixel_pitch_um / (1.0 + optics.magnification);
        if config.array.rows * config.array.cols > 1 && optics.aperture_um > lens_pitch_um {
            return Err(BenchError::Config {
                field: "optics.aperture_um",
                expected: format!("at most the distance between lenses, {lens_pitch_um:.1} um"),
                found: optics.aperture_um.to_string(),
            });
        }
        let (grid, sensor) = (config.manifest().object, [config.sensor.rows, config.sensor.cols]);
        Ok(Self { family: family::build(config)?, grid, sensor })
    }

    /// These optics with the parts that `settings` move, if the family moves parts; those settings are then done.
    pub(super) fn moved(&self, settings: &[EffectSetting]) -> Option<Self> {
        if !settings.iter().any(|s| Change::knows(&s.id)) {
            return None;
        }
        let family = self.family.moved(&Change::of(settings, self.lenses()))?;
        Some(Self { family, grid: self.grid, sensor: self.sensor })
    }

    /// Why an effect cannot act on these lenses as much as a setting says; `None`: it can.
    pub(super) fn refuses(&self, setting: &EffectSetting) -> Option<String> {
        self.family.refuses(setting)
    }

    /// Anchor (row, col) of each lens without effects, sensor pixels.
    pub(super) fn anchors_px(&self) -> Vec<[f64; 2]> {
        self.family.anchors_px()
    }

    /// Allocates working memory.
    pub(super) fn work(&self) -> Work {
        self.family.work()
    }

    /// Computes the PSF of a point through lens `l` into `work`, with the chief ray as effects move it.
    pub(super) fn focus(&self, l: usize, point: Point, moves: Moves<'_>, work: &mut Work) -> Focus {
        self.family.focus(l, point, moves.of(&self.family.ray(l, point.at_um)), work)
    }

    /// Foci of points through lens `l` without effects.
    pub(super) fn foci(&self, l: usize, points: &[Point]) -> Foci {
        let side = self.family.side();
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
        (0..self.lenses()).all(|l| {
            let mut points = (0..self.grid.rows).flat_map(|r| (0..self.grid.cols).map(move |c| (r, c)));
            points.all(|(r, c)| {
                let ray = self.family.ray(l, self.position_um(r, c));
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
            && moves.of(&self.family.ray(l, point.at_um)) == Moved::default()
        {
            return found;
        }
        let focus = self.focus(l, point, moves, work);
        (focus, &work.psf.share)
    }

    /// Calls `put(row, first col, shares)` for each row of the PSF on the sensor.
    fn each_row(&self, focus: Focus, share: &[f32], mut put: impl FnMut(usize, usize, &[f32])) {
        let side = self.family.side();
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
        let mut band = self.empty_band(l, &rows, emission, moves);
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
    fn empty_band(&self, l: usize, rows: &std::ops::Range<usize>, emission: &Emission<'_>, moves: Moves<'_>) -> Band {
        let half = (self.family.side() / 2) as f64;
        let (mut low, mut high) = (f64::MAX, f64::MIN);
        for (r, c) in rows.clone().flat_map(|r| (0..self.grid.cols).map(move |c| (r, c))) {
            let point = Point { at_um: self.position_um(r, c), z_um: emission.z_um };
            let at = self.family.focus_px(l, point, moves.of(&self.family.ray(l, point.at_um)))[0].round();
            (low, high) = (low.min(at - half), high.max(at + half + 1.0));
        }
        let clip = |v: f64| v.clamp(0.0, self.sensor[0] as f64) as usize;
        let (low, high) = (clip(low), clip(high));
        Band { first_row: low, light: Array3::zeros((emission.objects.len(), high.max(low) - low, self.sensor[1])) }
    }

    /// Stage position (y, x) of the centre of an object pixel, um.
    pub(super) fn position_um(&self, r: usize, c: usize) -> [f64; 2] {
        let along = |i: usize, n: usize| (i as f64 - (n as f64 - 1.0) / 2.0) * self.grid.pixel_um;
        [along(r, self.grid.rows), along(c, self.grid.cols)]
    }

    /// Number of lenses.
    pub(super) fn lenses(&self) -> usize {
        self.family.anchors_px().len()
    }

    /// Where the axis of each lens without effects meets the sensor, (row, col) pixels.
    pub(super) fn axes_px(&self) -> Vec<[f64; 2]> {
        let anchors = self.anchors_px().into_iter().enumerate();
        anchors
            .map(|(l, anchor)| {
                let ray = self.family.ray(l, [0.0; 2]);
                [0, 1].map(|k| anchor[k] + ray.field_px[k] - ray.axis_px[k])
            })
            .collect()
    }

    /// Object position on each lens's axis, um.
    pub(super) fn axes_um(&self) -> Vec<[f64; 2]> {
        self.family.axes_um()
    }
}

/// Light of some object rows on the sensor rows that it can reach.
struct Band {
    first_row: usize,
    light: Array3<f32>,
}
