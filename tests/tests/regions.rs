//! Regions of interest. A region that is computed alone has every bit of the region cut from the whole, for networks,
//! frame sizes and tile sizes of many kinds. A region whose field is held from an earlier frame is reported as such and
//! has the bits that this machine computes. `qemu_parity` repeats a part of it on the boards.
#![allow(clippy::unwrap_used)]

mod networks;

use networks::{DENSE, PRUNED, Shape, TAPPED, THIN};
use ommatidia::device::{
    Client, DeviceError, DeviceRun, Loopback, LoopbackConfig, RunRequest, Runtime, Scope, reference, run,
};
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
            let work = RunRequest { frames: &frames, scope: region.into() };
            let expected = networks::cut(&whole[0], &shape, region);
            assert_eq!(reference(&blob, work).unwrap()[0], expected, "{region} of {shape:?}");
            let device = run(&Runtime::Host(LoopbackConfig::default()), &blob, work, None, &mut |_| {}).unwrap();
            assert_eq!(device.objects[0], expected, "{region} of {shape:?}");
        }
    }
}

/// With several passes the last one is cut, and nothing can be held.
#[test]
fn every_region_of_passes_is_the_cut_of_the_whole() {
    for (seed, (shape, passes)) in (60..).zip([(DENSE, 2), (TAPPED, 3), (PRUNED, 2), (THIN, 4)]) {
        let blob = networks::network_of(&networks::with_passes(&shape, passes, 3), seed);
        let frames = networks::frames(&shape, 1, seed);
        let whole = reference(&blob, frames.as_slice().into()).unwrap();
        for region in regions(&shape) {
            let work = RunRequest { frames: &frames, scope: region.into() };
            let expected = networks::cut(&whole[0], &shape, region);
            assert_eq!(reference(&blob, work).unwrap()[0], expected, "{region} of {shape:?}");
            let device = run(&Runtime::Host(LoopbackConfig::default()), &blob, work, None, &mut |_| {}).unwrap();
            assert_eq!(device.objects[0], expected, "{region} of {shape:?}");
        }
        let scope = Scope { hold: 1, ..Region { row: 0, col: 0, rows: 1, cols: 1 }.into() };
        let work = RunRequest { frames: &frames, scope };
        let error = run(&Runtime::Host(LoopbackConfig::default()), &blob, work, None, &mut |_| {}).unwrap_err();
        assert!(error.to_string().contains("hold of 0"), "{error}");
    }
}

#[test]
fn a_region_outside_is_refused_in_words() {
    let (blob, frames) = (networks::network(&DENSE, 1), networks::frames(&DENSE, 1, 1));
    for (row, col, rows, cols) in [(24, 0, 1, 1), (0, 30, 2, 7), (3, 3, 0, 4), (65535, 0, 65535, 1)] {
        let work = RunRequest { frames: &frames, scope: Region { row, col, rows, cols }.into() };
        let error = run(&Runtime::Host(LoopbackConfig::default()), &blob, work, None, &mut |_| {}).unwrap_err();
        assert!(matches!(error, DeviceError::Refused(_)), "{error:?}");
        let text = error.to_string();
        assert!(text.contains("must lie in the 24 x 36 pixels"), "{text}");
        assert!(reference(&blob, work).is_err());
    }
}

fn on_this_machine(shape: &Shape, seed: u64, work: RunRequest<'_>) -> DeviceRun {
    run(&Runtime::Host(LoopbackConfig::default()), &networks::network(shape, seed), work, None, &mut |_| {}).unwrap()
}

/// The same frame several times: the held statistics are those that would be measured.
#[test]
fn a_region_held_from_its_own_frame_is_the_cut_of_the_whole() {
    for (seed, shape) in (40..).zip(shapes()) {
        let frames = vec![networks::frames(&shape, 1, seed).remove(0); 3];
        let whole = reference(&networks::network(&shape, seed), frames[..1].into()).unwrap();
        for region in regions(&shape) {
            let device = on_this_machine(
                &shape,
                seed,
                RunRequest { frames: &frames, scope: Scope { hold: 2, ..region.into() } },
            );
            let reports: Vec<_> = device.reports.iter().map(|report| (report.field_id, report.field_age)).collect();
            assert_eq!(reports, [(1, 0), (1, 1), (1, 2)]);
            let expected = networks::cut(&whole[0], &shape, region);
            assert!(device.objects.iter().all(|object| *object == expected), "{region} of {shape:?}");
            assert!(device.deviation.unwrap().worst_db > 150.0);
        }
    }
}

#[test]
fn a_region_held_from_another_frame_says_so_and_agrees_bit_for_bit() {
    let (mut different, mut tried) = (0, 0);
    for (seed, shape) in (60..).zip(shapes()) {
        let frames = networks::frames(&shape, 5, seed);
        for region in regions(&shape) {
            let device = on_this_machine(
                &shape,
                seed,
                RunRequest { frames: &frames, scope: Scope { hold: 2, ..region.into() } },
            );
            assert_eq!(device.differing_bits, 0);
            let reports: Vec<_> = device.reports.iter().map(|report| (report.field_id, report.field_age)).collect();
            assert_eq!(reports, [(1, 0), (1, 1), (1, 2), (4, 0), (4, 1)], "{region} of {shape:?}");
            assert_eq!(device.telemetry.held_runs, 3);
            let exact =
                reference(&networks::network(&shape, seed), RunRequest { frames: &frames, scope: region.into() });
            let exact = exact.unwrap();
            assert_eq!([&device.objects[0], &device.objects[3]], [&exact[0], &exact[3]]);
            (different, tried) = (different + usize::from(device.objects[1] != exact[1]), tried + 1);
        }
    }
    assert!(2 * different > tried, "statistics that do nothing would pass: {different} of {tried}");
}

/// Statistics are held only for the same network and in the same conversation.
#[test]
fn another_network_and_another_conversation_begin_with_nothing_held() {
    let blobs = [1, 2].map(|seed| networks::network(&DENSE, seed));
    let frame = networks::frames(&DENSE, 1, 1).remove(0);
    let scope = Scope { hold: 9, ..Region { row: 5, col: 6, rows: 3, cols: 4 }.into() };
    let (mut client, _) = Client::connect(Loopback::start(LoopbackConfig::default()).unwrap()).unwrap();
    let mut id = 0;
    let mut age = |client: &mut Client<Loopback>, scope: Scope| {
        id += 1;
        client.send_frame(&frame).unwrap();
        client.reconstruct(id, scope).unwrap().field_age
    };
    for blob in blobs {
        client.send_blob(blob.bytes(), &mut |_| {}).unwrap();
        assert_eq!([(); 3].map(|()| age(&mut client, scope)), [0, 1, 2]);
    }
    client.hello().unwrap();
    assert_eq!([(); 2].map(|()| age(&mut client, scope)), [0, 1]);
    assert_eq!([(); 2].map(|()| age(&mut client, Scope { hold: 0, ..scope })), [0; 2], "exact when asked for");
    assert_eq!(age(&mut client, Scope { region: None, ..scope }), 1, "the statistics are those of any exact run");
    // The same request is run once; with another `hold` it is another run.
    client.send_frame(&frame).unwrap();
    let ages = [9, 9, 0].map(|hold| client.reconstruct(100, Scope { hold, ..scope }).unwrap().field_age);
    assert_eq!(ages, [2, 2, 0]);
}
