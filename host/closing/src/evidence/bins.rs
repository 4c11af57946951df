//! Sums of the residuals of the scenes in bins of a covariate.

use super::covariate::Covariate;
use crate::fit::{Model, Predicted};
use ndarray::Array2;
use ommatidia_physics::effects::blur_within;
use std::ops::Range;

/// Number of bins of a continuous covariate.
const BINS: usize = 24;

/// Bins of a covariate: the bin of each used pixel of each frame, and the mean of the covariate in each bin.
pub(crate) struct Bins {
    pub(crate) covariate: Covariate,
    of: Vec<Vec<u16>>,
    pub(crate) at: Vec<f64>,
}

/// Marks a pixel without a bin.
const NONE: u16 = u16::MAX;

/// Sums of one bin that do not wait for one another: neighbours mostly lie in the same bin.
const LANES: usize = 4;

/// Sums and numbers of the residuals of one cell in each bin, in lanes.
struct Lanes {
    sums: Vec<[f64; LANES]>,
    counts: Vec<[u32; LANES]>,
}

impl Lanes {
    fn new(bins: usize) -> Self {
        Self { sums: vec![[0.0; LANES]; bins], counts: vec![[0; LANES]; bins] }
    }

    fn clear(&mut self) {
        self.sums.fill([0.0; LANES]);
        self.counts.fill([0; LANES]);
    }

    /// Sum and number of a bin.
    fn of(&self, bin: usize) -> (f64, f64) {
        (self.sums[bin].iter().sum(), f64::from(self.counts[bin].iter().sum::<u32>()))
    }
}

/// Statistics of the residuals in bins.
pub(crate) struct Statistic {
    /// Sum over the bins of the squared sum of residuals over its variance, which is estimated from the scatter between
    /// cells.
    pub(crate) chi2: f64,
    /// Mean residual of each bin.
    pub(crate) mean: Vec<f64>,
}

impl Bins {
    /// Bins of a covariate for `frames`. None: the covariate does not vary in this session.
    pub(crate) fn of(covariate: Covariate, model: &Model<'_>, now: &[Predicted], frames: &[usize]) -> Option<Self> {
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
            Covariate::Intensity => {
                // Dark pixels differ in their expected light by errors of the calibration alone, so they go into one
                // bin.
                let dark = 3.0 * model.forward.noise().read_noise_e;
                let lit = |p: &Predicted| at_pixels(&p.light_e).into_iter().map(|e| e.max(dark)).collect();
                (per_frame(&|p, _| lit(p)), false)
            }
            Covariate::LocalMean => (per_frame(&|p, _| at_pixels(&blur_within(&p.light_e, 6.0))), false),
            Covariate::Sharpness => (
                per_frame(&|p, _| {
                    let soft = blur_within(&p.light_e, 1.5);
                    at_pixels(&((&p.light_e - &soft) / soft.mapv(|v| (v.max(0.0) + 50.0).sqrt())))
                }),
                false,
            ),
            Covariate::PreviousFrame => {
                let before = |k: usize| seen.frames[k].previous.map(|p| at_pixels(&now[p].light_e));
                (per_frame(&|_, k| before(k).unwrap_or_default()), false)
            }
            Covariate::TotalLight | Covariate::Depth => {
                let of = |k: usize| match covariate {
                    Covariate::Depth => seen.frames[k].info.z_um,
                    _ => f64::from(now[k].light_e.sum()),
                };
                if frames.iter().all(|k| of(*k) == of(frames[0])) {
                    return None;
                }
                (per_frame(&|_, k| vec![of(k); seen.pixels.len()]), false)
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
            Covariate::NextFrame | Covariate::Repeats | Covariate::FixedPattern => return None,
        };
        if values.iter().all(Vec::is_empty) {
            return None;
        }
        // Bins of equal numbers of pixels, over all frames.
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

    /// Adds the residuals of one cell, frame `f` and pixels `span`, to the sums of the bins.
    fn add_cell(&self, model: &Model<'_>, residual: &[Vec<f32>], f: usize, span: Range<usize>, bins: &mut Lanes) {
        if self.covariate.is_product() {
            let mut product = |lag: usize, a: f32, b: f32| {
                if a != 0.0 && b != 0.0 {
                    bins.sums[lag][0] += f64::from(a * b);
                    bins.counts[lag][0] += 1;
                }
            };
            self.products(model, residual, f, span, &mut product);
            return;
        }
        for (i, (b, r)) in self.of[f][span.clone()].iter().zip(&residual[f][span]).enumerate() {
            if *b != NONE && *r != 0.0 {
                bins.sums[usize::from(*b)][i % LANES] += f64::from(*r);
                bins.counts[usize::from(*b)][i % LANES] += 1;
            }
        }
    }

    /// Calls `put` with each pair of residuals and its lag: neighbours, or the same pixel in the next frame.
    fn products(
        &self,
        model: &Model<'_>,
        residual: &[Vec<f32>],
        f: usize,
        span: Range<usize>,
        put: &mut impl FnMut(usize, f32, f32),
    ) {
        if self.covariate == Covariate::NextFrame {
            if let Some(next) = residual.get(f + 1) {
                span.for_each(|i| put(0, residual[f][i], next[i]));
            }
            return;
        }
        // Within a block pixels are stored row by row; a sampled frame has hardly any neighbours.
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

    /// Sums over all cells.
    pub(crate) fn statistic(&self, model: &Model<'_>, frames: &[usize], residual: &[Vec<f32>]) -> Statistic {
        let bins = self.at.len();
        let (mut total, mut square, mut count) = (vec![0.0; bins], vec![0.0; bins], vec![0.0; bins]);
        let mut lanes = Lanes::new(bins);
        for f in 0..frames.len() {
            for span in &model.seen.blocks {
                lanes.clear();
                self.add_cell(model, residual, f, span.clone(), &mut lanes);
                for b in 0..bins {
                    let (sum, n) = lanes.of(b);
                    total[b] += sum;
                    // At least the variance of white noise.
                    square[b] += (sum * sum).max(n);
                    count[b] += n;
                }
            }
        }
        let chi2 = (0..bins).filter(|b| count[*b] > 0.0).map(|b| total[b] * total[b] / square[b]).sum();
        let mean = (0..bins).map(|b| total[b] / f64::max(count[b], 1.0)).collect();
        Statistic { chi2, mean }
    }
}
