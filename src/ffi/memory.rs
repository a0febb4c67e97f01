//! Memory that the C library keeps.

/// Gives memory that is free back to the system. What a stage of a long video took in small pieces stays with the
/// process otherwise, and lies beneath all that later stages take.
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
    // SAFETY: the function of the C library that this target always has; it takes its own locks, and what is in use
    // stays where it is.
    unsafe { malloc_trim(0) };
}
