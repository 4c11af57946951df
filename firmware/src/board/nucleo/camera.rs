//! The MT9V032 on the DCMI (ST RM0433, chapter 32). The device starts each exposure by a pulse; DMA brings the frame.
#![allow(unsafe_code)] // memory that DMA writes

use super::bus::Bus;
use super::{clock, light};
use crate::camera::mt9v032::ARRAY;
use crate::camera::{ImageSensor, Mt9v032};
use core::slice;
use core::sync::atomic::{Ordering, fence};
use embassy_stm32::dcmi::{self, Dcmi};
use embassy_stm32::gpio::{Input, Level, Output, Pull, Speed};
use embassy_stm32::pac::dma::vals::{Dir, Size};
use embassy_stm32::pac::{self, DMA1, DMAMUX1};
use embassy_stm32::peripherals as p;
use embassy_stm32::rcc::{Mco, Mco1Source, McoConfig, McoPrescaler};
use embassy_stm32::{Peri, bind_interrupts, dma};
use ommatidia_shared::device::{Camera as ImageCamera, FrameSource, IoError, Steps};
use ommatidia_shared::wire::{CameraLimits, CameraSettings, SensorRegion, Setting, SettingError, Trigger};

bind_interrupts!(struct Interrupts {
    DCMI => dcmi::InterruptHandler<p::DCMI>;
    DMA1_STREAM0 => dma::InterruptHandler<p::DMA1_CH0>;
});

type Sensor = Mt9v032<Bus>;

/// The frame after the start: half the resolution, in the middle of the array.
const REGION: SensorRegion = SensorRegion { row: 0, col: 0, rows: 214, cols: 214, bin: 2 }.centred(ARRAY[0], ARRAY[1]);
/// The settings after the start.
const SETTINGS: CameraSettings = CameraSettings {
    exposure_us: 13_200,
    analog_gain_thousandths: 1000,
    interval_us: 40_000,
    led_permille: 0,
    region: REGION,
    trigger: Trigger::Device,
};
/// Level of the excitation LED: the converter has 12 bits.
const LED: Steps = Steps { setting: Setting::Led, numer: 1000, denom: 4095, counts: [0, 4095] };
/// Stream of DMA1, and channel of DMAMUX1, that carries the frames.
const STREAM: usize = 0;
/// Request number of the DCMI at DMAMUX1 (ST RM0433, table 121).
const DMA_REQUEST: u8 = 75;
/// Length of the pulse that starts an exposure, cycles: at least one microsecond.
const PULSE: u32 = 480;
/// Words of two pixels in the memory of frames: two frames of [`REGION`].
pub const WORDS: usize = REGION.pixels();

/// Peripherals and pins of the camera.
pub struct Pins {
    pub(super) dcmi: Peri<'static, p::DCMI>,
    pub(super) dma: Peri<'static, p::DMA1_CH0>,
    pub(super) data: Data,
    pub(super) vsync: Peri<'static, p::PG9>,
    pub(super) hsync: Peri<'static, p::PA4>,
    pub(super) pixclk: Peri<'static, p::PA6>,
    pub(super) mco: Peri<'static, p::MCO1>,
    pub(super) clock: Peri<'static, p::PA8>,
    pub(super) i2c: Peri<'static, p::I2C1>,
    pub(super) scl: Peri<'static, p::PB8>,
    pub(super) sda: Peri<'static, p::PB9>,
    pub(super) expose: Peri<'static, p::PF12>,
    pub(super) trigger: Peri<'static, p::PF13>,
}

/// D0 to D9.
pub type Data = (
    Peri<'static, p::PC6>,
    Peri<'static, p::PC7>,
    Peri<'static, p::PE0>,
    Peri<'static, p::PE1>,
    Peri<'static, p::PE4>,
    Peri<'static, p::PD3>,
    Peri<'static, p::PE5>,
    Peri<'static, p::PE6>,
    Peri<'static, p::PC10>,
    Peri<'static, p::PC12>,
);

