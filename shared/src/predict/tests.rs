//! Predicted frames against their definition in f64.

extern crate std;

use super::{GROUP, Predictor};
use crate::blob::{Corner, Passes, Size};
use crate::naive::{self, Noise, wide};
use crate::num::f16;
use crate::num::simd::Simd;
use std::vec;
use std::vec::Vec;

/// Roundings of the stored transforms: about 4e-4 of the root mean square for each of two factors and the image.
const TOLERANCE: f64 = 2.0e-3;

struct Case {
    passes: Passes,
    frame: Size,
    object: Size,
    model: Vec<f16>,
    x: Vec<f16>,
}

impl Case {
    fn new([frame, object]: [[u16; 2]; 2], [terms, window, node_step]: [u16; 3], corners: &[[i16; 2]]) -> Self {
        let [frame, object] = [frame, object].map(|[rows, cols]| Size { rows, cols });
        let corners = corners.iter().map(|&[row, col]| Corner { row, col }).collect();
        let passes = Passes { later: 1, terms: terms as u8, window, node_step, corners };
        let mut noise = Noise(31);
        let mut model = Vec::new();
        let tile = f32::from(passes.tile(object).unwrap());
        let lags = usize::from(window).pow(2);
        for _ in 0..passes.corners.len() * usize::from(terms) {
            model.extend(noise.halves(passes.nodes(object).iter().product(), 1.0));
            model.extend(noise.halves(lags, tile / (lags as f32 * f32::from(terms))));
        }
        let x = (0..usize::from(object.rows) * usize::from(object.cols))
            .map(|_| f16::from_f32(0.5 + 0.5 * noise.next()))
            .collect();
        Self { passes, frame, object, model, x }
    }

    fn run(&self, wide: bool) -> Vec<f16> {
        let plan = Predictor::new(&self.passes, self.frame, self.object).unwrap();
        let (simd, scratch) =
            if wide { (Simd::detect(), plan.scratch_len_wide()) } else { (Simd::PORTABLE, plan.scratch_len()) };
        let (mut arena, mut scratch) = (vec![f16::NAN; plan.arena_len()], vec![f32::NAN; scratch]);
        let mut frame = vec![f16::NAN; plan.frame_len()];
        plan.process(simd, &self.model, &self.x, &mut frame, &mut arena, &mut scratch).unwrap();
        frame
    }

    fn expected(&self) -> Vec<f64> {
        let (nodes, tile) = (self.passes.nodes(self.object), self.passes.tile(self.object).unwrap());
        naive::predict(&self.passes, (nodes, tile), [self.frame, self.object], &wide(&self.model), &wide(&self.x))
    }
}

/// Lenses inside the frame, cut at its edges, and beside it; maps whose last nodes lie on and beyond the object; more
/// terms than a group has.
fn cases() -> Vec<Case> {
    let corners = [[3, 2], [-4, 9], [14, -6], [25, 22], [-400, 3], [3, 400]];
    vec![
        Case::new([[30, 28], [12, 10]], [1, 5, 1], &corners[..1]),
        Case::new([[30, 28], [12, 10]], [3, 5, 4], &corners),
        Case::new([[30, 28], [17, 9]], [2, 1, 8], &corners),
        Case::new([[31, 40], [14, 26]], [GROUP as u16 + 3, 7, 16], &corners),
        Case::new([[20, 9], [2, 2]], [2, 7, 64], &corners),
    ]
}

#[test]
fn predictions_agree_with_their_definition() {
    for (i, case) in cases().iter().enumerate() {
        let error = naive::error(&case.run(true), &case.expected());
        assert!(error < TOLERANCE, "{i}: {error:e}");
    }
}

#[test]
fn memory_that_is_too_short_is_refused() {
    let case = &cases()[0];
    let plan = Predictor::new(&case.passes, case.frame, case.object).unwrap();
    let (mut arena, mut scratch) = (vec![f16::NAN; plan.arena_len()], vec![f32::NAN; plan.scratch_len()]);
    let mut frame = vec![f16::NAN; plan.frame_len()];
    let mut attempt = |arena: &mut [f16], scratch: &mut [f32]| {
        plan.process(Simd::detect(), &case.model, &case.x, &mut frame, arena, scratch)
    };
    let [short, less] = [plan.arena_len(), plan.scratch_len()].map(|len| len - 1);
    assert!(attempt(&mut arena[..short], &mut scratch).is_err());
    assert!(attempt(&mut arena, &mut scratch[..less]).is_err());
    assert_eq!(attempt(&mut arena, &mut scratch), Ok(()));
}

#[test]
fn scratch_and_vectors_do_not_change_a_bit() {
    for case in cases() {
        assert_eq!(case.run(false), case.run(true));
    }
}

/// The largest model that a file may have, of an object of ones.
#[test]
fn the_largest_light_does_not_overflow() {
    let mut case = Case::new([[20, 20], [40, 40]], [1, 3, 8], &[[-9, -9]; crate::blob::MAX_LENSES]);
    let [rows, cols] = case.passes.nodes(case.object);
    for term in case.model.chunks_mut(rows * cols + 9) {
        term.fill(f16::ONE);
        term[rows * cols..].fill(f16::from_f32(64.0 / 9.0));
    }
    case.x.fill(f16::ONE);
    let frame = case.run(true);
    assert!(frame.iter().all(|light| (light.to_f32() - 25.0).abs() < 0.1), "{frame:?}");
}

#[test]
fn transforms_hold_the_images() {
    let passes = Case::new([[20, 9], [2, 2]], [1, 7, 64], &[[0, 0]]).passes;
    let tile = |rows, cols, window| Passes { window, ..passes.clone() }.tile(Size { rows, cols });
    assert_eq!((tile(96, 96, 21), tile(96, 108, 21), tile(96, 110, 21)), (Some(128), Some(128), Some(256)));
    assert_eq!((tile(2, 2, 1), tile(1000, 4, 25), tile(1000, 4, 27)), (Some(8), Some(1024), None));
    assert_eq!(tile(u16::MAX, u16::MAX, u16::MAX), None);
    let nodes = |node_step, rows, cols| Passes { node_step, ..passes.clone() }.nodes(Size { rows, cols });
    assert_eq!((nodes(4, 9, 10), nodes(1, 2, 6), nodes(64, 2, 65), nodes(0, 9, 9)), ([3, 4], [2, 6], [2, 2], [1, 1]));
}
