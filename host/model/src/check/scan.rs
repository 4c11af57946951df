//! The bead frames, made small, and how well they coincide.

use ndarray::{Array2, s};
use ommatidia_physics::sensor::constant_dn;
use ommatidia_session::{Cut, Manifest, Role, Session, SessionError};
use rayon::prelude::*;

/// A frame is looked at more closely if its correlation is below this share of the median one.
pub(super) const SUSPECT: f64 = 0.6;
/// Most memory of all small frames, pixels.
const MOST_PX: usize = 32 << 20;
/// Longest side of a small frame, pixels.
const SIDE: [f64; 2] = [96.0, 256.0];
/// Most pixels that are read; of a larger scan an even sample of the frames is used.
const MOST_READ_PX: usize = 1 << 30;

/// One bead frame.
#[derive(Clone, Debug)]
pub struct Small {
    /// Index among all bead frames of the session.
    pub bead: usize,
    /// Its file, relative to the session.
    pub file: String,
    /// Index in its file.
    pub frame: usize,
    /// Displacement of its foci by the table, sensor pixels [row, col].
    pub moved_px: [f64; 2],
    /// Position in the table, um [y, x].
    pub at_um: [f64; 2],
    /// Depth, um.
    pub z_um: f64,
    /// Time in the table, s; 0 without one.
    pub time_s: f64,
    /// Light above the median of all frames, small, DN.
    pub light: Array2<f32>,
    /// Sum of the light, DN.
    pub total_dn: f64,
    /// Median of the frame, DN.
    pub level_dn: f32,
    /// Sum of the squares that the noise adds to those of the light, DN^2.
    pub noise_dn2: f64,
}

/// The bead scan.
#[derive(Clone, Debug)]
pub struct Scan {
    /// Its frames, in order.
    pub frames: Vec<Small>,
    /// Displacements by the table of all bead frames, also of those that were not read, sensor pixels.
    pub all_moved_px: Vec<[f64; 2]>,
    /// Depths of all bead frames, um.
    pub all_z_um: Vec<f64>,
    /// Number of bead frames that were read; those of one value, and those without light, are not among `frames`.
    pub read: usize,
    /// Sensor pixels along one side of a small pixel.
    pub bin: usize,
}

impl Scan {
    /// Reads the bead frames of a session.
    ///
    /// # Errors
    /// A frame cannot be read.
    pub fn read(session: &Session, step: &mut dyn FnMut()) -> Result<Self, SessionError> {
        let m = session.manifest();
        let stacks: Vec<_> = session.stacks_of(Role::Bead).collect();
        let count: usize = stacks.iter().map(|s| s.len()).sum();
        let most = (MOST_READ_PX / (m.sensor.rows * m.sensor.cols)).max(16);
        let every = count.div_ceil(most).max(1);
        let side = ((MOST_PX as f64 / count.div_ceil(every).max(1) as f64).sqrt()).clamp(SIDE[0], SIDE[1]);
        let bin = (m.sensor.rows.max(m.sensor.cols) as f64 / side).ceil().max(1.0) as usize;
        let (mut frames, mut all_moved_px, mut all_z_um) = (Vec::new(), Vec::new(), Vec::new());
        let (mut bead, mut read) = (0, 0);
        for stack in stacks {
            let mut reader = stack.frames()?;
            for info in stack.whole() {
                let moved_px = moved_px(m, [info.y_um, info.x_um]);
                all_moved_px.push(moved_px);
                all_z_um.push(info.z_um);
                if bead % every == 0 {
                    let frame = reader.read(info.frame)?;
                    step();
                    read += 1;
                    bead += 1;
                    if constant_dn(frame.iter()).is_some() {
                        continue;
                    }
                    let (light, level_dn) = small(&frame, bin);
                    let (at_um, z_um) = ([info.y_um, info.x_um], info.z_um);
                    let file = stack.entry().file.clone();
                    let frame = info.frame;
                    frames.push(Small {
                        bead: bead - 1,
                        file,
                        frame,
                        moved_px,
                        at_um,
                        z_um,
                        time_s: info.time_s,
                        light,
                        total_dn: 0.0,
                        level_dn,
                        noise_dn2: 0.0,
                    });
                } else {
                    bead += 1;
                }
            }
        }
        without_pattern(&mut frames);
        for f in &mut frames {
            f.total_dn = f.light.iter().map(|v| f64::from(*v)).sum::<f64>() * (bin * bin) as f64;
            f.light = box_blur(&f.light);
            let mut off: Vec<f32> = f.light.iter().map(|v| v.abs()).collect();
            // The light of foci covers few pixels: the median is that of the noise.
            f.noise_dn2 = (1.4826 * f64::from(median(&mut off))).powi(2) * f.light.len() as f64;
        }
        Ok(Self { frames, all_moved_px, all_z_um, read, bin })
    }

