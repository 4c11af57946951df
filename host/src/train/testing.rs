//! Training pairs for tests.

use super::Pair;
use crate::rng;
use ndarray::Array2;
use rand::RngExt;

/// Pairs of random points imaged by 3 x 3 lenses, each focus a small cross; the views lie `pitch` pixels apart.
pub(crate) fn foci(count: usize, frame: usize, object: usize, pitch: usize) -> Vec<Pair> {
    let make = |i: usize| {
        let mut rng = rng::stream(11, "points", i as u64);
        let mut o = Array2::<f32>::zeros((object, object));
        for _ in 0..12 {
            o[[rng.random_range(0..object), rng.random_range(0..object)]] = rng.random_range(0.3..1.0f32);
        }
        let mut f = Array2::<f32>::zeros((frame, frame));
        let middle = (frame - object) / 2;
        for ((r, c), &v) in o.indexed_iter().filter(|(_, v)| **v > 0.0) {
            for lens in 0..9 {
                let (r0, c0) = (r + middle + (lens / 3) * pitch - pitch, c + middle + (lens % 3) * pitch - pitch);
                for (dr, dc, w) in [(0i32, 0i32, 0.5f32), (1, 0, 0.15), (-1, 0, 0.1), (0, 1, 0.15), (0, -1, 0.1)] {
                    let (r, c) = ((r0 as i32 + dr) as usize, (c0 as i32 + dc) as usize);
                    if let Some(p) = f.get_mut((r, c)) {
                        *p += v * w * 1000.0;
                    }
                }
            }
        }
        Pair { object: o, expected_e: f }
    };
    (0..count).map(make).collect()
}
