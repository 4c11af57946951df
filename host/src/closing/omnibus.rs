//! Omnibus tests: does the residual depend on anything at all, whatever the catalogue says?
//!
//! For each covariate the residual of the scenes is summed in bins; the error of a bin's sum is its scatter between cells (one frame by
//! one block) together with the calibration's own uncertainty. The sum of squares over bins is compared with draws of the model: noise
//! and calibration errors, the nuisances fitted as in the data. Tables are not trusted here (Protocol 6).

use super::model::{Model, Predicted};
use super::observe::Shown;
use super::refit::Fitted;
use super::repeats;
use super::stats::{chi2_tail, sigmas};
use crate::effects::blur_within;
use crate::noise::MapErrors;
use crate::rng::stream;
use ndarray::Array2;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Bins of a covariate that has no bins of its own.
const BINS: usize = 24;
/// Draws that the thresholds come from.
const DRAWS: usize = 48;

/// What a residual may depend on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Covariate {
    /// Row of the sensor.
    Row,
    /// Column of the sensor.
    Column,
    /// Even or odd row.
    RowParity,
    /// Even or odd column.
    ColumnParity,
    /// The colours of a checkerboard.
    Checkerboard,
    /// Distance from the middle of the sensor.
    Radius,
    /// The lens whose chief ray of the on-axis source is nearest.
    Lens,
    /// Row from the anchor of that lens: place on the object.
    FieldRow,
    /// Column from the anchor of that lens.
    FieldColumn,
    /// Expected light of the pixel.
    Intensity,
    /// Mean expected light around it.
    LocalMean,
    /// Expected light against its surroundings: how sharp the picture is there.
    Sharpness,
    /// Light of the pixel in the frame before.
    PreviousFrame,
    /// The frame.
    Frame,
    /// Neighbours in space: correlation of the residual at small distances.
    Neighbours,
    /// The same pixel one frame on.
    NextFrame,
    /// The noise of repeats: its variance; its correlation along the row, along the column and diagonally; what rows and what columns
    /// share.
    Repeats,
}

impl Covariate {
    /// All of them.
    pub const ALL: [Self; 17] = [
        Self::Row,
        Self::Column,
        Self::RowParity,
        Self::ColumnParity,
        Self::Checkerboard,
        Self::Radius,
        Self::Lens,
        Self::FieldRow,
        Self::FieldColumn,
        Self::Intensity,
        Self::LocalMean,
        Self::Sharpness,
        Self::PreviousFrame,
        Self::Frame,
        Self::Neighbours,
        Self::NextFrame,
        Self::Repeats,
    ];

    /// In words.
    pub fn words(self) -> &'static str {
        match self {
            Self::Row => "row",
            Self::Column => "column",
            Self::RowParity => "row parity",
            Self::ColumnParity => "column parity",
            Self::Checkerboard => "checkerboard",
            Self::Radius => "radius from the middle of the sensor",
            Self::Lens => "lens",
            Self::FieldRow => "row from the lens's anchor",
            Self::FieldColumn => "column from the lens's anchor",
            Self::Intensity => "expected light",
            Self::LocalMean => "expected light around the pixel",
            Self::Sharpness => "expected light against its surroundings",
            Self::PreviousFrame => "light of the frame before",
            Self::Frame => "frame",
            Self::Neighbours => "residual of neighbouring pixels",
            Self::NextFrame => "residual of the next frame",
            Self::Repeats => "noise of repeats: variance, neighbours, rows, columns",
        }
    }

    fn is_product(self) -> bool {
        matches!(self, Self::Neighbours | Self::NextFrame)
    }
}

/// The residual against one covariate.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Dependence {
    /// The covariate.
    pub covariate: Covariate,
    /// Place of each bin: pixels, electrons, index, whichever the covariate counts in.
    pub at: Vec<f64>,
    /// Mean residual of each bin in standard deviations of a pixel (correlation, for neighbours and frames; standard errors, for repeats).
    pub mean: Vec<f64>,
    /// Standard deviation of that mean if the model is right: the null band.
    pub band: Vec<f64>,
    /// Sum of squares over the bins against its error.
    pub chi2: f64,
    /// Its mean over draws of the model.
    pub expected: f64,
    /// Probability of a larger one if the model is right.
    pub p: f64,
    /// The same as standard deviations.
    pub z: f64,
}

/// Bins of a covariate for the scenes: bin of each looked-at pixel of each frame (or none), and the places of the bins.
struct Bins {
    covariate: Covariate,
    of: Vec<Vec<u16>>,
    at: Vec<f64>,
}

