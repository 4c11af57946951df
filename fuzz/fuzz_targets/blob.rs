//! See `ommatidia_fuzz::blob`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| ommatidia_fuzz::blob::try_input(data));
