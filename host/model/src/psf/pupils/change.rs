//! How PSFs change with the wavefront, as a low-rank model of its own.

use super::fit::{Design, LensPupil, Place, effective_area, fit_lens, fit_like};
use super::kernel::{Kernel, Waves};
use super::{EVEN, MOST_MISFIT, SQUARES, TERMS};
use crate::psf::LowRankPsf;
use crate::psf::decompose::decompose;
use crate::psf::nodes::Taps;
use ndarray::{Array1, Array2, Array4, Array5, Axis, s};
use ommatidia_physics::optics::Wavefront;
use rayon::prelude::*;
use serde::Serialize;
use std::f64::consts::TAU;
use std::sync::{Arc, OnceLock};

/// Places of each axis whose PSFs are fitted.
const PLACES: usize = 4;
/// Nodes of each axis on which changes are computed: pupils are quadratic in the field, and a change is as smooth.
const NODES: usize = 5;
/// PSFs with less than this share of the light of the brightest say too little: their foci fall off the sensor.
pub(super) const FAINT: f64 = 0.2;
/// Smallest window whose PSFs a pupil can be fitted to, px a side.
const LEAST_SIDE: usize = 7;
/// Terms of the low-rank model of a change, at most, and the relative size of the least.
const RANK: usize = 6;
const LEAST_TERM: f64 = 3e-3;
/// A pupil of the common design explains PSFs as well as one of its own up to this ratio of their errors.
const AS_WELL: f64 = 1.1;
/// Wavelength of the light, um, where a session does not state it. Fluorescence in use lies within 20 % of it (GFP
/// 0.51, tdTomato 0.58).
pub const WAVELENGTH_UM: f64 = 0.53;

/// How the wavefront of a lens differs from that of its fitted pupil.
#[derive(Clone, Debug, PartialEq)]
pub struct Wavefronts {
    /// What is added at each node of [`PupilModel::nodes_px`].
    pub added: Array2<Wavefront>,
    /// Defocus that the pupil had before beyond what was fitted, waves rms: it changes no PSF by itself.
    pub misjudged_waves: f64,
}

impl Wavefronts {
    /// Whether any of the added terms that change a PSF (defocus and beyond) differs from 0.
    pub fn change_psfs(&self) -> bool {
        self.added.iter().any(|w| w.coefficient[3..].iter().any(|c| *c != 0.0))
    }
}

/// The pupils of all lenses.
#[derive(Clone, Debug)]
pub struct PupilModel {
    /// None: a dead lens.
    pub(super) lenses: Vec<Option<LensPupil>>,
    /// The depth whose PSFs were fitted, by its index.
    pub(super) depth: usize,
    /// Defocus of a source that is displaced by 1 um, for each lens, as a scan at several depths shows it, waves rms;
    /// empty: the scan has one depth.
    pub(super) scanned_waves_per_um: Vec<Option<f64>>,
    /// Defocus of a source displaced by 1 um along the axis by a pupil of radius 1 cycle/px, waves rms for a wavelength
    /// of 1 um.
    waves_per_um2: f64,
    /// Rows and columns on which changes are computed, object pixels.
    nodes_px: [Vec<f64>; 2],
    /// What changes of the PSFs of each lens share: computed when the first of them is asked for.
    prepared: Vec<Arc<OnceLock<Prepared>>>,
    /// Relative error of the pupils of all lenses (root mean square).
    pub misfit: f64,
}

/// Samples of the pupil of a lens, and what they need for windows of one size.
#[derive(Clone, Debug)]
struct Prepared {
    kernel: Kernel,
    waves: Waves,
    displacements: [[f64; 2]; TERMS],
}

impl Prepared {
    fn new(lens: &LensPupil, side: usize) -> Self {
        let kernel = Kernel::new(side, 1.3 * lens.radius);
        let waves = kernel.waves(side, lens.radius);
        let displacements = kernel.displacements(lens.apodisation, lens.radius);
        Self { kernel, waves, displacements }
    }
}

