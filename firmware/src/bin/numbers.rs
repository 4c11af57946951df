//! Prints the digests of all conversions, for comparison with the host's.
#![no_std]
#![no_main]

use cortex_m_semihosting::hprintln;
use ommatidia_firmware::board::this as board;
use ommatidia_firmware::numbers::digests;

#[cortex_m_rt::entry]
fn main() -> ! {
    for (name, digest) in digests() {
        hprintln!("{} {:016x}", name, digest);
    }
    board::exit()
}
