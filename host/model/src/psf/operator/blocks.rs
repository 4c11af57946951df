//! The image of an object through all lenses, and its transpose, with functions of the place that the lenses share in
//! each block ([`super::local`]).
//!
//! ```text
//! image of lens l = F^-1( sum_k B_lk(w) sum_p a_lkp F(phi_p . O)(w) )
//! transpose       = sum_p phi_p . F^-1( sum_l sum_k a_lkp conj(B_lk(w)) F(frame behind lens l)(w) )
//! ```
//! Some blocks go through together, so that the spectra of the basis PSFs, which take most of the memory, are read once
//! for all of them. The sums over terms and functions run column by column of the spectra ([`super::mix`]).

use super::image::Span;
use super::local::Functions;
use super::mix::{pack, padded, panels_len, unpack};
use super::products::{Products, Work};
use super::terms::Lens;
use super::tiling::Block;
use ndarray::{Array2, ArrayView2, Axis, s};
use rayon::prelude::*;
use rustfft::num_complex::Complex32;

/// The spectra of blocks that go through together take up to this many bytes, or those of one block.
const MOST_GROUP_BYTES: usize = 256 << 20;

/// The terms of all living lenses, and the functions of all blocks.
#[derive(Clone, Debug)]
pub(super) struct LocalTerms {
    pub lenses: Vec<Lens>,
    /// Functions of each block.
    pub functions: Vec<Functions>,
    /// Spectra of the basis PSFs in panels: [column, lens, panel, term, 2, PANEL].
    spectra: Vec<f32>,
    /// Values of one column of one lens in them.
    len: usize,
}

/// Computes the light of a block, counted in its group, behind a living lens.
type Part<'a> = dyn Fn(&mut Work, [usize; 2], &mut Array2<f32>) + Sync + 'a;

impl LocalTerms {
    /// Bytes of the spectra of so many terms of so many lenses.
    pub fn bytes(transform: [usize; 2], lenses: usize, terms: usize) -> usize {
        (transform[1] / 2 + 1) * lenses * panels_len(transform[0], padded(terms)) * size_of::<f32>()
    }

    pub fn new(products: &Products, lenses: Vec<Lens>, functions: Vec<Functions>) -> Self {
        let [rows, n] = [products.fft.shape()[0], products.fft.spectrum_len()];
        let terms = lenses.first().map_or(0, |of| of.terms.count());
        let len = panels_len(rows, padded(terms));
        let mut spectra = vec![0.0; products.fft.half_cols() * lenses.len() * len];
        for (l, of) in lenses.iter().enumerate() {
            let of_lens = products.spectra(of.terms.kernels.view());
            spectra.par_chunks_exact_mut(lenses.len() * len).enumerate().for_each(|(column, to)| {
                let columns = of_lens.chunks_exact(n).map(|s| &s[column * rows..(column + 1) * rows]);
                pack(columns, padded(terms), &mut to[l * len..(l + 1) * len]);
            });
        }
        Self { lenses, functions, spectra, len }
    }

