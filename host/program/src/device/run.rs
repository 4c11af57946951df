//! Sends a network and frames to a device and compares its reconstructions bit by bit with the host's.

use super::client::Client;
use super::counter::Counter;
use super::emulator::Emulator;
use super::error::DeviceError;
use super::flash;
use super::runtime::{Place, Runtime};
use super::scope::{Deviation, Scope};
use super::transport::Transport;
use half::f16;
use ommatidia_network::network_file::NetworkFile;
use ommatidia_shared::pipeline::{HeldRegion, Holder, Memory, Pipeline};
use ommatidia_shared::wire::{RunReport, Telemetry};
use std::path::Path;
use std::time::{Duration, Instant};

/// Frames to reconstruct.
#[derive(Clone, Copy, Debug)]
pub struct RunRequest<'a> {
    /// Raw frames: sensor codes, DN, row by row.
    pub frames: &'a [Vec<u16>],
    /// Which region of each, and whether exactly.
    pub scope: Scope,
}

impl<'a> From<&'a [Vec<u16>]> for RunRequest<'a> {
    /// Whole objects, exactly.
    fn from(frames: &'a [Vec<u16>]) -> Self {
        Self { frames, scope: Scope::default() }
    }
}

/// Reconstructions and figures of a run.
#[derive(Clone, Debug)]
pub struct DeviceRun {
    /// Board, as the device reports it.
    pub board: String,
    /// Where the program ran. On [`Place::Host`] no device took part, and equal bits say nothing about one.
    pub place: Place,
    /// The emulator and its version, if one was used.
    pub emulator: Option<String>,
    /// Reconstructions, row by row.
    pub objects: Vec<Vec<f16>>,
    /// Report of the device on each frame.
    pub reports: Vec<RunReport>,
    /// Bits that differ from the host's reconstructions with the same network and frames.
    pub differing_bits: u64,
    /// Deviation of frames with held statistics from exact ones, which the host computes; `None` if all are exact.
    pub deviation: Option<Deviation>,
    /// Instructions of each reconstruction; `None` if they cannot be counted.
    pub instructions: Option<Vec<u64>>,
    /// Why an emulator did not count the instructions.
    pub uncounted: Option<String>,
    /// Telemetry of the device.
    pub telemetry: Telemetry,
    /// Wall time of sending the network file.
    pub upload: Duration,
    /// Wall time of all frames: sending, reconstructing, fetching.
    pub frames: Duration,
}

impl DeviceRun {
    /// Whether every output bit equals the host's.
    pub fn bit_exact(&self) -> bool {
        self.differing_bits == 0
    }

    /// Memory of the device in use, bytes: variables, the deepest stack, arenas, frame and reconstruction.
    pub fn ram_bytes(&self) -> u64 {
        let t = &self.telemetry;
        let program = [t.static_bytes, t.stack_bytes, t.fast_bytes, t.bulk_bytes, t.frame_bytes, t.object_bytes];
        program.into_iter().map(u64::from).sum()
    }
}

/// Starts a device, uploads the network if it does not run already, reconstructs all frames, and compares them with the
/// host's. The flash of an emulated device is the file `state`. `progress` is called with the share that is done, 0 to
/// 1. An emulator whose instructions cannot be counted runs uncounted.
///
/// # Errors
/// The device cannot be started, refuses a request, or stops answering.
pub fn run(
    runtime: &Runtime,
    blob: &NetworkFile,
    work: RunRequest<'_>,
    state: Option<&Path>,
    progress: &mut dyn FnMut(f64),
) -> Result<DeviceRun, DeviceError> {
    let emulator = match runtime {
        Runtime::Host(_) | Runtime::Serial { .. } => None,
        Runtime::Qemu(_) => Some(Emulator::find()?),
    };
    let mut once = |counter: Option<&Counter>| -> Result<DeviceRun, DeviceError> {
        let (line, run) = converse(runtime.start(counter, state)?, blob, work, progress)?;
        line.wait()?;
        let run = DeviceRun { place: runtime.place(), emulator: emulator.as_ref().map(ToString::to_string), ..run };
        match counter.map(|counter| counts(counter, run.reports.len())).transpose() {
            Ok(instructions) => Ok(DeviceRun { instructions, ..run }),
            Err(why) => Ok(DeviceRun { uncounted: Some(why.to_string()), ..run }),
        }
    };
    let why = match emulator.as_ref().map(Counter::build).transpose() {
        Ok(counter) => match once(counter.as_ref()) {
            // The counter itself may have stopped the emulator.
            Err(why @ DeviceError::Stopped { .. }) if counter.is_some() => why,
            done => return done,
        },
        Err(why) => why,
    };
    once(None).map(|run| DeviceRun { uncounted: Some(why.to_string()), ..run })
}

/// The counts of all reconstructions.
fn counts(counter: &Counter, runs: usize) -> Result<Vec<u64>, DeviceError> {
    let regions = counter.regions()?;
    if regions.len() == runs {
        return Ok(regions);
    }
    Err(DeviceError::Counter { detail: format!("{} counts came for {runs} reconstructions", regions.len()) })
}

