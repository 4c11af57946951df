//! A small network from raw codes to reconstruction, against f64; memory plans; bad input.

extern crate std;

use std::boxed::Box;
use std::string::ToString;
use std::vec;
use std::vec::Vec;

use super::*;
use crate::blob::{
    Bank, BlobError, Header, MemoryPlan, Network, Rcan as RcanShape, Section, Sensor, Size, Tap, Weights,
};
use crate::filter::FilterError;
use crate::image::Region;
use crate::naive::{self, Noise, Tensor, wide};
use crate::nn::rcan;
use crate::num::f16;

const FRAME: Size = Size { rows: 27, cols: 30 };
const OBJECT: Size = Size { rows: 14, cols: 12 };
const RCAN: RcanShape = RcanShape { width: 8, groups: 2, blocks: 2, reduction: 4 };
const TILE: usize = 32;

/// Roundings of the filter (6e-4 of its largest output) and of the network (4e-4 of its own) together, twice over.
const TOLERANCE: f64 = 1.5e-3;

pub(super) struct Case {
    pub header: Header,
    spectra: Vec<f16>,
    pub rcan: Vec<f16>,
    pub predictor: Vec<f16>,
    offset: Vec<f16>,
    gain: Vec<f16>,
    pub frame: Vec<u16>,
}

impl Case {
    pub fn new() -> Self {
        let mut noise = Noise(12);
        let pixels = usize::from(FRAME.rows) * usize::from(FRAME.cols);
        let header = Header {
            name: "small".parse().unwrap_or_default(),
            checkpoint: Default::default(),
            frame: FRAME,
            object: OBJECT,
            sensor: Sensor { black_level_dn: 64.5, saturation_dn: 4095, has_offset_map: true, has_gain_map: true },
            bank: Bank {
                tile: TILE as u16,
                step: TILE as u16,
                channels: 2,
                taps: (0..2).map(|channel| Tap { channel, dy: 0, dx: 0 }).collect(),
                blocks: None,
            },
            rcan: RCAN,
            memory: MemoryPlan { fast_bytes: 0, bulk_bytes: 0 },
            integers: None,
            passes: None,
            watch: None,
        };
        let header = Header { memory: Pipeline::plan(&header).unwrap(), ..header };
        let gain = noise.halves(pixels, 0.1).into_iter().map(|x| f16::from_f32(1.0 + x.to_f32())).collect();
        Self {
            spectra: noise.halves(2 * 2 * TILE * (TILE / 2 + 1), 0.5),
            rcan: noise.halves(rcan::weights_len(&RCAN, 2), 0.2),
            predictor: Vec::new(),
            offset: noise.halves(pixels, 4.0),
            gain,
            frame: (0..pixels).map(|_| (600.0 + 550.0 * noise.next()) as u16).collect(),
            header,
        }
    }

