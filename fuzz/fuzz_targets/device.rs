//! See `ommatidia_fuzz::device`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| ommatidia_fuzz::device::try_input(data));
