#![no_std]
#![no_main]
//! echo
use embedded_io::{Read,Write};
#[cortex_m_rt::entry]
fn main() -> ! {
    let mut u = ommatidia_firmware::board::mps2_an500::uart();
    let mut b=[0u8;4096];
    loop {
        let mut n=0;
        while n<b.len() { n+=u.read(&mut b[n..]).unwrap_or(0); }
        u.write_all(b"ok").ok();
    }
}
#[panic_handler]
fn p(_:&core::panic::PanicInfo)->!{loop{}}
