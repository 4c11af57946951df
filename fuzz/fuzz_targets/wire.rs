//! See `ommatidia_fuzz::wire`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| ommatidia_fuzz::wire::try_input(data));
