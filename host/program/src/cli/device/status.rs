//! `device status`: status of a device.

use super::target::Target;
use crate::cli::common::{Outcome, Run};
use crate::cli::files::Files;
use crate::device::{Place, active_fraction, status, watch_json, watch_text};
use ommatidia_shared::watch::Alarm;
use ommatidia_shared::wire::{Info, SlotReport, Telemetry};
use serde_json::{Value, json};

/// Options of `device status`.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    #[command(flatten)]
    target: Target,
}

impl Args {
    /// What the verb reads and writes.
    pub(super) fn files(&self) -> Files {
        self.target.with_files(Files::default())
    }
}

/// Runs the verb.
pub(super) fn run(args: &Args, run: &Run) -> anyhow::Result<Outcome> {
    let runtime = args.target.runtime(run)?;
    let (info, telemetry) = status(&runtime, args.target.state.as_deref())?;
    let place = runtime.place();
    Ok(Outcome { json: json(place, &info, &telemetry), text: text(place, &info, &telemetry) })
}

fn json(place: Place, info: &Info, t: &Telemetry) -> Value {
    let slot = |slot: &SlotReport| {
        json!({
            "slot": format!("{:?}", slot.slot), "generation": slot.mark.generation, "bytes": slot.mark.len,
            "crc": format!("{:08x}", slot.mark.crc), "runs": slot.runs,
        })
    };
    json!({
        "board": info.board.as_str(), "ran_on": place.name(), "network": t.network.as_str(),
        "slots": t.slots.iter().flatten().map(slot).collect::<Vec<_>>(), "refused_slots": t.refused_slots,
        "slot_bytes": info.blob_bytes, "starts": t.starts, "started_by": format!("{:?}", t.started_by).to_lowercase(),
        "runs": t.runs, "held_runs": t.held_runs, "cycles": t.cycles, "active_fraction": active_fraction(t),
            "camera": info.live, "saturated_px": t.saturated_px, "dropped_frames": t.dropped_frames,
        "temperature_c": t.temperature_cdeg.map(|cdeg| f64::from(cdeg) / 100.0),
        "crc_errors": t.crc_errors, "dropped_packets": t.dropped_packets, "repeated_requests": t.repeated_requests,
        "stack_bytes": t.stack_bytes, "image_bytes": t.image_bytes, "static_bytes": t.static_bytes,
        "core_mhz": t.core_mhz, "watch": watch_json(&t.watch),
    })
}

/// The share of the time since its start that the core was awake, for people.
pub(super) fn active_text(t: &Telemetry) -> String {
    match (active_fraction(t), t.activity) {
        (Some(active), Some(activity)) => {
            format!("{:.1} % of {:.1} s", 100.0 * active, f64::from(activity.total_ms) / 1000.0)
        }
        _ => "not measured".into(),
    }
}

fn text(place: Place, info: &Info, t: &Telemetry) -> String {
    let mut text = format!("board         {}\n", place.board(&info.board));
    let network = if t.network.is_empty() { "none: send one with `ommatidia device flash`" } else { &t.network };
    text += &format!("network       {network}\n");
    for slot in t.slots.iter().flatten() {
        let runs = if slot.runs { ", runs" } else { "" };
        let mark = slot.mark;
        text += &format!(
            "slot {:?}        {} bytes, CRC {:08x}, generation {}{runs}\n",
            slot.slot, mark.len, mark.crc, mark.generation
        );
    }
    if t.refused_slots > 0 {
        text += &format!(
            "refused       {} committed networks at the start: damaged, or of another version\n",
            t.refused_slots
        );
    }
    let known = |value: Option<String>| value.unwrap_or_else(|| "not measured".into());
    text += &format!("starts        {}, the last by {}\n", t.starts, format!("{:?}", t.started_by).to_lowercase());
    text += &format!(
        "runs          {}, {} of them with the field held, {} frames dropped, {} pixels saturated\n",
        t.runs, t.held_runs, t.dropped_frames, t.saturated_px
    );
    text += &format!("core          {}\n", known(t.core_mhz.map(|mhz| format!("{mhz} MHz"))));
    text += &format!("cycles        {}\n", known(t.cycles.map(|cycles| format!("{cycles} in the last run"))));
    text += &format!("awake         {}\n", active_text(t));
    text += &format!("camera        {}\n", if info.live { "yes" } else { "none: the host sends the frames" });
    let since = |alarm: &Alarm| format!("run {}, {} frames ago", alarm.since, alarm.frames);
    if let Some(sentence) = watch_text(&t.watch, since) {
        text += &format!("optics        {sentence}\n");
    }
    text += &format!(
        "temperature   {}\n",
        known(t.temperature_cdeg.map(|cdeg| format!("{:.2} C", f64::from(cdeg) / 100.0)))
    );
    text += &format!(
        "line          {} CRC errors, {} packets dropped, {} requests repeated\n",
        t.crc_errors, t.dropped_packets, t.repeated_requests
    );
    text
}