    fn weights(&self) -> Weights<'_> {
        let (offset_dn, inverse_gain) = (Some(self.offset.as_slice()), Some(self.gain.as_slice()));
        Weights {
            filters: &self.spectra,
            index: &[],
            rcan: &self.rcan,
            offset_dn,
            inverse_gain,
            convolutions: None,
            predictor: &self.predictor,
            watch: Default::default(),
        }
    }

    pub fn network(&self) -> Result<Network<'_>, BlobError> {
        Network::new(self.header.clone(), self.weights())
    }

    /// The network lives as long as the test program.
    pub fn pipeline(&self) -> Pipeline<'_> {
        Pipeline::new(Box::leak(Box::new(self.network().unwrap()))).unwrap()
    }

    /// Runs with so much more memory than planned, all of it dirty, with guards behind.
    pub fn run(&self, more_fast: usize, more_bulk: usize) -> (Vec<f16>, Stats) {
        let pipeline = self.pipeline();
        let (fast_len, bulk_len) = (pipeline.fast_len() + more_fast, pipeline.bulk_len() + more_bulk);
        let (mut fast, mut bulk) = (vec![f32::NAN; fast_len + 4], vec![f16::NAN; bulk_len + 4]);
        let mut output = vec![f16::NAN; pipeline.output_len()];
        let memory = Memory { fast: &mut fast[..fast_len], bulk: &mut bulk[..bulk_len] };
        let stats = pipeline.run(&self.frame, memory, &mut output).unwrap();
        assert!(fast[fast_len..].iter().all(|x| x.is_nan()) && bulk[bulk_len..].iter().all(|x| x.is_nan()));
        (output, stats)
    }

    /// The corrected frame, DN.
    pub fn corrected(&self) -> Vec<f64> {
        let (offset, gain) = (wide(&self.offset), wide(&self.gain));
        let correct = |(i, &code): (usize, &u16)| (f64::from(code) - 64.5 - offset[i]) * gain[i];
        self.frame.iter().enumerate().map(correct).collect()
    }

    /// The filter outputs of a frame.
    pub fn filtered(&self, frame: &[f64]) -> Vec<f64> {
        let mut plane = vec![[0.0, 0.0]; TILE * TILE];
        for (i, x) in frame.iter().enumerate() {
            plane[((TILE - 27) / 2 + i / 30) * TILE + (TILE - 30) / 2 + i % 30][0] = *x;
        }
        let plane = crate::fft::naive::dft2(&plane, TILE, false);
        self.spectra.chunks(TILE * (TILE + 2)).flat_map(|k| filter(&plane, &wide(k))).collect()
    }

    /// The whole way in f64: frame maximum, filter maximum, reconstruction.
    fn expected(&self) -> (f64, f64, Tensor) {
        let (maxima, out) = self.expected_with(None, &mut |own| own);
        (maxima[0], maxima[1], out)
    }

    /// The same divided by maxima of another frame; `choose` says which scales are used.
    fn expected_with(
        &self,
        held: Option<[f64; 2]>,
        choose: &mut dyn FnMut(Vec<f64>) -> Vec<f64>,
    ) -> ([f64; 2], Tensor) {
        let x = self.corrected();
        let frame_max = held.map_or(x.iter().copied().fold(f64::MIN, f64::max), |held| held[0]);
        let x: Vec<f64> = x.into_iter().map(|x| x / frame_max).collect();
        let channels = self.filtered(&x);
        let filter_max = held.map_or(channels.iter().copied().fold(f64::MIN, f64::max), |held| held[1]);
        let x = Tensor::new([2, 14, 12], channels).map(|x| x / filter_max);
        ([frame_max, filter_max], naive::rcan_with(&x, [2, 2, 8, 2], &wide(&self.rcan), choose))
    }
}

/// `irfft2(plane k)`, object crop. The full spectrum follows from the half as numpy's irfft2 reads it: rows are
/// transformed back with the columns left of T/2 mirrored, and the imaginary parts of columns 0 and T/2 dropped.
fn filter(plane: &[[f64; 2]], k: &[f64]) -> Vec<f64> {
    let width = TILE / 2 + 1;
    let mut columns = vec![[0.0, 0.0]; TILE * TILE];
    for c in 0..width {
        let product: Vec<[f64; 2]> = (0..TILE)
            .map(|r| {
                let (k, x) = (&k[2 * (r * width + c)..][..2], plane[r * TILE + c]);
                [k[0] * x[0] - k[1] * x[1], k[0] * x[1] + k[1] * x[0]]
            })
            .collect();
        for (r, value) in crate::fft::naive::dft(&product, true).into_iter().enumerate() {
            columns[r * TILE + c] = if c == 0 || c == TILE / 2 { [value[0], 0.0] } else { value };
            columns[r * TILE + (TILE - c) % TILE] = [columns[r * TILE + c][0], -columns[r * TILE + c][1]];
        }
    }
    let rows: Vec<[f64; 2]> = columns.chunks(TILE).flat_map(|row| crate::fft::naive::dft(row, true)).collect();
    let at = |i: usize| rows[((TILE - 14) / 2 + i / 12) * TILE + (TILE - 12) / 2 + i % 12][0];
    (0..14 * 12).map(|i| at(i) / (TILE * TILE) as f64).collect()
}

