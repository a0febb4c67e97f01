//! A file that another thread still writes.

use std::io;
use std::sync::{Condvar, Mutex, PoisonError};
use std::time::Duration;

/// Longest wait for a notification: a lost one delays a reader by this much.
const PATIENCE: Duration = Duration::from_millis(20);

/// Growth of a file: its reader waits at the end until the writer has added data or has finished.
#[derive(Debug, Default)]
pub struct Growth {
    is_finished: Mutex<bool>,
    changed: Condvar,
}

impl Growth {
    /// Adds data by a function and wakes the readers; returns false, without calling it, if the file has ended.
    ///
    /// # Errors
    /// Those of the function.
    pub fn grow(&self, add: impl FnOnce() -> io::Result<()>) -> io::Result<bool> {
        let is_finished = self.is_finished.lock().unwrap_or_else(PoisonError::into_inner);
        if !*is_finished {
            add()?;
            self.changed.notify_all();
        }
        Ok(!*is_finished)
    }

    /// Ends the file: readers reach its end.
    pub fn finish(&self) {
        *self.is_finished.lock().unwrap_or_else(PoisonError::into_inner) = true;
        self.changed.notify_all();
    }

    /// Returns true once nothing is added any more.
    pub fn is_finished(&self) -> bool {
        *self.is_finished.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Waits for more data, for a moment at most.
    pub fn wait(&self) {
        let is_finished = self.is_finished.lock().unwrap_or_else(PoisonError::into_inner);
        if !*is_finished {
            drop(self.changed.wait_timeout(is_finished, PATIENCE));
        }
    }
}
