//! ST NUCLEO-H743ZI2 (ST UM2407): STM32H743ZI at 480 MHz (400 before revision V), an MT9V032 on the DCMI, the host at
//! the serial port of the debug probe.
//!
//! | function | pins |
//! |---|---|
//! | DCMI D0 to D9 | PC6, PC7, PE0, PE1, PE4, PD3, PE5, PE6, PC10, PC12 |
//! | DCMI VSYNC, HSYNC, PIXCLK | PG9, PA4, PA6 |
//! | clock of the sensor, 24 MHz (MCO1) | PA8 |
//! | registers of the sensor (I2C1) SCL, SDA | PB8, PB9 |
//! | start of an exposure, to EXPOSURE of the sensor | PF12 |
//! | trigger input, a rising edge | PF13 |
//! | level of the excitation LED (DAC1), to the driver that LED_OUT of the sensor enables | PA5 |
//! | host (USART3) TX, RX | PD8, PD9 |
//! | reconstructing (green LED) | PB0 |
//!
//! LED_OUT of the sensor is high during exposures: it is the trigger output as well.
//!
//! The data cache is on, but for the memory that DMA writes; after the flash has changed its lines are dropped.

mod bus;
mod cache;
mod camera;
mod clock;
mod flash;
mod light;
mod link;
mod memory;
mod revision;

pub use camera::Camera;
pub use flash::InternalFlash;
pub use link::Link;
pub use memory::footprint;

use super::{float, guard, restart};
use crate::app::Parts;
use crate::log;
use crate::start::Start;
use core::convert::Infallible;
use core::sync::atomic::{AtomicBool, Ordering};
use cortex_m::peripheral::DWT;
use embassy_stm32::gpio::{Level, Output, Speed};
use embassy_stm32::pac::IWDG1;
use embassy_stm32::pac::iwdg::vals::{Key, Pr};
use embassy_stm32::rcc::{AHBPrescaler, APBPrescaler, Hse, HseMode, Sysclk};
use embassy_stm32::time::Hertz;
use embassy_stm32::{Config, pac};
use embedded_hal::digital::{ErrorType, OutputPin};
use ommatidia_shared::boards;
use ommatidia_shared::device::{Arenas, Watchdog};
use revision::Revision;

/// Name of the board.
pub const NAME: &str = boards::NUCLEO_H743ZI.name;

/// Reload value of the watchdog, in units of 256 / 32 kHz: the longest, 32.8 s (ST RM0433, section 47.3).
const PATIENCE: u16 = 0xfff;

/// The parts of the board. `None` where they were taken before. If no image sensor answers, frames come from the host.
pub fn take() -> Option<Parts<'static, Link, Trigger, InternalFlash, Dog, Camera>> {
    static TAKEN: AtomicBool = AtomicBool::new(false);
    if TAKEN.swap(true, Ordering::Relaxed) {
        return None;
    }
    let start = start();
    // Whatever does not answer from here on, a clock or a sensor, the board starts again.
    let mut watchdog = Dog(());
    watchdog.start();
    if !float::set_mode() {
        fail(&"the floating-point unit does not round as IEEE 754 says");
    }
    let revision = Revision::read();
    let p = embassy_stm32::init(clocks(revision));
    enable_memories();
    let mut core = cortex_m::Peripherals::take()?;
    cache::enable(&mut core);
    core.DCB.enable_trace();
    core.DWT.enable_cycle_counter();
    clock::begin(core.SYST, revision.mhz());
    log::chip(revision.name(), revision.mhz());
    light::begin(p.PA5);
    let camera = Camera::new(
        camera::Pins {
            dcmi: p.DCMI,
            dma: p.DMA1_CH0,
            data: (p.PC6, p.PC7, p.PE0, p.PE1, p.PE4, p.PD3, p.PE5, p.PE6, p.PC10, p.PC12),
            vsync: p.PG9,
            hsync: p.PA4,
            pixclk: p.PA6,
            mco: p.MCO1,
            clock: p.PA8,
            i2c: p.I2C1,
            scl: p.PB8,
            sda: p.PB9,
            expose: p.PF12,
            trigger: p.PF13,
        },
        memory::frames(),
    );
    Some(Parts {
        name: NAME,
        link: Link::new(p.USART3, p.PD9, p.PD8, memory::line_buffers(), watchdog)?,
        line: memory::line(),
        trigger: Trigger(Output::new(p.PB0, Level::Low, Speed::Low)),
        watchdog,
        start,
        core_mhz: Some(revision.mhz()),
        footprint,
        cycles: || Some(DWT::cycle_count()),
        temperature_cdeg: || None,
        activity: clock::activity,
        flash: InternalFlash::new(p.FLASH),
        source: camera,
        object: memory::object(),
        arenas: Arenas { fast: memory::fast(), bulk: memory::bulk() },
    })
}