impl PupilModel {
    /// Fits pupils to the PSFs at a depth. `dead` marks lenses without light. None: they do not explain the PSFs, their
    /// relative error exceeds [`MOST_MISFIT`].
    pub fn fit(psf: &LowRankPsf, depth: usize, dead: &[bool], scale: Scale) -> Option<Self> {
        if psf.basis.dim().2 < LEAST_SIDE {
            return None;
        }
        let is_dead = |l: usize| dead.get(l).is_some_and(|d| *d);
        let alone: Vec<Option<LensPupil>> = (0..psf.basis.dim().0)
            .into_par_iter()
            .map(|l| if is_dead(l) { None } else { fit_lens(&places(psf, l, depth)) })
            .collect();
        let count = alone.iter().flatten().count();
        if count == 0 || count < (0..alone.len()).filter(|l| !is_dead(*l)).count() {
            return None;
        }
        let mut model = Self::of(psf, alone, depth, scale);
        model.share_a_sign();
        model.fit_by_design(psf, depth);
        model.share_a_sign();
        let live = || model.lenses.iter().flatten();
        let misfit = (live().map(|l| l.misfit * l.misfit).sum::<f64>() / count as f64).sqrt();
        (misfit <= MOST_MISFIT).then_some(Self { misfit, ..model })
    }

    /// The model of pupils that were fitted to the PSFs at a depth, without what is known of their misfit and of other
    /// depths.
    pub(super) fn of(psf: &LowRankPsf, lenses: Vec<Option<LensPupil>>, depth: usize, scale: Scale) -> Self {
        // A path longer by z NA^2 / 2 at the rim, with NA = R wavelength M / pitch in the object's space; the rms of
        // Z_4 is 1 / (2 sqrt 3) of that (Born & Wolf, section 9.2).
        let na_per_um = scale.magnification / scale.pixel_pitch_um;
        Self {
            prepared: lenses.iter().map(|_| Arc::default()).collect(),
            lenses,
            depth,
            scanned_waves_per_um: Vec::new(),
            waves_per_um2: na_per_um * na_per_um / 2.0 / (2.0 * 3f64.sqrt()),
            nodes_px: [&psf.node_rows_px, &psf.node_cols_px].map(|nodes| coarse(nodes)),
            misfit: 0.0,
        }
    }

    /// Defocus of a source of light of `wavelength_um` that is displaced by `z_um` along the axis, through a lens,
    /// waves rms; 0 for a dead lens. It grows as the square of the radius of the pupil: its curvature at a given
    /// frequency is the same for all lenses. Its sign is that of the even terms: unknown. A scan at several depths
    /// shows both for each lens, whatever the wavelength.
    pub fn defocus_waves(&self, lens: usize, z_um: f64, wavelength_um: f64) -> f64 {
        if let Some(Some(waves_per_um)) = self.scanned_waves_per_um.get(lens) {
            return waves_per_um * z_um;
        }
        let radius = self.lenses.get(lens).and_then(Option::as_ref).map_or(0.0, |l| l.radius);
        self.waves_per_um2 * wavelength_um * radius * radius * z_um
    }

    /// Mean cut-off frequency of the pupils, cycles/px, and rms over the object and the live lenses of the wavefront
    /// terms from Z_4 on, waves.
    pub fn summary(&self) -> PupilSummary {
        let live = || self.lenses.iter().flatten();
        let count = live().count().max(1) as f64;
        let grid = [-1.0, -0.5, 0.0, 0.5, 1.0];
        let places: Vec<[f64; 2]> = grid.iter().flat_map(|y| grid.map(|x| [*y, x])).collect();
        let mut square = [0.0; TERMS];
        for pupil in live().flat_map(|l| places.iter().map(|at| l.at(*at))) {
            square.iter_mut().zip(pupil.terms).for_each(|(s, t)| *s += (t / TAU).powi(2));
        }
        let rms = square.map(|s| (s / (count * places.len() as f64)).sqrt());
        PupilSummary {
            misfit: self.misfit,
            cutoff_cycles_per_px: live().map(|l| l.radius).sum::<f64>() / count,
            defocus_waves: rms[2],
            astigmatism_waves: rms[3].hypot(rms[4]),
            coma_waves: rms[5].hypot(rms[6]),
            trefoil_waves: rms[7].hypot(rms[8]),
            spherical_waves: rms[9],
        }
    }

    /// The depth whose PSFs were fitted, by its index.
    pub fn depth(&self) -> usize {
        self.depth
    }

    /// Rows and columns of the nodes on which changes are computed, object pixels.
    pub fn nodes_px(&self) -> &[Vec<f64>; 2] {
        &self.nodes_px
    }

