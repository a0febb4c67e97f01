//! Free memory that the C library retains.

/// Returns free memory to the system.
///
/// Otherwise small allocations that a stage of a long video has freed stay with the process, and add to the memory of
/// all later stages.
pub fn give_back() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    trim();
}

#[cfg(all(target_os = "linux", target_env = "gnu"))]
#[allow(unsafe_code)]
fn trim() {
    unsafe extern "C" {
        fn malloc_trim(pad: usize) -> std::ffi::c_int;
    }
    // SAFETY: the C library of this target always has the function; it takes its own locks, and does not move memory in
    // use.
    unsafe { malloc_trim(0) };
}
