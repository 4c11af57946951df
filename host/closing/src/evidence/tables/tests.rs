#![allow(clippy::unwrap_used)]
use super::single::{hot, sparse};
use super::*;
use ommatidia_session::rng::stream;
use rand_distr::{Distribution, Exp1, StandardNormal};

const SIDE: usize = 90;
const NOISE: f32 = 0.01;

/// Two halves with the same pattern and independent noise.
fn halves(pattern: impl Fn(usize, usize) -> f32) -> [Half; 2] {
    [0, 1].map(|h| {
        let mut rng = stream(11, "tables", h);
        let value = Array2::from_shape_fn((SIDE, SIDE), |(r, c)| {
            let z: f32 = StandardNormal.sample(&mut rng);
            pattern(r, c) + NOISE * z
        });
        Half {
            value,
            weight: Array2::from_elem((SIDE, SIDE), 1.0 / (NOISE * NOISE)),
            scatter: Array2::ones((SIDE, SIDE)),
            frames: 4.0,
        }
    })
}

fn white(rms: f32) -> Array2<f32> {
    let mut rng = stream(12, "white", 0);
    Array2::from_shape_simple_fn((SIDE, SIDE), || {
        let z: f32 = StandardNormal.sample(&mut rng);
        rms * z
    })
}

#[test]
fn a_white_pattern_is_measured_without_bias_and_a_smooth_one_is_rejected() {
    let own = white(0.008);
    let judged = |halves: [Half; 2]| {
        let single = outliers(&halves[0], &halves[1]);
        let [a, b] = halves.map(|h| sharp(&h, &single, SMOOTH_PX));
        (pattern(&a, &b, &single, 0.0, kept(SMOOTH_PX)).unwrap(), is_white(&a, &b))
    };
    let (found, is) = judged(halves(|r, c| own[[r, c]]));
    assert!(is && found.z > 20.0 && (found.size.sqrt() - 0.008).abs() < 3e-4, "{} {}", found.z, found.size.sqrt());
    // A wave, a step, a slope with a pattern on it, nothing.
    assert!(!judged(halves(|r, c| 0.02 * ((r + c) as f32 * 0.46).sin())).1);
    assert!(!judged(halves(|_, c| if c < SIDE / 2 { 0.02 } else { 0.0 })).1);
    assert!(judged(halves(|r, c| own[[r, c]] + 0.0005 * r as f32)).1);
    assert!(judged(halves(|_, _| 0.0)).0.z.abs() < 4.0);
}

#[test]
fn hot_and_dead_pixels_are_no_pattern_of_all_pixels() {
    let mut table = Array2::<f32>::zeros((SIDE, SIDE));
    (0..40).for_each(|i| table[[(i * 37) % SIDE, (i * 53) % SIDE]] = if i % 4 == 0 { -1.0 } else { 1.5 });
    let halves = halves(|r, c| table[[r, c]]);
    let single = outliers(&halves[0], &halves[1]);
    assert_eq!(single.iter().filter(|out| **out).count(), 40);
    let [a, b] = halves.map(|h| sharp(&h, &single, SMOOTH_PX));
    let found = pattern(&a, &b, &single, 0.0, kept(SMOOTH_PX)).unwrap();
    assert!(found.z < 4.0, "{}", found.z);
    // Their own values stay.
    assert!((a.value[[37, 53]] - 1.5).abs() < 0.1);
}

#[test]
fn dust_is_dark_and_a_wave_is_no_dust() {
    let disc = |r: usize, c: usize| if (r as f32 - 40.0).hypot(c as f32 - 51.0) < 3.5 { -0.05 } else { 0.0 };
    let [a, b] = halves(disc);
    let found = spots(&a, &b, 0.0).unwrap();
    assert!(found.z > 5.0 && (found.size - 0.05).abs() < 4.0 * found.error, "{} {}", found.z, found.size);
    assert!(found.table[[40, 51]] < -0.02 && found.table[[10, 10]] == 0.0);
    let [a, b] = halves(|r, c| 0.02 * ((r + c) as f32 * 0.46).sin());
    assert!(spots(&a, &b, 0.0).is_none());
}

