//! The firmware under QEMU computes, on every board, the bits that this machine computes.
//!
//! The tests need `qemu-system-arm` and the thumb targets. Where these are missing they are reported as skipped.
#![allow(clippy::unwrap_used)]

mod networks;

use networks::{DENSE, PRUNED, Shape, TAPPED, THIN};
use ommatidia::device::{DeviceError, DeviceRun, Firmware, LoopbackConfig, RunRequest, Runtime, Scope, find_qemu, run};
use ommatidia_network::network_file::NetworkFile;
use ommatidia_shared::boards::{BOARDS, MPS3_AN547};
use ommatidia_shared::device::Footprint;
use ommatidia_shared::image::Region;

/// The firmware for each board. Where QEMU or a target is missing the test counts as skipped; under `cargo verify`,
/// which installs them, it fails.
fn firmware() -> Option<Vec<Firmware>> {
    let boards = BOARDS.into_iter().filter(|board| board.emulated);
    let missing = match boards.map(|board| Firmware::build(board, "app")).collect() {
        Ok(firmware) if find_qemu().is_some() => return Some(firmware),
        Ok(_) => "qemu-system-arm is not on the PATH".to_string(),
        Err(DeviceError::NoFirmware { detail }) => detail,
        Err(error) => panic!("{error}"),
    };
    assert!(std::env::var_os("OMMATIDIA_REQUIRE_QEMU").is_none(), "{missing}");
    ommatidia_tests::skip(std::thread::current().name().unwrap_or("a test"), &missing);
    None
}

/// Runs the network on each board.
fn check(shape: &Shape, seed: u64) -> Option<Vec<DeviceRun>> {
    check_blob(&networks::network(shape, seed), &networks::frames(shape, 2, seed))
}

fn check_blob(blob: &NetworkFile, frames: &[Vec<u16>]) -> Option<Vec<DeviceRun>> {
    let runs = firmware()?.into_iter().map(|firmware| {
        let board = firmware.board().name;
        let device = run(&Runtime::Qemu(firmware), blob, frames.into(), None, &mut |_| {}).unwrap();
        assert_eq!(device.board, board);
        assert_eq!(device.objects.len(), 2);
        assert_eq!(device.differing_bits, 0, "{board}");
        // A network with the same output everywhere would agree by accident.
        let mut values: Vec<u16> = device.objects.iter().flatten().map(|half| half.to_bits()).collect();
        values.sort_unstable();
        values.dedup();
        assert!(values.len() > 50, "only {} different values", values.len());
        device
    });
    Some(runs.collect())
}

#[test]
fn a_dense_network_agrees_bit_for_bit() {
    let plan = networks::header(&DENSE).memory;
    for device in check(&DENSE, 1).into_iter().flatten() {
        let (stack, variables) = (device.telemetry.stack_bytes, device.telemetry.static_bytes);
        assert!(stack > 256, "{:?}", device.telemetry);
        assert!(stack + variables <= Footprint::MOST_RAM, "{:?}", device.telemetry);
        assert!(device.telemetry.image_bytes > 10_000, "{:?}", device.telemetry);
        assert_eq!(device.telemetry.bulk_bytes, plan.bulk_bytes);
        assert!(device.telemetry.fast_bytes >= plan.fast_bytes);
    }
}

#[test]
fn a_tapped_network_agrees_bit_for_bit() {
    check(&TAPPED, 2);
}

#[test]
fn a_pruned_network_agrees_bit_for_bit() {
    check(&PRUNED, 4);
    check(&Shape { tile: 256, step: 256, channels: 1, kernels: Some((4, 300)), ..PRUNED }, 5);
}

#[test]
fn the_thinnest_network_agrees_bit_for_bit() {
    check(&THIN, 3);
}

/// Predictions of frames, and the passes that compare with them: transforms of 32, 64 and 128 with several lenses, more
/// terms than one sum takes, and a region.
#[test]
fn passes_agree_bit_for_bit() {
    let large = Shape { object: [62, 80], frame: [90, 100], tile: 128, step: 128, channels: 1, maps: false, ..DENSE };
    for (shape, passes, terms, seed) in
        [(DENSE, 2, 2, 61), (TAPPED, 3, 5, 62), (PRUNED, 2, 1, 63), (THIN, 2, 3, 64), (large, 2, 4, 65)]
    {
        let blob = networks::network_of(&networks::with_passes(&shape, passes, terms), seed);
        check_blob(&blob, &networks::frames(&shape, 2, seed));
    }
    let Some(boards) = firmware() else { return };
    let blob = networks::network_of(&networks::with_passes(&TAPPED, 2, 3), 66);
    let frames = networks::frames(&TAPPED, 1, 66);
    let region = Region { row: 9, col: 7, rows: 8, cols: 11 };
    for board in &boards {
        let whole = run_on(board, &blob, RunRequest::from(&frames[..]));
        let part = run_on(board, &blob, RunRequest { frames: &frames, scope: region.into() });
        assert_eq!(part.objects[0], networks::cut(&whole.objects[0], &TAPPED, region), "{}", board.board().name);
    }
}

