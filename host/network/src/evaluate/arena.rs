//! The arena: many methods on the same scenes of many kinds, with paired intervals, and its page.

use crate::methods::title;
use ommatidia_session::rng;
use rand::RngExt;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt::Write;

/// Resamples of the bootstrap.
const RESAMPLES: usize = 2000;

/// A method in the arena.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Entrant {
    /// Its name, unique in the arena.
    pub name: String,
    /// The file that it was made from.
    pub source: String,
    /// Whether it was trained; the others are made from an instrument.
    pub trained: bool,
    /// Mean wall time of one frame, s.
    pub seconds_per_frame: f64,
}

/// One scene, with the figures of every method in the order of the entrants.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Bout {
    /// Kind of specimen.
    pub specimen: String,
    /// Expected signal of the brightest pixel, electrons.
    pub peak_e: f64,
    /// What the instrument has that its calibration does not know; `as calibrated` for nothing.
    pub condition: String,
    /// Peak signal-to-noise ratios, dB.
    pub psnr_db: Vec<f64>,
    /// Structural similarities.
    pub ssim: Vec<f64>,
}

/// All results.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Arena {
    /// The methods.
    pub entrants: Vec<Entrant>,
    /// The scenes.
    pub bouts: Vec<Bout>,
}

/// A mean difference with the interval that holds 95 % of the bootstrap's resamples of the scenes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Difference {
    /// The mean.
    pub mean: f64,
    /// Lower end.
    pub low: f64,
    /// Upper end.
    pub high: f64,
}

impl Difference {
    /// Of paired differences, by the percentile bootstrap (B. Efron, Ann. Statist. 7, 1 (1979)).
    ///
    /// ```
    /// use ommatidia_network::evaluate::Difference;
    ///
    /// let d = Difference::of(&[1.0, 1.5, 0.5, 1.0, 2.0, 0.0, 1.0, 1.0]);
    /// assert!((d.mean - 1.0).abs() < 1e-12 && d.low > 0.5 && d.high < 1.5);
    /// ```
    pub fn of(differences: &[f64]) -> Self {
        let n = differences.len();
        let mean = differences.iter().sum::<f64>() / n.max(1) as f64;
        if n == 0 {
            return Self { mean, low: mean, high: mean };
        }
        let mut rng = rng::stream(1, "arena/bootstrap", n as u64);
        let mut means: Vec<f64> = (0..RESAMPLES)
            .map(|_| (0..n).map(|_| differences[rng.random_range(0..n)]).sum::<f64>() / n as f64)
            .collect();
        means.sort_by(f64::total_cmp);
        let at = |share: f64| means[((share * RESAMPLES as f64) as usize).min(RESAMPLES - 1)];
        Self { mean, low: at(0.025), high: at(0.975) }
    }
}

