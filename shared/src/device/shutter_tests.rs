//! The state machine of a camera, on a clock that advances only while it waits.
#![allow(clippy::unwrap_used)]

extern crate std;

use super::*;
use crate::device::steps::Steps;
use crate::wire::{CameraLimits, CameraSettings, Limits, SensorRegion, Setting, SettingError};
use core::cell::Cell;
use proptest::prelude::*;
use std::vec::Vec;

/// Time between two questions of the shutter, us.
const TICK_US: u64 = 10;
const READOUT: u64 = 5000;
const REGION: SensorRegion = SensorRegion { row: 0, col: 0, rows: 8, cols: 8, bin: 1 };
const EXPOSURE: Steps = Steps { setting: Setting::Exposure, numer: 55, denom: 2, counts: [1, 2000] };

/// A camera that can be told to fail.
struct Fake {
    now: Cell<u64>,
    settings: CameraSettings,
    /// Level of the LED, and since when.
    led: (u16, u64),
    /// When the LED was lit: from, to.
    lit: Vec<(u64, u64)>,
    began: Option<u64>,
    pulses_us: Option<u64>,
    pulse: u64,
    /// The clock steps back to 0 at the end of this many pauses.
    reset_after: Cell<u32>,
    /// Longest time until an exposure begins, and the time until this one begins, us.
    latency_us: [u32; 2],
    /// No frame comes.
    silent: bool,
    /// The sensor does not respond.
    deaf: bool,
    /// What the sensor is really set to; `None` where it is half set, or has lost it.
    set: Option<CameraSettings>,
}

impl Fake {
    fn new() -> Self {
        let settings = CameraSettings {
            exposure_us: 10_010,
            analog_gain_thousandths: 1000,
            interval_us: 40_000,
            led_permille: 500,
            region: REGION,
            trigger: Trigger::Device,
        };
        let now = Cell::new(1_000_000);
        let (led, lit) = ((0, 0), Vec::new());
        let (began, pulses_us, pulse, reset_after, latency_us) = (None, None, 0, Cell::new(0), [0; 2]);
        Self {
            now,
            settings,
            led,
            lit,
            began,
            pulses_us,
            pulse,
            reset_after,
            latency_us,
            silent: false,
            deaf: false,
            set: Some(settings),
        }
    }

    fn sleep(&self, us: u64) {
        self.now.set(self.now.get() + us);
    }
}

impl Camera for Fake {
    fn sensor(&self) -> &'static str {
        "fake"
    }

    fn settings(&self) -> CameraSettings {
        self.settings
    }

    fn limits(&self) -> CameraLimits {
        let any = Limits { least: 0, most: u32::MAX };
        CameraLimits {
            array_rows: 8,
            array_cols: 8,
            exposure_us: EXPOSURE.limits(),
            analog_gain_thousandths: any,
            interval_us: any,
        }
    }

    fn plan(&self, wanted: CameraSettings) -> Result<CameraSettings, SettingError> {
        Ok(CameraSettings { exposure_us: EXPOSURE.nearest(wanted.exposure_us)?, ..wanted })
    }

    fn apply(&mut self, settings: CameraSettings) -> Result<(), IoError> {
        self.set = None;
        if self.deaf {
            return Err(IoError::Failed);
        }
        (self.settings, self.set) = (settings, Some(settings));
        Ok(())
    }

    fn now_us(&self) -> u64 {
        self.now.get()
    }

    fn latency_us(&self) -> u32 {
        self.latency_us[0]
    }

    fn light(&mut self, permille: u16) {
        if self.led.0 > 0 {
            self.lit.push((self.led.1, self.now.get()));
        }
        self.led = (permille, self.now.get());
    }

    fn triggered(&mut self) -> bool {
        let pulse = self.pulses_us.map_or(0, |every| self.now.get() / every);
        core::mem::replace(&mut self.pulse, pulse) != pulse
    }

    fn expose(&mut self) -> Result<(), IoError> {
        self.began = Some(self.now.get() + u64::from(self.latency_us[1]));
        if self.deaf { Err(IoError::Failed) } else { Ok(()) }
    }

    fn ready(&mut self) -> Result<bool, IoError> {
        let done = self.began.unwrap() + u64::from(self.settings.exposure_us) + READOUT;
        Ok(!self.silent && self.now.get() >= done)
    }

    fn abandon(&mut self) {
        self.began = None;
    }

    fn pause(&self) {
        self.sleep(TICK_US);
        match self.reset_after.get() {
            0 => {}
            1 => {
                self.now.set(0);
                self.reset_after.set(0);
            }
            left => self.reset_after.set(left - 1),
        }
    }
}

