//! `device`: runs the firmware on a board, under QEMU, or its logic in this process.

mod camera;
mod faults;
mod flash;
mod scope;
mod status;
mod stream;
mod target;

use super::common::{Outcome, Run, warn};
use super::files::{Content, Files};
use crate::device::{BoardCounts, DeviceRun, Emulator, Place, RunRequest, count_board, run as run_device, table};
use anyhow::Context;
use clap::Subcommand;
use ndarray::{Array3, Axis};
use ommatidia_network::methods::frame_range;
use ommatidia_network::network_file::NetworkFile;
use ommatidia_physics::sensor::FrameWatch;
use ommatidia_session::artifact::write_whole;
use ommatidia_session::kind::FileKind;
use ommatidia_session::stack;
use ommatidia_shared::boards::{BOARDS, Board};
use ommatidia_shared::image::Region;
use serde_json::json;
use std::path::PathBuf;
use target::Target;

/// Options of `device`.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, Subcommand)]
enum Action {
    /// Reconstruct frames on the device and compare every bit with the host's reconstruction
    #[command(after_help = "Examples:\n  ommatidia device run --with network.omm --frames frames.npy -o \
            objects.npy\n  ommatidia device run --with network.omm --frames frames.npy --roi 32,32,24,24\n  ommatidia \
            device run --with network.omm --frames frames.npy --roi 32,32,24,24 --hold")]
    Run(RunArgs),
    /// Upload a network into the inactive flash slot of the device, commit it, and check that it runs
    #[command(after_help = "Example:\n  ommatidia device flash --with network.omm --state board.flash")]
    Flash(flash::Args),
    /// Stream frames through the device, with a live view in the browser and a recording
    #[command(
        after_help = "Examples:\n  ommatidia device stream --with network.omm --frames frames.npy --fps 2 --view \
            127.0.0.1:8080 -o objects.tif\n  ommatidia device stream --with network.omm --live 100 --fps 30 --every \
            30 --roi 32,32,24,24\n  ommatidia device stream --with network.omm --frames frames.npy --roi 32,32,24,24 \
            --hold 9"
    )]
    Stream(stream::Args),
    /// Print the status of the device: starts, flash slots, faults, dropped frames
    #[command(after_help = "Example:\n  ommatidia device status --state board.flash")]
    Status(status::Args),
    /// Set the camera of the device and its excitation LED, and print what they were really set to
    #[command(
        after_help = "Examples:\n  ommatidia device camera --port /dev/ttyACM0 --exposure-us 10000 --analog-gain \
            2 --led 20\n  ommatidia device camera --port /dev/ttyACM0 --frame-rate 20 --sensor-region \
            26,162,214,214,2\n  ommatidia device camera --on qemu"
    )]
    Camera(camera::Args),
    /// Inject faults (power cuts, flipped bits, a bad line) and report whether networks and frames survive
    #[command(after_help = "Example:\n  ommatidia device faults -o docs/faults.md")]
    Faults(faults::Args),
    /// Count the instructions of each operator on the emulated boards, and the memory of the firmware
    #[command(after_help = "Example:\n  ommatidia device bench -o docs/instructions.md")]
    Bench(BenchArgs),
}

#[derive(Debug, clap::Args)]
struct BenchArgs {
    /// Page to write, Markdown (default: only print the tables)
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Board, by name; repeat the option for more (default: all emulated boards)
    #[arg(long, value_parser = target::boards())]
    board: Vec<Board>,
}

#[derive(Debug, clap::Args)]
struct RunArgs {
    /// Network file of a device, from `ommatidia quantize`
    #[arg(long, value_name = "BLOB")]
    with: PathBuf,
    /// Raw frames, DN: .npy, .tif, .avi, .mat, .zarr, or the folder of a recording
    #[arg(long, value_name = "STACK")]
    frames: PathBuf,
    /// Reconstructions to write: .npy or .tif (default: none are written)
    #[arg(short, long, value_name = "STACK")]
    output: Option<PathBuf>,
    /// Use only the first N frames (default: all)
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    first: Option<u32>,
    #[command(flatten)]
    scope: scope::ScopeArgs,
    #[command(flatten)]
    target: Target,
}

