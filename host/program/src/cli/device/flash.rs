//! `device flash`: uploads a network into the flash of a device.

use super::target::Target;
use crate::cli::common::{Outcome, Run};
use crate::cli::files::Files;
use crate::device::flash;
use ommatidia_network::network_file::NetworkFile;
use serde_json::json;
use std::path::PathBuf;

/// Options of `device flash`.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Network file of a device, from `ommatidia quantize`
    #[arg(long, value_name = "BLOB")]
    with: PathBuf,
    #[command(flatten)]
    target: Target,
}

impl Args {
    /// What the verb reads and writes.
    pub(super) fn files(&self) -> Files {
        self.target.with_files(Files::reading([&self.with]))
    }
}

/// Runs the verb.
pub(super) fn run(args: &Args, run: &Run) -> anyhow::Result<Outcome> {
    let blob = NetworkFile::read(&args.with)?;
    let runtime = args.target.runtime(run)?;
    let bar = run.progress(1000, "flash");
    let report =
        flash(&runtime, args.target.state.as_deref(), &blob, &mut |part| bar.set_position((1000.0 * part) as u64))?;
    bar.finish_and_clear();
    let (slot, seconds) = (report.slot, report.took.as_secs_f64());
    let json = json!({
        "board": report.board, "ran_on": runtime.place().name(), "network": report.telemetry.network.as_str(),
        "slot": format!("{:?}", slot.slot),
        "generation": slot.mark.generation, "bytes": slot.mark.len, "crc": format!("{:08x}", slot.mark.crc),
        "uploads": report.attempts, "verified": slot.runs, "seconds": seconds,
    });
    let done = match report.attempts {
        0 => "not needed: the network was there already".to_string(),
        1 => format!("sent in {seconds:.1} s"),
        n => format!("sent in {seconds:.1} s, in attempt {n}"),
    };
    let text = format!(
        "board         {}\nnetwork       {}, {} bytes, CRC {:08x}\nslot          {:?}, generation {}: committed and \
            running\nupload        {done}\n",
        runtime.place().board(&report.board),
        report.telemetry.network,
        slot.mark.len,
        slot.mark.crc,
        slot.slot,
        slot.mark.generation,
    );
    Ok(Outcome { json, text })
}
