//! The log over a debug probe, with the feature `probe`; nothing without it.

#[cfg(feature = "probe")]
pub(crate) use probe::*;

#[cfg(not(feature = "probe"))]
pub(crate) use silent::*;

#[cfg(feature = "probe")]
mod probe {
    use crate::start::Start;
    use defmt::{Display2Format, info, warn};
    use ommatidia_shared::wire::{Reply, Request, StartCause};

    /// The program has started.
    pub(crate) fn started(name: &str, start: &Start) {
        match start.cause {
            StartCause::Power => info!("{}: start {}, by power or reset", name, start.count),
            StartCause::Watchdog => warn!("{}: start {}, by the watchdog: the program hung", name, start.count),
            StartCause::Fault => warn!("{}: start {}, after a fault or a panic", name, start.count),
        }
        if start.keeps_faulting {
            warn!("the last starts ended in faults: no network runs until another one is sent");
        }
    }

    /// The host has asked the program to end.
    pub(crate) fn ended() {
        info!("the host has left");
    }

    /// A reconstruction was computed.
    pub(crate) fn computed(cycles: Option<u32>, core_mhz: Option<u16>) {
        if let (Some(cycles), Some(mhz)) = (cycles, core_mhz) {
            info!("computed in {} us", cycles / u32::from(mhz.max(1)));
        }
    }

    /// A request was answered.
    pub(crate) fn answered(request: &Request<'_>, reply: &Reply<'_>) {
        match (request, reply) {
            (_, Reply::Refused(refusal)) => warn!("refused: {}", Display2Format(refusal)),
            (_, Reply::Hello(_)) => info!("a host has connected"),
            (Request::Commit, Reply::Done) => info!("a network was committed, and runs"),
            (_, Reply::Ran(report)) => {
                if let Some(capture) = report.capture {
                    info!(
                        "run {}: frame {}, exposed at {} us for {} us, LED at {} thousandths",
                        report.id,
                        capture.number,
                        capture.start_us,
                        capture.settings.exposure_us,
                        capture.settings.led_permille
                    );
                }
                if report.saturated_px > 0 || !report.filter_finite {
                    warn!(
                        "run {}: {} pixels saturated, filters finite: {}",
                        report.id, report.saturated_px, report.filter_finite
                    );
                }
            }
            (_, Reply::Camera(status)) => {
                let set = status.settings;
                info!(
                    "camera: exposure {} us, gain {} thousandths, a frame in {} us, LED {} thousandths, {} x {} pixels",
                    set.exposure_us,
                    set.analog_gain_thousandths,
                    set.interval_us,
                    set.led_permille,
                    set.region.rows,
                    set.region.cols
                );
            }
            _ => {}
        }
    }

    /// Which chip runs, and how fast.
    #[cfg(all(feature = "nucleo-h743zi", target_os = "none"))]
    pub(crate) fn chip(revision: char, mhz: u16) {
        info!("STM32H743 revision {}: {} MHz", revision, mhz);
    }

    /// The excitation LED was lit for too long, and is dark now.
    #[cfg(all(feature = "nucleo-h743zi", target_os = "none"))]
    pub(crate) fn interlock() {
        warn!("the LED was lit after its exposure: turned off by the interlock");
    }
}

#[cfg(not(feature = "probe"))]
mod silent {
    use crate::start::Start;
    use ommatidia_shared::wire::{Reply, Request};

    pub(crate) fn started(_: &str, _: &Start) {}
    pub(crate) fn ended() {}
    pub(crate) fn computed(_: Option<u32>, _: Option<u16>) {}
    pub(crate) fn answered(_: &Request<'_>, _: &Reply<'_>) {}
    #[cfg(all(feature = "nucleo-h743zi", target_os = "none"))]
    pub(crate) fn chip(_: char, _: u16) {}
    #[cfg(all(feature = "nucleo-h743zi", target_os = "none"))]
    pub(crate) fn interlock() {}
}
