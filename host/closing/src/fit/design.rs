//! The linearised problem around a state: columns, residuals and calibration errors in units of the noise, summed in
//! cells.
//!
//! A cell is one frame by one spatial block. It keeps the Gram matrix of all columns, of the calibration's errors and
//! of the residual. Hold-outs and clusters are then sums over cells and need no further pass over the frames.

use super::cell::Cell;
use super::derivative::{Expansion, LensImages};
use super::errors::Errors;
use super::lamp;
use super::model::Model;
use super::state::{Column, Predicted};
use super::{prior, registration, repeats, wings};
use crate::data::{Observations, Shown};
use ndarray::{Array2, ArrayView2, s};
use ommatidia_model::forward::ForwardError;
use ommatidia_session::Role;
use rayon::prelude::*;
use std::ops::Range;

/// All cells of a linearised problem.
#[derive(Clone, Debug)]
pub struct Design {
    /// The columns.
    pub columns: Vec<Column>,
    /// Number of directions of the calibration's errors that are the scatter of its replicates.
    pub scattered: usize,
    /// Number of those that are stated.
    pub stated: usize,
    /// The cells.
    pub cells: Vec<Cell>,
    /// Gram matrix of the columns over the training cells before any specimen is taken out of them, in units of the
    /// noise: of the columns of each effect with each other, and of every other column with itself. Other products are
    /// zero.
    pub before: Array2<f64>,
    /// Whether specimens are estimated.
    pub estimated: bool,
}

/// What a design is computed for.
#[derive(Clone, Copy, Debug)]
pub enum Scope<'a> {
    /// All cells, and the products of all columns.
    Whole,
    /// The training cells alone.
    Training,
    /// The training cells, and the products that score tests need: of the first `given` columns, the errors of the
    /// calibration and the residual with everything, and of the columns of each group with each other. Other products
    /// are zero.
    Scores {
        /// Number of columns that are projected out.
        given: usize,
        /// Columns of each trial term.
        groups: &'a [Range<usize>],
    },
}

impl Scope<'_> {
    /// Ranges of columns that belong to one effect; every other column alone.
    fn effects(self, columns: &[Column]) -> Vec<Range<usize>> {
        let (first, mut ranges) = match self {
            Self::Scores { given, groups } => (given, groups.to_vec()),
            Self::Whole | Self::Training => (columns.len(), Vec::new()),
        };
        let same = |a: &Column, b: &Column| match (a, b) {
            (Column::Own { term: a, .. }, Column::Own { term: b, .. }) => a == b,
            _ => false,
        };
        let mut start = 0;
        for given in columns[..first].chunk_by(same) {
            ranges.push(start..start + given.len());
            start += given.len();
        }
        ranges
    }

    /// The rows of a design of `columns` columns in the order of their products: first those that need them with all
    /// rows, with their number, then the groups.
    fn order(self, columns: usize, rows: usize) -> (Vec<usize>, usize) {
        let given = if let Self::Scores { given, .. } = self { given } else { columns };
        ((0..given).chain(columns..rows).chain(given..columns).collect(), given + rows - columns)
    }

    /// Gram matrix of all `rows` rows of a design over some pixels. `x` holds those that are not zero, [row, pixel], as
    /// `order` lists them; the first `most` of them have products with all.
    fn gram(self, x: &ArrayView2<'_, f32>, (order, most): (&[usize], usize), rows: usize) -> Array2<f32> {
        let mut gram = Array2::zeros((rows, rows));
        let mut put = |i: usize, j: usize, v: f32| {
            gram[[order[i], order[j]]] = v;
            gram[[order[j], order[i]]] = v;
        };
        x.slice(s![..most, ..]).dot(&x.t()).indexed_iter().for_each(|((i, j), v)| put(i, j, *v));
        if let Self::Scores { groups, .. } = self {
            let place = |row: usize| most + order[most..].partition_point(|r| *r < row);
            for group in groups.iter().map(|g| place(g.start)..place(g.end)) {
                let own = squared(&x.slice(s![group.clone(), ..]));
                own.indexed_iter().for_each(|((i, j), v)| put(group.start + i, group.start + j, *v));
            }
        }
        gram
    }
}

/// Rows whose products are computed one by one: a product of matrices first copies them to blocks of more rows.
const FEW: usize = 8;

/// Gram matrix of a few rows, [row, pixel].
fn squared(x: &ArrayView2<'_, f32>) -> Array2<f32> {
    if x.nrows() > FEW {
        return x.dot(&x.t());
    }
    let mut gram = Array2::zeros((x.nrows(), x.nrows()));
    for (i, a) in x.outer_iter().enumerate() {
        for (j, b) in x.outer_iter().enumerate().take(i + 1) {
            let product = a.dot(&b);
            gram[[i, j]] = product;
            gram[[j, i]] = product;
        }
    }
    gram
}