/// The transforms of the device are written in its own instructions, those of this machine in Rust. The test covers
/// every length that a board has room for, and one column and one row more than a block of any loop.
#[test]
fn transforms_of_every_size_agree_bit_for_bit() {
    check(&Shape { tile: 8, step: 4, frame: [13, 11], object: [10, 6], ..THIN }, 8);
    for tile in [128, 256, 512] {
        check(&Shape { tile, step: tile, channels: 1, maps: false, ..DENSE }, u64::from(tile));
    }
}

/// The convolutions of the device are written in its own instructions. The shapes have odd rows, and channels that
/// fill no group; the last features saturate.
#[test]
fn networks_in_integers_agree_bit_for_bit() {
    let odd = Shape { width: 7, object: [30, 46], frame: [53, 47], ..DENSE };
    let wide = Shape { width: 20, channels: 5, ..DENSE };
    for (shape, seed, gain) in [
        (&DENSE, 31, 1.0),
        (&TAPPED, 32, 1.0),
        (&PRUNED, 33, 1.0),
        (&odd, 34, 1.0),
        (&wide, 35, 1.0),
        (&DENSE, 36, 9.0),
    ] {
        let frames = networks::frames(shape, 2, seed);
        for header in [networks::in_integers(shape), networks::in_bytes(shape)] {
            let file = networks::scaled(&header, seed, [1.0, gain, 1.0]);
            check_blob(&file, &frames);
        }
    }
    let Some(boards) = firmware() else { return };
    let file = networks::network_of(&networks::in_integers(&TAPPED), 37);
    let mut frames = networks::frames(&TAPPED, 2, 37);
    frames.insert(0, frames[0].clone());
    let region = Region { row: 9, col: 7, rows: 8, cols: 11 };
    for board in &boards {
        let whole = run_on(board, &file, RunRequest::from(&frames[..1]));
        let exact = run_on(board, &file, RunRequest { frames: &frames[..1], scope: region.into() });
        assert_eq!(exact.objects[0], networks::cut(&whole.objects[0], &TAPPED, region), "{}", board.board().name);
        let held = run_on(board, &file, RunRequest { frames: &frames, scope: Scope { hold: 2, ..region.into() } });
        assert_eq!((held.differing_bits, &held.objects[1]), (0, &exact.objects[0]), "{}", board.board().name);
    }
}

/// Features whose rows do not begin at words, and channels that do not fill a block.
#[test]
fn odd_rows_and_channels_agree_bit_for_bit() {
    check(&Shape { width: 7, object: [30, 46], frame: [53, 47], ..DENSE }, 9);
    check(&Shape { width: 5, object: [22, 26], ..TAPPED }, 10);
}

/// Layers that multiply by some hundred each: features reach the largest half within three layers and stay there, some
/// of each sign.
#[test]
fn features_beyond_the_largest_half_agree_bit_for_bit() {
    for (shape, seed) in [(&DENSE, 21), (&TAPPED, 22)] {
        check_blob(
            &networks::scaled(&networks::header(shape), seed, [1.0, 200.0, 1.0e-4]),
            &networks::frames(shape, 2, seed),
        );
    }
}

/// Filters whose outputs are infinite or NaN: every board takes them as zeros, and says so.
#[test]
fn filters_that_overflow_agree_bit_for_bit() {
    let Some(boards) = firmware() else { return };
    let (file, frames) =
        (networks::scaled(&networks::header(&DENSE), 23, [5.0e4, 1.0, 1.0]), networks::frames(&DENSE, 1, 23));
    for board in &boards {
        let device = run_on(board, &file, RunRequest::from(frames.as_slice()));
        assert_eq!(device.differing_bits, 0, "{}", device.board);
        assert!(device.reports.iter().all(|report| !report.filter_finite), "{}", device.board);
    }
}

/// Helium flushes numbers below 2^-126 to zero. Transforms with such numbers are repeated without it. With a black
/// level of 2e-41 DN every dark pixel is such a number, and some rows hold nothing else.
#[test]
fn numbers_that_helium_flushes_agree_bit_for_bit() {
    let shape = Shape { maps: false, ..DENSE };
    let mut header = networks::header(&shape);
    header.sensor.black_level_dn = 2.0e-41;
    let mut frames = networks::frames(&shape, 2, 11);
    let cols = usize::from(shape.frame[1]);
    for frame in &mut frames {
        for (i, code) in frame.iter_mut().enumerate() {
            *code = if i / cols % 3 == 0 || i % 2 == 0 { 0 } else { *code };
        }
    }
    let (Some(slow), Some(fast)) = (check_blob(&networks::network_of(&header, 11), &frames), check(&shape, 11)) else {
        return;
    };
    for (slow, fast) in slow.iter().zip(&fast).filter(|(device, _)| device.board == MPS3_AN547.name) {
        let (Some(slow), Some(fast)) = (&slow.instructions, &fast.instructions) else { return };
        assert!(slow[0] > fast[0] * 101 / 100, "nothing was done again: {slow:?}, {fast:?}");
    }
}