#[test]
fn a_small_network_agrees_with_f64() {
    let mut case = Case::new();
    case.frame[7] = 4095;
    let (output, stats) = case.run(0, 0);
    let (frame_max, filter_max, expected) = case.expected();
    let error = naive::error(&output, &expected.data);
    assert!(error < TOLERANCE, "{error:e}");
    let (low, high) = expected.data.iter().fold((1.0_f64, 0.0_f64), |(low, high), &x| (low.min(x), high.max(x)));
    assert!(high - low > 0.1, "a network that does nothing would pass: {low} to {high}");
    assert_eq!(stats.saturated_px, 1);
    assert!((f64::from(stats.frame_max_dn) / frame_max - 1.0).abs() < 1e-6);
    assert!((f64::from(stats.filter_max) / filter_max - 1.0).abs() < 2e-3 && stats.filter_finite);
}

#[test]
fn more_memory_does_not_change_a_bit() {
    let case = Case::new();
    let reference = case.run(0, 0);
    let best = case.pipeline().fast_len_best();
    for (more_fast, more_bulk) in [(1, 1), (100, 0), (777, 33), (best, 5000)] {
        assert_eq!(case.run(more_fast, more_bulk), reference, "{more_fast} {more_bulk}");
    }
}

#[test]
fn a_frame_without_light_is_a_frame_of_zeros() {
    let mut case = Case::new();
    case.frame.fill(10);
    let dark = case.run(0, 0);
    assert!(dark.1.frame_max_dn < 0.0);
    assert_eq!(dark.1.filter_max, 0.0);
    case.frame.fill(11);
    assert_eq!(case.run(0, 0).0, dark.0);
    let expected = naive::rcan(&Tensor::new([2, 14, 12], vec![0.0; 336]), [2, 2, 8, 2], &wide(&case.rcan));
    assert!(naive::error(&dark.0, &expected.data) < TOLERANCE);
}

#[test]
fn filters_that_overflow_are_reported_and_give_zeros() {
    let mut case = Case::new();
    case.spectra.fill(f16::MAX);
    let (output, stats) = case.run(0, 0);
    assert!(!stats.filter_finite);
    assert!(output.iter().all(|x| x.is_finite()));
}

#[test]
fn the_scale_of_the_spectra_does_not_matter() {
    let mut case = Case::new();
    let reference = case.run(0, 0).0;
    case.spectra.iter_mut().for_each(|k| *k = f16::from_f32(k.to_f32() * 4.0));
    assert_eq!(case.run(0, 0).0, reference);
}

#[test]
fn wrong_lengths_are_refused_and_nothing_is_written() {
    let case = Case::new();
    let pipeline = case.pipeline();
    let (mut fast, mut bulk) = (vec![0.0; pipeline.fast_len()], vec![f16::ZERO; pipeline.bulk_len()]);
    let mut output = vec![f16::ONE; 168];
    let mut attempt = |frame: &[u16], fast: &mut [f32], bulk: &mut [f16], len: usize| {
        let error = pipeline.run(frame, Memory { fast, bulk }, &mut output[..len]).unwrap_err();
        assert!(output.iter().all(|&x| x == f16::ONE));
        error
    };
    let error = attempt(&case.frame[1..], &mut fast, &mut bulk, 168);
    assert_eq!(error, PipelineError::Frame { expected: 810, found: 809 });
    let error = attempt(&case.frame, &mut fast, &mut bulk, 167);
    assert_eq!(error, PipelineError::Output { expected: 168, found: 167 });
    let error = attempt(&case.frame, &mut fast[3..], &mut bulk, 168);
    assert!(error.to_string().contains("(12 missing)"), "{error}");
    let error = attempt(&case.frame, &mut fast, &mut bulk[5..], 168);
    assert!(error.to_string().contains("(10 missing)"), "{error}");
}