/// Sums over cells.
#[derive(Clone, Debug)]
pub struct Sums {
    /// Gram matrix of columns, errors of the calibration and residual, [n, n].
    pub gram: Array2<f64>,
    /// chi-squared that noise alone gives: the number of pixels that are used, less what estimated specimens take up.
    pub pixels: f64,
    /// Sum of the logarithms of the pixels' variances in DN^2.
    pub log_variance: f64,
}

impl Sums {
    /// chi-squared and deviance. The model determines the variance of the noise, so chi-squared alone would fall with
    /// every effect that adds light to dark pixels; the deviance does not. It is counted from the chi-squared that
    /// noise gives: of two states, one may let the specimens take up more of the noise.
    pub fn misfit(&self) -> Misfit {
        let last = self.gram.nrows().saturating_sub(1);
        let chi2 = self.gram.get((last, last)).copied().unwrap_or(0.0);
        Misfit { chi2, deviance: chi2 - self.pixels + self.log_variance, pixels: self.pixels }
    }
}

/// Distance between a state and measured frames.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Misfit {
    /// chi-squared.
    pub chi2: f64,
    /// -2 ln of the Gaussian likelihood, less what noise alone gives. States are compared by it.
    pub deviance: f64,
    /// chi-squared that noise alone gives: the number of pixels that are used, less what estimated specimens take up.
    pub pixels: f64,
}

impl Design {
    /// Computes the cells of a scope.
    ///
    /// # Errors
    /// An object holds negative or non-finite light.
    pub fn compute(
        model: &Model<'_>,
        at: Expansion<'_>,
        columns: Vec<Column>,
        errors: &Errors,
        scope: Scope<'_>,
    ) -> Result<Self, ForwardError> {
        let fitted = columns.clone();
        Self::of(model, at, (columns, &fitted), errors, scope)
    }

    /// The residuals alone, in all cells, of a state of which all `fitted` columns are fitted: no frame is
    /// differentiated.
    ///
    /// # Errors
    /// An object holds negative or non-finite light.
    pub fn of_residuals(model: &Model<'_>, at: Expansion<'_>, fitted: &[Column]) -> Result<Self, ForwardError> {
        Self::of(model, at, (Vec::new(), fitted), &Errors::default(), Scope::Whole)
    }