/// No bin.
const NONE: u16 = u16::MAX;

/// Tests every covariate on the frames of known objects (of unknown specimens where there are no others), and the noise on repeats;
/// held-out frames left out.
pub fn test(model: &Model<'_>, fitted: &Fitted, replicas: &[Vec<Option<Array2<f32>>>], seed: u64) -> Vec<Dependence> {
    let mut all = on_scenes(model, &fitted.predicted, replicas, seed);
    all.extend(on_repeats(repeats::residuals(model, &fitted.state, &fitted.predicted)));
    all
}

/// The covariance channel: the features of repeats are sums over so many pixels that they are normal, and need no draws.
fn on_repeats(levels: Vec<repeats::Features>) -> Option<Dependence> {
    let n = levels.len() as f64;
    if levels.is_empty() {
        return None;
    }
    let mut mean = vec![0.0; repeats::FEATURES];
    let mut chi2 = 0.0;
    for level in &levels {
        mean.iter_mut().zip(level).for_each(|(m, v)| *m += v / n);
        chi2 += level.iter().map(|v| v * v).sum::<f64>();
    }
    let dof = n * repeats::FEATURES as f64;
    let p = chi2_tail(chi2, dof);
    Some(Dependence {
        covariate: Covariate::Repeats,
        at: (0..mean.len()).map(|i| i as f64).collect(),
        band: vec![1.0 / n.sqrt(); mean.len()],
        mean,
        chi2,
        expected: dof,
        p,
        z: sigmas(p),
    })
}

fn on_scenes(
    model: &Model<'_>,
    now: &[Predicted],
    replicas: &[Vec<Option<Array2<f32>>>],
    seed: u64,
) -> Vec<Dependence> {
    let frames = scenes(model);
    if frames.is_empty() {
        return Vec::new();
    }
    // The sharp part of an unknown specimen is its own: only what is fixed to the sensor can be held against the model.
    let unknown = model.seen.frames[frames[0]].shown == Shown::Unknown;
    let fixed = |c: &Covariate| matches!(c, Covariate::RowParity | Covariate::ColumnParity | Covariate::Checkerboard);
    let tested: Vec<Covariate> = Covariate::ALL.into_iter().filter(|c| !unknown || fixed(c)).collect();
    let bins: Vec<Bins> = tested.par_iter().filter_map(|c| Bins::of(*c, model, now, &frames)).collect();
    let residual: Vec<Vec<f32>> = frames.iter().map(|k| gather(model, &now[*k], &now[*k].residual_dn)).collect();
    let directions: Vec<Vec<Option<Vec<f32>>>> = replicas
        .iter()
        .map(|r| frames.iter().map(|k| r[*k].as_ref().map(|d| gather(model, &now[*k], d))).collect())
        .collect();
    let templates: Vec<[Vec<f32>; 2]> = frames
        .iter()
        .map(|k| {
            let light = now[*k].light_e.mapv(|e| e * model.forward.noise().gain_dn_per_e as f32);
            [gather(model, &now[*k], &light), gather(model, &now[*k], &Array2::ones(light.dim()))]
        })
        .collect();
    let draws: Vec<Vec<(f64, Vec<f64>)>> = (0..DRAWS)
        .into_par_iter()
        .map(|d| {
            let drawn = draw(&residual, &directions, &templates, model.maps, seed, d as u64);
            bins.iter().map(|b| b.statistic(model, &frames, &drawn)).map(|s| (s.chi2, s.mean)).collect()
        })
        .collect();
    bins.iter()
        .enumerate()
        .map(|(i, b)| {
            let s = b.statistic(model, &frames, &residual);
            let null: Vec<f64> = draws.iter().map(|d| d[i].0).collect();
            let n = null.len() as f64;
            let expected = null.iter().sum::<f64>() / n;
            let variance = null.iter().map(|v| (v - expected).powi(2)).sum::<f64>() / (n - 1.0);
            // A scaled chi-squared of the same mean and variance.
            let p = chi2_tail(s.chi2 * 2.0 * expected / variance, 2.0 * expected * expected / variance);
            let band =
                (0..s.mean.len()).map(|j| (draws.iter().map(|d| d[i].1[j].powi(2)).sum::<f64>() / n).sqrt()).collect();
            Dependence {
                covariate: b.covariate,
                at: b.at.clone(),
                mean: s.mean,
                band,
                chi2: s.chi2,
                expected,
                p,
                z: sigmas(p),
            }
        })
        .collect()
}