    /// How far the own defocus of a lens may lie from that of its pupil, waves rms (standard deviation).
    ///
    /// A lens with defocus c makes a PSF that differs from that with `c + e` by about `(2 |c| e + e^2) (2 pi)^2 / 2`,
    /// relative to its norm and with its light free: the fall of the peak to second order in the wavefront (Born &
    /// Wolf, section 9.1.3), half of which is taken to be a loss that the free light makes up for. e is the largest
    /// that the misfit of the pupil hides. 0: a dead lens.
    pub fn doubt_waves(&self, lens: usize) -> f64 {
        let Some(Some(lens)) = self.lenses.get(lens) else { return 0.0 };
        let row = lens.terms.row(2);
        let value = |f: usize| row.get(f).copied().unwrap_or(0.0);
        // The mean over the object of the functions 1, y^2 and x^2.
        let own = (value(0) + (value(SQUARES) + value(SQUARES + 2)) / 3.0) / TAU;
        let hidden = 2.0 * lens.misfit / (TAU * TAU);
        (own * own + hidden).sqrt() - own.abs()
    }

    /// The change of the shape of the PSFs of a lens by wavefronts: DN above black of a unit source, in the windows of
    /// `psf`, which must be those of the fit, at a depth, on the nodes of [`Self::nodes_px`], as the PSFs of the only
    /// lens of a model. Centroids stay:
    /// how far coma moves them depends on where the rim of the pupil is taken to be, which soft edges leave open. None:
    /// a dead lens.
    pub fn change(&self, psf: &LowRankPsf, (l, depth): (usize, usize), by: &Wavefronts) -> Option<LowRankPsf> {
        let lens = self.lenses.get(l)?.as_ref()?;
        let side = psf.basis.dim().2;
        let [rows, cols] = [0, 1].map(|a| self.nodes_px[a].len());
        let mut basis = Array4::zeros((1, RANK, side, side));
        let mut coefficients = Array5::zeros((1, RANK, 1, rows, cols));
        let windows = self.changes(psf, (l, depth), lens, by);
        let even = Array1::ones(side * side);
        if let Ok(d) = decompose(windows.view(), None, even.view(), RANK) {
            let first = d.singular_values.first().copied().unwrap_or(0.0);
            let large = d.singular_values.iter().take_while(|v| **v > LEAST_TERM * first).count();
            for k in 0..large.min(d.basis.nrows()).min(RANK) {
                basis.slice_mut(s![0, k, .., ..]).iter_mut().zip(d.basis.row(k)).for_each(|(b, v)| *b = *v);
                let mut map = coefficients.slice_mut(s![0, k, 0, .., ..]);
                map.iter_mut().zip(d.coefficients.column(k)).for_each(|(m, v)| *m = *v as f32);
            }
        }
        let [node_rows_px, node_cols_px] = self.nodes_px.clone();
        let node_depths_um = vec![psf.node_depths_um[depth]];
        Some(LowRankPsf {
            basis,
            coefficients,
            node_depths_um,
            node_rows_px,
            node_cols_px,
            exposure_ms: psf.exposure_ms,
        })
    }

    /// The change of the PSF of a lens at each node, [node, pixel].
    fn changes(&self, psf: &LowRankPsf, (l, depth): (usize, usize), lens: &LensPupil, by: &Wavefronts) -> Array2<f32> {
        let side = psf.basis.dim().2;
        let Some(prepared) = self.prepared.get(l) else { return Array2::zeros((0, 0)) };
        let Prepared { kernel, waves, displacements } = prepared.get_or_init(|| Prepared::new(lens, side));
        let [rows, cols] = [0, 1].map(|a| placed(&self.nodes_px[a]));
        let light = light(psf, l, depth);
        let mut out = Array2::zeros((rows.len() * cols.len(), side * side));
        for ((i, j), added) in by.added.indexed_iter().filter(|((i, j), _)| *i < rows.len() && *j < cols.len()) {
            let mut before = lens.at([rows[i], cols[j]]);
            before.terms[2] += TAU * by.misjudged_waves;
            let mut after = before;
            for k in 2..TERMS {
                after.terms[k] += TAU * added.coefficient[k + 1];
            }
            // Z_2 displaces along the columns, Z_3 along the rows.
            let moved =
                |a: usize| (2..TERMS).map(|k| TAU * added.coefficient[k + 1] * displacements[k][a]).sum::<f64>();
            after.terms[0] -= moved(1) / displacements[0][1];
            after.terms[1] -= moved(0) / displacements[1][0];
            let [from, to] = [before, after].map(|pupil| kernel.psf(waves, &pupil));
            // The wavefront leaves the light of a lens as it is.
            let taps =
                [Taps::at(&psf.node_rows_px, self.nodes_px[0][i]), Taps::at(&psf.node_cols_px, self.nodes_px[1][j])];
            let here = interpolated(&light, &taps).max(0.0);
            let scale = here / from.sum().max(f64::MIN_POSITIVE);
            let mut row = out.row_mut(i * cols.len() + j);
            row.iter_mut().zip(to.iter().zip(&from)).for_each(|(o, (t, f))| *o = (scale * (t - f)) as f32);
        }
        out
    }