#[test]
fn bad_headers_are_refused_by_field() {
    let case = Case::new();
    let refuse = |change: fn(&mut Header)| {
        let mut header = case.header.clone();
        change(&mut header);
        Pipeline::plan(&header).unwrap_err()
    };
    for (change, name) in [
        ((|h| h.frame.rows = 0) as fn(&mut Header), "frame.rows"),
        (|h| h.frame.cols = 5000, "frame.cols"),
        (|h| h.object.rows = 13, "object.rows"),
        (|h| h.object.cols = 0, "object.cols"),
        (|h| h.rcan.width = 0, "rcan.width"),
        (|h| h.rcan.width = 64, "rcan.width"),
        (|h| h.rcan.reduction = 0, "rcan.reduction"),
        (|h| h.rcan.reduction = 3, "rcan.reduction"),
        (|h| h.bank.channels = 0, "bank.channels"),
        (|h| h.sensor.black_level_dn = f32::NAN, "sensor.black_level_dn"),
    ] {
        assert!(refuse(change).to_string().starts_with(name), "{name}: {}", refuse(change));
    }
    assert_eq!(refuse(|h| h.bank.step = 0), PipelineError::Filter(FilterError::Step { tile: TILE as u16, step: 0 }));
    let mut case = case;
    case.header.memory.fast_bytes -= 4;
    let refused = Pipeline::new(&case.network().unwrap()).map(|_| ()).unwrap_err();
    assert!(matches!(refused, PipelineError::Plan { .. }));
}

#[test]
fn weights_of_another_length_are_refused_by_section() {
    let refuse = |change: fn(&mut Case)| {
        let mut case = Case::new();
        change(&mut case);
        case.network().map(|_| ()).unwrap_err()
    };
    let length = |section, expected, found| BlobError::SectionLength { section, expected, found };
    let rcan = refuse(|case| case.header.rcan.blocks = 3);
    assert!(matches!(rcan, BlobError::SectionLength { section: Section::Rcan, .. }));
    assert_eq!(refuse(|case| case.header.sensor.has_gain_map = false), length(Section::InverseGain, 0, 810));
    assert_eq!(refuse(|case| case.spectra.truncate(2175)), length(Section::Filters, 2176, 2175));
}

#[test]
fn weights_that_are_not_finite_are_refused_by_place() {
    let refuse = |change: fn(&mut Case)| {
        let mut case = Case::new();
        change(&mut case);
        case.network().map(|_| ()).unwrap_err()
    };
    let at = |section, index| BlobError::NonFinite { section, index };
    assert_eq!(refuse(|case| case.spectra[9] = f16::NAN), at(Section::Filters, 9));
    assert_eq!(refuse(|case| case.rcan[100] = f16::INFINITY), at(Section::Rcan, 100));
    assert_eq!(refuse(|case| case.offset[0] = f16::NEG_INFINITY), at(Section::Offset, 0));
    assert_eq!(refuse(|case| case.gain[809] = f16::NAN), at(Section::InverseGain, 809));
}

/// A network on a frame so large that a region is computed from a part of everything.
fn wide_case() -> Case {
    let mut noise = Noise(14);
    let mut case = Case::new();
    let (frame, object) = (Size { rows: 60, cols: 63 }, Size { rows: 50, cols: 52 });
    let bank = Bank {
        tile: 32,
        step: 16,
        channels: 2,
        taps: (0..2).flat_map(|channel| [-1, 1].map(|dy| Tap { channel, dy, dx: 0 })).collect(),
        blocks: None,
    };
    let rcan = RcanShape { width: 4, groups: 1, blocks: 1, reduction: 2 };
    let mut header = Header { frame, object, bank, rcan, ..case.header.clone() };
    header.memory = Pipeline::plan(&header).unwrap();
    let pixels = 60 * 63;
    case.offset = noise.halves(pixels, 4.0);
    case.gain = vec![f16::ONE; pixels];
    case.spectra = noise.halves(4 * 2 * 32 * 17, 0.5);
    case.rcan = noise.halves(rcan::weights_len(&rcan, 2), 0.4);
    case.frame = (0..pixels).map(|_| (600.0 + 500.0 * noise.next()) as u16).collect();
    case.header = header;
    case
}

