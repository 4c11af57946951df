//! See `ommatidia_fuzz::session`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| ommatidia_fuzz::session::try_input(data));
