//! Environment variables that C libraries read.

/// Sets a variable unless the user has set it. To be called before the first thread starts.
#[allow(unsafe_code)]
pub fn set_default(name: &str, value: &str) {
    if std::env::var_os(name).is_none() {
        // SAFETY: `main` calls this first, while the process has a single thread, so that nothing reads the environment
        // at the same time.
        unsafe { std::env::set_var(name, value) }
    }
}
