//! Accepted container formats.
//!
//! A video is one file. FFmpeg's demuxers also read playlists, session descriptions and numbered images, which name
//! other files or addresses. Formats are therefore allowed by name: a demuxer that a later FFmpeg adds is rejected
//! until it is known to read one file only. Users of rare formats have to convert their files, as the message explains.

/// Formats in which cameras, recorders and editors store video.
const VIDEOS: &str = "\
    apng asf asf_o av1 avi avs2 avs3 cavsvideo cine dhav dirac dnxhd dv evc film_cpk filmstrip flic flv gif gxf h261 \
    h263 h264 hevc ifv ivf ivr kux live_flv lxf m4v matroska,webm mjpeg mjpeg_2000 mov,mp4,m4a,3gp,3g2,mj2 mpeg \
    mpegts mpegtsraw mpegvideo mpjpeg mxf mxg nsv nut nuv obu ogg rm vc1 vvc wtv yuv4mpegpipe";
/// Rare video formats: TiVo, PlayStation Portable, TechnoTrend, Red, SER, VC-1 test streams, Flash, SMJPEG, LMLM4,
/// Ingenient.
const RARE_VIDEOS: &str = "ty pmp pva r3d ser vc1test swf smjpeg lmlm4 ingenient";
/// Sound and subtitles: opened for messages about the content of the file, and for receivers' logs in subtitles.
const OTHERS: &str = "aac ac3 aiff amr ass caf eac3 flac mp3 srt w64 wav webvtt";
/// Formats that name other files or addresses.
const PLAYLISTS: &str = "avisynth concat dash hls imf rtp rtsp sap sdp vapoursynth vobsub webm_dash_manifest";

/// Treatment of a container format.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Admission {
    /// One file that holds its own streams.
    Open,
    /// A list of other files.
    Playlist,
    /// Unknown format, or no video.
    Refuse,
}

/// Treatment of a format, by FFmpeg's name of its demuxer.
pub(super) fn admission(demuxer: &str) -> Admission {
    let is_in = |names: &str| names.split(' ').any(|name| name == demuxer);
    if is_in(VIDEOS) || is_in(RARE_VIDEOS) || is_in(OTHERS) {
        Admission::Open
    } else if is_in(PLAYLISTS) {
        Admission::Playlist
    } else {
        Admission::Refuse
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_formats_of_one_file_are_opened() {
        for name in ["mov,mp4,m4a,3gp,3g2,mj2", "matroska,webm", "mpegts", "srt", "wav"] {
            assert_eq!(admission(name), Admission::Open, "{name}");
        }
        assert_eq!(admission("hls"), Admission::Playlist);
        for name in ["image2", "png_pipe", "tty", "rawvideo", "of a later version"] {
            assert_eq!(admission(name), Admission::Refuse, "{name}");
        }
    }
}