/// The sensor and the memory of its frames, which DMA reaches. Pixels lie there two in a word, the first in the low
/// half.
pub struct Camera {
    /// Keeps pins and clock configured.
    _dcmi: Dcmi<'static, p::DCMI>,
    _clock: Mco<'static, p::MCO1>,
    /// `None` where no sensor answered: frames come from the host.
    sensor: Option<Sensor>,
    settings: CameraSettings,
    /// To the pin EXPOSURE of the sensor.
    expose: Output<'static>,
    trigger: Input<'static>,
    /// Level of the trigger input when it was asked last.
    was_high: bool,
    memory: &'static mut [u32],
    /// Pixels of the frame in memory.
    pixels: usize,
}

impl Camera {
    /// Starts the sensor, if one answers.
    pub(super) fn new(pins: Pins, memory: &'static mut [u32]) -> Self {
        let mut config = McoConfig::default();
        config.prescaler = McoPrescaler::DIV2;
        let clock = Mco::new(pins.mco, pins.clock, Mco1Source::HSI48, config);
        let (d0, d1, d2, d3, d4, d5, d6, d7, d8, d9) = pins.data;
        // The sensor's FRAME_VALID and LINE_VALID are high while pixels come; they change at the falling edge of the
        // clock.
        let mut config = dcmi::Config::default();
        config.vsync_level = dcmi::VSyncDataInvalidLevel::Low;
        let dcmi = Dcmi::new_10bit(
            pins.dcmi,
            pins.dma,
            Interrupts,
            d0,
            d1,
            d2,
            d3,
            d4,
            d5,
            d6,
            d7,
            d8,
            d9,
            pins.vsync,
            pins.hsync,
            pins.pixclk,
            config,
        );
        let mut settings = SETTINGS;
        let sensor = Bus::new(pins.i2c, pins.scl, pins.sda).and_then(|bus| {
            let mut sensor = Sensor::new(bus).ok()?;
            settings = planned(SETTINGS).ok()?;
            sensor.apply(&settings).ok()?;
            Some(sensor)
        });
        Self {
            _dcmi: dcmi,
            _clock: clock,
            sensor,
            settings,
            expose: Output::new(pins.expose, Level::Low, Speed::Low),
            trigger: Input::new(pins.trigger, Pull::Down),
            was_high: false,
            memory,
            pixels: 0,
        }
    }

    /// Waits for the next frame of the sensor, which goes to the memory.
    fn capture(&mut self, words: usize) {
        let stream = DMA1.st(STREAM);
        stop();
        DMA1.ifcr(0).write(|w| {
            w.set_tcif(STREAM, true);
            w.set_teif(STREAM, true);
            w.set_feif(STREAM, true);
            w.set_dmeif(STREAM, true);
            w.set_htif(STREAM, true);
        });
        pac::DCMI.icr().write(|w| {
            w.set_frame_isc(true);
            w.set_ovr_isc(true);
            w.set_err_isc(true);
        });
        DMAMUX1.ccr(STREAM).write(|w| w.set_dmareq_id(DMA_REQUEST));
        stream.par().write_value(pac::DCMI.dr().as_ptr().addr() as u32);
        stream.m0ar().write_value(self.memory.as_mut_ptr().addr() as u32);
        stream.ndtr().write(|w| w.set_ndt(words as u16));
        fence(Ordering::SeqCst);
        stream.cr().write(|w| {
            w.set_dir(Dir::PERIPHERAL_TO_MEMORY);
            w.set_minc(true);
            w.set_psize(Size::BITS32);
            w.set_msize(Size::BITS32);
            w.set_en(true);
        });
        // The DCMI waits for the next VSYNC and captures one frame.
        pac::DCMI.cr().modify(|w| {
            w.set_cm(true);
            w.set_enable(true);
            w.set_capture(true);
        });
    }

    /// The memory as pixels.
    fn codes(&mut self) -> &mut [u16] {
        let words = &mut *self.memory;
        // SAFETY: words are aligned for pixels, and all of their bits belong to pixels.
        unsafe { slice::from_raw_parts_mut(words.as_mut_ptr().cast(), 2 * words.len()) }
    }
}

