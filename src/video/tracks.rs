//! Which video track of a file is read.

use std::path::Path;

use super::error::regular;
use super::{VideoError, diagnosis};
use crate::ffi::ffmpeg::{FfmpegError, MediaFile, Packet, Stream, StreamKind};
use crate::memory;
use crate::scene::{Timed, Topic, Warning};

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

/// Makes something of the packets with a time in the first stream of a kind; `None` if there is no such stream. Nothing
/// is decoded.
///
/// * `track` – video track whose clock counts, as [`choose`] takes it.
/// * `make` – gets the kind of the stream and the content of a packet; returns what is kept, and the bytes that this
///   owns.
pub(super) fn packets<T>(
    path: &Path,
    track: Option<u32>,
    is_wanted: impl Fn(StreamKind) -> bool,
    make: impl Fn(StreamKind, &[u8]) -> Option<(T, usize)>,
) -> Result<Option<Vec<Timed<T>>>, VideoError> {
    regular(path)?;
    let mut file = MediaFile::open(path).map_err(|error| diagnosis::refused(path, error))?;
    let Some(stream) = file.streams().into_iter().find(|stream| is_wanted(stream.kind)) else { return Ok(None) };
    let origin_s = choose(&file, path, track).map_or(0.0, |chosen| chosen.stream.start_s());
    file.keep_only(stream.index);
    let mut packet = Packet::new()?;
    let (mut found, mut taken) = (Vec::new(), 0);
    // Telemetry that is read from them takes up as much again.
    let limit = memory::of_machine() / 4;
    while file.read(&mut packet)? {
        let Some(time) = packet.time() else { continue };
        let Some((content, num_bytes)) = make(stream.kind, packet.data()) else { continue };
        taken += (size_of::<Timed<T>>() + num_bytes) as u64;
        if taken > limit {
            return Err(VideoError::TextTooLarge { path: path.to_owned(), limit });
        }
        let end = time.saturating_add(packet.duration());
        let [start_s, end_s] = [time, end].map(|ticks| stream.time_base.seconds(ticks) - origin_s);
        found.push(Timed { start_s, end_s, content });
    }
    Ok(Some(found))
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
