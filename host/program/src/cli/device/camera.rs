//! `device camera`: sets the camera of a device and prints what it was really set to.

use super::target::Target;
use crate::cli::common::{Outcome, Run};
use crate::cli::files::Files;
use crate::device::{DeviceError, Place, camera};
use clap::ValueEnum;
use ommatidia_shared::wire::{CameraChange, CameraSettings, CameraStatus, Limits, SensorRegion, Trigger};
use serde_json::{Value, json};

/// Options of `device camera`.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    #[command(flatten)]
    settings: CameraArgs,
    #[command(flatten)]
    target: Target,
}

/// Settings of a camera. What is not given stays as it is.
#[derive(Clone, Copy, Debug, Default, clap::Args)]
#[command(next_help_heading = "Camera")]
pub(super) struct CameraArgs {
    /// Exposure, us
    #[arg(long, value_name = "US")]
    exposure_us: Option<u32>,
    /// Analogue gain, relative to the smallest of the sensor
    #[arg(long, value_name = "FACTOR", value_parser = thousandths)]
    analog_gain: Option<u32>,
    /// Rate at which the device can start exposures, frames per second
    #[arg(long, value_name = "RATE", value_parser = interval)]
    frame_rate: Option<u32>,
    /// Level of the excitation LED during exposures, percent of its full current. It is dark between exposures, without
    /// a host, and when frames do not come
    #[arg(long, value_name = "PERCENT", value_parser = percent)]
    led: Option<u16>,
    /// Pixels of the array that are read: first row, first column, rows and columns of the frame, and how many rows and
    /// columns of the array make one of the frame (1 if left out)
    #[arg(long, value_name = "ROW,COL,ROWS,COLS[,BIN]", value_parser = region)]
    sensor_region: Option<SensorRegion>,
    /// What starts an exposure
    #[arg(long, value_enum)]
    trigger: Option<On>,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum On {
    /// The clock of the device
    Device,
    /// A pulse at the trigger input of the board
    Input,
}

fn number(text: &str) -> Option<f64> {
    text.parse().ok().filter(|value: &f64| value.is_finite() && *value >= 0.0)
}

fn thousandths(text: &str) -> Result<u32, String> {
    let value = number(text).map(|value| (1000.0 * value).round()).filter(|value| *value < 1e9);
    value.map(|value| value as u32).ok_or_else(|| "expected a factor of 0 or more".into())
}

fn interval(text: &str) -> Result<u32, String> {
    let rate = number(text).filter(|rate| (1e-3..=1e6).contains(rate));
    rate.map(|rate| (1e6 / rate).round() as u32).ok_or_else(|| "expected 0.001 to 1000000 frames a second".into())
}

fn percent(text: &str) -> Result<u16, String> {
    let level = number(text).filter(|level| *level <= 100.0);
    level.map(|level| (10.0 * level).round() as u16).ok_or_else(|| "expected 0 to 100 percent".into())
}

fn region(text: &str) -> Result<SensorRegion, String> {
    let numbers: Vec<u16> = text.split(',').map_while(|number| number.trim().parse().ok()).collect();
    match (numbers.as_slice(), text.split(',').count()) {
        (&[row, col, rows, cols], 4) => Ok(SensorRegion { row, col, rows, cols, bin: 1 }),
        (&[row, col, rows, cols, bin], 5) => Ok(SensorRegion { row, col, rows, cols, bin }),
        _ => Err("expected `ROW,COL,ROWS,COLS` or `ROW,COL,ROWS,COLS,BIN`, pixels".into()),
    }
}

impl CameraArgs {
    /// The settings that are to change.
    pub(super) fn change(self) -> CameraChange {
        CameraChange {
            exposure_us: self.exposure_us,
            analog_gain_thousandths: self.analog_gain,
            interval_us: self.frame_rate,
            led_permille: self.led,
            region: self.sensor_region,
            trigger: self.trigger.map(|trigger| match trigger {
                On::Device => Trigger::Device,
                On::Input => Trigger::Input,
            }),
        }
    }
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
    let (info, status) = camera(&runtime, args.target.state.as_deref(), args.settings.change()).map_err(advised)?;
    let place = runtime.place();
    let mut json = json(&status);
    (json["board"], json["ran_on"]) = (json!(info.board.as_str()), json!(place.name()));
    let mut text = format!("board         {}\n{}", place.board(&info.board), text(&status));
    if place == Place::Emulator {
        text += "note          the settings end with the emulation: give them to `device stream`\n";
    }
    Ok(Outcome { json, text })
}

/// There are no frames to give in place of the camera's.
fn advised(error: DeviceError) -> anyhow::Error {
    match error {
        DeviceError::NoCamera { board } => anyhow::anyhow!("the device has no working camera ({board})"),
        error => error.into(),
    }
}

/// The camera, for programs.
pub(super) fn json(status: &CameraStatus) -> Value {
    let CameraSettings { region, .. } = status.settings;
    let limits = |limits: Limits| json!([limits.least, limits.most]);
    json!({
        "sensor": status.sensor.as_str(), "exposure_us": status.settings.exposure_us,
        "analog_gain": f64::from(status.settings.analog_gain_thousandths) / 1e3,
        "interval_us": status.settings.interval_us, "led": f64::from(status.settings.led_permille) / 1e3,
        "region": { "row": region.row, "col": region.col, "rows": region.rows, "cols": region.cols, "bin": region.bin },
        "trigger": format!("{:?}", status.settings.trigger).to_lowercase(),
        "limits": {
            "array": [status.limits.array_rows, status.limits.array_cols],
            "exposure_us": limits(status.limits.exposure_us),
            "analog_gain_thousandths": limits(status.limits.analog_gain_thousandths),
            "interval_us": limits(status.limits.interval_us),
        },
        "clock_s": status.now_us as f64 / 1e6, "frames": status.frames, "failed_frames": status.failed_frames,
        "led_lit_s": status.lit_us as f64 / 1e6,
    })
}

/// The camera, for people.
pub(super) fn text(status: &CameraStatus) -> String {
    let CameraSettings { exposure_us, analog_gain_thousandths, interval_us, led_permille, region, trigger } =
        status.settings;
    let SensorRegion { row, col, rows, cols, bin } = region;
    let limits = &status.limits;
    let milli = |value: u32| f64::from(value) / 1e3;
    let range = |limits: Limits| format!("{} to {}", limits.least, limits.most);
    format!(
        "sensor        {}, {} x {} pixels\nexposure      {exposure_us} us ({} at this rate and region)\n\
            analogue gain {} ({} to {})\nframe rate    {:.3} a second: one in {interval_us} us ({})\n\
            LED           {:.1} % during exposures; lit for {:.3} s so far\n\
            region        {rows} x {cols} pixels of {bin} x {bin} from row {row}, column {col}\n\
            trigger       {}\nframes        {} exposed, {} of them not delivered\n",
        status.sensor,
        limits.array_rows,
        limits.array_cols,
        range(limits.exposure_us),
        milli(analog_gain_thousandths),
        milli(limits.analog_gain_thousandths.least),
        milli(limits.analog_gain_thousandths.most),
        1e6 / f64::from(interval_us.max(1)),
        range(limits.interval_us),
        f64::from(led_permille) / 10.0,
        status.lit_us as f64 / 1e6,
        match trigger {
            Trigger::Device => "the clock of the device",
            Trigger::Input => "pulses at the trigger input",
        },
        status.frames,
        status.failed_frames,
    )
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Command {
        #[command(flatten)]
        settings: CameraArgs,
    }

    fn change(options: &str) -> Result<CameraChange, String> {
        let words = ["camera"].into_iter().chain(options.split_whitespace());
        let command = Command::try_parse_from(words).map_err(|error| error.to_string())?;
        Ok(command.settings.change())
    }

    #[test]
    fn options_become_the_units_of_the_messages() {
        assert_eq!(change("").unwrap(), CameraChange::default());
        let all = change(
            "--exposure-us 5000 --analog-gain 1.25 --frame-rate 30 --led 12.5 --sensor-region 1,2,80,80,2 --trigger \
             input",
        );
        let region = SensorRegion { row: 1, col: 2, rows: 80, cols: 80, bin: 2 };
        assert_eq!(
            all.unwrap(),
            CameraChange {
                exposure_us: Some(5000),
                analog_gain_thousandths: Some(1250),
                interval_us: Some(33_333),
                led_permille: Some(125),
                region: Some(region),
                trigger: Some(Trigger::Input),
            }
        );
        for wrong in ["--led 101", "--led nan", "--frame-rate 0", "--analog-gain -1", "--sensor-region 1,2,3"] {
            assert!(change(wrong).is_err(), "{wrong}");
        }
    }
}
