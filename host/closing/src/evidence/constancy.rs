//! Whether an effect has one strength everywhere.
//!
//! A cause has the same strength in every frame and in every part of the sensor; what merely resembles it has not. Let
//! x be the change of the frames that a found effect makes, in units of the noise, and x_g the same in one group of
//! cells (a frame, or a spatial block) and zero elsewhere. With all columns of the fit projected out by P, the scores
//! ```text
//! s_g = x_g' (1 - P) r        with the covariance V_gh = x_g' (1 - P) x_h + C_gh
//! ```
//! have mean zero where the strength is the same in all groups; C is what errors of the calibration do. If the strength
//! of group g is 1 + u_g times the fitted one, with u_g of standard deviation tau, their covariance is V + tau^2 M M'
//! with M_gh = x_g' (1 - P) x_h. T = s' V^+ s is compared with F (a test of homogeneity: Cochran, Biometrics 10, 101,
//! 1954), and what it exceeds its degrees of freedom by gives tau (by moments, as DerSimonian & Laird do, Control.
//! Clin. Trials 7, 177, 1986).

use super::score::STATED_DEGREES;
use super::stats::{f_tail, sigmas};
use crate::data::Shown;
use crate::fit::{Cell, Column, Design, Fitted, Model, pseudo_inverse};
use ndarray::{Array1, Array2, Axis};
use ommatidia_physics::linalg::{SymmetricEigen, symmetric_eigen};
use std::collections::BTreeMap;

/// Evidence from which a strength is called different between groups, standard deviations.
const CERTAIN: f64 = 4.5;
/// Evidence from which a strength is not shown to be the same in all groups, standard deviations.
const SEEN: f64 = 3.0;
/// Frames may differ by this much, as much as a small error in the law of a strong effect makes.
const SMALL: f64 = 0.03;
/// Relative standard deviation of a strength between groups from which the effect is no cause.
const UNEVEN: f64 = 0.125;
/// The same whatever errors of the PSFs make of it: a strength that differs by more than itself is none.
const WHOLE: f64 = 1.0;
/// A strength that differs by less than this between groups is shown to be the same in all of them, if a difference of
/// this size would show.
const EVEN: f64 = 0.1;
/// The law of a true effect errs as the PSFs do that it moves: so many times their relative error is allowed too.
const BY_PSFS: f64 = 2.0;
/// Where the PSFs err, so does the light in a part of the sensor, and a weak effect seems stronger or weaker there: the
/// relative error of the light over the share of the light that the effect changes. Half of it is allowed, since errors
/// of several foci average.
const BY_LIGHT: f64 = 0.5;
/// Fewest groups that are compared.
const LEAST_GROUPS: usize = 3;
/// Groups in which the effect has less than this share of its largest squared norm in a group do not show it.
const FAINT: f64 = 1e-6;
/// An effect of which less than this share is left beside the light of its frames is a change of that light.
const OF_LIGHT: f64 = 0.1;
/// Combinations of groups of which the rest of the fit leaves less than this share do not show the effect.
const HIDDEN: f64 = 1e-3;

/// How the strength of an effect differs between groups of cells.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Spread {
    /// Standard deviation of the strength between groups, relative to the fitted strength.
    pub(crate) tau: f64,
    /// Evidence that the strength differs at all, standard deviations.
    pub(crate) z: f64,
    /// The least `tau` that would show: three standard deviations of the statistic. 0: there are no groups to compare.
    pub(crate) resolution: f64,
}

impl Spread {
    /// Whether the strength differs by much, by more than is `allowed`, and certainly.
    fn is_uneven(self, allowed: f64) -> bool {
        self.z > CERTAIN && self.tau > UNEVEN.max(allowed.min(WHOLE))
    }
}

/// How the strength of an effect differs.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Constancy {
    /// Between frames.
    pub(crate) frames: Spread,
    /// Between spatial blocks.
    pub(crate) blocks: Spread,
    /// Light of the known objects over what the effect changes of it, both in units of the noise; 0: none are known.
    pub(crate) light: f64,
}

