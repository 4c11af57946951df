//! Which frames of a recording of unknown specimens are used.
//!
//! A recording may have thousands of frames, and the cost of a frame is that of estimating its specimen. So the
//! recording is divided evenly over time, and of each part the frame is taken whose content shows most. Frames pass one
//! by one: of a part, its best frame so far and the frame before that are in memory, nothing else.

use ndarray::{Array2, ArrayView2};

/// How much a frame shows of the optics: the information that it holds on a displacement of its light, in arbitrary
/// units. `full_dn` is the value at which pixels saturate. Frames of one recording can be compared by it.
///
/// The slope of the light, squared, over the variance of the noise. Slopes of two neighbouring rows are multiplied in
/// place of squares of one: their noise is independent, so that noise counts as nothing. The variance is taken to be in
/// proportion to the light above the darkest pixel, and not below that of the mean light. Pixels beside saturated ones
/// do not count.
pub(crate) fn content(frame: &Array2<f32>, full_dn: f64) -> f64 {
    let (rows, cols) = frame.dim();
    if rows < 3 || cols < 3 {
        return 0.0;
    }
    let darkest = frame.iter().copied().fold(f32::INFINITY, f32::min);
    let mean = (frame.mean().unwrap_or(darkest) - darkest).max(f32::MIN_POSITIVE);
    let full = full_dn as f32;
    let along = |frame: ArrayView2<'_, f32>| -> f64 {
        let pair = |[upper, lower]: [&[f32]; 2]| -> f64 {
            let of = |(u, l): (&[f32], &[f32])| {
                if u.iter().chain(l).any(|v| *v >= full) {
                    return 0.0;
                }
                let level = 0.5 * (u[1] + l[1]) - darkest;
                f64::from((u[2] - u[0]) * (l[2] - l[0]) / (level + mean))
            };
            upper.windows(3).zip(lower.windows(3)).map(of).sum()
        };
        let lines: Vec<Vec<f32>> = frame.outer_iter().map(|line| line.to_vec()).collect();
        lines.windows(2).map(|two| pair([&two[0], &two[1]])).sum()
    };
    (along(frame.view()) + along(frame.t())).max(0.0)
}

/// Of `n` successive parts of a sequence, the index of the member with the largest content of each. With no more than
/// `n` members all of them.
pub(crate) fn best_of_parts(contents: &[f64], n: usize) -> Vec<usize> {
    let (len, n) = (contents.len(), n.min(contents.len()));
    // The first of equals.
    let best =
        |part: std::ops::Range<usize>| part.reduce(|best, i| if contents[i] > contents[best] { i } else { best });
    (0..n).filter_map(|p| best(p * len / n..(p + 1) * len / n)).collect()
}

/// A frame that is kept, with its index in the stack.
pub(super) struct Kept {
    pub(super) index: usize,
    pub(super) frame: Array2<f32>,
    pub(super) content: f64,
}

/// Keeps the frame with the largest content of each of some parts of a sequence, with the frame before it: effects of
/// the preceding frame need it, and repeats need pairs.
pub(super) struct Chooser {
    /// Frames of the sequence.
    len: usize,
    /// Parts that it is divided into.
    parts: usize,
    part: usize,
    best: Option<(Option<Kept>, Kept)>,
    last: Option<Kept>,
    chosen: Vec<Kept>,
}

impl Chooser {
    /// For a sequence of `len` frames in `parts` parts.
    pub(super) fn new(len: usize, parts: usize) -> Self {
        Self { len, parts: parts.clamp(1, len.max(1)), part: 0, best: None, last: None, chosen: Vec::new() }
    }

    /// Takes the next frame of the sequence.
    pub(super) fn push(&mut self, next: Kept) {
        // The last part that begins at or before the frame.
        let part = ((next.index + 1) * self.parts - 1) / self.len.max(1);
        if part != self.part {
            self.end_part();
            self.part = part;
        }
        let copy = |k: &Kept| Kept { index: k.index, frame: k.frame.clone(), content: k.content };
        if self.best.as_ref().is_none_or(|(_, best)| next.content > best.content) {
            self.best = Some((self.last.as_ref().map(copy), copy(&next)));
        }
        self.last = Some(next);
    }