/// The clocks: the fastest of the revision, from the 8 MHz of the probe (ST UM2407, section 6.8.1).
fn clocks(revision: Revision) -> Config {
    let mut config = Config::default();
    let rcc = &mut config.rcc;
    (rcc.voltage_scale, rcc.pll1) = revision.clock();
    rcc.hse = Some(Hse { freq: Hertz(8_000_000), mode: HseMode::Bypass });
    rcc.sys = Sysclk::PLL1_P;
    rcc.ahb_pre = AHBPrescaler::DIV2;
    rcc.apb1_pre = APBPrescaler::DIV2;
    rcc.apb2_pre = APBPrescaler::DIV2;
    rcc.apb3_pre = APBPrescaler::DIV2;
    rcc.apb4_pre = APBPrescaler::DIV2;
    config
}

/// Enables the clock of the SRAM of the second domain, which is off after a reset (ST RM0433, section 8.7.43).
fn enable_memories() {
    pac::RCC.ahb2enr().modify(|w| {
        w.set_sram1en(true);
        w.set_sram2en(true);
        w.set_sram3en(true);
    });
}

/// How the program was started. The flags of the last reset are cleared. From here on a stack too deep is a fault.
fn start() -> Start {
    guard::begin();
    let hung = pac::RCC.rsr().read().iwdg1rstf();
    pac::RCC.rsr().modify(|w| w.set_rmvf(true));
    restart::begin(hung)
}

/// The independent watchdog. The program feeds it, and so does the serial line while it waits.
#[derive(Clone, Copy)]
pub struct Dog(());

impl Watchdog for Dog {
    fn start(&mut self) {
        IWDG1.kr().write(|w| w.set_key(Key::ENABLE));
        IWDG1.pr().write(|w| w.set_pr(Pr::DIVIDE_BY256));
        IWDG1.rlr().write(|w| w.set_rl(PATIENCE));
        IWDG1.kr().write(|w| w.set_key(Key::START));
    }

    fn feed(&mut self) {
        IWDG1.kr().write(|w| w.set_key(Key::RESET));
    }
}

/// The trigger pin with the green LED, high while a reconstruction is computed.
pub struct Trigger(Output<'static>);

impl ErrorType for Trigger {
    type Error = Infallible;
}

impl OutputPin for Trigger {
    fn set_low(&mut self) -> Result<(), Infallible> {
        self.0.set_low();
        Ok(())
    }

    fn set_high(&mut self) -> Result<(), Infallible> {
        self.0.set_high();
        Ok(())
    }
}

/// Restarts the program, where the host has asked it to end.
pub fn exit() -> ! {
    cortex_m::peripheral::SCB::sys_reset()
}

/// Cycles before a program that has failed is started again: some seconds, in which the probe can take control.
const PAUSE: u32 = 1_000_000_000;

/// Reports the reason to the probe, and starts the program again after a pause.
pub fn fail(reason: &dyn core::fmt::Display) -> ! {
    light::fail();
    #[cfg(feature = "probe")]
    defmt::error!("{}", defmt::Display2Format(reason));
    #[cfg(not(feature = "probe"))]
    let _ = reason;
    cortex_m::asm::delay(PAUSE);
    restart::fault()
}

#[panic_handler]
fn panic(info: &core::panic::PanicInfo<'_>) -> ! {
    fail(info)
}