impl Constancy {
    /// The constancy of a term of the state, by its strengths. The design holds all columns of the fit. Effects without
    /// columns, such as tables, and those that only the noise of repeats shows, count as constant. Of unknown specimens
    /// frames alone are compared, and a steady drift within the recording is no sign against an effect.
    pub(crate) fn of(model: &Model<'_>, fit: &Fitted, design: &Design, term: usize) -> Self {
        let it = &fit.state.terms[term];
        let expanded = it.expanded(model.lenses());
        let change = |(i, column): (usize, &Column)| match column {
            Column::Own { term: t, param } if *t == term => {
                let p = expanded.get(*param).map(|(_, p)| *p).filter(|p| p.is_strength())?;
                Some((i, p.inner(it.params[*param]) - p.inner(p.off)))
            }
            _ => None,
        };
        let own: Vec<(usize, f64)> = design.columns.iter().enumerate().filter_map(change).collect();
        let time = |k: usize| model.seen.frames.get(k).map_or(0.0, |f| f.info.time_s);
        let blocks = match design.estimated {
            true => Spread::default(),
            false => spread(design, groups(design, &own, |c| c.block), &[]),
        };
        let light = light(design, &own, |c| {
            model.seen.frames.get(c.frame).is_some_and(|f| matches!(f.shown, Shown::Object(_)))
        });
        let by_frame = groups(design, &own, |c| c.frame);
        let frames = match (design.estimated, beside_light(design, &own, &by_frame)) {
            (true, _) => spread(design, by_frame, &[&time]),
            // Beside the light of each frame the strength that was fitted to all may be another one.
            (false, Some(beside)) => spread(design, beside, &[&|_| 1.0]),
            (false, None) => spread(design, by_frame, &[]),
        };
        let it = Self { frames, blocks, light };
        tracing::info!("constancy of {}: {it:.3?}", fit.state.terms[term].id());
        it
    }

    /// Whether the strength is shown to be the same in all frames and, within the errors of the PSFs, in all parts of
    /// the sensor. What resembles a cause in part fits one frame, or one place, better than another.
    pub(crate) fn is_shown(self) -> bool {
        self.is_even() && (self.frames.z < SEEN || self.frames.tau < SMALL)
    }

    /// The same up to small errors in the law of the effect, which a strong one shows.
    pub(crate) fn is_even(self) -> bool {
        let even = |s: Spread| s.resolution > 0.0 && s.resolution < EVEN && s.tau < EVEN;
        even(self.frames) && even(self.blocks)
    }

    /// Whether there were groups to compare.
    pub(crate) fn is_compared(self) -> bool {
        self.frames.resolution > 0.0 || self.blocks.resolution > 0.0
    }

    /// Says how the strength differs, if it does so by much ([`Spread::is_uneven`]). `psf_error`: relative error of the
    /// PSFs between the positions of their calibration.
    pub(crate) fn objection(self, psf_error: f64) -> Option<String> {
        let [frames, blocks] = [BY_PSFS, BY_PSFS.max(BY_LIGHT * self.light)].map(|times| times * psf_error);
        let (at, between) = match (self.frames.is_uneven(frames), self.blocks.is_uneven(blocks)) {
            (false, false) => return None,
            (true, _) => (self.frames, "frames"),
            (false, true) => (self.blocks, "parts of the sensor"),
        };
        let (percent, z) = (100.0 * at.tau, at.z);
        Some(format!(
            "its strength differs by {percent:.0} % between {between} ({z:.1} standard deviations), and a cause has \
             one strength everywhere"
        ))
    }
}

/// A group of cells: products of the effect with all rows of the Gram matrix, and with itself.
#[derive(Clone)]
struct Group {
    key: usize,
    with: Array1<f64>,
    square: f64,
}

