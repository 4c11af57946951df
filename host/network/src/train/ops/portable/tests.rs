use super::super::fourier::FourierSizes;
use super::testing::{alike, draw};
use super::*;
use std::sync::Arc;

#[test]
fn convolutions_are_ours() {
    let shape = [2, 3, 6, 5];
    alike(
        &[("x", 180), ("weight", 4 * 3 * 9), ("bias", 4)],
        |l| super::super::conv3x3(l[0].clone().reshape(shape), l[1].clone(), l[2].clone()),
        |l| conv3x3(l[0].clone().reshape(shape), l[1].clone(), l[2].clone()),
    );
}

#[test]
fn filters_are_ours() {
    for (t, frame, object) in [(16, [12, 13], [6, 8]), (15, [15, 9], [7, 4])] {
        let sizes = FourierSizes { frame, object, filter_size: t, channels: 3 };
        let plan = Arc::new(Fourier::new(sizes));
        let spectra = Arc::new(plan.spectra(&draw("frames", 2 * frame[0] * frame[1])));
        let n = 3 * t * (t / 2 + 1);
        alike(
            &[("re", n), ("im", n)],
            |l| super::super::filter_bank(&plan, Arc::clone(&spectra), l[0].clone(), l[1].clone()),
            |l| filter_bank(&plan, &spectra, l[0].clone(), l[1].clone()),
        );
        alike(
            &[("h", 3 * t * t)],
            |l| Tensor::cat(super::super::kernel_spectra(&plan, l[0].clone()).to_vec(), 0),
            |l| Tensor::cat(kernel_spectra(&plan, l[0].clone()).to_vec(), 0),
        );
    }
}
