//! Axes of charts. The ticks of a logarithmic axis are at 1, 2 and 5 times powers of ten.

use plotters::coord::ranged1d::{DefaultFormatting, KeyPointHint, Ranged};
use plotters::coord::types::RangedCoordf64;
use std::ops::Range;

/// How values are placed along an axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AxisKind {
    /// Linear.
    Linear,
    /// Logarithmic, base 10.
    Log10,
}

/// An axis over places: the values themselves, or their decimal logarithms.
#[derive(Clone)]
pub struct Places {
    even: RangedCoordf64,
    kind: AxisKind,
}

impl Places {
    /// Between two places.
    pub fn new(kind: AxisKind, low: f64, high: f64) -> Self {
        Self { even: (low..high).into(), kind }
    }
}

impl Ranged for Places {
    type FormatOption = DefaultFormatting;
    type ValueType = f64;

    fn map(&self, value: &f64, limit: (i32, i32)) -> i32 {
        self.even.map(value, limit)
    }

    fn key_points<Hint: KeyPointHint>(&self, hint: Hint) -> Vec<f64> {
        match self.kind {
            AxisKind::Linear => {
                let Range { start, end } = self.range();
                // Rounding leaves the tick at zero a tiny residue, which would print as -1.1e-16.
                let negligible = 1e-9 * (end - start).abs();
                let clean = |tick: f64| if tick.abs() < negligible { 0.0 } else { tick };
                self.even.key_points(hint).into_iter().map(clean).collect()
            }
            AxisKind::Log10 => decades(self.range(), hint.max_num_points()),
        }
    }

    fn range(&self) -> Range<f64> {
        self.even.range()
    }
}

/// Logarithms of 1, 2, 5 times powers of ten, of powers of ten, or of every other: whatever fits.
fn decades(range: Range<f64>, most: usize) -> Vec<f64> {
    let (first, last) = (range.start.floor() as i32, range.end.ceil() as i32);
    let within = |values: Vec<f64>| values.into_iter().filter(|v| range.contains(v)).collect::<Vec<_>>();
    let fine = within((first..=last).flat_map(|d| [1.0f64, 2.0, 5.0].map(|m| f64::from(d) + m.log10())).collect());
    if fine.len() <= most.max(1) {
        return fine;
    }
    let coarse =
        |step: usize| within((first..=last).filter(|d| d.rem_euclid(step as i32) == 0).map(f64::from).collect());
    (1..=100).map(coarse).find(|ticks| ticks.len() <= most.max(1)).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_in_value() {
        let values = |low: f64, high: f64| -> Vec<f64> {
            decades(low..high, 6).into_iter().map(|t| (10f64.powf(t) * 1e6).round() / 1e6).collect()
        };
        assert_eq!(values(-0.1, 1.6), [1.0, 2.0, 5.0, 10.0, 20.0]);
        assert_eq!(values(-4.2, 0.1), [1e-4, 1e-3, 1e-2, 1e-1, 1.0]);
        assert_eq!(values(-12.0, 0.1).len(), 5);
    }

    #[test]
    fn the_tick_at_zero_is_zero() {
        for (low, high) in [(-0.3, 0.7), (-0.07, 0.05), (-1.1, 0.3), (-0.35, 0.62)] {
            let axis = Places::new(AxisKind::Linear, low, high);
            let ticks = axis.key_points(plotters::coord::ranged1d::BoldPoints(6));
            assert!(ticks.contains(&0.0) && ticks.iter().all(|t| *t == 0.0 || t.abs() > 1e-3), "{ticks:?}");
        }
    }
}