    /// The images of all living lenses, [object rows + window - 1, object cols + window - 1] each.
    pub fn images(&self, products: &Products, blocks: &[Block], object: ArrayView2<'_, f32>) -> Vec<Array2<f32>> {
        let mut images = vec![Array2::zeros(products.image_shape(object.dim())); self.lenses.len()];
        let of = |b: usize| object.slice(s![blocks[b].0.clone(), blocks[b].1.clone()]);
        // Blocks that no lens shows have no functions.
        let shows = |b: &usize| self.functions[*b].count() > 0 && of(*b).iter().any(|v| *v != 0.0);
        let lit: Vec<usize> = (0..blocks.len()).filter(shows).collect();
        let (sparse, dense): (Vec<usize>, Vec<usize>) = lit.into_iter().partition(|b| products.is_sparse(of(*b)));
        let (mut space, mut parts) = (Space::default(), Vec::new());
        let mut add = |group: &[usize], part: &Part<'_>| {
            let tasks = self.each_lens(group);
            parts.resize_with(tasks.len().max(parts.len()), || Array2::zeros((0, 0)));
            let task = |w: &mut Work, (at, to): (&[usize; 2], &mut Array2<f32>)| {
                let (r, c) = &blocks[group[at[0]]];
                let shape = products.image_shape((r.len(), c.len()));
                if to.dim() != shape {
                    *to = Array2::zeros(shape);
                }
                part(w, *at, to);
            };
            tasks.par_iter().zip(&mut parts).for_each_init(|| products.work(), task);
            for ([i, l], part) in tasks.into_iter().zip(&parts) {
                products.add(part, &blocks[group[i]], &mut images[l]);
            }
        };
        for b in sparse {
            add(&[b], &|w, [_, l], to| products.sum_of_psfs(&self.lenses[l].terms, &blocks[b], of(b), to, w));
        }
        let [rows, lenses] = [products.fft.shape()[0], self.lenses.len()];
        for group in self.groups(products, &dense) {
            self.image_spectra(products, group, blocks, object, &mut space);
            let n = group.len() * lenses;
            add(group, &|w, [i, l], to| {
                let load = |column: usize, to: &mut [Complex32]| {
                    to.copy_from_slice(&space.sums[(column * n + i * lenses + l) * rows..][..rows]);
                };
                products.light(load, to, &mut w.scratch);
            });
        }
        images
    }

    /// The spectra of the images of the blocks of a group, [column, block, lens, row], into `space.sums`.
    fn image_spectra(
        &self,
        products: &Products,
        group: &[usize],
        blocks: &[Block],
        object: ArrayView2<'_, f32>,
        space: &mut Space,
    ) {
        let [rows, lenses] = [products.fft.shape()[0], self.lenses.len()];
        let tasks: Vec<(usize, usize)> =
            group.iter().flat_map(|b| (0..self.functions[*b].count()).map(move |p| (*b, p))).collect();
        let transform = |w: &mut Work, (&(b, p), spectrum): (&(usize, usize), &mut Vec<Complex32>)| {
            let (r, c) = &blocks[b];
            let take = |column: usize, values: &[Complex32]| {
                spectrum[column * rows..(column + 1) * rows].copy_from_slice(values);
            };
            let nodes = self.functions[b].nodes.index_axis(Axis(0), p);
            let block = object.slice(s![r.clone(), c.clone()]);
            products.weighted(nodes, (r, c), block, take, &mut w.scratch, &mut w.map);
        };
        space.with_spectra(tasks.len(), products.fft.spectrum_len());
        tasks.par_iter().zip(&mut space.spectra).for_each_init(|| products.work(), transform);
        let mut first = vec![0];
        group.iter().for_each(|b| first.push(first[first.len() - 1] + self.functions[*b].count()));
        let spans: Vec<Span> = first.windows(2).map(|w| w[0]..w[1]).collect();
        let weighted = &space.spectra;
        let mix = |panels: &mut Vec<Vec<f32>>, (column, out): (usize, &mut [Complex32])| {
            for (panels, span) in panels.iter_mut().zip(&spans) {
                panels.resize(panels_len(rows, span.len()), 0.0);
                let columns = weighted[span.clone()].iter().map(|s| &s[column * rows..(column + 1) * rows]);
                pack(columns, span.len(), panels);
            }
            for (l, basis) in self.column(column).enumerate() {
                for (i, (b, panels)) in group.iter().zip(panels.iter()).enumerate() {
                    let out = &mut out[(i * lenses + l) * rows..][..rows];
                    self.functions[*b].weights[l].image(panels, basis, out);
                }
            }
        };
        let len = group.len() * lenses * rows;
        space.sums.resize(products.fft.half_cols() * len, Complex32::default());
        space.sums.par_chunks_exact_mut(len).enumerate().for_each_init(|| vec![Vec::new(); group.len()], mix);
    }

    /// The transpose: sets a dark object to what all lenses collect from a frame.
    pub fn adjoint(&self, products: &Products, blocks: &[Block], frame: ArrayView2<'_, f32>, object: &mut Array2<f32>) {
        let (rows, lenses) = (products.fft.shape()[0], self.lenses.len());
        let shown: Vec<usize> = (0..blocks.len()).filter(|b| self.functions[*b].count() > 0).collect();
        let mut space = Space::default();
        for group in self.groups(products, &shown) {
            let transform = |w: &mut Work, (&[i, l], spectrum): (&[usize; 2], &mut Vec<Complex32>)| {
                let take = |column: usize, values: &[Complex32]| {
                    spectrum[column * rows..(column + 1) * rows].copy_from_slice(values);
                };
                products.seen(self.lenses[l].corner, &blocks[group[i]], frame, take, &mut w.scratch)
            };
            let tasks = self.each_lens(group);
            space.with_spectra(tasks.len(), products.fft.spectrum_len());
            let views = tasks.par_iter().zip(&mut space.spectra);
            let on_sensor: Vec<bool> = views.map_init(|| products.work(), transform).collect();
            let seen = |i: usize, l: usize| on_sensor[i * lenses + l].then(|| &space.spectra[i * lenses + l]);
            let most = group.iter().map(|b| self.functions[*b].count()).max().unwrap_or(0);
            let mix = |(panels, view): &mut (Vec<f32>, Vec<f32>), (column, out): (usize, &mut [Complex32])| {
                view.resize(panels_len(rows, 1), 0.0);
                for (i, (b, out)) in group.iter().zip(out.chunks_exact_mut(most * rows)).enumerate() {
                    let functions = self.functions[*b].count();
                    panels.clear();
                    panels.resize(panels_len(rows, padded(functions)), 0.0);
                    for (l, basis) in self.column(column).enumerate() {
                        if let Some(spectrum) = seen(i, l) {
                            pack(std::iter::once(&spectrum[column * rows..(column + 1) * rows]), 1, view);
                            self.functions[*b].weights[l].collect(view, basis, panels);
                        }
                    }
                    for (p, out) in out.chunks_exact_mut(rows).enumerate().take(functions) {
                        unpack(panels, (p, padded(functions)), out);
                    }
                }
            };
            let len = group.len() * most * rows;
            space.sums.resize(products.fft.half_cols() * len, Complex32::default());
            let columns = space.sums.par_chunks_exact_mut(len);
            columns.enumerate().for_each_init(Default::default, mix);
            let part = |w: &mut Work, (i, b): (usize, &usize)| {
                let (r, c) = &blocks[*b];
                let mut part = Array2::zeros((r.len(), c.len()));
                for (p, nodes) in self.functions[*b].nodes.outer_iter().enumerate() {
                    let load = |column: usize, to: &mut [Complex32]| {
                        to.copy_from_slice(&space.sums[column * len + (i * most + p) * rows..][..rows]);
                    };
                    products.weigh(nodes, (r, c), load, part.view_mut(), &mut w.scratch, &mut w.map);
                }
                part
            };
            let parts: Vec<Array2<f32>> = group.par_iter().enumerate().map_init(|| products.work(), part).collect();
            for (b, part) in group.iter().zip(parts) {
                object.slice_mut(s![blocks[*b].0.clone(), blocks[*b].1.clone()]).assign(&part);
            }
        }
    }

    /// The spectra of the basis PSFs of each living lens in a column, in panels.
    fn column(&self, column: usize) -> impl Iterator<Item = &[f32]> {
        let of_column = self.lenses.len() * self.len;
        self.spectra[column * of_column..(column + 1) * of_column].chunks_exact(self.len)
    }

    /// Pairs of the blocks of a group, counted in it, and the living lenses.
    fn each_lens(&self, group: &[usize]) -> Vec<[usize; 2]> {
        (0..group.len()).flat_map(|i| (0..self.lenses.len()).map(move |l| [i, l])).collect()
    }

    /// Blocks that go through together.
    fn groups<'a>(&self, products: &Products, blocks: &'a [usize]) -> impl Iterator<Item = &'a [usize]> + use<'a> {
        let most = self.functions.iter().map(Functions::count).max().unwrap_or(0) + self.lenses.len();
        let bytes = most * products.fft.spectrum_len() * size_of::<Complex32>();
        blocks.chunks((MOST_GROUP_BYTES / bytes.max(1)).max(1))
    }
}

/// Working memory that all groups of blocks use, one after the other: new memory costs much of the time.
#[derive(Default)]
struct Space {
    /// Spectra, [column, row] each.
    spectra: Vec<Vec<Complex32>>,
    /// Sums over them, by column.
    sums: Vec<Complex32>,
}

impl Space {
    /// Makes sure of `n` spectra of so many values.
    fn with_spectra(&mut self, n: usize, len: usize) {
        if self.spectra.len() < n {
            self.spectra.resize_with(n, || vec![Complex32::default(); len]);
        }
    }
}