/// The frames that are looked at.
fn scenes(model: &Model<'_>) -> Vec<usize> {
    let frames = &model.seen.frames;
    let open = |k: &usize| !frames[*k].held_out;
    let known: Vec<usize> = (0..frames.len())
        .filter(open)
        .filter(|k| matches!(frames[*k].shown, Shown::Object(_) | Shown::Bead(..)))
        .collect();
    if !known.is_empty() {
        return known;
    }
    (0..frames.len()).filter(|k| frames[*k].shown == Shown::Unknown).collect()
}

/// Values at the looked-at pixels, in units of the noise; zero in held-out blocks.
fn gather(model: &Model<'_>, here: &Predicted, image: &Array2<f32>) -> Vec<f32> {
    let (Some(image), Some(weight)) = (image.as_slice(), here.inverse_sigma.as_slice()) else { return Vec::new() };
    let seen = model.seen;
    let mut out: Vec<f32> = seen.pixels.iter().map(|p| image[*p as usize] * weight[*p as usize]).collect();
    for (span, _) in seen.blocks.iter().zip(&seen.held_out_blocks).filter(|(_, h)| **h) {
        out[span.clone()].fill(0.0);
    }
    out
}

/// Residuals as the model makes them: noise, calibration errors, what the maps of the sensor leave, which is the same in all frames; the
/// light of the frames and the black level fitted.
fn draw(
    like: &[Vec<f32>],
    directions: &[Vec<Option<Vec<f32>>>],
    templates: &[[Vec<f32>; 2]],
    maps: MapErrors,
    seed: u64,
    index: u64,
) -> Vec<Vec<f32>> {
    let mut rng = stream(seed, "omnibus", index);
    let mut normal = || -> f32 { StandardNormal.sample(&mut rng) };
    let n = directions.len() as f32;
    let xi: Vec<f32> = directions.iter().map(|_| normal() * ((n - 1.0) / n).sqrt()).collect();
    let mean_xi = xi.iter().sum::<f32>() / n.max(1.0);
    let pixels = like.first().map_or(0, Vec::len);
    let mut pattern = |rms: f64| -> Vec<f32> {
        if rms > 0.0 { (0..pixels).map(|_| rms as f32 * normal()).collect() } else { vec![0.0; pixels] }
    };
    let patterns = [pattern(maps.response), pattern(maps.offset_dn)];
    let mut drawn: Vec<Vec<f32>> = like
        .iter()
        .enumerate()
        .map(|(f, frame)| {
            // A pixel that is not looked at has no residual.
            let mut r: Vec<f32> = frame.iter().map(|v| if *v == 0.0 { 0.0 } else { normal() }).collect();
            for (pattern, template) in patterns.iter().zip(&templates[f]) {
                r.iter_mut().zip(pattern.iter().zip(template)).for_each(|(r, (p, t))| *r += p * t);
            }
            for (xi, direction) in xi.iter().zip(directions) {
                if let Some(d) = &direction[f] {
                    r.iter_mut().zip(d).for_each(|(r, d)| *r += (xi - mean_xi) * d);
                }
            }
            r
        })
        .collect();
    project(&mut drawn, templates);
    drawn
}

/// Takes out what the light of all frames and the black level can take.
fn project(frames: &mut [Vec<f32>], templates: &[[Vec<f32>; 2]]) {
    let dot = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(x, y)| f64::from(x * y)).sum::<f64>();
    let (mut g, mut s) = ([0.0; 3], [0.0; 2]);
    for (r, [a, b]) in frames.iter().zip(templates) {
        g.iter_mut().zip([dot(a, a), dot(a, b), dot(b, b)]).for_each(|(g, v)| *g += v);
        s.iter_mut().zip([dot(a, r), dot(b, r)]).for_each(|(s, v)| *s += v);
    }
    let determinant = g[0] * g[2] - g[1] * g[1];
    if determinant <= 1e-9 * g[0] * g[2] {
        return;
    }
    let (u, v) = ((g[2] * s[0] - g[1] * s[1]) / determinant, (g[0] * s[1] - g[1] * s[0]) / determinant);
    for (r, [a, b]) in frames.iter_mut().zip(templates) {
        for ((r, a), b) in r.iter_mut().zip(a).zip(b) {
            *r -= u as f32 * a + v as f32 * b;
        }
    }
}