pub(super) fn run_with(
    case: &Case,
    frame: &[u16],
    region: Region,
    field: Field<'_>,
) -> Result<(Vec<f16>, Stats), PipelineError> {
    let pipeline = case.pipeline();
    let (mut fast, mut bulk) = (vec![f32::NAN; pipeline.fast_len()], vec![f16::NAN; pipeline.bulk_len()]);
    let mut output = vec![f16::NAN; region.pixels()];
    let stats = pipeline.run_with(frame, region, field, Memory { fast: &mut fast, bulk: &mut bulk }, &mut output)?;
    Ok((output, stats))
}

#[test]
fn a_region_held_from_its_own_frame_has_every_bit() {
    let case = wide_case();
    let mut scales = vec![f32::NAN; case.pipeline().scales_len()];
    for [row, col, rows, cols] in [[0, 0, 50, 52], [20, 22, 9, 8], [0, 51, 50, 1], [49, 0, 1, 1], [17, 16, 16, 17]] {
        let region = Region { row, col, rows, cols };
        let (exact, stats) = run_with(&case, &case.frame, region, Field::Measured(Some(&mut scales))).unwrap();
        let (held, seen) = run_with(&case, &case.frame, region, Field::Held(stats, &scales)).unwrap();
        assert_eq!(held, exact, "{region}");
        assert_eq!((seen.saturated_px, seen.frame_max_dn), (stats.saturated_px, stats.frame_max_dn));
        assert!(seen.filter_max <= stats.filter_max);
    }
}

#[test]
fn every_region_held_from_another_frame_is_a_cut_of_the_whole_so_computed() {
    let case = wide_case();
    let mut scales = vec![f32::NAN; case.pipeline().scales_len()];
    let whole = case.pipeline().whole();
    let (_, stats) = run_with(&case, &case.frame, whole, Field::Measured(Some(&mut scales))).unwrap();
    let now: Vec<u16> = case.frame.iter().rev().map(|code| code / 4 * 3).collect();
    let (all, _) = run_with(&case, &now, whole, Field::Held(stats, &scales)).unwrap();
    let (exact, _) = run_with(&case, &now, whole, Field::Measured(None)).unwrap();
    assert_ne!(all, exact, "statistics that do nothing would pass");
    for (row, rows) in [(0, 1), (0, 7), (15, 1), (16, 3), (20, 25), (49, 1)] {
        for (col, cols) in [(0, 1), (0, 52), (31, 2), (40, 12), (51, 1)] {
            let region = Region { row, col, rows, cols };
            let [rows, cols] = region.ranges();
            let expected: Vec<f16> = rows.flat_map(|r| &all[r * 52..][cols.clone()]).copied().collect();
            assert_eq!(run_with(&case, &now, region, Field::Held(stats, &scales)).unwrap().0, expected, "{region}");
        }
    }
}

#[test]
fn what_is_held_from_another_frame_agrees_with_f64() {
    let (before, mut now) = (Case::new(), Case::new());
    now.frame.iter_mut().for_each(|code| *code = 64 + (*code).rotate_left(2) % 700);
    let whole = before.pipeline().whole();
    let mut scales = vec![f32::NAN; before.pipeline().scales_len()];
    let (_, stats) = run_with(&before, &before.frame, whole, Field::Measured(Some(&mut scales))).unwrap();
    let mut written = Vec::new();
    let (maxima, _) = before.expected_with(None, &mut |own| {
        written.extend(own.iter().copied());
        own
    });
    let mut blocks = written.chunks(8);
    let (_, expected) = now.expected_with(Some(maxima), &mut |_| blocks.next().unwrap().to_vec());
    let (_, own) = now.expected_with(None, &mut |own| own);
    let found = run_with(&before, &now.frame, whole, Field::Held(stats, &scales)).unwrap().0;
    assert!(naive::error(&found, &expected.data) < TOLERANCE, "{:e}", naive::error(&found, &expected.data));
    assert!(naive::error(&found, &own.data) > 4.0 * TOLERANCE, "statistics that do nothing would pass");
}