/// A region that is computed alone is the region cut from the whole.
#[test]
fn regions_agree_bit_for_bit_with_the_whole() {
    let regions = [
        (&DENSE, [Region { row: 9, col: 13, rows: 6, cols: 8 }, Region { row: 0, col: 35, rows: 24, cols: 1 }]),
        (&TAPPED, [Region { row: 30, col: 0, rows: 8, cols: 11 }, Region { row: 17, col: 18, rows: 1, cols: 1 }]),
    ];
    let Some(boards) = firmware() else { return };
    for (shape, regions) in regions {
        let (blob, frames) = (networks::network(shape, 12), networks::frames(shape, 1, 12));
        let whole = run_on(&boards[0], &blob, RunRequest::from(frames.as_slice()));
        for region in regions {
            let expected = networks::cut(&whole.objects[0], shape, region);
            for board in &boards {
                let device = run_on(board, &blob, RunRequest { frames: &frames, scope: region.into() });
                assert_eq!(device.objects[0], expected, "{} {region}", device.board);
                if let (Some(part), Some(all)) = (&device.instructions, &whole.instructions) {
                    assert!(device.board != whole.board || part[0] < all[0], "{region}: {part:?} {all:?}");
                }
            }
        }
    }
}

/// A region whose field is held from an earlier frame. If that frame is equal, it has every bit of the whole; otherwise
/// it has the bits that this machine computes.
#[test]
fn regions_with_a_held_field_agree_bit_for_bit() {
    // So wide and shallow that a region in the middle takes a part of everything.
    const WIDE: Shape = Shape { tile: 16, step: 8, frame: [70, 76], object: [60, 64], ..TAPPED };
    let regions = [
        (&DENSE, Region { row: 9, col: 13, rows: 6, cols: 8 }),
        (&TAPPED, Region { row: 30, col: 0, rows: 8, cols: 11 }),
        (&TAPPED, Region { row: 0, col: 29, rows: 1, cols: 1 }),
        (&WIDE, Region { row: 26, col: 28, rows: 6, cols: 5 }),
    ];
    let Some(boards) = firmware() else { return };
    for (shape, region) in regions {
        let mut frames = networks::frames(shape, 2, 13);
        frames.insert(0, frames[0].clone());
        let scope = Scope { hold: 2, ..region.into() };
        for board in &boards {
            let device = run_on(board, &networks::network(shape, 13), RunRequest { frames: &frames, scope });
            let ages: Vec<u16> = device.reports.iter().map(|report| report.field_age).collect();
            assert_eq!((ages, device.differing_bits), (vec![0, 1, 2], 0), "{} {region}", device.board);
            assert_eq!(device.objects[0], device.objects[1], "{} {region}", device.board);
            assert_ne!(device.objects[1], device.objects[2], "{} {region}", device.board);
            if let (true, Some(counts)) = (shape.object == WIDE.object, &device.instructions) {
                assert!(counts[1] < counts[0] * 2 / 3, "{region}: little was saved: {counts:?}");
            }
        }
    }
}

fn run_on(firmware: &Firmware, blob: &NetworkFile, work: RunRequest<'_>) -> DeviceRun {
    run(&Runtime::Qemu(firmware.clone()), blob, work, None, &mut |_| {}).unwrap()
}

#[test]
fn counts_repeat_exactly() {
    let (Some(first), Some(second)) = (check(&THIN, 4), check(&THIN, 4)) else { return };
    for (first, second) in first.into_iter().zip(second) {
        assert_eq!(first.instructions, second.instructions);
        if let Some(counts) = first.instructions {
            assert_eq!(counts.len(), 2);
            assert!(counts.iter().all(|count| *count > 50_000), "{counts:?}");
        }
    }
}

#[test]
fn the_logic_in_this_process_agrees_bit_for_bit() {
    for (shape, seed) in [(&DENSE, 5), (&TAPPED, 6), (&THIN, 7)] {
        let (blob, frames) = (networks::network(shape, seed), networks::frames(shape, 2, seed));
        let device =
            run(&Runtime::Host(LoopbackConfig::default()), &blob, frames.as_slice().into(), None, &mut |_| {}).unwrap();
        assert_eq!((device.board.as_str(), device.differing_bits), ("host", 0));
    }
}
