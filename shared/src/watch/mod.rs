//! A watch on the optics: a few statistics of each raw frame that hardly depend on the specimen, and a sequential test
//! of them.
//!
//! A frame is y = A x + noise. A fixed linear statistic s = w . y of an unknown specimen x has the mean (A'w) . x, and
//! a parameter theta (the displacement or the gain of one lens) adds theta ((dA/dtheta)'w) . x to it. Where A'w is 0
//! and (dA/dtheta)'w is a constant c, s over the light of the frame is c theta, whatever the specimen. Of nine equal
//! views apart, w = the coordinate in view l, and -1/8 of it in each of the others, compares the centroid of view l
//! with those of the others: it answers a displacement of lens l by the displacement itself. The host computes such
//! maps for a calibrated instrument; here they are applied ([`Maps`]) and watched ([`Watch`]).
//!
//! **The statistics** are sums of integers, so they are exact and their order does not matter. The frame is cut into
//! blocks of B x B pixels (less at its right and lower edge). With h rows and w columns in a block, and v the codes,
//!
//! ```text
//! m0 = 16 (sum v - h w black),   m1 = sum (2 r - h + 1) v,   m2 = sum (2 c - w + 1) v       r, c within the block
//! light = sum of all m0 / 16
//! s_j = scale_j ((sum over blocks and i of q_jbi m_i) / light)        q: 16-bit integers; both roundings in binary32
//! ```
//! that is, maps of displacements which are linear in each block; those of gains take m0 alone and are constant there.
//! A pixel costs two additions.
//!
//! **The test.** The mean m_j of the first [`BASELINE`] frames is the baseline of the stream. From then on two
//! cumulative sums (E. S. Page, Biometrika 41, 100, 1954) of each statistic grow with what exceeds a slack,
//!
//! ```text
//! S+ <- max(0, S+ + (s - m) - slack),   S- <- max(0, S- - (s - m) - slack)
//! slack = d + 5 sigma / sqrt(BASELINE) + sigma / 8,   alarm where S > height = 4 sigma log_odds
//! ```
//! with d the standard deviation of the difference that two specimens make to s, and sigma that of s from frame to
//! frame: of shot and read noise at half the light of the baseline, and of a specimen that is new in every frame. As
//! long as nothing has moved, and the specimen has not changed for good by more than d, the mean step is -sigma / 8 or
//! less, and the probability that a sum which begins at 0 ever reaches the height is at most `exp(-2 (sigma / 8) height
//! / sigma^2) = exp(-log_odds)` (Lundberg's inequality for normal steps; D. Siegmund, Sequential Analysis, Springer
//! 1985, chapter 2). Each frame begins at most one such attempt of each sum, so with J statistics at most `2 J
//! exp(-log_odds)` false alarms come in a frame: `log_odds = ln(2 J 10^6)` makes one in 10^6 frames. The alarm says
//! since which frame the sum has grown: the estimate of the moment of the change by the largest likelihood.

mod maps;
mod monitor;

pub use maps::{MAX_BLOCK, MAX_LENSES, MAX_PIXELS, MAX_STATISTICS, MOMENTS, Maps, Projection, Statistic, blocks};
pub use monitor::{Alarm, BASELINE, Report, Watch};

#[cfg(test)]
mod tests;
