#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| tractrix_fuzz::once("gpmf", bytes));