    /// Fits each lens again with what most lenses share, and keeps that where it explains the PSFs as well.
    fn fit_by_design(&mut self, psf: &LowRankPsf, depth: usize) {
        let Some(design) = Design::of(&self.lenses.iter().flatten().collect::<Vec<_>>()) else { return };
        self.lenses.par_iter_mut().enumerate().for_each(|(l, lens)| {
            let Some(now) = lens else { return };
            if let Some(found) =
                fit_like(&design, &places(psf, l, depth)).filter(|found| found.misfit < AS_WELL * now.misfit)
            {
                *now = found;
            }
        });
    }

    /// Turns the even terms of lenses so that all lenses are alike, and their mean defocus is positive.
    ///
    /// Lenses of one design share how their wavefronts change with the square of the field (curvature and astigmatism),
    /// and do not share where they are mounted: a lens that sits a little too high has another defocus at the centre,
    /// and a field that seems shifted. So the squares decide.
    fn share_a_sign(&mut self) {
        let even = |lens: &LensPupil| -> Vec<f64> {
            let rows = lens.terms.outer_iter().zip(EVEN).filter(|(_, even)| *even);
            rows.flat_map(|(row, _)| row.iter().skip(SQUARES).copied().collect::<Vec<_>>()).collect()
        };
        // Again and again through all: the mean of what was turned turns the rest.
        for _ in 0..4 {
            let all: Vec<Vec<f64>> = self.lenses.iter().flatten().map(even).collect();
            let mut mean = vec![0.0; all.first().map_or(0, Vec::len)];
            all.iter().for_each(|own| mean.iter_mut().zip(own).for_each(|(m, v)| *m += v));
            for lens in self.lenses.iter_mut().flatten() {
                let own = even(lens);
                // Of the mean of the others.
                let along: f64 = own.iter().zip(&mean).map(|(a, b)| a * (b - a)).sum();
                if along < 0.0 {
                    turn(lens);
                    mean.iter_mut().zip(own).for_each(|(m, v)| *m -= 2.0 * v);
                }
            }
        }
        // The mean over the object of the functions 1, y^2 and x^2.
        let defocus: f64 =
            self.lenses.iter().flatten().map(|l| l.terms.row(2)).map(|t| t[0] + (t[3] + t[5]) / 3.0).sum();
        if defocus < 0.0 {
            self.lenses.iter_mut().flatten().for_each(turn);
        }
    }
}

/// What the pupils of an instrument look like.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PupilSummary {
    /// Relative error of the PSFs that they make (root mean square).
    pub misfit: f64,
    /// Mean cut-off frequency of the amplitude, cycles/px.
    pub cutoff_cycles_per_px: f64,
    /// Defocus, rms over the object and the lenses, waves rms.
    pub defocus_waves: f64,
    /// Astigmatism of both directions, as above.
    pub astigmatism_waves: f64,
    /// Coma of both directions, as above.
    pub coma_waves: f64,
    /// Trefoil of both directions, as above.
    pub trefoil_waves: f64,
    /// Spherical aberration, as above.
    pub spherical_waves: f64,
}

/// Sizes by which a displacement in the object appears on the sensor.
#[derive(Clone, Copy, Debug)]
pub struct Scale {
    /// Image per object.
    pub magnification: f64,
    /// Pixel pitch, um.
    pub pixel_pitch_um: f64,
}

fn turn(lens: &mut LensPupil) {
    lens.terms.outer_iter_mut().zip(EVEN).filter(|(_, even)| *even).for_each(|(mut row, _)| row *= -1.0);
}

/// At most [`NODES`] even nodes over the same pixels.
fn coarse(nodes: &[f64]) -> Vec<f64> {
    let (Some(first), Some(last)) = (nodes.first(), nodes.last()) else { return vec![0.0] };
    let n = nodes.len().min(NODES);
    if n < 2 {
        return vec![*first];
    }
    (0..n).map(|i| first + (last - first) * i as f64 / (n - 1) as f64).collect()
}