    /// The frames of each depth, since foci change their shape with depth: first the depth with the most frames (of
    /// several such depths that nearest to 0 um), then the others, ascending. At least one, which may be empty.
    pub fn by_depth(self) -> Vec<Self> {
        let Self { frames, all_moved_px, all_z_um, read, bin } = self;
        let mut depths: Vec<Self> = Vec::new();
        for frame in frames {
            match depths.iter_mut().find(|depth| same_depth(depth.z_um(), frame.z_um)) {
                Some(depth) => depth.frames.push(frame),
                None => depths.push(Self {
                    frames: vec![frame],
                    all_moved_px: all_moved_px.clone(),
                    all_z_um: all_z_um.clone(),
                    read,
                    bin,
                }),
            }
        }
        depths.sort_by(|a, b| a.z_um().total_cmp(&b.z_um()));
        let rank = |depth: &Self| (depth.frames.len(), -depth.z_um().abs());
        let main = (0..depths.len()).max_by(|a, b| {
            let (a, b) = (rank(&depths[*a]), rank(&depths[*b]));
            a.0.cmp(&b.0).then(a.1.total_cmp(&b.1))
        });
        match main {
            Some(main) => depths[..=main].rotate_right(1),
            None => depths.push(Self { frames: Vec::new(), all_moved_px, all_z_um, read, bin }),
        }
        depths
    }

    /// Depth of the first frame, um; 0 without one.
    pub fn z_um(&self) -> f64 {
        self.frames.first().map_or(0.0, |f| f.z_um)
    }

    /// The sum of all frames, each moved back by `moved` (sensor pixels, one entry a frame).
    pub fn sum(&self, moved: &[[f64; 2]]) -> Array2<f32> {
        let Some(first) = self.frames.first() else { return Array2::zeros((0, 0)) };
        let mut sum = Array2::zeros(first.light.dim());
        self.frames.iter().zip(moved).for_each(|(f, by)| add(&mut sum, &f.light, self.steps(*by), 1.0));
        sum
    }

    /// Correlation of each frame, moved back by `moved`, with the sum of all others.
    pub fn correlations(&self, moved: &[[f64; 2]]) -> Vec<f64> {
        let sum = self.sum(moved);
        let all = dot(&sum, &sum);
        let noise: f64 = self.frames.iter().map(|f| f.noise_dn2).sum();
        let one = |(f, by): (&Small, &[f64; 2])| {
            let (with_sum, own) = overlap(&f.light, &sum, self.steps(*by));
            // The sum of the others is the sum less this frame. The whole norm of the frame counts: what is moved off
            // the sensor coincides with nothing.
            let others = all - 2.0 * with_sum + own;
            cosine(with_sum - own, without(dot(&f.light, &f.light), f.noise_dn2), without(others, noise - f.noise_dn2))
        };
        self.frames.par_iter().zip(moved).map(one).collect()
    }

    /// A displacement in whole small pixels.
    pub fn steps(&self, px: [f64; 2]) -> [isize; 2] {
        px.map(|v| (v / self.bin as f64).round().clamp(-1e6, 1e6) as isize)
    }

    /// Displacements of the frames by the table, sensor pixels.
    pub fn table(&self) -> Vec<[f64; 2]> {
        self.frames.iter().map(|f| f.moved_px).collect()
    }
}

/// Whether two depths count as one, as in a calibration.
pub fn same_depth(a_um: f64, b_um: f64) -> bool {
    (a_um - b_um).abs() < 1e-3
}

/// Displacement of the foci of a bead at a stage position [y, x] um, by the manifest, sensor pixels.
pub fn moved_px(m: &Manifest, at_um: [f64; 2]) -> [f64; 2] {
    at_um.map(|um| um * m.optics.magnification / m.sensor.pixel_pitch_um)
}

/// Adds `factor` times an image moved back by whole pixels.
pub fn add(sum: &mut Array2<f32>, image: &Array2<f32>, by: [isize; 2], factor: f32) {
    let (rows, cols) = sum.dim();
    let (Some(r), Some(c)) = (span(rows, by[0]), span(cols, by[1])) else { return };
    let from = image.slice(s![r.start + by[0]..r.end + by[0], c.start + by[1]..c.end + by[1]]);
    sum.slice_mut(s![r, c]).zip_mut_with(&from, |t, v| *t += factor * v);
}