    /// The kept frames in their order.
    pub(super) fn finish(mut self) -> Vec<Kept> {
        self.end_part();
        self.chosen
    }

    fn end_part(&mut self) {
        let Some((before, best)) = self.best.take() else { return };
        let last = self.chosen.last().map(|k| k.index);
        self.chosen.extend(before.filter(|k| last.is_none_or(|last| k.index > last)));
        self.chosen.push(best);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ommatidia_session::rng::stream;
    use rand_distr::{Distribution, StandardNormal};

    /// Spots of a peak and a width on a black level of 100 DN, with noise.
    fn frame(peak: f32, sigma_px: f32, seed: u64) -> Array2<f32> {
        let mut rng = stream(seed, "content", 0);
        Array2::from_shape_fn((40, 50), |(r, c)| {
            let square = |at: usize| (at as f32 % 10.0 - 5.0).powi(2);
            let light = peak * (-(square(r) + square(c)) / (2.0 * sigma_px * sigma_px)).exp();
            let noise: f32 = StandardNormal.sample(&mut rng);
            (100.0 + light + noise * (4.0 + light).sqrt()).round()
        })
    }

    #[test]
    fn light_and_detail_are_content_and_noise_is_not() {
        let of = |peak, sigma, seed| content(&frame(peak, sigma, seed), 4000.0);
        let (bright, dim, smooth, noise) = (of(1000.0, 1.5, 1), of(100.0, 1.5, 2), of(1000.0, 4.0, 3), of(0.0, 1.5, 4));
        // The information of Poisson noise grows as the light does.
        assert!((6.0..16.0).contains(&(bright / dim)), "{bright} {dim}");
        assert!(bright > 3.0 * smooth && noise < 0.05 * dim, "{bright} {dim} {smooth} {noise}");
        // Beside saturated pixels there is no slope.
        assert!(content(&frame(1000.0, 1.5, 1), 800.0) < 0.9 * bright);
        assert_eq!(content(&Array2::zeros((2, 9)), 100.0), 0.0);
    }

    #[test]
    fn each_part_of_a_long_recording_gives_its_best_frame_with_the_one_before() {
        let contents: Vec<f64> = (0..1000).map(|i| f64::from(i * 389 % 1000)).collect();
        let mut chooser = Chooser::new(1000, 24);
        let mut most = 0;
        for (index, content) in contents.iter().copied().enumerate() {
            chooser.push(Kept { index, frame: Array2::zeros((1, 1)), content });
            most = most.max(chooser.chosen.len() + 3);
        }
        let kept = chooser.finish();
        assert!(most <= 2 * 24 + 3, "{most}");
        let best = best_of_parts(&contents, 24);
        assert_eq!(best.len(), 24);
        for (p, b) in best.iter().enumerate() {
            assert!((p * 1000 / 24..(p + 1) * 1000 / 24).contains(b));
            assert!(kept.iter().any(|k| k.index == *b) && (*b == 0 || kept.iter().any(|k| k.index == b - 1)));
        }
        assert!(kept.windows(2).all(|w| w[0].index < w[1].index), "in order, none twice");
    }

    #[test]
    fn few_frames_are_all_taken() {
        assert_eq!(best_of_parts(&[3.0, 1.0, 2.0], 8), [0, 1, 2]);
        assert_eq!(best_of_parts(&[0.0; 6], 3), [0, 2, 4]);
        assert!(best_of_parts(&[], 8).is_empty());
        let mut chooser = Chooser::new(3, 24);
        for index in 0..3 {
            chooser.push(Kept { index, frame: Array2::zeros((1, 1)), content: 0.0 });
        }
        assert_eq!(chooser.finish().iter().map(|k| k.index).collect::<Vec<_>>(), [0, 1, 2]);
    }
}