struct Statistic {
    chi2: f64,
    mean: Vec<f64>,
}

impl Bins {
    fn of(covariate: Covariate, model: &Model<'_>, now: &[Predicted], frames: &[usize]) -> Option<Self> {
        let seen = model.seen;
        let [rows, cols] = seen.sensor;
        let cx = model.forward.context();
        let nearest = |r: f64, c: f64| {
            let off = |a: &[f64; 2]| (a[0] - r).powi(2) + (a[1] - c).powi(2);
            let lenses = 0..cx.anchors_px.len();
            lenses.min_by(|a, b| off(&cx.anchors_px[*a]).total_cmp(&off(&cx.anchors_px[*b]))).unwrap_or(0)
        };
        let per_frame = |value: &dyn Fn(&Predicted, usize) -> Vec<f64>| -> Vec<Vec<f64>> {
            frames.iter().map(|k| value(&now[*k], *k)).collect()
        };
        let at_pixels = |image: &Array2<f32>| -> Vec<f64> {
            let image = image.as_slice().unwrap_or(&[]);
            seen.pixels.iter().map(|p| f64::from(image[*p as usize])).collect()
        };
        let place = |value: &dyn Fn(f64, f64) -> f64| -> Vec<Vec<f64>> {
            let at = |p: &u32| value((*p as usize / cols) as f64, (*p as usize % cols) as f64);
            vec![seen.pixels.iter().map(at).collect()]
        };
        let middle = [(rows as f64 - 1.0) / 2.0, (cols as f64 - 1.0) / 2.0];
        let (values, whole) = match covariate {
            Covariate::Row => (place(&|r, _| r), false),
            Covariate::Column => (place(&|_, c| c), false),
            Covariate::RowParity => (place(&|r, _| r % 2.0), true),
            Covariate::ColumnParity => (place(&|_, c| c % 2.0), true),
            Covariate::Checkerboard => (place(&|r, c| (r + c) % 2.0), true),
            Covariate::Radius => (place(&|r, c| (r - middle[0]).hypot(c - middle[1])), false),
            Covariate::Lens if cx.anchors_px.len() > 1 => (place(&|r, c| nearest(r, c) as f64), true),
            Covariate::FieldRow if cx.anchors_px.len() > 1 => {
                (place(&|r, c| r - cx.anchors_px[nearest(r, c)][0]), false)
            }
            Covariate::FieldColumn if cx.anchors_px.len() > 1 => {
                (place(&|r, c| c - cx.anchors_px[nearest(r, c)][1]), false)
            }
            Covariate::Lens | Covariate::FieldRow | Covariate::FieldColumn => return None,
            Covariate::Intensity => (per_frame(&|p, _| at_pixels(&p.light_e)), false),
            Covariate::LocalMean => (per_frame(&|p, _| at_pixels(&blur_within(&p.light_e, 6.0))), false),
            Covariate::Sharpness => (
                per_frame(&|p, _| {
                    let soft = blur_within(&p.light_e, 1.5);
                    at_pixels(&((&p.light_e - &soft) / soft.mapv(|v| (v + 50.0).sqrt())))
                }),
                false,
            ),
            Covariate::PreviousFrame => {
                let before = |k: usize| seen.frames[k].previous.map(|p| at_pixels(&now[p].light_e));
                (per_frame(&|_, k| before(k).unwrap_or_default()), false)
            }
            Covariate::Frame => {
                if frames.len() < 2 {
                    return None;
                }
                let of = frames.iter().enumerate().map(|(i, _)| vec![i as u16; seen.pixels.len()]).collect();
                return Some(Self {
                    covariate,
                    of,
                    at: frames.iter().map(|k| seen.frames[*k].info.frame as f64).collect(),
                });
            }
            Covariate::Neighbours => {
                return Some(Self { covariate, of: Vec::new(), at: vec![1.0, 1.0, 2f64.sqrt(), 2.0, 2.0] });
            }
            Covariate::NextFrame if frames.len() > 1 => return Some(Self { covariate, of: Vec::new(), at: vec![1.0] }),
            Covariate::NextFrame | Covariate::Repeats => return None,
        };
        if values.iter().all(Vec::is_empty) {
            return None;
        }
        // Bins of equal content, by the values of all frames together.
        let mut sorted: Vec<f64> = values.iter().flat_map(|v| v.iter().step_by(37)).copied().collect();
        sorted.sort_by(f64::total_cmp);
        let edges: Vec<f64> = if whole {
            let last = sorted.last().copied().unwrap_or(0.0);
            (1..=last as usize).map(|i| i as f64 - 0.5).collect()
        } else {
            let mut edges: Vec<f64> = (1..BINS).map(|i| sorted[i * sorted.len() / BINS]).collect();
            edges.dedup();
            edges
        };
        let bin = |v: &f64| edges.partition_point(|e| e <= v) as u16;
        let one = |v: &Vec<f64>| -> Vec<u16> {
            if v.is_empty() { vec![NONE; seen.pixels.len()] } else { v.iter().map(bin).collect() }
        };
        let binned: Vec<Vec<u16>> = values.iter().map(one).collect();
        let of: Vec<Vec<u16>> = (0..frames.len()).map(|f| binned[f.min(binned.len() - 1)].clone()).collect();
        let (mut sum, mut n) = (vec![0.0; edges.len() + 1], vec![0.0; edges.len() + 1]);
        for (b, v) in binned.iter().zip(&values).flat_map(|(b, v)| b.iter().zip(v)).filter(|(b, _)| **b != NONE) {
            sum[*b as usize] += v;
            n[*b as usize] += 1.0;
        }
        let at = sum.iter().zip(&n).map(|(s, n): (&f64, &f64)| s / n.max(1.0)).collect();
        Some(Self { covariate, of, at })
    }