    fn of(
        model: &Model<'_>,
        at: Expansion<'_>,
        (columns, fitted): (Vec<Column>, &[Column]),
        errors: &Errors,
        scope: Scope<'_>,
    ) -> Result<Self, ForwardError> {
        let seen = model.seen;
        let whole = matches!(scope, Scope::Whole);
        let rows = columns.len() + errors.changes.len() + 1;
        // A state must not gain by driving pixels out of range: each unused pixel counts as one with the largest noise.
        let noise = model.forward.noise();
        let unseen = noise.variance_dn2(noise.saturation_dn).ln();
        let effects = scope.effects(&columns);
        let (order, most) = scope.order(columns.len(), rows);
        // Pixels of the training blocks of a frame.
        let used = |k: usize| -> Vec<u32> {
            let blocks = seen.blocks.iter().enumerate().filter(|(block, _)| !seen.is_held_out(k, *block));
            blocks.flat_map(|(_, span)| seen.pixels[span.clone()].iter().copied()).collect()
        };
        let changes_of = |k: usize| -> Result<Changed, ForwardError> {
            let mut images = LensImages::default();
            let mut changes: Vec<(usize, Array2<f32>)> = Vec::new();
            for (i, column) in columns.iter().enumerate() {
                changes.extend(model.derivative(k, column, at, &mut images)?.map(|d| (i, d)));
            }
            // Before a specimen is taken out: what is left shows whether a frame can test a column.
            let before = match seen.frames[k].held_out {
                true => Vec::new(),
                false => {
                    products(&changes, &effects, at.predicted[k].inverse_sigma.as_slice().unwrap_or(&[]), &used(k))
                }
            };
            Ok(Changed { k, changes, before })
        };
        let cells_of = |Changed { k, changes, before }: Changed| {
            let here = &at.predicted[k];
            let weight = here.inverse_sigma.as_slice().unwrap_or(&[]);
            // What the frame does not depend on has no row.
            let mut of_row: Vec<Option<&Array2<f32>>> = vec![None; rows];
            changes.iter().for_each(|(i, d)| of_row[*i] = Some(d));
            let of_errors = errors.changes.iter().map(|change| change[k].as_ref());
            of_row[columns.len()..rows - 1].iter_mut().zip(of_errors).for_each(|(row, d)| *row = d);
            of_row[rows - 1] = Some(&here.residual_dn);
            let live = |part: &[usize]| part.iter().copied().filter(|i| of_row[*i].is_some()).collect::<Vec<_>>();
            let (with_all, groups) = order.split_at(most);
            let (mut order, groups) = (live(with_all), live(groups));
            let most = order.len();
            order.extend(groups);
            let mut x = Array2::<f32>::zeros((order.len(), seen.pixels.len()));
            for (mut row, i) in x.outer_iter_mut().zip(&order) {
                let Some(image) = of_row[*i].and_then(|image| image.as_slice()) else { continue };
                for (out, p) in row.iter_mut().zip(&seen.pixels) {
                    *out = image[*p as usize] * weight[*p as usize];
                }
            }
            if matches!(seen.frames[k].shown, Shown::Bead(..)) {
                // The light of each bead is a nuisance parameter of its own: its column is projected out of all
                // rows.
                let black_dn = model.forward.noise().black_level_dn;
                let own = if model.has_background { here.sum_e.clone() } else { &here.dn - black_dn as f32 };
                own_light(&mut x, &own, here, seen);
            }
            let cells = seen
                .blocks
                .iter()
                .enumerate()
                .filter(|(block, _)| whole || !seen.is_held_out(k, *block))
                .map(|(block, span)| {
                    let gram = scope.gram(&x.slice(s![.., span.clone()]), (&order, most), rows);
                    let (mut pixels, mut log_variance) = (0.0, 0.0);
                    for w in seen.pixels[span.clone()].iter().map(|p| weight[*p as usize]) {
                        pixels += f64::from(u8::from(w > 0.0));
                        log_variance += if w > 0.0 { -2.0 * f64::from(w.ln()) } else { unseen };
                    }
                    let held_out = seen.is_held_out(k, block);
                    let pixels = at.state.share(k, block) * pixels;
                    Cell { frame: k, block, held_out, pixels, gram, log_variance }
                })
                .collect::<Vec<_>>();
            (cells, before)
        };
        let together = |group: &[usize]| -> Result<Vec<OfFrame>, ForwardError> {
            let mut of_frames: Vec<Changed> =
                group.par_iter().map(|k| changes_of(*k)).collect::<Result<_, ForwardError>>()?;
            let all = of_frames.iter_mut().flat_map(|f| f.changes.iter_mut().map(|(_, d)| (f.k, d)));
            model.visible(at.state, all);
            Ok(of_frames.into_par_iter().map(cells_of).collect())
        };
        let taken: Vec<usize> = (0..seen.frames.len()).filter(|k| whole || !seen.frames[*k].held_out).collect();
        let groups = groups(seen, &taken, columns.len());
        let frames = groups.into_par_iter().map(together).collect::<Result<Vec<_>, ForwardError>>()?;
        let frames: Vec<OfFrame> = frames.into_iter().flatten().collect();
        let mut before = Array2::zeros((columns.len(), columns.len()));
        for (range, gram) in frames.iter().flat_map(|(_, own)| effects.iter().zip(own)) {
            let mut sum = before.slice_mut(s![range.clone(), range.clone()]);
            sum.zip_mut_with(gram, |s: &mut f64, v: &f32| *s += f64::from(*v));
        }
        let mut cells: Vec<Cell> = frames.into_iter().flat_map(|(cells, _)| cells).collect();
        let of_frames = cells.len();
        cells.extend(repeats::cells(model, at, &columns, errors.changes.len()));
        cells.extend(prior::cell(model, at.state, (&columns, fitted), errors.changes.len()));
        // No specimen is taken out of what repeats show.
        for cell in cells[of_frames..].iter().filter(|c| !c.held_out) {
            for range in &effects {
                let own = || s![range.clone(), range.clone()];
                before.slice_mut(own()).zip_mut_with(&cell.gram.slice(own()), |s: &mut f64, v| *s += f64::from(*v));
            }
        }
        let (scattered, estimated) = (errors.scattered, at.state.specimens.is_some());
        Ok(Self { columns, scattered, stated: errors.changes.len() - scattered, cells, before, estimated })
    }

    /// Index of the residual in a Gram matrix.
    pub fn residual(&self) -> usize {
        self.columns.len() + self.scattered + self.stated
    }

    /// Indices of the errors of the calibration in a Gram matrix: those that are the scatter of replicates, and those
    /// that are stated.
    pub fn error_rows(&self) -> [Range<usize>; 2] {
        let first = self.columns.len();
        [first..first + self.scattered, first + self.scattered..self.residual()]
    }

