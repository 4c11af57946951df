//! Paints soft-edged shapes on the object grid. Positions and sizes are in um; the origin is the centre of the grid.

use ndarray::Array2;
use ommatidia_session::ObjectGrid;
use rand::{Rng, RngExt};

/// A point (y, x), um.
pub(super) type Point = [f64; 2];

/// How a shape combines with the light that is already there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Blend {
    /// The light is added: separate bodies on top of each other.
    Add,
    /// The brighter value remains: parts of one body.
    Max,
    /// The shape covers what lies under it.
    Over,
}

/// A shape at one point.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ink {
    /// Signed distance to the edge of the shape, um; negative inside.
    pub distance_um: f64,
    /// Brightness of the shape.
    pub value: f64,
}

/// Emitted light on the object grid.
#[derive(Debug)]
pub(super) struct Canvas {
    light: Array2<f32>,
    grid: ObjectGrid,
}

impl Canvas {
    pub(super) fn new(grid: &ObjectGrid) -> Self {
        Self { light: Array2::zeros((grid.rows, grid.cols)), grid: *grid }
    }

    pub(super) fn into_light(self) -> Array2<f32> {
        self.light
    }

    /// Side of a pixel, um.
    pub(super) fn pixel_um(&self) -> f64 {
        self.grid.pixel_um
    }

    /// Half the height and half the width of the field, um.
    pub(super) fn half_um(&self) -> Point {
        [self.grid.rows as f64 / 2.0 * self.grid.pixel_um, self.grid.cols as f64 / 2.0 * self.grid.pixel_um]
    }

    /// Area of the field, mm^2.
    pub(super) fn area_mm2(&self) -> f64 {
        let [h, w] = self.half_um();
        4.0 * h * w * 1e-6
    }

    /// A random point in the field.
    pub(super) fn anywhere(&self, rng: &mut impl Rng) -> Point {
        self.half_um().map(|h| rng.random_range(-h..h))
    }

    /// Rows and columns.
    pub(super) fn size(&self) -> [usize; 2] {
        [self.grid.rows, self.grid.cols]
    }

    /// Number of pixels.
    pub(super) fn pixels(&self) -> usize {
        self.grid.rows * self.grid.cols
    }

    /// The pixel that a point lies in; None off the field.
    fn pixel(&mut self, at: Point) -> Option<&mut f32> {
        let [r, c] = self.grid.pixel_of_um(at[0], at[1]).map(f64::round);
        let inside = r >= 0.0 && c >= 0.0;
        if inside { self.light.get_mut([r as usize, c as usize]) } else { None }
    }

    /// Adds light to the pixel that a point lies in.
    pub(super) fn point(&mut self, at: Point, value: f64) {
        if let Some(light) = self.pixel(at) {
            *light += value as f32;
        }
    }

    /// Gives the pixel that a point lies in this light at least.
    pub(super) fn light_up(&mut self, at: Point, value: f64) {
        if let Some(light) = self.pixel(at) {
            *light = light.max(value as f32);
        }
    }

    /// Adds light to each pixel, given as [row, col].
    pub(super) fn add(&mut self, of: impl Fn([usize; 2]) -> f64) {
        self.light.indexed_iter_mut().for_each(|((r, c), light)| *light += of([r, c]) as f32);
    }

    /// Number of objects at a density of `per_mm2`, at least one.
    pub(super) fn number(&self, per_mm2: f64) -> usize {
        (per_mm2 * self.area_mm2()).round().max(1.0) as usize
    }

    /// Paints a shape on each pixel within `reach_um` of the box with the corners `a` and `b`.
    ///
    /// `shape` returns the signed distance from a point to the edge of the shape, negative inside, and the brightness
    /// there. A pixel is covered by the share that a straight edge at that distance covers.
    pub(super) fn paint(&mut self, [a, b]: [Point; 2], reach_um: f64, blend: Blend, shape: impl Fn(Point) -> Ink) {
        let pixel = self.grid.pixel_um;
        let reach = reach_um + pixel;
        let low = self.grid.pixel_of_um(a[0].min(b[0]) - reach, a[1].min(b[1]) - reach);
        let high = self.grid.pixel_of_um(a[0].max(b[0]) + reach, a[1].max(b[1]) + reach);
        let clip = |v: f64, n: usize| v.clamp(0.0, n as f64) as usize;
        let [h, w] = self.half_um();
        for r in clip(low[0], self.grid.rows)..clip(high[0] + 1.0, self.grid.rows) {
            for c in clip(low[1], self.grid.cols)..clip(high[1] + 1.0, self.grid.cols) {
                let at = [(r as f64 + 0.5) * pixel - h, (c as f64 + 0.5) * pixel - w];
                let ink = shape(at);
                let cover = (0.5 - ink.distance_um / pixel).clamp(0.0, 1.0);
                let paint = (ink.value * cover) as f32;
                let light = &mut self.light[[r, c]];
                match blend {
                    Blend::Add => *light += paint,
                    Blend::Max => *light = light.max(paint),
                    Blend::Over => *light = paint + (1.0 - cover as f32) * *light,
                }
            }
        }
    }

