//! The program on its board.
#![no_std]
#![no_main]

#[cfg(feature = "probe")]
use defmt_rtt as _;
use ommatidia_firmware::{app, board::this as board};

#[cortex_m_rt::entry]
fn main() -> ! {
    let Some(parts) = board::take() else { board::fail(&"the board is taken") };
    match app::run(parts) {
        Ok(_) => board::exit(),
        Err(never) => match never {},
    }
}
