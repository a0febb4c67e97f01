//! Which video track of a file is read.

use std::path::Path;

use super::VideoError;
use super::diagnosis;
use crate::ffi::ffmpeg::{FfmpegError, MediaFile, Packet, Stream, StreamKind};
use crate::scene::{Topic, Warning};

/// A track with fewer frames than this share of the longest one is not the camera's: cameras recorded together have 15
/// to 60 frames per second, thumbnails one per second or one in all.
const MIN_SHARE: f64 = 0.25;
/// Packets of one track after which the tracks of a container without counts are compared: ten seconds, by which a
/// still image or thumbnails have far fewer.
const NUM_COMPARED: u64 = 250;

/// The track that is read.
#[derive(Clone, Copy, Debug)]
pub(super) struct Chosen {
    pub(super) stream: Stream,
    /// Number among the video tracks of the file, from 0, as FFmpeg counts them (`-map 0:v:N`).
    pub(super) track: u32,
    /// Tracks of moving pictures among which it was chosen without being asked for.
    pub(super) num_candidates: usize,
}

/// Chooses the video track: the one that is asked for, else the first with about as many frames as any.
///
/// # Errors
/// [`VideoError::NoTrack`], [`VideoError::NoPictures`]; those of reading the file again.
pub(super) fn choose(file: &MediaFile, path: &Path, wanted: Option<u32>) -> Result<Chosen, VideoError> {
    let streams = file.streams();
    let is_picture = |stream: &&Stream| matches!(stream.kind, StreamKind::Video | StreamKind::Cover);
    let tracks: Vec<(u32, Stream)> = (0..).zip(streams.iter().filter(is_picture).copied()).collect();
    if let Some(wanted) = wanted {
        let found = tracks.iter().find(|(track, _)| *track == wanted);
        let missing = || VideoError::NoTrack { path: path.to_owned(), track: wanted, count: tracks.len() };
        return found.map(|&(track, stream)| Chosen { stream, track, num_candidates: 1 }).ok_or_else(missing);
    }
    let moving: Vec<(u32, Stream)> =
        tracks.into_iter().filter(|(_, stream)| stream.kind == StreamKind::Video).collect();
    let num_candidates = moving.len();
    let chosen = |(track, stream)| Chosen { stream, track, num_candidates };
    match moving.as_slice() {
        [] => Err(diagnosis::no_pictures(path, &streams)),
        [only] => Ok(chosen(*only)),
        [first, ..] => {
            let counts = match moving.iter().map(|(_, stream)| stream.num_packets).collect::<Option<Vec<u64>>>() {
                Some(stated) => stated,
                None => counted(path, &moving)?,
            };
            let most = counts.iter().copied().max().unwrap_or(0) as f64;
            let enough = counts.iter().position(|&count| count as f64 >= MIN_SHARE * most);
            Ok(chosen(enough.map_or(*first, |k| moving[k])))
        }
    }
}

/// Packets of each track in the beginning of the file.
fn counted(path: &Path, tracks: &[(u32, Stream)]) -> Result<Vec<u64>, FfmpegError> {
    let (mut file, mut packet) = (MediaFile::open(path)?, Packet::new()?);
    let mut counts = vec![0; tracks.len()];
    while counts.iter().all(|count| *count < NUM_COMPARED) && file.read(&mut packet)? {
        if let Some(k) = tracks.iter().position(|(_, stream)| stream.index == packet.stream()) {
            counts[k] += 1;
        }
    }
    Ok(counts)
}

impl Chosen {
    /// Says which track was taken where there are several.
    pub(super) fn remark(&self) -> Option<Warning> {
        (self.num_candidates > 1).then(|| {
            Topic::SeveralVideoTracks.warning(format!(
                "{} video tracks: using track {}; --video-track N selects another one (0 is the first)",
                self.num_candidates, self.track
            ))
        })
    }
}