    /// Removes 90 % of the light under a shape; `distance_um` is the signed distance to its edge, as in
    /// [`Self::paint`].
    pub(super) fn dim(&mut self, ends: [Point; 2], reach_um: f64, distance_um: impl Fn(Point) -> f64) {
        let mut cover = Self::new(&self.grid);
        cover.paint(ends, reach_um, Blend::Max, |p| Ink { distance_um: distance_um(p), value: 0.9 });
        self.light.zip_mut_with(&cover.light, |light, cover| *light *= 1.0 - cover);
    }

    /// Paints a disc with the light of its true area, even if it is smaller than a pixel.
    pub(super) fn disc(&mut self, centre: Point, radius_um: f64, value: f64, blend: Blend) {
        let (radius, value) = self.at_least_a_pixel(radius_um, value);
        let disc = |p| Ink { distance_um: length(sub(p, centre)) - radius, value };
        self.paint([centre, centre], radius, blend, disc);
    }

    /// Paints a straight stroke with round ends. Its radius changes from `radii_um[0]` to `radii_um[1]`.
    pub(super) fn stroke(&mut self, ends: [Point; 2], radii_um: [f64; 2], value: f64, blend: Blend) {
        let axis = sub(ends[1], ends[0]);
        let square = axis[0] * axis[0] + axis[1] * axis[1];
        let (thin, value) = (radii_um[0].min(radii_um[1]), value);
        let (_, value) = self.at_least_a_pixel_wide(thin, value);
        let least = self.grid.pixel_um / 2.0;
        let reach = radii_um[0].max(radii_um[1]).max(least);
        self.paint(ends, reach, blend, |p| {
            let q = sub(p, ends[0]);
            let t = if square > 0.0 { ((q[0] * axis[0] + q[1] * axis[1]) / square).clamp(0.0, 1.0) } else { 0.0 };
            let radius = (radii_um[0] + t * (radii_um[1] - radii_um[0])).max(least);
            Ink { distance_um: length(sub(q, [t * axis[0], t * axis[1]])) - radius, value }
        });
    }

    /// Radius and brightness for painting a disc with the light of its true area: an edge that falls off over one pixel
    /// gives a disc the area `pi (r^2 + pixel^2 / 12)`.
    fn at_least_a_pixel(&self, radius: f64, value: f64) -> (f64, f64) {
        let painted = radius.max(0.5 * self.grid.pixel_um);
        (painted, value * radius.powi(2) / (painted.powi(2) + self.grid.pixel_um.powi(2) / 12.0))
    }

    /// Radius and brightness for painting a stroke that is at least a pixel wide, with the light of its true width.
    fn at_least_a_pixel_wide(&self, radius: f64, value: f64) -> (f64, f64) {
        let least = 0.5 * self.grid.pixel_um;
        if radius >= least { (radius, value) } else { (least, value * radius / least) }
    }
}

pub(super) fn sub(a: Point, b: Point) -> Point {
    [a[0] - b[0], a[1] - b[1]]
}

pub(super) fn add(a: Point, b: Point) -> Point {
    [a[0] + b[0], a[1] + b[1]]
}

pub(super) fn length(a: Point) -> f64 {
    a[0].hypot(a[1])
}

/// The vector of length `distance` in the direction `angle`, rad from the column axis to the row axis.
pub(super) fn polar(distance: f64, angle: f64) -> Point {
    [distance * angle.sin(), distance * angle.cos()]
}

/// A random number from `low` to `high` whose logarithm is uniformly distributed.
pub(super) fn log_uniform(rng: &mut impl Rng, low: f64, high: f64) -> f64 {
    (rng.random_range(low.ln()..high.ln())).exp()
}

/// The value between four nodes, `node(down, across)`, at shares 0 to 1 of the way down and across: bilinear.
pub(super) fn between(node: impl Fn(usize, usize) -> f64, [down, across]: [f64; 2]) -> f64 {
    let along = |row| node(row, 0) * (1.0 - across) + node(row, 1) * across;
    along(0) * (1.0 - down) + along(1) * down
}

/// A random direction, rad.
pub(super) fn direction(rng: &mut impl Rng) -> f64 {
    rng.random_range(0.0..std::f64::consts::TAU)
}