impl Args {
    /// What the verb reads and writes.
    pub fn files(&self) -> Files {
        match &self.action {
            Action::Run(a) => {
                let files = Files::reading([&a.with, &a.frames]).writing(&a.output, Content::File(FileKind::Stack));
                a.target.with_files(files)
            }
            Action::Flash(a) => a.files(),
            Action::Status(a) => a.files(),
            Action::Camera(a) => a.files(),
            Action::Stream(a) => a.files(),
            Action::Faults(a) => a.files(),
            Action::Bench(a) => Files::default().writing(&a.output, Content::Text(table::START)),
        }
    }
}

/// Runs the verb.
///
/// # Errors
/// The device cannot be started or fails, or a file cannot be read or written.
pub fn run(args: &Args, run: &Run) -> anyhow::Result<Outcome> {
    match &args.action {
        Action::Run(args) => run_network(args, run),
        Action::Flash(args) => flash::run(args, run),
        Action::Status(args) => status::run(args, run),
        Action::Camera(args) => camera::run(args, run),
        Action::Stream(args) => stream::run(args, run),
        Action::Faults(args) => faults::run(args),
        Action::Bench(args) => count(args),
    }
}

fn count(args: &BenchArgs) -> anyhow::Result<Outcome> {
    let emulated = BOARDS.into_iter().filter(|board| board.emulated);
    // Before anything is built.
    Emulator::find()?;
    let boards = if args.board.is_empty() { emulated.collect() } else { args.board.clone() };
    let counts = boards.into_iter().map(count_board).collect::<Result<Vec<_>, _>>()?;
    if let Some(path) = &args.output {
        write_whole(path, table::page(&counts)?.as_bytes())?;
    }
    let text: Vec<String> =
        counts.iter().map(|counts| format!("{}\n{}", counts.board.name, table::table(counts))).collect();
    let board = |counts: &BoardCounts| {
        json!({ "board": counts.board.name, "core": counts.board.core, "memory":
        counts.footprint, "operators": counts.operators })
    };
    Ok(Outcome { json: json!({ "boards": counts.iter().map(board).collect::<Vec<_>>() }), text: text.join("\n") })
}

fn run_network(args: &RunArgs, run: &Run) -> anyhow::Result<Outcome> {
    let blob = NetworkFile::read(&args.with)?;
    let header = blob.network()?.into_header();
    let stack = stack::read(&args.frames)?;
    let mut watch = frame_range(&args.with)?.map(FrameWatch::new);
    let count = args.first.map_or(usize::MAX, |n| n as usize);
    let frames = stack
        .axis_iter(Axis(0))
        .take(count)
        .enumerate()
        .inspect(|(i, frame)| watch.iter_mut().for_each(|watch| watch.see(*i, frame.view())))
        .map(|(i, frame)| blob.codes(frame).with_context(|| format!("{}: frame {i}", args.frames.display())))
        .collect::<anyhow::Result<Vec<_>>>()?;
    let warnings = warn(watch.and_then(|watch| watch.warning(&args.frames)));
    let runtime = args.target.runtime(run)?;
    let state = args.target.state.as_deref();
    let work = RunRequest { frames: &frames, scope: args.scope.scope() };
    let bar = run.progress(1000, "device");
    let device = run_device(&runtime, &blob, work, state, &mut |part| bar.set_position((1000.0 * part) as u64))?;
    bar.finish_and_clear();
    let region = args.scope.region(&header);
    if let Some(output) = &args.output {
        stack::write(output, objects(&device, region)?.view())?;
    }
    let mut outcome = outcome(&device, &blob, frames.len());
    outcome.json["warnings"] = json!(warnings);
    Ok(outcome)
}

