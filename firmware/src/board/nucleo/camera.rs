//! The MT9V032 on the DCMI (ST RM0433, chapter 32). DMA captures the next frame while one is reconstructed.
#![allow(unsafe_code)] // memory that DMA writes

use super::clock;
use crate::camera::{Mt9v032, Window, is_fresh};
use core::slice;
use core::sync::atomic::{Ordering, fence};
use cortex_m::peripheral::DWT;
use embassy_stm32::dcmi::{self, Dcmi};
use embassy_stm32::i2c::{Config as I2cConfig, I2c};
use embassy_stm32::pac::dma::vals::{Dir, Size};
use embassy_stm32::pac::{self, DMA1, DMAMUX1};
use embassy_stm32::peripherals as p;
use embassy_stm32::rcc::{Mco, Mco1Source, McoConfig, McoPrescaler};
use embassy_stm32::{Peri, bind_interrupts, dma};
use ommatidia_shared::device::{FrameSource, IoError};

bind_interrupts!(struct Interrupts {
    DCMI => dcmi::InterruptHandler<p::DCMI>;
    DMA1_STREAM0 => dma::InterruptHandler<p::DMA1_CH0>;
});

/// The window that the sensor delivers.
pub const WINDOW: Window = Window { rows: 214, cols: 214, bin: 2 };
/// Exposure, rows: with rows of 660 clocks of 24 MHz, 13.2 ms.
const EXPOSURE_ROWS: u16 = 480;
/// Stream of DMA1, and channel of DMAMUX1, that carries the frames.
const STREAM: usize = 0;
/// Request number of the DCMI at DMAMUX1 (ST RM0433, table 121).
const DMA_REQUEST: u8 = 75;
/// Longest wait for a frame, cycles: half a second at 480 MHz, a little more at 400.
const PATIENCE: u32 = 240_000_000;

/// A frame as DMA writes it: two pixels in a word, the first one in the low half.
pub type Frame = [u32; WINDOW.pixels() / 2];

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

/// Two frames in memory that DMA reaches: one from the host or the sensor, to be reconstructed, and one to capture
/// into.
pub struct Camera {
    /// Keeps pins and clock configured.
    _dcmi: Dcmi<'static, p::DCMI>,
    _clock: Mco<'static, p::MCO1>,
    frames: [&'static mut Frame; 2],
    /// Index of the frame that the sensor writes.
    back: usize,
    mode: Mode,
    /// When the capture was started, microseconds.
    began_us: u32,
    /// Pixels of the frame that the host sends.
    pixels: usize,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Mode {
    /// No sensor answered: frames come from the host.
    Host,
    /// The sensor runs, and no frame is being captured.
    Idle,
    /// A frame is being captured.
    Capturing,
}

impl Camera {
    /// Starts the sensor, if one answers.
    pub(super) fn new(pins: Pins, frames: [&'static mut Frame; 2]) -> Self {
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
        let bus = I2c::new_blocking(pins.i2c, pins.scl, pins.sda, I2cConfig::default());
        let started = Mt9v032::new(bus).and_then(|mut sensor| {
            sensor.expose(EXPOSURE_ROWS)?;
            sensor.start(WINDOW)
        });
        let mode = if started.is_ok() { Mode::Idle } else { Mode::Host };
        Self { _dcmi: dcmi, _clock: clock, frames, back: 0, mode, began_us: 0, pixels: 0 }
    }

    /// Starts the capture of the next whole frame into the back buffer.
    fn capture(&mut self) {
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
        let back = &mut *self.frames[self.back];
        stream.par().write_value(pac::DCMI.dr().as_ptr().addr() as u32);
        stream.m0ar().write_value(back.as_mut_ptr().addr() as u32);
        stream.ndtr().write(|w| w.set_ndt(back.len() as u16));
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
        self.mode = Mode::Capturing;
        self.began_us = clock::now();
    }

    /// Waits until the back buffer holds a frame.
    ///
    /// # Errors
    /// [`IoError::Failed`] where the capture failed or took too long.
    fn captured(&self) -> Result<(), IoError> {
        let began = DWT::cycle_count();
        loop {
            let (dcmi, dma) = (pac::DCMI.ris().read(), DMA1.isr(0).read());
            let late = DWT::cycle_count().wrapping_sub(began) > PATIENCE;
            if dcmi.ovr_ris() || dcmi.err_ris() || dma.teif(STREAM) || late {
                return Err(IoError::Failed);
            }
            if dcmi.frame_ris() && dma.tcif(STREAM) {
                fence(Ordering::SeqCst);
                return Ok(());
            }
        }
    }

    /// The frame to reconstruct.
    fn front(&mut self) -> &mut [u16] {
        let frame = &mut *self.frames[1 - self.back];
        // SAFETY: words are aligned for pixels, and all of their bits belong to pixels.
        unsafe { slice::from_raw_parts_mut(frame.as_mut_ptr().cast(), WINDOW.pixels()) }
    }
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
        WINDOW.pixels()
    }

    fn live(&self) -> bool {
        self.mode != Mode::Host
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
        let memory: &mut [u8] = bytemuck::cast_slice_mut(self.front().get_mut(..len).unwrap_or_default());
        let (needed, available) = (offset.saturating_add(bytes.len()), memory.len());
        let to = memory.get_mut(offset..needed).ok_or(IoError::NoRoom { needed, available })?;
        to.copy_from_slice(bytes);
        Ok(())
    }

    /// The frame of the host where it has sent one since the last run, otherwise that of the sensor, which was captured
    /// during the last run. Where that is too long ago, as with one frame a minute, a new one is captured first.
    fn frame(&mut self) -> Result<&[u16], IoError> {
        let sent = self.pixels;
        if self.live() {
            self.pixels = 0;
        }
        if sent > 0 || !self.live() {
            return Ok(self.front().get(..sent).unwrap_or_default());
        }
        if self.mode == Mode::Idle || !is_fresh(self.began_us, clock::now()) {
            self.capture();
        }
        let captured = self.captured();
        self.mode = Mode::Idle;
        captured?;
        self.back = 1 - self.back;
        self.capture();
        Ok(self.front())
    }
}