/// The PSF of a lens at a node, [window, window].
pub(super) fn window(psf: &LowRankPsf, [l, depth, i, j]: [usize; 4]) -> Array2<f64> {
    let mut sum = Array2::<f64>::zeros((psf.basis.dim().2, psf.basis.dim().3));
    for (k, kernel) in psf.basis.index_axis(Axis(0), l).outer_iter().enumerate() {
        let weight = f64::from(psf.coefficients[[l, k, depth, i, j]]);
        sum.zip_mut_with(&kernel, |s, v| *s += weight * f64::from(*v));
    }
    sum
}

/// Places of nodes along one axis, -1 to 1 over the object.
fn placed(nodes: &[f64]) -> Vec<f64> {
    let ends = nodes.first().zip(nodes.last()).filter(|(a, b)| b > a);
    nodes.iter().map(|v| ends.map_or(0.0, |(a, b)| 2.0 * (v - a) / (b - a) - 1.0)).collect()
}

/// The nodes whose PSFs are compared with those of pupils, and their places, -1 to 1 over the object.
pub(super) fn chosen_nodes(psf: &LowRankPsf) -> Vec<([usize; 2], [f64; 2])> {
    let chosen = |n: usize| -> Vec<usize> {
        let k = n.min(PLACES);
        let mut at: Vec<usize> = (0..k).map(|i| if k < 2 { n / 2 } else { i * (n - 1) / (k - 1) }).collect();
        at.dedup();
        at
    };
    let (rows, cols) = (placed(&psf.node_rows_px), placed(&psf.node_cols_px));
    let of_cols = chosen(cols.len());
    let pairs = chosen(rows.len()).into_iter().flat_map(|i| of_cols.iter().map(move |j| [i, *j]));
    pairs.map(|[i, j]| ([i, j], [rows[i], cols[j]])).collect()
}

/// What is fitted of a lens: PSFs on a coarse grid of its nodes, the one nearest to the centre first, cut to the light.
fn places(psf: &LowRankPsf, l: usize, depth: usize) -> Vec<Place> {
    let place = |([i, j], at): ([usize; 2], [f64; 2])| {
        let window = window(psf, [l, depth, i, j]);
        (window.sum(), Place { at, window })
    };
    let mut found: Vec<(f64, Place)> = chosen_nodes(psf).into_iter().map(place).collect();
    let brightest = found.iter().fold(0.0f64, |m, (light, _)| m.max(*light));
    found.retain(|(light, _)| *light > FAINT * brightest);
    let mut places: Vec<Place> = found.into_iter().map(|(_, place)| place).collect();
    places.sort_by(|a, b| a.at[0].hypot(a.at[1]).total_cmp(&b.at[0].hypot(b.at[1])));
    let side = psf.basis.dim().2;
    let widest = places.iter().map(|p| effective_area(&p.window)).fold(1.0f64, f64::max);
    let kept = (2 * ((2.0 * widest.sqrt()).ceil() as usize) + 1).max(11);
    let cut = side.saturating_sub(kept) / 2;
    for place in &mut places {
        let inner = place.window.slice(s![cut..side - cut, cut..side - cut]).to_owned();
        let norm = inner.mapv(|v| v * v).sum().sqrt().max(f64::MIN_POSITIVE);
        place.window = inner / norm;
    }
    places
}

/// Light of a lens at the nodes of its coefficient maps, DN.
pub(super) fn light(psf: &LowRankPsf, l: usize, depth: usize) -> Array2<f64> {
    let mut sum = Array2::<f64>::zeros((psf.node_rows_px.len(), psf.node_cols_px.len()));
    for (k, kernel) in psf.basis.index_axis(Axis(0), l).outer_iter().enumerate() {
        let share: f64 = kernel.iter().map(|v| f64::from(*v)).sum();
        let map = psf.coefficients.slice(s![l, k, depth, .., ..]);
        sum.zip_mut_with(&map, |s, v| *s += share * f64::from(*v));
    }
    sum
}

fn interpolated(map: &Array2<f64>, [row, col]: &[Taps; 2]) -> f64 {
    let pairs = (0..row.count).flat_map(|i| (0..col.count).map(move |j| (i, j)));
    pairs.map(|(i, j)| f64::from(row.weights[i] * col.weights[j]) * map[[row.first + i, col.first + j]]).sum()
}