fn take(shutter: &mut Shutter, camera: &mut Fake) -> Result<Capture, Refusal> {
    shutter.take(camera, &mut || {})
}

fn status(shutter: &mut Shutter, camera: &mut Fake) -> CameraStatus {
    shutter.change(camera, CameraChange::default(), 64).unwrap()
}

#[test]
fn every_frame_is_exposed_after_it_is_asked_for() {
    let (mut shutter, mut camera) = (Shutter::default(), Fake::new());
    // Frames in a row, frames after a minute, and everything between.
    for pause_us in [0, 0, 0, 39_000, 41_000, 500_000, 60_000_000, 60_000_000, 0] {
        camera.sleep(pause_us);
        let asked = camera.now_us();
        let capture = take(&mut shutter, &mut camera).unwrap();
        assert!(capture.start_us >= asked, "{capture:?}, asked at {asked}");
        assert!(capture.start_us - asked <= 40_000 + TICK_US, "it waits for one place in the grid at most");
        assert_eq!(capture.settings, camera.settings);
    }
}

#[test]
fn frames_that_are_not_taken_are_gaps_in_the_numbers() {
    let (mut shutter, mut camera) = (Shutter::default(), Fake::new());
    let first = take(&mut shutter, &mut camera).unwrap();
    let mut last = first;
    for (pause_us, gap) in [(0, 1), (0, 1), (100_000, 3), (60_000_000, 1501), (0, 1)] {
        camera.sleep(pause_us);
        let next = take(&mut shutter, &mut camera).unwrap();
        assert_eq!(next.number - last.number, gap, "after {pause_us} us");
        let on_grid = first.start_us + u64::from(next.number - first.number) * 40_000;
        assert!(next.start_us.abs_diff(on_grid) <= TICK_US, "{next:?}");
        last = next;
    }
    // Other settings begin another grid; the numbers go on.
    let change = CameraChange { interval_us: Some(50_000), ..CameraChange::default() };
    shutter.change(&mut camera, change, 64).unwrap();
    let next = take(&mut shutter, &mut camera).unwrap();
    assert_eq!(next.number, last.number + 1);
    let after = take(&mut shutter, &mut camera).unwrap();
    assert_eq!((after.number - next.number, (after.start_us - next.start_us) / 1000), (1, 50));
    // A question begins none.
    status(&mut shutter, &mut camera);
    assert_eq!(take(&mut shutter, &mut camera).unwrap().start_us - after.start_us, 50_000);
}

/// A clock that steps back costs the grid or a frame, and never an endless wait in which the watchdog is fed.
#[test]
fn a_clock_that_steps_back_ends_every_wait() {
    let bounded = |shutter: &mut Shutter, camera: &mut Fake| {
        let mut waits = 0;
        shutter.take(camera, &mut || {
            waits += 1;
            assert!(waits < 1_000_000, "an endless wait");
        })
    };
    let (mut shutter, mut camera) = (Shutter::default(), Fake::new());
    camera.sleep(1 << 40);
    let change = CameraChange { interval_us: Some(50_000), ..CameraChange::default() };
    shutter.change(&mut camera, change, 64).unwrap();
    let first = bounded(&mut shutter, &mut camera).unwrap();
    // Between two frames: the numbers go on, on a new grid.
    camera.now.set(5);
    let second = bounded(&mut shutter, &mut camera).unwrap();
    assert_eq!((second.number, second.start_us), (first.number + 1, 5));
    let third = bounded(&mut shutter, &mut camera).unwrap();
    assert_eq!((third.number, third.start_us - 5), (second.number + 1, 50_000));
    // While it waits for the next place, and while it waits for pixels.
    camera.sleep(1 << 40);
    bounded(&mut shutter, &mut camera).unwrap();
    camera.reset_after.set(2);
    bounded(&mut shutter, &mut camera).unwrap();
    camera.sleep(1 << 40);
    camera.silent = true;
    camera.reset_after.set(5100);
    assert!(matches!(bounded(&mut shutter, &mut camera), Err(Refusal::NoFrame { .. })));
    assert_eq!(camera.led.0, 0);
}