/// Takes the light of each frame out of the effect in it: the lamp may be a little brighter in one frame than in
/// another, and the model errs a little more in bright ones. What an effect adds to a bright frame that it hardly
/// changes would seem stronger or weaker for it. None: the effect itself is mostly that light.
fn beside_light(design: &Design, own: &[(usize, f64)], groups: &[Group]) -> Option<Vec<Group>> {
    let scales: Vec<usize> =
        design.columns.iter().enumerate().filter(|(_, c)| matches!(c, Column::Scale(_))).map(|(i, _)| i).collect();
    let mut light: BTreeMap<usize, Group> = BTreeMap::new();
    for cell in design.cells.iter().filter(|c| !c.held_out) {
        let new = || Group { key: cell.frame, with: Array1::zeros(design.residual() + 1), square: 0.0 };
        let group = light.entry(cell.frame).or_insert_with(new);
        for i in &scales {
            group.with.zip_mut_with(&cell.gram.row(*i), |to, v| *to += f64::from(*v));
            group.square += scales.iter().map(|j| f64::from(cell.gram[[*i, *j]])).sum::<f64>();
        }
    }
    let without = |group: &Group| {
        let Some(light) = light.get(&group.key).filter(|l| l.square > 0.0) else { return group.clone() };
        let both: f64 = own.iter().map(|(i, u)| u * light.with[*i]).sum();
        let share = both / light.square;
        let with = &group.with - &(&light.with * share);
        Group { key: group.key, with, square: (group.square - share * both).max(0.0) }
    };
    let left: Vec<Group> = groups.iter().map(without).collect();
    let all = |of: &[Group]| of.iter().map(|g| g.square).sum::<f64>();
    (all(&left) > OF_LIGHT * all(groups)).then_some(left)
}

/// Sums the training cells into groups by a key. `own`: columns of the effect, and by how much each is changed.
fn groups(design: &Design, own: &[(usize, f64)], key: impl Fn(&Cell) -> usize) -> Vec<Group> {
    let mut all: BTreeMap<usize, Group> = BTreeMap::new();
    for cell in design.cells.iter().filter(|c| !c.held_out) {
        let key = key(cell);
        let new = || Group { key, with: Array1::zeros(design.residual() + 1), square: 0.0 };
        let group = all.entry(key).or_insert_with(new);
        for (i, u) in own {
            group.with.zip_mut_with(&cell.gram.row(*i), |to, v| *to += u * f64::from(*v));
            group.square += own.iter().map(|(j, w)| u * w * f64::from(cell.gram[[*i, *j]])).sum::<f64>();
        }
    }
    let largest = all.values().map(|g| g.square).fold(0.0, f64::max);
    all.into_values().filter(|g| g.square > FAINT * largest).collect()
}

/// Norm of the light of the training cells that `shows` selects, over that of what the effect changes in them; 0: they
/// show no light, or not the effect.
fn light(design: &Design, own: &[(usize, f64)], shows: impl Fn(&Cell) -> bool) -> f64 {
    let scales = design.columns.iter().enumerate().filter(|(_, c)| matches!(c, Column::Scale(_)));
    let scales: Vec<usize> = scales.map(|(i, _)| i).collect();
    let (mut all, mut changed) = (0.0, 0.0);
    for cell in design.cells.iter().filter(|c| !c.held_out && shows(c)) {
        let gram = |i: usize, j: usize| f64::from(cell.gram[[i, j]]);
        all += scales.iter().map(|i| gram(*i, *i)).sum::<f64>();
        changed += own
            .iter()
            .flat_map(|(i, u)| own.iter().map(move |(j, w)| (i, j, u * w)))
            .map(|(i, j, uw)| uw * gram(*i, *j))
            .sum::<f64>();
    }
    if changed > 0.0 { (all / changed).sqrt() } else { 0.0 }
}

