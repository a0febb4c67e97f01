//! Child processes that end with the program.

use std::process::Command;

/// Makes the kernel end a child with the thread that starts it, even if that is killed.
///
/// Linux only; elsewhere a child ends when it writes into its closed pipe.
#[cfg_attr(target_os = "linux", allow(unsafe_code))]
pub fn end_with_parent(command: &mut Command) {
    #[cfg(target_os = "linux")]
    {
        use std::os::unix::process::CommandExt;

        use rustix::process::{Signal, set_parent_process_death_signal};

        // SAFETY: between fork and exec only async-signal-safe calls may run. This is one system call, which uses no
        // memory of the parent.
        unsafe {
            command.pre_exec(|| Ok(set_parent_process_death_signal(Some(Signal::KILL))?));
        }
    }
    #[cfg(not(target_os = "linux"))]
    let _ = command;
}
