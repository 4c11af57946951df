//! Regions of interest: a region that is computed alone has every bit of the region cut from the whole, on networks, frame sizes and
//! tile sizes of many kinds. `qemu_parity` tries some of it on the boards.
#![allow(clippy::unwrap_used)]

mod networks;

use networks::{DENSE, PRUNED, Shape, TAPPED, THIN};
use ommatidia_host::device::{DeviceError, LoopbackConfig, Runtime, Work, reference, run};
use ommatidia_shared::image::Region;

/// Networks that differ in what a region depends on.
fn shapes() -> [Shape; 9] {
    [
        DENSE,
        TAPPED,
        PRUNED,
        THIN,
        Shape { tile: 128, step: 128, channels: 1, maps: false, ..DENSE },
        Shape { tile: 32, step: 8, ..TAPPED },
        Shape { width: 7, object: [30, 46], frame: [53, 47], ..DENSE },
        Shape { groups: 3, blocks: 2, frame: [64, 64], object: [40, 40], tile: 64, step: 64, ..DENSE },
        Shape { groups: 2, blocks: 0, ..TAPPED },
    ]
}

/// Corners, edges, single pixels, the middle, and all but one row and column.
fn regions(shape: &Shape) -> Vec<Region> {
    let [rows, cols] = shape.object;
    let region = |row, col, rows, cols| Region { row, col, rows, cols };
    let (half_rows, half_cols) = (rows / 2, (cols / 2).max(1));
    let mut regions = vec![
        region(0, 0, rows, cols),
        region(0, 0, 1, 1),
        region(rows - 1, cols - 1, 1, 1),
        region(0, cols - 1, rows, 1),
        region(rows - 3, 0, 3, cols),
        region(half_rows - 1, cols - half_cols, half_rows / 2, half_cols),
        region(1, cols.min(2) - 1, rows - 1, cols - cols.min(2) + 1),
    ];
    // Each parity of the first and the last pixel.
    regions.extend(
        [0, 1].into_iter().flat_map(|d| [region(half_rows + d, half_cols - 1, 3, 1), region(half_rows + d, 0, 4, 2)]),
    );
    regions
}

#[test]
fn every_region_is_the_cut_of_the_whole() {
    for (seed, shape) in (20..).zip(shapes()) {
        let (blob, frames) = (networks::network(&shape, seed), networks::frames(&shape, 1, seed));
        let whole = reference(&blob, frames.as_slice().into()).unwrap();
        for region in regions(&shape) {
            let work = Work { frames: &frames, region: Some(region) };
            let expected = networks::cut(&whole[0], &shape, region);
            assert_eq!(reference(&blob, work).unwrap()[0], expected, "{region} of {shape:?}");
            let device = run(&Runtime::Host(LoopbackConfig::default()), &blob, work, None, &mut |_| {}).unwrap();
            assert_eq!(device.objects[0], expected, "{region} of {shape:?}");
        }
    }
}

#[test]
fn a_region_outside_is_refused_in_words() {
    let (blob, frames) = (networks::network(&DENSE, 1), networks::frames(&DENSE, 1, 1));
    for (row, col, rows, cols) in [(24, 0, 1, 1), (0, 30, 2, 7), (3, 3, 0, 4), (65535, 0, 65535, 1)] {
        let work = Work { frames: &frames, region: Some(Region { row, col, rows, cols }) };
        let error = run(&Runtime::Host(LoopbackConfig::default()), &blob, work, None, &mut |_| {}).unwrap_err();
        assert!(matches!(error, DeviceError::Refused(_)), "{error:?}");
        let text = error.to_string();
        assert!(text.contains("must lie in the 24 x 36 pixels"), "{text}");
        assert!(reference(&blob, work).is_err());
    }
}
