//! The sequential test of the statistics.

use super::maps::{MAX_STATISTICS, Maps, Projection, Statistic};
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// Number of frames whose mean is the baseline.
pub const BASELINE: u32 = 128;
/// 5 / sqrt(BASELINE) + 1/8.
const SLACK: f32 = 0.5669417;
/// Height of the test over the standard deviation and the logarithm of the odds: 1 / (2 / 8).
const HEIGHT: f32 = 4.0;
/// Largest ratio, either way, of the light of a frame to that of the baseline.
const CHANGE: f32 = 2.0;
/// Of so many pixels at most one may be saturated.
const SATURATED: u32 = 1000;
/// So many frames in a row that do not fit an unfinished baseline begin a new one.
const RESTART: u32 = 16;
/// An alarm is averaged over so many frames at most.
const MOST: u32 = 4096;
/// Reports count in millionths of a pixel, or of 1.
const MILLION: f32 = 1e6;

/// A cumulative sum.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Cusum {
    value: f32,
    /// Frames since it was 0.
    frames: u32,
    /// Number of the first of them.
    since: u32,
}

impl Cusum {
    fn step(&mut self, by: f32, id: u32) {
        if self.value <= 0.0 {
            (self.frames, self.since) = (0, id);
        }
        let value = self.value + by;
        self.value = if value > 0.0 { value } else { 0.0 };
        self.frames = self.frames.saturating_add(1);
    }

    /// The mean by which the statistic exceeds its baseline, from the sum.
    fn mean(&self, slack: f32) -> f32 {
        self.value / self.frames.max(1) as f32 + slack
    }
}

/// That something has moved, and what.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct Alarm {
    /// Which statistic: displacements along the rows of all lenses, then along the columns, then gains.
    pub statistic: u8,
    /// Number of the run since which it has moved.
    pub since: u32,
    /// Frames that counted since then.
    pub frames: u32,
    /// Mean change since then, millionths of a pixel or of 1: of this lens against the mean of all others.
    pub millionths: i32,
    /// Standard error of it by noise and specimens that change, and the standard deviation of what another specimen
    /// makes for good, millionths.
    pub error_millionths: [u32; 2],
}

/// What the watch has seen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct Report {
    /// Number of lenses that are watched; 0: the network has no maps.
    pub lenses: u8,
    /// Frames that counted, those of the baseline included.
    pub frames: u32,
    /// Frames that did not count: dark, saturated, or with another light.
    pub left_out: u32,
    /// The first alarm.
    pub alarm: Option<Alarm>,
}

/// The state of the watch.
#[derive(Clone, Debug)]
pub struct Watch {
    frames: u32,
    left_out: u32,
    /// Frames in a row that did not fit the baseline.
    other: u32,
    /// Mean light of the baseline, DN.
    light_dn: f32,
    mean: [f32; MAX_STATISTICS],
    /// Sums of what lies above the mean, and below.
    sums: [[Cusum; 2]; MAX_STATISTICS],
    raised: Option<Raised>,
}

/// An alarm that is being averaged.
#[derive(Clone, Copy, Debug)]
struct Raised {
    statistic: u8,
    since: u32,
    frames: u32,
    mean: f32,
    /// Standard deviation of one frame, and of the difference between two specimens.
    error: [f32; 2],
}

impl Default for Watch {
    fn default() -> Self {
        Self::new()
    }
}

impl Watch {
    /// A watch that has seen no frame.
    pub const fn new() -> Self {
        let zero = Cusum { value: 0.0, frames: 0, since: 0 };
        Self {
            frames: 0,
            left_out: 0,
            other: 0,
            light_dn: 0.0,
            mean: [0.0; MAX_STATISTICS],
            sums: [[zero; 2]; MAX_STATISTICS],
            raised: None,
        }
    }

    /// Forgets everything, in place.
    pub fn restart(&mut self) {
        (self.frames, self.left_out, self.other, self.light_dn, self.raised) = (0, 0, 0, 0.0, None);
        self.mean.fill(0.0);
        self.sums.fill(Default::default());
    }

    /// Looks at the raw frame of run `id`, of which `saturated_px` pixels are saturated.
    pub fn see(&mut self, maps: &Maps<'_>, frame: &[u16], saturated_px: u32, id: u32) {
        if saturated_px > frame.len() as u32 / SATURATED {
            self.left_out = self.left_out.saturating_add(1);
            return;
        }
        self.take(maps, &maps.project(frame), id);
    }