    /// Sums over the cells for which `take` is true.
    pub fn sums(&self, take: impl Fn(&Cell) -> bool) -> Sums {
        let n = self.residual() + 1;
        let mut sums = Sums { gram: Array2::zeros((n, n)), pixels: 0.0, log_variance: 0.0 };
        for cell in self.cells.iter().filter(|c| take(c)) {
            sums.gram.zip_mut_with(&cell.gram, |s, v| *s += f64::from(*v));
            sums.pixels += cell.pixels;
            sums.log_variance += cell.log_variance;
        }
        sums
    }

    /// Sums over the training cells: those that are not held out.
    pub fn training(&self) -> Sums {
        self.sums(|c| !c.held_out)
    }
}

/// Cells of a frame, and its products before a specimen is taken out of them.
type OfFrame = (Vec<Cell>, Vec<Array2<f32>>);

/// What the columns change in a frame.
struct Changed {
    /// The frame.
    k: usize,
    /// By how much each column changes the expected frame, DN; columns that it does not depend on are left out.
    changes: Vec<(usize, Array2<f32>)>,
    /// Products of the changes of each effect before a specimen is taken out of them.
    before: Vec<Array2<f32>>,
}

/// Changes of frames with estimated specimens from which the specimens are taken out together: many at once take hardly
/// more time than a few.
const TOGETHER: usize = 256;

/// Frames that are computed together, in their order, for a design of so many columns.
fn groups<'a>(seen: &Observations, frames: &'a [usize], columns: usize) -> Vec<&'a [usize]> {
    let estimated = |k: &usize| seen.frames[*k].shown == Shown::Estimated;
    let runs = frames.chunk_by(|a, b| estimated(a) && estimated(b));
    runs.flat_map(|run| run.chunks((TOGETHER / columns.max(1)).max(1))).collect()
}

/// For each range of columns the Gram matrix of their changes of a frame, in units of the noise, at some pixels.
fn products(
    changes: &[(usize, Array2<f32>)],
    ranges: &[Range<usize>],
    weight: &[f32],
    pixels: &[u32],
) -> Vec<Array2<f32>> {
    let of = |range: &Range<usize>| {
        let mut x = Array2::<f32>::zeros((range.len(), pixels.len()));
        for (i, image) in changes.iter().filter(|(i, _)| range.contains(i)) {
            let Some(image) = image.as_slice() else { continue };
            for (out, p) in x.row_mut(i - range.start).iter_mut().zip(pixels) {
                *out = image[*p as usize] * weight[*p as usize];
            }
        }
        squared(&x.view())
    };
    ranges.iter().map(of).collect()
}

/// Projects the frame's own light, in any unit, out of each row.
fn own_light(x: &mut Array2<f32>, own: &Array2<f32>, here: &Predicted, seen: &Observations) {
    let (Some(own), Some(weight)) = (own.as_slice(), here.inverse_sigma.as_slice()) else { return };
    let light: Vec<f32> = seen.pixels.iter().map(|p| own[*p as usize] * weight[*p as usize]).collect();
    let norm: f64 = light.iter().map(|v| f64::from(*v).powi(2)).sum();
    if norm <= 0.0 {
        return;
    }
    for mut row in x.outer_iter_mut() {
        let along: f64 = row.iter().zip(&light).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum();
        let share = (along / norm) as f32;
        row.iter_mut().zip(&light).for_each(|(a, b)| *a -= share * b);
    }
}

/// The columns of the nuisance parameters: the light of each lit stack, the black level, the background of each stack
/// of scenes and beads where the calibration found one, the lamp of the flats, the light outside the windows, and the
/// registrations of the truths.
pub fn nuisances(model: &Model<'_>) -> Vec<Column> {
    let frames = &model.seen.frames;
    let lit = |s: &usize| {
        let shows = |shown: &Shown| matches!(shown, Shown::Object(_) | Shown::Even);
        frames.iter().any(|f| f.stack == *s && shows(&f.shown))
    };
    let stacks = frames.iter().map(|f| f.stack + 1).max().unwrap_or(0);
    let mut columns: Vec<Column> = (0..stacks).filter(lit).map(Column::Scale).collect();
    if frames.iter().any(|f| f.role == Role::Dark || f.shown != Shown::Unknown) {
        columns.push(Column::Black);
    }
    if model.has_background {
        let shows = |s: &usize| {
            frames.iter().any(|f| f.stack == *s && !matches!(f.shown, Shown::Even | Shown::Dark | Shown::Unknown))
        };
        columns.extend((0..stacks).filter(shows).flat_map(|s| (0..3).map(move |part| Column::Background(s, part))));
    }
    if frames.iter().any(|f| f.shown == Shown::Even) {
        columns.extend((0..lamp::TERMS).map(Column::Lamp));
    }
    columns.extend(wings::columns(&model.rings));
    columns.extend(registration::columns(&model.seen.registrations));
    columns
}