impl Arena {
    /// Mean over the scenes that `of` selects; None of none.
    fn mean(&self, entrant: usize, figure: impl Fn(&Bout) -> &[f64], of: impl Fn(&Bout) -> bool) -> Option<f64> {
        let values: Vec<f64> = self.bouts.iter().filter(|b| of(b)).map(|b| figure(b)[entrant]).collect();
        (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
    }

    /// Mean PSNR over all scenes, dB.
    pub fn psnr_db(&self, entrant: usize) -> f64 {
        self.mean(entrant, |b| &b.psnr_db, |_| true).unwrap_or(0.0)
    }

    /// PSNR of one entrant minus that of another, paired by scene.
    pub fn difference(&self, entrant: usize, other: usize) -> Difference {
        Difference::of(&self.bouts.iter().map(|b| b.psnr_db[entrant] - b.psnr_db[other]).collect::<Vec<_>>())
    }

    /// Entrants, highest mean PSNR first.
    pub fn order(&self) -> Vec<usize> {
        let mut order: Vec<usize> = (0..self.entrants.len()).collect();
        order.sort_by(|a, b| self.psnr_db(*b).total_cmp(&self.psnr_db(*a)));
        order
    }

    /// The best of the methods that are made from an instrument; None without one.
    pub fn best_solver(&self) -> Option<usize> {
        self.order().into_iter().find(|e| !self.entrants[*e].trained)
    }

    /// The page, in Markdown; `command` repeats it.
    pub fn page(&self, command: &str) -> String {
        let order = self.order();
        let mut text = format!(
            "# Arena\n\nWritten by the program: {} scenes of the virtual instrument, {} methods on each of them. \
             PSNR with one free scale a\nscene; intervals are 95 %, from a bootstrap over the scenes, and do not hold \
             the spread from training to training.\nEach specimen, light and instrument has scenes of its own, so \
             columns differ by their scenes as well.\n\n```\n{command}\n```\n\n",
            self.bouts.len(),
            self.entrants.len()
        );
        // Writing to a string cannot fail.
        let solver = self.best_solver();
        text.push_str("| method | file | PSNR, dB | SSIM | to the best solver, dB | better in | time a frame |\n");
        text.push_str("|---|---|---|---|---|---|---|\n");
        for &e in &order {
            let entrant = &self.entrants[e];
            let (difference, better) = match solver.filter(|s| *s != e) {
                Some(s) => {
                    let Difference { mean, low, high } = self.difference(e, s);
                    let wins = self.bouts.iter().filter(|b| b.psnr_db[e] > b.psnr_db[s]).count();
                    (format!("{mean:+.2} [{low:+.2}, {high:+.2}]"), format!("{wins} of {}", self.bouts.len()))
                }
                None => (String::new(), String::new()),
            };
            let _ = writeln!(
                text,
                "| {} | {} | {:.2} | {:.3} | {difference} | {better} | {:.1} ms |",
                title(method(&entrant.name)),
                file(&entrant.source),
                self.psnr_db(e),
                self.mean(e, |b| &b.ssim, |_| true).unwrap_or(0.0),
                1e3 * entrant.seconds_per_frame,
            );
        }
        let peak = |b: &Bout| format!("{:.0} e-", b.peak_e);
        self.by(&mut text, "By light", "PSNR, dB, by the expected signal of the brightest pixel.", &peak);
        self.by(&mut text, "By specimen", "PSNR, dB.", &|b| b.specimen.clone());
        let what = "PSNR, dB, by what the instrument has that its calibration does not know.";
        self.by(&mut text, "By instrument", what, &|b| b.condition.clone());
        if let Some(worst) = self.worst() {
            text.push_str(&worst);
        }
        text
    }

    /// A table with a column for each value of `key`, in the order of the scenes.
    fn by(&self, text: &mut String, heading: &str, what: &str, key: &dyn Fn(&Bout) -> String) {
        let mut keys: Vec<String> = Vec::new();
        for bout in &self.bouts {
            let key = key(bout);
            if !keys.contains(&key) {
                keys.push(key);
            }
        }
        let _ = writeln!(text, "\n## {heading}\n\n{what}\n\n| method | {} |", keys.join(" | "));
        let _ = writeln!(text, "|---|{}", "---|".repeat(keys.len()));
        for e in self.order() {
            let cell =
                |k: &String| self.mean(e, |b| &b.psnr_db, |b| key(b) == *k).map_or("-".into(), |v| format!("{v:.2}"));
            let cells: Vec<String> = keys.iter().map(cell).collect();
            let _ = writeln!(text, "| {} | {} |", self.label(e), cells.join(" | "));
        }
    }

    /// Where the best network loses most to the best solver of the cell: a cell has one specimen and one light.
    fn worst(&self) -> Option<String> {
        let network = self.order().into_iter().find(|e| self.entrants[*e].trained)?;
        let solvers: Vec<usize> = (0..self.entrants.len()).filter(|e| !self.entrants[*e].trained).collect();
        let mut cells: BTreeMap<(String, u64), Vec<&Bout>> = BTreeMap::new();
        for bout in &self.bouts {
            cells.entry((bout.specimen.clone(), bout.peak_e as u64)).or_default().push(bout);
        }
        let lead = |bouts: &Vec<&Bout>| {
            let mean = |e: usize| bouts.iter().map(|b| b.psnr_db[e]).sum::<f64>() / bouts.len() as f64;
            let best = solvers.iter().copied().max_by(|a, b| mean(*a).total_cmp(&mean(*b)))?;
            Some((mean(network) - mean(best), best))
        };
        let leads: Vec<_> = cells.iter().filter_map(|(cell, bouts)| Some((cell, lead(bouts)?))).collect();
        let ahead = leads.iter().filter(|(_, (lead, _))| *lead > 0.0).count();
        let ((specimen, peak), (lead, solver)) = leads.iter().min_by(|a, b| a.1.0.total_cmp(&b.1.0))?;
        Some(format!(
            "\nThe best network against the best solver of each specimen and light: ahead in {ahead} of {} of them; \
             the worst is\n{specimen} at {peak} e-, {lead:+.2} dB to {}.\n",
            leads.len(),
            title(method(&self.entrants[*solver].name))
        ))
    }

    fn label(&self, entrant: usize) -> String {
        let entrant = &self.entrants[entrant];
        if entrant.trained { file(&entrant.source).into() } else { title(method(&entrant.name)) }
    }
}

/// The name of a method without its file.
fn method(name: &str) -> &str {
    name.split('@').next().unwrap_or(name)
}

/// The name of a file without its folder.
fn file(path: &str) -> &str {
    path.rsplit(['/', '\\']).next().unwrap_or(path)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn arena() -> Arena {
        let entrant = |name: &str, trained| Entrant {
            name: name.into(),
            source: format!("folder/{name}.safetensors"),
            trained,
            seconds_per_frame: 0.01,
        };
        let bout = |i: usize| Bout {
            specimen: ["beads", "worms"][i % 2].into(),
            peak_e: 100.0,
            condition: "as calibrated".into(),
            psnr_db: vec![20.0 + i as f64, 22.0 + i as f64, 21.0 + (i % 2) as f64 * 3.0 + i as f64],
            ssim: vec![0.5, 0.6, 0.7],
        };
        Arena {
            entrants: vec![entrant("wiener", false), entrant("admm", false), entrant("svfouriernet", true)],
            bouts: (0..8).map(bout).collect(),
        }
    }

    #[test]
    fn differences_are_paired() {
        let arena = arena();
        assert_eq!((arena.order(), arena.best_solver()), (vec![2, 1, 0], Some(1)));
        // Scenes differ much; the difference of two methods that differ by a constant does not vary.
        assert_eq!(arena.difference(1, 0), Difference { mean: 2.0, low: 2.0, high: 2.0 });
        let d = arena.difference(2, 1);
        assert!(d.mean == 0.5 && d.low < 0.0 && d.high > 1.0, "{d:?}");
    }

    #[test]
    fn the_page_names_the_worst_case() {
        let page = arena().page("ommatidia arena");
        assert!(page.contains("8 scenes") && page.contains("| SV-FourierNet, float | svfouriernet.safetensors |"));
        assert!(page.contains("ahead in 1 of 2 of them") && page.contains("beads at 100 e-, -1.00 dB to ADMM"));
        assert!(page.contains("## By specimen") && page.contains("| method | beads | worms |"));
    }
}