#[test]
fn hot_pixels_are_found_beside_a_pattern() {
    let mut rng = stream(13, "hot", 0);
    let mut table = Array2::<f32>::zeros((SIDE, SIDE));
    for i in 0..60 {
        let level: f32 = Exp1.sample(&mut rng);
        table[[(i * 37) % SIDE, (i * 53) % SIDE]] = 0.3 * level;
    }
    let [a, b] = halves(|r, c| table[[r, c]]);
    let found = sparse(&a, &b, 0.0).unwrap();
    assert!((found.size - 0.3).abs() < 3.0 * found.error && found.z > 5.0, "{} +- {}", found.size, found.error);
    // What jumps is not hot.
    let mut jumping = halves(|r, c| table[[r, c]]);
    jumping.iter_mut().for_each(|h| h.scatter = table.mapv(|v| 1.0 + (v / NOISE).powi(2)));
    let [a, b] = jumping;
    assert!(sparse(&a, &b, 0.0).unwrap().z < 3.0);
    // One pixel that does not jump is by chance in one level where many do; forty are not.
    let [a, b] = halves(|r, c| if (r, c) == (20, 30) { 0.3 } else { 0.0 });
    let z = |share| sparse(&a, &b, share).unwrap().z;
    // 0.003 of 8100 pixels in the upper level in all of eight frames: 0.1 pixels.
    assert!(z(0.0) > 5.0 && (1.0..2.0).contains(&z(0.003)), "{} {}", z(0.0), z(0.003));
    let [a, b] = halves(|r, c| table[[r, c]]);
    assert!(sparse(&a, &b, 0.003).unwrap().z > 5.0);
    // A pattern of all pixels makes none of them hot.
    let own = white(0.05);
    let [a, b] = halves(|r, c| own[[r, c]]);
    assert!(sparse(&a, &b, 0.0).unwrap().z < 3.0);
}

/// The glow of an amplifier in a corner, without noise of its own: 8 at the corner, of 8 pixels' width.
fn glow(r: usize, c: usize) -> f32 {
    8.0 * (-((r + c) as f32) / 8.0).exp()
}

#[test]
fn a_glow_is_a_pattern_and_no_hot_pixels() {
    let [a, b] = halves(glow);
    assert!(sparse(&a, &b, 0.0).is_none_or(|found| found.z < 3.0));
    assert_eq!(hot(&a, &b).iter().filter(|out| **out).count(), 0);
    let found = pattern(&a, &b, &hot(&a, &b), 0.0, 1.0).unwrap();
    let off = found.table.indexed_iter().map(|((r, c), v)| (v - glow(r, c)).abs()).fold(0.0, f32::max);
    assert!(found.z > 20.0 && off < 0.05, "{} {off}", found.z);
    // Hot pixels in the glow are found with their own rate.
    let places = [(0, 4), (2, 3), (5, 1), (40, 50), (60, 9), (9, 61), (70, 70), (89, 88), (33, 0), (12, 12)];
    let [a, b] = halves(|r, c| glow(r, c) + if places.contains(&(r, c)) { 3.0 } else { 0.0 });
    let found = sparse(&a, &b, 0.0).unwrap();
    let rates: Vec<f32> = places.iter().map(|at| found.table[*at]).collect();
    assert!(rates.iter().all(|v| (v - 3.0).abs() < 0.4), "{rates:?}");
    assert_eq!(found.table.iter().filter(|v| **v != 0.0).count(), places.len());
    // A bright square with a sharp edge: its corners stand out, and touch each other.
    let [a, b] = halves(|r, c| if r / 2 % 9 == 4 && c / 2 % 9 == 4 { 1.0 } else { 0.0 });
    assert!(sparse(&a, &b, 0.0).is_none());
}

#[test]
fn noise_that_rows_share_is_no_pattern() {
    // Offsets of the rows, drawn for each half: products of two halves scatter by what a row adds up to.
    let z = |seed: u64| {
        let mut rng = stream(seed, "rows", 0);
        let [a, b] = halves(|_, _| 0.0).map(|mut h| {
            for mut row in h.value.rows_mut() {
                let z: f32 = StandardNormal.sample(&mut rng);
                row += 3.0 * NOISE * z;
            }
            h
        });
        let none = Array2::from_elem((SIDE, SIDE), false);
        pattern(&a, &b, &none, 0.0, 1.0).unwrap().z
    };
    let all: Vec<f64> = (0..60).map(z).collect();
    let rms = (all.iter().map(|z| z * z).sum::<f64>() / all.len() as f64).sqrt();
    assert!((0.75..1.3).contains(&rms), "{rms}");
}