#[test]
fn the_led_is_lit_during_exposures_and_dark_without_a_host() {
    let (mut shutter, mut camera) = (Shutter::default(), Fake::new());
    let mut starts = Vec::new();
    for _ in 0..5 {
        starts.push(take(&mut shutter, &mut camera).unwrap().start_us);
        assert_eq!(camera.led.0, 0, "dark when the frame is there");
        camera.sleep(3_600_000_000);
    }
    assert_eq!(camera.lit.len(), 5);
    for (start, (from, to)) in starts.iter().zip(&camera.lit) {
        assert_eq!(from, start);
        assert!((10_010..=10_010 + TICK_US).contains(&(to - from)), "dark before the pixels are read: {}", to - from);
    }
    let lit: u64 = camera.lit.iter().map(|(from, to)| to - from).sum();
    assert_eq!(status(&mut shutter, &mut camera).lit_us, lit);
    // Level 0 lights nothing.
    shutter.change(&mut camera, CameraChange { led_permille: Some(0), ..CameraChange::default() }, 64).unwrap();
    take(&mut shutter, &mut camera).unwrap();
    assert_eq!((camera.lit.len(), status(&mut shutter, &mut camera).lit_us), (5, lit));
}

#[test]
fn the_led_is_lit_to_the_end_of_an_exposure_that_begins_late() {
    let (mut shutter, mut camera) = (Shutter::default(), Fake::new());
    for late_us in [0, 20, 66] {
        camera.latency_us = [66, late_us];
        let start = take(&mut shutter, &mut camera).unwrap().start_us;
        let (from, to) = camera.lit.pop().unwrap();
        let (begins, ends) = (start + u64::from(late_us), start + u64::from(late_us) + 10_010);
        assert!(from <= begins && to >= ends, "lit from {from} to {to} us, exposed from {begins} to {ends} us");
        assert!(to <= start + 10_010 + 66 + TICK_US, "and no longer than that takes at most");
    }
}

#[test]
fn the_led_is_dark_when_frames_stop() {
    let (mut shutter, mut camera) = (Shutter::default(), Fake::new());
    camera.silent = true;
    assert!(matches!(take(&mut shutter, &mut camera), Err(Refusal::NoFrame { waited_ms: 510 })));
    assert_eq!(camera.led.0, 0);
    assert!(camera.lit.iter().all(|(from, to)| to - from <= 10_010 + TICK_US), "{:?}", camera.lit);
    (camera.silent, camera.deaf) = (false, true);
    assert!(matches!(take(&mut shutter, &mut camera), Err(Refusal::NoFrame { waited_ms: 0 })));
    assert_eq!(camera.led.0, 0);
    camera.deaf = false;
    take(&mut shutter, &mut camera).unwrap();
    let status = status(&mut shutter, &mut camera);
    assert_eq!((status.frames, status.failed_frames), (3, 2));
    // Nothing comes later, into the memory of another frame.
    for (silent, deaf) in [(true, false), (false, true)] {
        (camera.silent, camera.deaf) = (silent, deaf);
        take(&mut shutter, &mut camera).unwrap_err();
        assert!(camera.began.is_none());
    }
}

/// No frame is exposed while the sensor is half set, or may have lost its settings.
#[test]
fn a_sensor_that_failed_is_set_again_before_the_next_exposure() {
    let (mut shutter, mut camera) = (Shutter::default(), Fake::new());
    let before = camera.settings;
    let shorter = CameraChange { exposure_us: Some(5005), ..CameraChange::default() };
    // A change that fails: the settings before it are in force, and the sensor gets them before it exposes.
    camera.deaf = true;
    assert_eq!(shutter.change(&mut camera, shorter, 64), Err(Refusal::NoCamera));
    assert!(matches!(take(&mut shutter, &mut camera), Err(Refusal::NoFrame { waited_ms: 0 })));
    assert!(camera.lit.is_empty(), "nothing was exposed");
    camera.deaf = false;
    assert_eq!(take(&mut shutter, &mut camera).unwrap().settings, before);
    assert_eq!(camera.set, Some(before));
    // The same settings are written again where a change to them has failed.
    let same = CameraChange { exposure_us: Some(10_010), ..CameraChange::default() };
    camera.deaf = true;
    assert_eq!(shutter.change(&mut camera, shorter, 64), Err(Refusal::NoCamera));
    camera.deaf = false;
    shutter.change(&mut camera, same, 64).unwrap();
    assert_eq!(camera.set, Some(before));
    // A sensor that was without power has lost its settings, and delivers no frame.
    (camera.silent, camera.set) = (true, None);
    take(&mut shutter, &mut camera).unwrap_err();
    camera.silent = false;
    take(&mut shutter, &mut camera).unwrap();
    assert_eq!(camera.set, Some(before));
}

