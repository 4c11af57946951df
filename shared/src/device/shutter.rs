//! When frames are exposed, and when the excitation LED is lit.
//!
//! A frame is exposed after it is asked for, never before: no frame is old. The LED is lit from just before an exposure
//! until its end, in [`Shutter::take`] and nowhere else, so it is dark whenever frames are not asked for, as when the
//! host is gone, and whenever they do not come.

use super::io::{Camera, IoError};
use super::refuse::saturated;
use crate::wire::{CameraChange, CameraSettings, CameraStatus, Capture, Refusal, Transfer, Trigger};
use heapless::String;

/// Longest wait for the pixels after an exposure, us.
const READOUT_US: u64 = 500_000;
/// Longest wait for a pulse at the trigger input, us: less than the host waits for an answer. It then asks again.
const TRIGGER_US: u64 = 2_000_000;

/// The grid of frames, and what came of them.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Shutter {
    /// Clock at the start of the grid, us.
    origin_us: u64,
    /// Number of the first frame on the grid.
    first: u32,
    /// Number of the next frame that may be taken.
    next: u32,
    frames: u32,
    failed_frames: u32,
    /// The sensor may have other settings than those in force: it did not take them, or did not deliver a frame. Maybe
    /// it was without power for a moment.
    stale: bool,
    lit_us: u64,
    /// Since when the LED is lit.
    lit_since_us: Option<u64>,
}

impl Shutter {
    /// Changes settings and says what they are now. A change starts a new grid.
    pub fn change(
        &mut self,
        camera: &mut dyn Camera,
        change: CameraChange,
        frame_px: usize,
    ) -> Result<CameraStatus, Refusal> {
        let wanted = change.of(camera.settings());
        if change != CameraChange::default() {
            let (needed, available) = (saturated(wanted.region.pixels().saturating_mul(2)), saturated(2 * frame_px));
            if needed > available {
                return Err(Refusal::NoRoom { what: Transfer::Frame, needed, available });
            }
            let settings = camera.plan(wanted).map_err(Refusal::Setting)?;
            if settings != camera.settings() || self.stale {
                self.apply(camera, settings).map_err(|_| Refusal::NoCamera)?;
                (self.origin_us, self.first) = (camera.now_us(), self.next);
            }
        }
        let mut sensor = String::new();
        for c in camera.sensor().chars() {
            let _cut = sensor.push(c);
        }
        Ok(CameraStatus {
            sensor,
            settings: camera.settings(),
            limits: camera.limits(),
            now_us: camera.now_us(),
            frames: self.frames,
            failed_frames: self.failed_frames,
            lit_us: self.lit_us,
        })
    }

    /// Sets the sensor. Where that fails it may be half set.
    fn apply(&mut self, camera: &mut dyn Camera, settings: CameraSettings) -> Result<(), IoError> {
        self.stale = true;
        camera.apply(settings)?;
        self.stale = false;
        Ok(())
    }

    /// Waits for the next place in the grid, or for a pulse, exposes a frame and waits until it is in memory. `alive`
    /// is called during waits.
    pub fn take(&mut self, camera: &mut dyn Camera, alive: &mut dyn FnMut()) -> Result<Capture, Refusal> {
        let settings = camera.settings();
        if self.stale && self.apply(camera, settings).is_err() {
            return Err(self.fails(camera, camera.now_us()));
        }
        let number = match settings.trigger {
            Trigger::Device => self.wait_for_place(camera, settings.interval_us, alive),
            Trigger::Input => {
                // A pulse from before the request would give an exposure that follows no pulse.
                camera.triggered();
                let began = camera.now_us();
                while !camera.triggered() {
                    let waited = since(camera, began);
                    if waited > TRIGGER_US {
                        return Err(Refusal::NoTrigger { waited_ms: ms(waited) });
                    }
                    alive();
                    camera.pause();
                }
                self.next
            }
        };
        self.next = number.wrapping_add(1);
        self.light(camera, settings.led_permille);
        let start_us = camera.now_us();
        let taken = match camera.expose() {
            Ok(()) => self.wait_for_pixels(camera, start_us, alive),
            Err(error) => Err(error),
        };
        self.light(camera, 0);
        match taken {
            Ok(()) => {
                self.frames = self.frames.wrapping_add(1);
                Ok(Capture { number, start_us, settings })
            }
            Err(_) => {
                camera.abandon();
                Err(self.fails(camera, start_us))
            }
        }
    }

    /// Counts a frame that the sensor does not deliver. It is set again before the next one.
    fn fails(&mut self, camera: &dyn Camera, start_us: u64) -> Refusal {
        self.stale = true;
        self.frames = self.frames.wrapping_add(1);
        self.failed_frames = self.failed_frames.wrapping_add(1);
        Refusal::NoFrame { waited_ms: ms(since(camera, start_us)) }
    }

    /// Waits for the first place in the grid that is not over, and returns its number. That is one interval away at
    /// most unless the clock has stepped back: then a new grid begins.
    fn wait_for_place(&mut self, camera: &dyn Camera, interval_us: u32, alive: &mut dyn FnMut()) -> u32 {
        let interval = u64::from(interval_us.max(1));
        let passed = since(camera, self.origin_us);
        let place = passed.div_ceil(interval).max(self.next.wrapping_sub(self.first).into());
        let due = self.origin_us.saturating_add(place.saturating_mul(interval));
        loop {
            let now = camera.now_us();
            if now >= due {
                return self.first.wrapping_add(place as u32);
            }
            if due - now > interval {
                (self.origin_us, self.first) = (now, self.next);
                return self.next;
            }
            alive();
            camera.pause();
        }
    }

    /// Waits until the frame is in memory. The LED is lit until the exposure has ended, whenever it began.
    fn wait_for_pixels(
        &mut self,
        camera: &mut dyn Camera,
        start_us: u64,
        alive: &mut dyn FnMut(),
    ) -> Result<(), IoError> {
        // The sensor may begin late, and the last part of the exposure needs light as well.
        let lit_us = u64::from(camera.settings().exposure_us) + u64::from(camera.latency_us());
        let mut lit = true;
        loop {
            if camera.ready()? {
                return Ok(());
            }
            let passed = since(camera, start_us);
            if lit && passed >= lit_us {
                self.light(camera, 0);
                lit = false;
            }
            if passed > lit_us + READOUT_US {
                return Err(IoError::Failed);
            }
            alive();
            camera.pause();
        }
    }

    /// Sets the LED, and counts how long it was lit.
    fn light(&mut self, camera: &mut dyn Camera, permille: u16) {
        camera.light(permille);
        let now = camera.now_us();
        if let Some(since) = self.lit_since_us.take() {
            self.lit_us = self.lit_us.saturating_add(now.saturating_sub(since));
        }
        self.lit_since_us = (permille > 0).then_some(now);
    }
}

/// Time since `start_us`. A clock before it has stepped back; any wait is over then, for the watchdog is fed during
/// waits and would not end it.
fn since(camera: &dyn Camera, start_us: u64) -> u64 {
    camera.now_us().checked_sub(start_us).unwrap_or(u64::MAX)
}

fn ms(us: u64) -> u32 {
    u32::try_from(us / 1000).unwrap_or(u32::MAX)
}

#[cfg(test)]
#[path = "shutter_tests.rs"]
mod tests;