#[test]
fn what_is_held_must_fit() {
    let case = wide_case();
    let (region, mut scales) = (Region { row: 3, col: 4, rows: 5, cols: 6 }, vec![0.0; 4]);
    let (_, stats) = run_with(&case, &case.frame, region, Field::Measured(Some(&mut scales))).unwrap();
    let run = |frame: &[u16], field: Field<'_>| run_with(&case, frame, region, field).map(|_| ());
    assert_eq!(run(&case.frame, Field::Held(stats, &scales)), Ok(()));
    let another = PipelineError::Scales { expected: 4, found: 3 };
    assert_eq!(run(&case.frame, Field::Held(stats, &scales[1..])), Err(another));
    assert_eq!(run(&case.frame, Field::Measured(Some(&mut [0.0; 3]))), Err(another));
    let dark = Stats { frame_max_dn: 0.0, ..stats };
    assert_eq!(run(&case.frame, Field::Held(dark, &scales)), Err(PipelineError::NothingHeld));
    let bright: Vec<u16> = case.frame.iter().map(|code| 3 * code).collect();
    let dim: Vec<u16> = case.frame.iter().map(|code| 64 + code / 4).collect();
    let faint = Stats { filter_max: stats.filter_max / 100.0, ..stats };
    assert_eq!(run(&bright, Field::Held(stats, &scales)), Err(PipelineError::Outgrown));
    assert_eq!(run(&dim, Field::Held(stats, &scales)), Err(PipelineError::Outgrown));
    assert_eq!(run(&case.frame, Field::Held(faint, &scales)), Err(PipelineError::Outgrown));
}

/// Checks the age of the statistics of each frame.
#[test]
fn a_holder_measures_when_it_must() {
    let case = wide_case();
    let pipeline = case.pipeline();
    let (mut fast, mut bulk) = (vec![f32::NAN; pipeline.fast_len() + 4], vec![f16::NAN; pipeline.bulk_len()]);
    let region = Region { row: 30, col: 4, rows: 5, cols: 6 };
    let bright: Vec<u16> = case.frame.iter().map(|code| 3 * code).collect();
    let dark = vec![10; case.frame.len()];
    let mut holder = Holder::default();
    let mut age = |frame: &[u16], hold: u16| {
        let (mut output, memory) = (vec![f16::NAN; 30], Memory { fast: &mut fast, bulk: &mut bulk });
        let (stats, age) = holder.run(&pipeline, frame, HeldRegion { region, hold }, memory, &mut output).unwrap();
        if age == 0 {
            let exact = run_with(&case, frame, region, Field::Measured(None)).unwrap();
            assert_eq!((output, stats), exact);
        }
        age
    };
    assert_eq!([(); 5].map(|()| age(&case.frame, 2)), [0, 1, 2, 0, 1], "every third one is exact");
    assert_eq!(
        [0, 1, 1, 5, 5].map(|hold| age(&case.frame, hold)),
        [0, 1, 0, 1, 2],
        "so is every one that may not be old"
    );
    assert_eq!([&bright, &bright, &case.frame].map(|frame| age(frame, 9)), [0, 1, 0], "another brightness");
    assert_eq!([&dark, &dark, &case.frame].map(|frame| age(frame, 9)), [0, 0, 0], "darkness leaves nothing");
    assert_eq!(age(&case.frame, 9), 1);
    holder.forget();
    let (mut output, memory) = (vec![f16::NAN; 30], Memory { fast: &mut fast, bulk: &mut bulk });
    assert_eq!(holder.run(&pipeline, &case.frame, HeldRegion { region, hold: 9 }, memory, &mut output).unwrap().1, 0);
    let mut short = |hold| {
        let memory = Memory { fast: &mut fast[1..], bulk: &mut bulk };
        holder.run(&pipeline, &case.frame, HeldRegion { region, hold }, memory, &mut output)
    };
    assert_eq!(short(0).unwrap().1, 0);
    assert!(short(1).unwrap_err().to_string().contains("(4 missing)"));
}