/// The reconstructions as one stack.
fn objects(device: &DeviceRun, size: Region) -> anyhow::Result<Array3<f32>> {
    let shape = (device.objects.len(), usize::from(size.rows), usize::from(size.cols));
    let values = device.objects.iter().flatten().map(|half| half.to_f32()).collect();
    Array3::from_shape_vec(shape, values).context("a reconstruction does not have the size given in the network file")
}

fn outcome(device: &DeviceRun, blob: &NetworkFile, frames: usize) -> Outcome {
    let t = &device.telemetry;
    let on_host = device.place == Place::Host;
    // What only an image on a board has.
    let measured = |value: u64| (!on_host).then_some(value);
    let flash = measured(u64::from(t.image_bytes) + blob.bytes().len() as u64);
    let ram = measured(device.ram_bytes());
    let ages: Vec<u16> = device.reports.iter().map(|report| report.field_age).collect();
    let held = ages.iter().filter(|&&age| age > 0).count();
    let instructions = device.instructions.as_ref().and_then(|counts| counts.iter().max().copied());
    let of_held = device.instructions.iter().flatten().zip(&ages).filter(|(_, age)| **age > 0);
    let held_instructions = of_held.map(|(count, _)| *count).max();
    let seconds = device.frames.as_secs_f64() / frames.max(1) as f64;
    let json = json!({
        "board": device.board, "ran_on": device.place.name(), "emulator": device.emulator,
        "uncounted": device.uncounted, "frames": frames, "bit_exact": device.bit_exact(),
        "differing_bits": device.differing_bits, "field_ages": ages, "held": held,
        "held_psnr_db": device.deviation.map(|d| json!({ "mean": d.mean_db, "worst": d.worst_db })),
        "instructions": instructions, "held_instructions": held_instructions,
        "ram_bytes": ram, "flash_bytes": flash, "stack_bytes": measured(t.stack_bytes.into()),
        "image_bytes": measured(t.image_bytes.into()), "blob_bytes": blob.bytes().len(),
        "static_bytes": measured(t.static_bytes.into()), "fast_bytes": t.fast_bytes, "bulk_bytes": t.bulk_bytes,
        "frame_bytes": t.frame_bytes, "object_bytes": t.object_bytes,
        "repeated_requests": t.repeated_requests, "dropped_packets": t.dropped_packets,
        "upload_seconds": device.upload.as_secs_f64(), "seconds_per_frame": seconds,
    });
    let board = device.place.board(&device.board);
    let figure = |value: Option<u64>, unit: &str| value.map_or("not measured".into(), |v| format!("{v}{unit}"));
    let verdict = match (device.differing_bits, on_host) {
        (0, false) => "every bit equals the host's".to_string(),
        (0, true) => {
            "not run on a device: the firmware's logic ran on this computer and agrees with itself".to_string()
        }
        (n, _) => format!("{n} bits differ from the host's"),
    };
    let counts = match &device.uncounted {
        Some(why) => format!("not counted: {why}"),
        None => figure(instructions, " per frame"),
    };
    let text = format!(
        "board         {}\nframes        {frames}, {seconds:.2} s each\n\
            agreement     {verdict}\nfield         {}{}\ninstructions  {}{}\nRAM           {}\n\
            flash         {}\nstack         {}\n",
        board + &device.emulator.as_ref().map_or(String::new(), |emulator| format!(" by {emulator}")),
        scope::exactness(held, frames),
        device.deviation.map_or(String::new(), |d| {
            format!(": PSNR {:.1} dB against exact ones, {:.1} dB at worst", d.mean_db, d.worst_db)
        }),
        counts,
        held_instructions.map_or(String::new(), |count| format!(", {count} with the field held")),
        figure(ram, " bytes"),
        figure(flash, " bytes"),
        figure(measured(t.stack_bytes.into()), " bytes"),
    );
    Outcome { json, text }
}
