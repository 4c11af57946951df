//! See `ommatidia_fuzz::recording`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| ommatidia_fuzz::recording::try_input(data));
