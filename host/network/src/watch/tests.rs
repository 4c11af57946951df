#![allow(clippy::unwrap_used)]
use super::*;
use ndarray::Array2;
use ommatidia_shared::watch::MAX_STATISTICS;

/// Nine lenses over one sensor whose views overlap, one PSF each: what is left of a specimen, and what a lens that
/// moves by a pixel makes, in frames that the operator computes.
#[test]
fn maps_answer_displacements_and_hardly_anything_else() {
    let mut instrument = ommatidia_model::testing::square_array(3, [90, 90], [40, 40]);
    let watch = WatchMaps::of(&instrument, 3).unwrap();
    assert_eq!((watch.statistics.len(), watch.maps().lenses()), (27, 9));
    assert!(27 <= MAX_STATISTICS && watch.weights.len() * 2 <= MOST_BYTES);
    let object = |seed: usize| {
        Array2::from_shape_fn(
            (40, 40),
            |(r, c)| if (r * 31 + c * 17 + r * c * seed).is_multiple_of(11) { 1.0 } else { 0.1f32 },
        )
    };
    let codes = |i: &Instrument, seed| -> Vec<u16> {
        let forward = Forward::new(i).unwrap();
        let light = forward.operator().apply(object(seed).view()).unwrap();
        let most = light.fold(0.0f32, |m, v| m.max(*v));
        light.iter().map(|v| (f32::from(watch.black_dn) + 3000.0 * v / most).round() as u16).collect()
    };
    let value = |codes: &[u16], j: usize| watch.maps().project(codes).value(j, &watch.statistics[j]);
    for seed in [1, 5, 8] {
        let still = codes(&instrument, seed);
        // Lens 4 moves down by a whole pixel, which displaces its image by one.
        instrument.geometry.anchors_px[4][0] += 1.0;
        let moved = codes(&instrument, seed);
        instrument.geometry.anchors_px[4][0] -= 1.0;
        let answer = value(&moved, 4) - value(&still, 4);
        assert!((0.5..1.5).contains(&answer), "{seed}: {answer}");
        for j in (0..18).filter(|j| *j != 4) {
            let other = value(&moved, j) - value(&still, j);
            assert!(other.abs() < 0.6, "{seed}: statistic {j} answers {other}");
            assert!((value(&still, j)).abs() < 0.1, "{seed}: a specimen makes {} of {j}", value(&still, j));
        }
    }
}

#[test]
fn too_few_lenses_and_frames_of_another_size_are_refused() {
    let two = ommatidia_model::testing::instrument([9, 11], [30, 33], 5, 3);
    assert!(matches!(WatchMaps::of(&two, 1), Err(WatchError::Lenses { found: 2, .. })));
    let watch = WatchMaps::of(&ommatidia_model::testing::square_array(3, [90, 90], [40, 40]), 3).unwrap();
    assert!(watch.header([90, 90]).is_ok());
    let error = watch.header([90, 91]).unwrap_err().to_string();
    assert!(error.contains("90 x 91") && error.contains("90 x 90"), "{error}");
}
