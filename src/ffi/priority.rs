//! Priority of threads.

/// Lowers the priority of the calling thread: others take precedence. Linux only; a no-op elsewhere.
pub fn lower() {
    // Nice value 10: about a tenth of a core that another thread wants as well. On Linux the "process" without an id is
    // the calling thread. On failure the priority does not change.
    #[cfg(target_os = "linux")]
    let _ = rustix::process::setpriority_process(None, 10);
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;

    #[test]
    fn only_the_calling_thread_gets_less() {
        let priority = || rustix::process::getpriority_process(None).unwrap();
        let before = priority();
        let lowered = std::thread::spawn(move || {
            lower();
            priority()
        });
        assert_eq!(lowered.join().unwrap(), before.max(10));
        assert_eq!(priority(), before);
    }
}