    /// Sums of one cell by bin, and how many pixels they are of.
    fn cell(
        &self,
        model: &Model<'_>,
        residual: &[Vec<f32>],
        f: usize,
        span: std::ops::Range<usize>,
        sum: &mut [f64],
        n: &mut [f64],
    ) {
        if self.covariate.is_product() {
            self.products(model, residual, f, span, sum, n);
            return;
        }
        for (b, r) in self.of[f][span.clone()].iter().zip(&residual[f][span]) {
            if *b != NONE && *r != 0.0 {
                sum[*b as usize] += f64::from(*r);
                n[*b as usize] += 1.0;
            }
        }
    }

    /// Products of residuals: of neighbours, or of the same pixel in the next frame.
    fn products(
        &self,
        model: &Model<'_>,
        residual: &[Vec<f32>],
        f: usize,
        span: std::ops::Range<usize>,
        sum: &mut [f64],
        n: &mut [f64],
    ) {
        let mut put = |i: usize, a: f32, b: f32| {
            if a != 0.0 && b != 0.0 {
                sum[i] += f64::from(a * b);
                n[i] += 1.0;
            }
        };
        if self.covariate == Covariate::NextFrame {
            if let Some(next) = residual.get(f + 1) {
                span.for_each(|i| put(0, residual[f][i], next[i]));
            }
            return;
        }
        // Within a block pixels are stored row by row; a sampled frame has no neighbours to speak of.
        let cols = model.seen.sensor[1] as u32;
        let pixels = &model.seen.pixels[span.clone()];
        let r = &residual[f][span];
        let width = pixels.windows(2).position(|w| w[1] != w[0] + 1).map_or(pixels.len(), |i| i + 1);
        for i in 0..pixels.len() {
            for (lag, (dr, dc)) in [(0usize, 1usize), (1, 0), (1, 1), (0, 2), (2, 0)].into_iter().enumerate() {
                let j = i + dr * width + dc;
                if j < pixels.len() && pixels[j] == pixels[i] + dr as u32 * cols + dc as u32 {
                    put(lag, r[i], r[j]);
                }
            }
        }
    }

    fn statistic(&self, model: &Model<'_>, frames: &[usize], residual: &[Vec<f32>]) -> Statistic {
        let bins = self.at.len();
        let (mut total, mut square, mut count) = (vec![0.0; bins], vec![0.0; bins], vec![0.0; bins]);
        for f in 0..frames.len() {
            for span in &model.seen.blocks {
                let (mut sum, mut n) = (vec![0.0; bins], vec![0.0; bins]);
                self.cell(model, residual, f, span.clone(), &mut sum, &mut n);
                for b in 0..bins {
                    total[b] += sum[b];
                    // At least what white noise makes of it.
                    square[b] += (sum[b] * sum[b]).max(n[b]);
                    count[b] += n[b];
                }
            }
        }
        let chi2 = (0..bins).filter(|b| count[*b] > 0.0).map(|b| total[b] * total[b] / square[b]).sum();
        let mean = (0..bins).map(|b| total[b] / f64::max(count[b], 1.0)).collect();
        Statistic { chi2, mean }
    }
}
