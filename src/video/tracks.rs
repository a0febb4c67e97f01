//! Selection of the video track of a file.

use std::path::Path;

use super::error::regular;
use super::{VideoError, diagnosis};
use crate::ffi::ffmpeg::{FfmpegError, MediaFile, Packet, Stream, StreamKind};
use crate::memory;
use crate::scene::{Timed, Topic, Warning};

/// Minimum number of frames of a camera's track, as a share of the longest one's.
///
/// Cameras recorded together have 15 to 60 frames per second, thumbnails one per second or a single one.
const MIN_SHARE: f64 = 0.25;
/// Number of packets of one track after which the tracks of a container without counts are compared.
///
/// Ten seconds, in which a still image or thumbnails have far fewer.
const NUM_COMPARED: u64 = 250;

/// Selected video track.
#[derive(Clone, Copy, Debug)]
pub(super) struct Chosen {
    pub(super) stream: Stream,
    /// Number among the video tracks of the file, from 0, as FFmpeg counts them (`-map 0:v:N`).
    pub(super) track: u32,
    /// Number of video tracks among which it was selected; 1 if it was requested.
    pub(super) num_candidates: usize,
}

/// Selects the video track: the requested one, else the first with about as many frames as any.
///
/// # Errors
/// [`VideoError::NoTrack`], [`VideoError::NoPictures`]; those of rereading the file.
pub(super) fn choose(file: &MediaFile, path: &Path, wanted: Option<u32>) -> Result<Chosen, VideoError> {
    let streams = file.streams();
    let is_image = |stream: &&Stream| matches!(stream.kind, StreamKind::Video | StreamKind::Cover);
    let tracks: Vec<(u32, Stream)> = (0..).zip(streams.iter().filter(is_image).copied()).collect();
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

/// Reads the packets with a time of the first stream of a kind; `None` if there is no such stream.
///
/// Nothing is decoded.
///
/// * `track` – video track whose clock applies, as in [`choose`].
/// * `make` – converts the content of a packet, given the kind of its stream, to a value and the number of bytes that
///   the value owns; `None` skips the packet.
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
    // Telemetry parsed from the packets takes as much memory again.
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

/// Number of packets of each track at the beginning of the file.
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
    /// Warning that names the selected track if there are several.
    pub(super) fn remark(&self) -> Option<Warning> {
        (self.num_candidates > 1).then(|| {
            Topic::SeveralVideoTracks.warning(format!(
                "{} video tracks: using track {}; --video-track N selects another one (0 is the first)",
                self.num_candidates, self.track
            ))
        })
    }
}