/// Compares the strength of an effect between groups. Changes of the strength in proportion to one of the values
/// `free`, which each key has, are allowed.
fn spread(design: &Design, groups: Vec<Group>, free: &[&dyn Fn(usize) -> f64]) -> Spread {
    let (m, given) = (groups.len(), design.columns.len());
    if m < LEAST_GROUPS {
        return Spread::default();
    }
    let gram = design.training().gram;
    let z: Vec<usize> = (0..given).collect();
    let of_z = |cols: &[usize]| gram.select(Axis(0), &z).select(Axis(1), cols);
    let with_z = Array2::from_shape_fn((m, given), |(g, j)| groups[g].with[j]);
    let b = with_z.dot(&pseudo_inverse(&of_z(&z)));
    let projected =
        |cols: &[usize]| Array2::from_shape_fn((m, cols.len()), |(g, j)| groups[g].with[cols[j]]) - b.dot(&of_z(cols));
    let within = Array1::from_iter(groups.iter().map(|g| g.square));
    let by_noise = Array2::from_diag(&within) - b.dot(&with_z.t());
    let Some(shown) = shown(&by_noise, &within) else { return Spread::default() };
    let reduced = |a: &Array2<f64>| shown.t().dot(a).dot(&shown);
    let s = shown.t().dot(&projected(&[design.residual()]).column(0));
    let [scattered, stated] = design.error_rows().map(|rows| {
        let e = shown.t().dot(&projected(&rows.collect::<Vec<_>>()));
        e.dot(&e.t())
    });
    let by_strength = reduced(&by_noise.dot(&by_noise.t()));
    let along = |value: &dyn Fn(usize) -> f64| {
        shown.t().dot(&by_noise.dot(&Array1::from_iter(groups.iter().map(|g| value(g.key)))))
    };
    let by_noise = reduced(&by_noise);
    let v = &by_noise + &scattered + &stated;
    let v_inverse = pseudo_inverse(&v);
    let mut weight = v_inverse.clone();
    for value in free {
        // What a strength that changes with the value does to the scores is taken out of them.
        let u = along(value);
        let out = weight.dot(&u);
        let square = u.dot(&out);
        // Of a second value no more may be left than rounding.
        if square > HIDDEN * u.dot(&v_inverse.dot(&u)) {
            let column = out.insert_axis(Axis(1));
            weight = weight - column.dot(&column.t()) / square;
        }
    }
    let dof = weight.dot(&v).diag().sum().round();
    if dof < 1.0 {
        return Spread::default();
    }
    let t = s.dot(&weight.dot(&s)).max(0.0);
    let share = |c: &Array2<f64>| (weight.dot(c).diag().sum() / dof).clamp(0.0, 1.0);
    let uncertain =
        share(&scattered).powi(2) / (design.scattered as f64 - 1.0).max(1.0) + share(&stated).powi(2) / STATED_DEGREES;
    let nu = if uncertain > 0.0 { 1.0 / uncertain } else { f64::INFINITY };
    let by_spread = weight.dot(&by_strength).diag().sum();
    let tau_of = |excess: f64| (excess.max(0.0) / by_spread.max(f64::MIN_POSITIVE)).sqrt();
    let resolution = tau_of(3.0 * (2.0 * dof).sqrt());
    Spread { tau: tau_of(t - dof), z: sigmas(f_tail(t / dof, dof, nu)), resolution }
}