/// Sums of products of an image, moved back by whole pixels, with another one and with itself.
fn overlap(image: &Array2<f32>, other: &Array2<f32>, by: [isize; 2]) -> (f64, f64) {
    let (rows, cols) = other.dim();
    let (Some(r), Some(c)) = (span(rows, by[0]), span(cols, by[1])) else { return (0.0, 0.0) };
    let from = image.slice(s![r.start + by[0]..r.end + by[0], c.start + by[1]..c.end + by[1]]);
    let (mut with, mut own) = (0.0, 0.0);
    for (a, b) in from.outer_iter().zip(other.slice(s![r, c]).outer_iter()) {
        let (mut x, mut y) = (0.0f32, 0.0f32);
        for (a, b) in a.iter().zip(b) {
            x += a * b;
            y += a * a;
        }
        with += f64::from(x);
        own += f64::from(y);
    }
    (with, own)
}

/// Range of pixels along an axis of length `n` that is still there after a motion back by `d`.
fn span(n: usize, d: isize) -> Option<std::ops::Range<isize>> {
    let (low, high) = ((-d).max(0), (n as isize - d).min(n as isize));
    (low < high).then_some(low..high)
}

/// Sum of products.
pub fn dot(a: &Array2<f32>, b: &Array2<f32>) -> f64 {
    a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum()
}

/// A sum of squares without that of the noise; a twentieth of it stays in any case.
pub fn without(squares: f64, noise: f64) -> f64 {
    (squares - noise).max(0.05 * squares)
}

fn cosine(ab: f64, aa: f64, bb: f64) -> f64 {
    if aa > 0.0 && bb > 0.0 { ab / (aa * bb).sqrt() } else { 0.0 }
}

/// Means of `bin` x `bin` pixels above the median of the frame, and that median. Pixels outside a cut count as the
/// median.
fn small(frame: &Array2<f32>, bin: usize) -> (Array2<f32>, f32) {
    let cut = Cut::of(frame);
    let measured = |r: usize, c: usize| cut.as_ref().is_none_or(|cut| cut.holds(r, c));
    let mut values: Vec<f32> = frame.indexed_iter().filter(|((r, c), _)| measured(*r, *c)).map(|(_, v)| *v).collect();
    let level = median(&mut values);
    let (rows, cols) = (frame.nrows().div_ceil(bin), frame.ncols().div_ceil(bin));
    let mut sum = Array2::<f32>::zeros((rows, cols));
    for ((r, c), v) in frame.indexed_iter().filter(|((r, c), _)| measured(*r, *c)) {
        sum[[r / bin, c / bin]] += v - level;
    }
    sum.mapv_inplace(|v| v / (bin * bin) as f32);
    (sum, level)
}

/// Takes the median of all frames off each: hot pixels and steady light coincide where nothing moves.
fn without_pattern(frames: &mut [Small]) {
    if frames.len() < 8 {
        return;
    }
    let dim = frames[0].light.dim();
    let every = frames.len().div_ceil(64);
    let pattern: Vec<f32> = (0..dim.0 * dim.1)
        .into_par_iter()
        .map(|p| {
            let at = [p / dim.1, p % dim.1];
            median(&mut frames.iter().step_by(every).map(|f| f.light[at]).collect::<Vec<f32>>())
        })
        .collect();
    for f in frames {
        f.light.iter_mut().zip(&pattern).for_each(|(v, p)| *v -= p);
    }
}

/// Median; 0 of nothing.
pub fn median(values: &mut [f32]) -> f32 {
    let middle = values.len() / 2;
    if values.is_empty() { 0.0 } else { *values.select_nth_unstable_by(middle, f32::total_cmp).1 }
}

/// Median of figures; 0 of nothing.
pub fn middle(values: &[f64]) -> f64 {
    f64::from(median(&mut values.iter().map(|v| *v as f32).collect::<Vec<_>>()))
}

/// Means of 3 x 3 pixels: room for foci that are not quite where they should be.
fn box_blur(image: &Array2<f32>) -> Array2<f32> {
    let (rows, cols) = image.dim();
    Array2::from_shape_fn((rows, cols), |(r, c)| {
        let part = image.slice(s![r.saturating_sub(1)..(r + 2).min(rows), c.saturating_sub(1)..(c + 2).min(cols)]);
        part.sum() / 9.0
    })
}