    /// Takes the statistics of the frame of run `id`.
    pub fn take(&mut self, maps: &Maps<'_>, projection: &Projection, id: u32) {
        let light = projection.light_dn as f32;
        if !self.fits(maps, light) {
            self.left_out = self.left_out.saturating_add(1);
            return;
        }
        let frames = self.frames;
        self.frames = frames.saturating_add(1);
        if frames < BASELINE {
            let mean = |mean: &mut f32, value: f32| *mean += (value - *mean) / (frames + 1) as f32;
            mean(&mut self.light_dn, light);
            for ((j, statistic), to) in maps.statistics.iter().enumerate().zip(&mut self.mean) {
                mean(to, projection.value(j, statistic));
            }
            return;
        }
        match self.raised {
            Some(_) => self.average(maps, projection),
            None => self.test(maps, projection, id),
        }
    }

    /// Whether a frame with this light counts.
    fn fits(&mut self, maps: &Maps<'_>, light: f32) -> bool {
        if light < maps.least_light_dn || light <= 0.0 {
            return false;
        }
        let same = self.frames == 0 || (light <= CHANGE * self.light_dn && CHANGE * light >= self.light_dn);
        self.other = if same { 0 } else { self.other.saturating_add(1) };
        if self.other >= RESTART && self.frames < BASELINE {
            let left_out = self.left_out;
            self.restart();
            self.left_out = left_out;
            return true;
        }
        same
    }

    fn test(&mut self, maps: &Maps<'_>, projection: &Projection, id: u32) {
        let least_light = self.light_dn / CHANGE;
        let mut most = 1.0;
        let parts = self.mean.iter().zip(&mut self.sums);
        for ((j, statistic), (mean, sums)) in maps.statistics.iter().enumerate().zip(parts) {
            if !statistic.is_used() {
                continue;
            }
            let excess = projection.value(j, statistic) - mean;
            let sigma = deviation(statistic, least_light);
            let (slack, height) = (statistic.specimens + SLACK * sigma, HEIGHT * sigma * maps.log_odds);
            for (sum, sign) in sums.iter_mut().zip([1.0, -1.0]) {
                sum.step(sign * excess - slack, id);
                // One that crosses together with others, as the neighbours of a lens do, need not be the first.
                let over = sum.value / height;
                if over > most {
                    most = over;
                    self.raised = Some(Raised {
                        statistic: j as u8,
                        since: sum.since,
                        frames: sum.frames,
                        mean: sign * sum.mean(slack),
                        error: [sigma, statistic.specimens],
                    });
                }
            }
        }
    }

    /// Goes on averaging the statistic that has raised the alarm.
    fn average(&mut self, maps: &Maps<'_>, projection: &Projection) {
        let Some(raised) = self.raised.as_mut().filter(|raised| raised.frames < MOST) else { return };
        let j = usize::from(raised.statistic);
        if let Some((statistic, mean)) = maps.statistics.get(j).zip(self.mean.get(j)) {
            raised.frames += 1;
            raised.mean += (projection.value(j, statistic) - mean - raised.mean) / raised.frames as f32;
        }
    }

    /// What has been seen.
    pub fn report(&self, maps: &Maps<'_>) -> Report {
        let alarm = self.raised.map(|Raised { statistic, since, frames, mean, error: [sigma, specimens] }| {
            let noise = sigma * root(1.0 / frames as f32 + 1.0 / BASELINE as f32);
            Alarm {
                statistic,
                since,
                frames,
                // Casts saturate.
                millionths: (mean * MILLION) as i32,
                error_millionths: [(noise * MILLION) as u32, (specimens * MILLION) as u32],
            }
        });
        Report { lenses: maps.lenses() as u8, frames: self.frames, left_out: self.left_out, alarm }
    }
}

/// Standard deviation of a statistic from frame to frame, by noise at so much light, DN, and by specimens that are new
/// in each: half the variance of a difference.
fn deviation(statistic: &Statistic, light: f32) -> f32 {
    let noise = (statistic.shot + statistic.reading / light) / light;
    root(noise + 0.5 * statistic.specimens * statistic.specimens)
}

/// Square root of a number that is not negative, to 1e-6 of itself: from half the exponent, four steps of Newton's.
fn root(x: f32) -> f32 {
    if x < f32::MIN_POSITIVE {
        return 0.0;
    }
    let mut root = f32::from_bits((x.to_bits() >> 1) + 0x1fc0_0000);
    for _ in 0..4 {
        root = 0.5 * (root + x / root);
    }
    root
}