/// The nearest settings that sensor and board have.
fn planned(wanted: CameraSettings) -> Result<CameraSettings, SettingError> {
    let settings = Sensor::plan(wanted)?;
    let led_permille = LED.nearest(wanted.led_permille.into())? as u16;
    Ok(CameraSettings { led_permille, ..settings })
}

/// Stops the DMA stream and the DCMI.
fn stop() {
    let stream = DMA1.st(STREAM);
    pac::DCMI.cr().modify(|w| {
        w.set_capture(false);
        w.set_enable(false);
    });
    stream.cr().modify(|w| w.set_en(false));
    // The stream finishes its current transfer first.
    while stream.cr().read().en() {}
}

impl FrameSource for Camera {
    fn capacity(&self) -> usize {
        2 * self.memory.len()
    }

    fn camera(&mut self) -> Option<&mut dyn ImageCamera> {
        if self.sensor.is_some() { Some(self) } else { None }
    }

    fn begin(&mut self, pixels: usize) -> Result<(), IoError> {
        let available = self.capacity();
        if pixels > available {
            return Err(IoError::NoRoom { needed: pixels, available });
        }
        self.pixels = pixels;
        Ok(())
    }

    fn write(&mut self, offset: usize, bytes: &[u8]) -> Result<(), IoError> {
        let len = self.pixels;
        let memory: &mut [u8] = bytemuck::cast_slice_mut(self.codes().get_mut(..len).unwrap_or_default());
        let (needed, available) = (offset.saturating_add(bytes.len()), memory.len());
        let to = memory.get_mut(offset..needed).ok_or(IoError::NoRoom { needed, available })?;
        to.copy_from_slice(bytes);
        Ok(())
    }

    fn frame(&mut self) -> Result<&[u16], IoError> {
        let len = self.pixels;
        Ok(self.codes().get(..len).unwrap_or_default())
    }
}

impl ImageCamera for Camera {
    fn sensor(&self) -> &'static str {
        Sensor::NAME
    }

    fn settings(&self) -> CameraSettings {
        self.settings
    }

    fn limits(&self) -> CameraLimits {
        Sensor::limits(&self.settings)
    }

    fn plan(&self, wanted: CameraSettings) -> Result<CameraSettings, SettingError> {
        planned(wanted)
    }

    fn apply(&mut self, settings: CameraSettings) -> Result<(), IoError> {
        let sensor = self.sensor.as_mut().ok_or(IoError::Failed)?;
        sensor.apply(&settings).map_err(|_| IoError::Failed)?;
        self.settings = settings;
        Ok(())
    }

    fn now_us(&self) -> u64 {
        clock::now_us()
    }

    fn latency_us(&self) -> u32 {
        Sensor::latency_us(&self.settings)
    }

    fn light(&mut self, permille: u16) {
        light::set(LED.count(permille.into()) as u16, self.settings.exposure_us);
    }

    fn triggered(&mut self) -> bool {
        let high = self.trigger.is_high();
        let was_high = core::mem::replace(&mut self.was_high, high);
        high && !was_high
    }

    fn expose(&mut self) -> Result<(), IoError> {
        self.pixels = 0;
        self.capture(self.settings.region.pixels() / 2);
        // The sensor notices a pulse of a few of its clocks.
        self.expose.set_high();
        cortex_m::asm::delay(PULSE);
        self.expose.set_low();
        Ok(())
    }

    fn ready(&mut self) -> Result<bool, IoError> {
        let (dcmi, dma) = (pac::DCMI.ris().read(), DMA1.isr(0).read());
        if dcmi.ovr_ris() || dcmi.err_ris() || dma.teif(STREAM) {
            return Err(IoError::Failed);
        }
        if !(dcmi.frame_ris() && dma.tcif(STREAM)) {
            return Ok(false);
        }
        fence(Ordering::SeqCst);
        self.pixels = self.settings.region.pixels();
        Ok(true)
    }

    fn abandon(&mut self) {
        stop();
    }
}