/// Combinations of groups that the rest of the fit leaves in sight, a column each; `None`: there are none. `by_noise`
/// holds what is left of the effect, `within` its squared norm in each group. The sum of all groups is the effect
/// itself, which is fitted; and a dark current, say, divided by the exposures is a black level. Of such combinations
/// rounding alone is left, in the scores and in their variances, whose quotient would count as evidence.
fn shown(by_noise: &Array2<f64>, within: &Array1<f64>) -> Option<Array2<f64>> {
    let scale = within.mapv(|w| 1.0 / w.sqrt());
    let m = within.len();
    let entry = |(i, j): (usize, usize)| 0.5 * (by_noise[[i, j]] + by_noise[[j, i]]) * scale[i] * scale[j];
    let SymmetricEigen { values, vectors } = symmetric_eigen(&Array2::from_shape_fn((m, m), entry)).ok()?;
    let kept: Vec<usize> = (0..m).filter(|i| values[*i] > HIDDEN).collect();
    (!kept.is_empty()).then(|| vectors.select(Axis(1), &kept) * &scale.insert_axis(Axis(1)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::arr2;
    use ommatidia_session::rng::stream;
    use rand_distr::{Distribution, StandardNormal};

    /// Frames with a nuisance and an effect of strength 1, which scatters by `tau` between frames and drifts by `slope`
    /// from frame to frame; the fit has taken out what both columns hold. 0.1 a pixel: 300 sigma in all.
    fn made_up(tau: f64, slope: f64, seed: u64) -> Design {
        under_lamp(tau, slope, 0.0, seed)
    }

    /// The same where the nuisance is light that scatters by `lamp` between frames, and the effect holds some of it.
    fn under_lamp(tau: f64, slope: f64, lamp: f64, seed: u64) -> Design {
        let mut rng = stream(seed, "constancy", 0);
        let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
        let mut rows: Vec<(usize, usize, [Vec<f64>; 3])> = Vec::new();
        for frame in 0..10 {
            let strength = 1.0 + tau * normal() + slope * (frame as f64 - 4.5);
            let (light, held) = if lamp > 0.0 { (lamp * normal(), 0.1) } else { (0.0, 0.0) };
            for block in 0..9 {
                let pairs: Vec<[f64; 3]> = (0..100)
                    .map(|_| {
                        let n = 1.0 + 0.3 * normal();
                        let x = held * n + 0.3 * normal();
                        [n, x, strength * x + light * n + normal()]
                    })
                    .collect();
                rows.push((frame, block, [0, 1, 2].map(|i| pairs.iter().map(|p| p[i]).collect())));
            }
        }
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
        let total = |i: usize, j: usize| rows.iter().map(|(.., r)| dot(&r[i], &r[j])).sum::<f64>();
        let [nn, nx, xx, ny, xy] = [total(0, 0), total(0, 1), total(1, 1), total(0, 2), total(1, 2)];
        let determinant = nn * xx - nx * nx;
        let fit = [(xx * ny - nx * xy) / determinant, (nn * xy - nx * ny) / determinant];
        let cells = rows
            .into_iter()
            .map(|(frame, block, mut r)| {
                let [n, x, y] = &mut r;
                for ((y, n), x) in y.iter_mut().zip(&*n).zip(&*x) {
                    *y -= fit[0] * n + fit[1] * x;
                }
                let gram = Array2::from_shape_fn((3, 3), |(i, j)| dot(&r[i], &r[j]) as f32);
                Cell { frame, block, held_out: false, pixels: 100.0, gram, log_variance: 0.0 }
            })
            .collect();
        let nuisance = if lamp > 0.0 { Column::Scale(0) } else { Column::Black };
        let columns = vec![nuisance, Column::Own { term: 0, param: 0 }];
        Design { columns, scattered: 0, stated: 0, cells, before: Array2::zeros((2, 2)), estimated: false }
    }

    fn of(tau: f64, slope: f64, seed: u64, free: &[&dyn Fn(usize) -> f64]) -> Spread {
        let design = made_up(tau, slope, seed);
        spread(&design, groups(&design, &[(1, 1.0)], |c| c.frame), free)
    }

    #[test]
    fn a_constant_strength_is_constant() {
        let all: Vec<Spread> = (0..200).map(|seed| of(0.0, 0.0, seed, &[])).collect();
        let beyond = all.iter().filter(|s| s.z > 2.0).count();
        // Binomial of 200 and 0.046: 9 +- 3.
        assert!(beyond < 20 && !all.iter().any(|s| s.is_uneven(0.0)), "{beyond}");
    }

    /// A dark current over the exposure is a black level, and all groups together are the effect: neither combination
    /// of frames is left in sight, and rounding of them is no evidence.
    #[test]
    fn what_the_fit_hides_is_not_compared() {
        let exposures = [1.0, 1.0, 4.0, 4.0, 1.0, 4.0];
        let within = Array1::from_iter(exposures.iter().map(|t: &f64| t * t));
        // Black levels of all frames alike, and the effect itself, are projected out of what each frame shows.
        let z = Array2::from_shape_fn((6, 2), |(g, j)| if j == 0 { exposures[g] } else { within[g] });
        let gram = arr2(&[[6.0, exposures.iter().sum()], [exposures.iter().sum(), within.sum()]]);
        let rounded = Array2::from_shape_fn((6, 6), |(i, j)| 1e-6 * ((7 * i + 3 * j) % 5) as f64);
        let by_noise = Array2::from_diag(&within) - z.dot(&pseudo_inverse(&gram)).dot(&z.t()) + rounded;
        let shown = shown(&by_noise, &within).unwrap();
        assert_eq!(shown.dim(), (6, 4));
        for hidden in [[1.0; 6], exposures.map(|t| 1.0 / t)] {
            // Scores of a hidden combination vanish: what is shown is orthogonal to it in the norms of the groups.
            let along = shown.t().dot(&(&within * &Array1::from_iter(hidden)));
            assert!(along.iter().all(|v| v.abs() < 1e-4), "{along}");
        }
    }

    #[test]
    fn the_spread_of_a_strength_is_measured() {
        let all: Vec<f64> = (0..100).map(|seed| of(0.5, 0.0, seed, &[]).tau.powi(2)).collect();
        let rms = (all.iter().sum::<f64>() / 100.0).sqrt();
        // Nine degrees of freedom, a hundred times: 0.5 +- 0.012.
        assert!((rms - 0.5).abs() < 0.05, "{rms}");
        assert!((0..20).all(|seed| of(0.5, 0.0, seed, &[]).is_uneven(0.0)));
        // Between blocks, which hold all frames alike, there is none.
        let design = made_up(0.5, 0.0, 3);
        let blocks = spread(&design, groups(&design, &[(1, 1.0)], |c| c.block), &[]);
        assert!(!blocks.is_uneven(0.0), "{blocks:?}");
    }

    #[test]
    fn light_that_differs_from_frame_to_frame_makes_no_strength_uneven() {
        let own = [(1, 1.0)];
        let of = |tau: f64, seed: u64| {
            let design = under_lamp(tau, 0.0, 1.0, seed);
            let frames = groups(&design, &own, |c| c.frame);
            let beside = beside_light(&design, &own, &frames).unwrap();
            [spread(&design, frames, &[]), spread(&design, beside, &[&|_| 1.0])]
        };
        for seed in 0..20 {
            let [with, without] = of(0.0, seed);
            assert!(with.is_uneven(0.0) && !without.is_uneven(0.0), "{with:?} {without:?}");
            assert!(of(0.5, seed)[1].is_uneven(0.0));
        }
        // An effect that is the light itself has nothing beside it.
        let light = |seed| {
            let design = under_lamp(0.0, 0.0, 1.0, seed);
            beside_light(&design, &[(0, 1.0)], &groups(&design, &[(0, 1.0)], |c| c.frame)).is_none()
        };
        assert!(light(1));
    }

    #[test]
    fn what_would_show_is_stated() {
        let of_seed = |seed| of(0.0, 0.0, seed, &[]);
        let resolution = of_seed(1).resolution;
        // T exceeds its nine degrees of freedom by three times its standard deviation.
        assert!((0.05..0.4).contains(&resolution), "{resolution}");
        // There T is 1 + 3 sqrt(18) / 9 = 2.4 times a chi-squared of nine degrees of freedom, and beyond 2 standard
        // deviations, 17.2, in 62 % of cases: 31 +- 3.4 of 50.
        let shows = |times: f64| (0..50).filter(|seed| of(times * resolution, 0.0, *seed, &[]).z > 2.0).count();
        assert!((21..=41).contains(&shows(1.0)) && shows(3.0) > 45, "{} {}", shows(1.0), shows(3.0));
    }

    #[test]
    fn a_drift_is_taken_out_where_it_is_allowed() {
        let number = |k: usize| k as f64;
        assert!(of(0.0, 0.15, 1, &[]).is_uneven(0.0));
        let without = of(0.0, 0.15, 1, &[&number]);
        assert!(without.z < 3.0, "{without:?}");
        assert!(of(0.5, 0.15, 1, &[&number]).is_uneven(0.0));
    }

    #[test]
    fn what_differs_is_said() {
        let some = |tau, z| Spread { tau, z, resolution: 0.05 };
        let none = Spread::default();
        let of = |frames, blocks| Constancy { frames, blocks, light: 3.0 }.objection(0.03);
        assert_eq!([of(none, none), of(some(0.1, 30.0), none), of(none, some(0.9, 3.0))], [None, None, None]);
        assert!(of(some(0.5, 9.0), none).is_some_and(|text| text.contains("50 % between frames (9.0")));
        assert!(of(none, some(0.5, 9.0)).is_some_and(|text| text.contains("parts of the sensor")));
        // PSFs that err by a quarter leave so much of a true effect.
        let err = |light, psf_error| Constancy { frames: none, blocks: some(0.4, 9.0), light }.objection(psf_error);
        assert!(err(3.0, 0.1).is_some() && err(3.0, 0.25).is_none());
        // An effect of a hundredth of the light is as uneven as light that errs by 0.9 %: by 45 %.
        assert!(err(100.0, 0.009).is_none() && err(50.0, 0.009).is_some());
        let shown = |frames, blocks| Constancy { frames, blocks, light: 3.0 }.is_shown();
        assert!(shown(some(0.02, 1.0), some(0.05, 9.0)) && !shown(some(0.02, 1.0), none));
        assert!(!shown(some(0.02, 5.0), none) && !shown(some(0.02, 1.0), some(0.2, 5.0)));
        let coarse = Spread { resolution: 0.5, ..some(0.0, 0.5) };
        assert!(!shown(coarse, some(0.02, 1.0)));
    }
}