#[test]
fn a_pulse_starts_an_exposure_and_without_pulses_the_led_stays_dark() {
    let (mut shutter, mut camera) = (Shutter::default(), Fake::new());
    shutter.change(&mut camera, CameraChange { trigger: Some(Trigger::Input), ..CameraChange::default() }, 64).unwrap();
    assert!(matches!(take(&mut shutter, &mut camera), Err(Refusal::NoTrigger { waited_ms: 2000 })));
    assert!(camera.lit.is_empty() && camera.led.0 == 0);
    camera.pulses_us = Some(300_000);
    // A pulse from before the request is none.
    camera.sleep(1_000_000);
    for n in 0..4 {
        let asked = camera.now_us();
        let capture = take(&mut shutter, &mut camera).unwrap();
        assert!(capture.start_us > asked && capture.start_us % 300_000 <= TICK_US, "{capture:?}");
        assert_eq!(capture.number, n);
    }
}

#[test]
fn the_answer_names_what_was_set_and_a_refusal_changes_nothing() {
    let (mut shutter, mut camera) = (Shutter::default(), Fake::new());
    let before = camera.settings;
    let ask = |shutter: &mut Shutter, camera: &mut Fake, exposure_us| {
        shutter.change(camera, CameraChange { exposure_us: Some(exposure_us), ..CameraChange::default() }, 64)
    };
    let error = SettingError { setting: Setting::Exposure, least: 28, most: 55_000, step: 1, found: 60_000 };
    assert_eq!(ask(&mut shutter, &mut camera, 60_000), Err(Refusal::Setting(error)));
    let text = std::format!("{error}");
    assert!(text.contains("60000") && text.contains("28 to 55000"), "{text}");
    assert_eq!(camera.settings, before);
    let set = ask(&mut shutter, &mut camera, 5000).unwrap().settings;
    assert_eq!(set, CameraSettings { exposure_us: 5005, ..before });
    let region = SensorRegion { rows: 9, ..REGION };
    let large = shutter.change(&mut camera, CameraChange { region: Some(region), ..CameraChange::default() }, 64);
    assert_eq!(large, Err(Refusal::NoRoom { what: Transfer::Frame, needed: 144, available: 128 }));
    camera.deaf = true;
    assert_eq!(ask(&mut shutter, &mut camera, 100), Err(Refusal::NoCamera));
    assert_eq!(camera.settings, set);
}

proptest! {
    /// Whatever the host asks for and the sensor does, the LED is dark afterwards, and no exposure is lit for longer
    /// than it takes.
    #[test]
    fn the_led_is_dark_after_any_request(
        steps in prop::collection::vec(
            (0u8..4, 0u64..100_000, 28u32..55_000, 0u16..=1000, any::<[bool; 3]>()), 1..20
        )
    ) {
        let (mut shutter, mut camera) = (Shutter::default(), Fake::new());
        for (kind, pause_us, exposure_us, led_permille, [silent, deaf, input]) in steps {
            camera.sleep(pause_us);
            (camera.silent, camera.deaf) = (silent, deaf);
            let trigger = if input { Trigger::Input } else { Trigger::Device };
            let change = CameraChange {
                exposure_us: Some(exposure_us),
                led_permille: Some(led_permille),
                trigger: Some(trigger),
                ..CameraChange::default()
            };
            if kind == 0 {
                let _ = shutter.change(&mut camera, change, 64);
            } else {
                let _ = take(&mut shutter, &mut camera);
            }
            prop_assert_eq!(camera.led.0, 0);
            let longest = 55_000 + TICK_US;
            prop_assert!(camera.lit.iter().all(|(from, to)| to - from <= longest));
        }
    }
}
