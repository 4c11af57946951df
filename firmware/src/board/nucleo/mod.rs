//! ST NUCLEO-H743ZI2 (ST UM2407): STM32H743ZI at 480 MHz, an MT9V032 on the DCMI, the host at the serial port of the
//! debug probe.
//!
//! | function | pins |
//! |---|---|
//! | DCMI D0 to D9 | PC6, PC7, PE0, PE1, PE4, PD3, PE5, PE6, PC10, PC12 |
//! | DCMI VSYNC, HSYNC, PIXCLK | PG9, PA4, PA6 |
//! | clock of the sensor, 24 MHz (MCO1) | PA8 |
//! | registers of the sensor (I2C1) SCL, SDA | PB8, PB9 |
//! | host (USART3) TX, RX | PD8, PD9 |
//! | trigger (green LED) | PB0 |
//!
//! The data cache stays off, as DMA and flash change memory without it.

mod camera;
mod clock;
mod flash;
mod link;
mod memory;

pub use camera::Camera;
pub use flash::InternalFlash;
pub use link::Link;
pub use memory::footprint;

use crate::app::Parts;
use core::convert::Infallible;
use core::sync::atomic::{AtomicBool, Ordering};
use cortex_m::peripheral::DWT;
use embassy_stm32::gpio::{Level, Output, Speed};
use embassy_stm32::pac::IWDG1;
use embassy_stm32::pac::iwdg::vals::{Key, Pr};
use embassy_stm32::rcc::{
    AHBPrescaler, APBPrescaler, Hse, HseMode, Pll, PllDiv, PllMul, PllPreDiv, PllSource, Sysclk, VoltageScale,
};
use embassy_stm32::time::Hertz;
use embassy_stm32::{Config, pac};
use embedded_hal::digital::{ErrorType, OutputPin};
use ommatidia_shared::boards;
use ommatidia_shared::device::{Arenas, Watchdog};
use ommatidia_shared::wire::StartCause;

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
    let started_by = start_cause();
    let p = embassy_stm32::init(clocks());
    enable_memories();
    let mut core = cortex_m::Peripherals::take()?;
    core.SCB.enable_icache();
    core.DCB.enable_trace();
    core.DWT.enable_cycle_counter();
    clock::begin(core.SYST);
    let watchdog = Dog(());
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
        },
        memory::frames(),
    );
    Some(Parts {
        name: NAME,
        link: Link::new(p.USART3, p.PD9, p.PD8, memory::line_buffers(), watchdog)?,
        line: memory::line(),
        trigger: Trigger(Output::new(p.PB0, Level::Low, Speed::Low)),
        watchdog,
        started_by,
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

/// The clocks: 480 MHz, the maximum at voltage scale 0, from the 8 MHz of the probe (ST UM2407, section 6.8.1).
fn clocks() -> Config {
    let mut config = Config::default();
    let rcc = &mut config.rcc;
    rcc.voltage_scale = VoltageScale::Scale0;
    rcc.hse = Some(Hse { freq: Hertz(8_000_000), mode: HseMode::Bypass });
    rcc.pll1 = Some(Pll {
        source: PllSource::HSE,
        prediv: PllPreDiv::DIV2,
        mul: PllMul::MUL240,
        fracn: None,
        divp: Some(PllDiv::DIV2),
        divq: Some(PllDiv::DIV8),
        divr: None,
    });
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

/// Cause of the last reset. The flags are cleared.
fn start_cause() -> StartCause {
    let hung = pac::RCC.rsr().read().iwdg1rstf();
    pac::RCC.rsr().modify(|w| w.set_rmvf(true));
    if hung { StartCause::Watchdog } else { StartCause::Power }
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

/// Stops until the watchdog resets the board or the probe takes control.
pub fn fail(reason: &dyn core::fmt::Display) -> ! {
    #[cfg(feature = "probe")]
    defmt::error!("{}", defmt::Display2Format(reason));
    #[cfg(not(feature = "probe"))]
    let _ = reason;
    loop {
        cortex_m::asm::nop();
    }
}

#[panic_handler]
fn panic(info: &core::panic::PanicInfo<'_>) -> ! {
    fail(info)
}
