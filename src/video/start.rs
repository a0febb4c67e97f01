//! Start time of a video.

use std::path::Path;

use crate::ffi::ffmpeg::MediaFile;

/// Start time of a video from its container, ISO 8601; `None` without one, or if the file is no video.
///
/// It is UTC if the camera follows the format. Some cameras write local time, or the end time.
pub fn stated_start(path: &Path) -> Option<String> {
    MediaFile::open(path).ok()?.metadata(c"creation_time")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_without_a_date_have_no_start() {
        let golden = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden");
        assert_eq!(stated_start(&golden.join("text_track.mp4")), None);
        assert_eq!(stated_start(&golden.join("missing.mp4")), None);
    }
}
