//! When a video was begun.

use std::path::Path;

use crate::ffi::ffmpeg::MediaFile;

/// The time at which a video was begun, as its container states it: ISO 8601, universal time if the camera keeps to the
/// format. Some cameras write local time, or the time at which they ended. `None` where it says nothing, or is no
/// video.
pub fn stated_start(path: &Path) -> Option<String> {
    MediaFile::open(path).ok()?.metadata(c"creation_time")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_states_nothing_has_no_start() {
        let golden = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden");
        assert_eq!(stated_start(&golden.join("text_track.mp4")), None);
        assert_eq!(stated_start(&golden.join("missing.mp4")), None);
    }
}
