//! What a watch is worth, in figures.

use super::WatchMaps;
use ommatidia_shared::watch::Statistic;
use serde::Serialize;

/// Figures of the statistics of one kind: displacements in pixels, or gains. Medians over the lenses.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct KindFigures {
    /// Standard deviation of the difference between two unrelated specimens.
    pub specimens: f32,
    /// Standard deviation by noise in one frame whose mean is 5 % of full scale.
    pub noise: f32,
}

/// Figures of a watch.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct WatchFigures {
    /// Length of the maps and statistics, bytes.
    pub bytes: usize,
    /// Side of a block, pixels.
    pub block_px: u8,
    /// Displacements, px.
    pub shifts_px: KindFigures,
    /// Gains, 1.
    pub gains: KindFigures,
}

/// Mean light of a frame as a share of full scale, for the noise.
pub(super) const LIGHT: f64 = 0.05;

impl WatchMaps {
    /// What the watch is worth where full scale is `full_dn` above the black level.
    pub fn figures(&self, full_dn: f64) -> WatchFigures {
        let light_dn = LIGHT * full_dn * f64::from(self.frame.rows) * f64::from(self.frame.cols);
        let (shifts, gains) = self.statistics.split_at(2 * self.statistics.len() / 3);
        let kind = |of: &[Statistic]| {
            let used: Vec<&Statistic> = of.iter().filter(|statistic| statistic.is_used()).collect();
            let light = light_dn as f32;
            KindFigures {
                specimens: median(used.iter().map(|s| s.specimens).collect()),
                noise: median(used.iter().map(|s| ((s.shot + s.reading / light) / light).sqrt()).collect()),
            }
        };
        WatchFigures {
            bytes: size_of_val(&self.weights[..]) + size_of_val(&self.statistics[..]),
            block_px: self.block,
            shifts_px: kind(shifts),
            gains: kind(gains),
        }
    }
}

fn median(mut values: Vec<f32>) -> f32 {
    values.sort_by(f32::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(0.0)
}
