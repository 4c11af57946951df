//! The revision of the chip, which limits its clock: 400 MHz, and 480 MHz from revision V on (ST DS12110, table 24; ST
//! ES0392, table 2).

use embassy_stm32::pac::DBGMCU;
use embassy_stm32::rcc::{Pll, PllDiv, PllMul, PllPreDiv, PllSource, VoltageScale};

/// REV_ID of revision V in DBGMCU_IDC (ST RM0433, section 60.5.8).
const V: u16 = 0x2003;

/// A revision.
#[derive(Clone, Copy)]
pub(super) struct Revision(u16);

impl Revision {
    /// Reads it.
    pub(super) fn read() -> Self {
        Self(DBGMCU.idc().read().rev_id())
    }

    /// Its letter; a question mark for one that is not known, which gets the slower clock.
    #[cfg_attr(not(feature = "probe"), allow(dead_code))] // for the log
    pub(super) fn name(self) -> char {
        match self.0 {
            0x1001 => 'Z',
            0x1003 => 'Y',
            0x2001 => 'X',
            V => 'V',
            _ => '?',
        }
    }

    fn is_fast(self) -> bool {
        self.0 == V
    }

    /// Clock of the core, MHz. The buses have a quarter of it, their timers half of it.
    pub(super) const fn mhz(self) -> u16 {
        if self.0 == V { 480 } else { 400 }
    }

    /// Voltage, and the multiplier of the 4 MHz that the PLL gets.
    pub(super) fn clock(self) -> (VoltageScale, Option<Pll>) {
        let fast = self.is_fast();
        let pll = Pll {
            source: PllSource::HSE,
            prediv: PllPreDiv::DIV2,
            mul: if fast { PllMul::MUL240 } else { PllMul::MUL200 },
            fracn: None,
            divp: Some(PllDiv::DIV2),
            divq: Some(PllDiv::DIV8),
            divr: None,
        };
        (if fast { VoltageScale::Scale0 } else { VoltageScale::Scale1 }, Some(pll))
    }
}