/// The whole conversation; gives the line back once the program was asked to end.
fn converse<T: Transport>(
    line: T,
    blob: &NetworkFile,
    work: RunRequest<'_>,
    progress: &mut dyn FnMut(f64),
) -> Result<(T, DeviceRun), DeviceError> {
    let RunRequest { frames, scope } = work;
    let (mut client, info) = Client::connect(line)?;
    // A frame weighs as much as its bytes, the network file as its own.
    let frame_bytes: usize = frames.iter().map(|frame| 2 * frame.len()).sum();
    let total = (blob.bytes().len() + frame_bytes) as f64;
    let start = Instant::now();
    if !flash::runs(&client.telemetry()?, blob) {
        client.send_blob(blob.bytes(), &mut |bytes| progress(bytes as f64 / total))?;
    }
    let upload = start.elapsed();
    let (mut objects, mut reports) = (Vec::new(), Vec::new());
    let mut sent = blob.bytes().len();
    for (id, frame) in (1..).zip(frames) {
        client.send_frame(frame)?;
        let report = client.reconstruct(id, scope)?;
        objects.push(client.fetch(&report)?);
        reports.push(report);
        sent += 2 * frame.len();
        progress(sent as f64 / total);
    }
    let frames_took = start.elapsed() - upload;
    let telemetry = client.telemetry()?;
    let line = client.quit();
    let expected = reference(blob, work)?;
    let differing_bits = differing_bits(&expected, &objects);
    let run = DeviceRun {
        board: info.board.as_str().into(),
        place: Place::Host,
        emulator: None,
        deviation: deviation(blob, work, &objects, &reports)?,
        objects,
        reports,
        differing_bits,
        instructions: None,
        uncounted: None,
        telemetry,
        upload,
        frames: frames_took,
    };
    Ok((line, run))
}

/// The reconstructions that the host computes, without a device: half-precision values, row by row.
///
/// # Errors
/// The network, a frame or the region is refused.
pub fn reference(blob: &NetworkFile, work: RunRequest<'_>) -> Result<Vec<Vec<f16>>, DeviceError> {
    let network = blob.network()?;
    let pipeline = Pipeline::new(&network).map_err(DeviceError::Pipeline)?;
    let mut fast = vec![0.0; pipeline.fast_len_best().max(pipeline.fast_len()) + pipeline.scales_len()];
    let mut bulk = vec![f16::ZERO; pipeline.bulk_len()];
    let Scope { region, hold } = work.scope;
    let region = region.unwrap_or(pipeline.whole());
    let (mut field, mut objects) = (Holder::default(), Vec::with_capacity(work.frames.len()));
    for frame in work.frames {
        let mut object = vec![f16::ZERO; region.pixels()];
        let memory = Memory { fast: &mut fast, bulk: &mut bulk };
        field.run(&pipeline, frame, HeldRegion { region, hold }, memory, &mut object).map_err(DeviceError::Pipeline)?;
        objects.push(object);
    }
    Ok(objects)
}

/// Compares frames with held statistics with exact ones.
fn deviation(
    blob: &NetworkFile,
    work: RunRequest<'_>,
    objects: &[Vec<f16>],
    reports: &[RunReport],
) -> Result<Option<Deviation>, DeviceError> {
    if reports.iter().all(|report| report.field_age == 0) {
        return Ok(None);
    }
    let exact = reference(blob, RunRequest { scope: Scope { hold: 0, ..work.scope }, ..work })?;
    let held = objects.iter().zip(&exact).zip(reports).filter(|(_, report)| report.field_age > 0);
    Ok(Deviation::of(held.map(|((held, exact), _)| (held.as_slice(), exact.as_slice()))))
}

/// Bits in which two stacks of halves differ; halves that only one of them has count in full.
fn differing_bits(a: &[Vec<f16>], b: &[Vec<f16>]) -> u64 {
    let bits = |stack: &[Vec<f16>], i: usize, j: usize| stack.get(i).and_then(|o| o.get(j)).map(|h| h.to_bits());
    let mut differing = 0;
    for i in 0..a.len().max(b.len()) {
        let len = a.get(i).map_or(0, Vec::len).max(b.get(i).map_or(0, Vec::len));
        differing += (0..len)
            .map(|j| match (bits(a, i, j), bits(b, i, j)) {
                (Some(x), Some(y)) => u64::from((x ^ y).count_ones()),
                _ => 16,
            })
            .sum::<u64>();
    }
    differing
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn differing_bits_are_counted() {
        let h = |bits: u16| f16::from_bits(bits);
        assert_eq!(differing_bits(&[vec![h(3), h(0)]], &[vec![h(3), h(0)]]), 0);
        assert_eq!(differing_bits(&[vec![h(3), h(0)]], &[vec![h(0), h(0x8000)]]), 3);
        assert_eq!(differing_bits(&[vec![h(3), h(0)]], &[vec![h(3)]]), 16);
        assert_eq!(differing_bits(&[], &[vec![h(3)]]), 16);
    }
}
