//! Telemetry that belongs to the input.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use nalgebra::Point3;

use crate::checks::text::with_causes;
use crate::math::rounding::counted;
use crate::memory::MemoryLimit;
use crate::pipeline::TelemetryChoice;
use crate::pipeline::driver::fingerprint;
use crate::pipeline::driver::run::{Outcome, Run};
use crate::scene::{Frame, Topic};
use crate::telemetry::{self, Log, Range, TelemetryError};
use crate::video::{self, Kind, VideoError};

/// Origin of telemetry.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::pipeline) enum Origin {
    /// A file that the user named.
    Named,
    /// A file next to the video.
    Beside,
    /// The video itself.
    Inside,
    /// The photographs themselves.
    Photographs,
    /// A file that the user named, with fixes by image name.
    ByName,
}

impl Origin {
    /// True if every position belongs to an image, independent of clocks.
    pub(in crate::pipeline) fn is_of_images(self) -> bool {
        matches!(self, Self::Photographs | Self::ByName)
    }

    /// Name of the positions as a source of scale.
    pub(in crate::pipeline) fn source_name(self) -> &'static str {
        if self.is_of_images() { "positions of the photographs" } else { "telemetry" }
    }
}

/// A log and its origin.
pub(in crate::pipeline) struct Telemetry {
    pub(in crate::pipeline) log: Log,
    pub(in crate::pipeline) path: PathBuf,
    pub(in crate::pipeline) origin: Origin,
}

/// Extensions of logs next to a video; the first file with telemetry is used.
const EXTENSIONS: [&str; 6] = ["srt", "gpx", "csv", "nmea", "log", "txt"];

/// The files, besides the input, on which the detected telemetry depends.
pub(in crate::pipeline) fn files(run: &Run) -> Vec<PathBuf> {
    match &run.options.metric.telemetry {
        TelemetryChoice::None => Vec::new(),
        TelemetryChoice::File(path) => vec![path.clone()],
        TelemetryChoice::Auto if run.info().kind == Kind::Video => logs_next_to(run.input()),
        TelemetryChoice::Auto => Vec::new(),
    }
}

/// Hashes of these files; `None` for an unreadable one: next to a video it is no telemetry, and a named one has been
/// read before.
pub(in crate::pipeline) fn fingerprints(run: &Run) -> Vec<Option<String>> {
    files(run).iter().map(|file| fingerprint::of_content(file).ok()).collect()
}

/// The files next to a video with its stem and the extension of a log, in the order of [`EXTENSIONS`].
pub(in crate::pipeline) fn logs_next_to(video: &Path) -> Vec<PathBuf> {
    let (Some(folder), Some(stem)) = (video.parent(), video.file_stem()) else { return Vec::new() };
    let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let rank = |path: &Path| {
        let extension = path.extension()?.to_str()?.to_ascii_lowercase();
        EXTENSIONS.iter().position(|known| *known == extension).filter(|_| path.file_stem() == Some(stem))
    };
    let ranked = entries.filter_map(|entry| Some((rank(&entry.path())?, entry.path())));
    let mut found: Vec<(usize, PathBuf)> = ranked.filter(|(_, path)| path.is_file() && path != video).collect();
    found.sort();
    found.into_iter().map(|(_, path)| path).collect()
}

/// The telemetry of the input; anomalies are reported.
pub(in crate::pipeline) fn find(run: &Run, outcome: &mut Outcome) -> Option<Telemetry> {
    let found = match &run.options.metric.telemetry {
        TelemetryChoice::None => None,
        TelemetryChoice::File(path) => named(path, run, outcome),
        TelemetryChoice::Auto if run.info().kind == Kind::Video => {
            from_files(&logs_next_to(run.input()), run.options.memory(), outcome).or_else(|| inside(run, outcome))
        }
        TelemetryChoice::Auto => photographs(run),
    };
    if let Some(found) = &found {
        say(found, outcome);
    }
    found
}

/// 35 mm equivalent focal length, millimeters, by the log of a video; `None` where it changes.
pub(in crate::pipeline) fn film_focal_mm(run: &Run) -> Option<f64> {
    let of_log = || {
        let is_video = run.info().kind == Kind::Video;
        let Range { least, most } = is_video.then(|| find(run, &mut Outcome::default()))??.log.film_focal_mm?;
        // Rounding of logs: a hundredth or a tenth of a millimeter.
        (most < 1.02 * least).then_some(least)
    };
    *run.film_focal_mm.get_or_init(of_log)
}

fn named(path: &Path, run: &Run, outcome: &mut Outcome) -> Option<Telemetry> {
    match telemetry_of(path, run.options.memory()) {
        Ok(mut log) if log.is_by_name() => {
            let (num_fixes, num_unmatched) = (log.fixes.len(), match_names(&mut log, run.frames().ok()?));
            if num_unmatched > 0 {
                let path = path.display();
                let text =
                    format!("{path}: {num_unmatched} of {num_fixes} image names match no frame; check the names");
                outcome.warn(Topic::TelemetryLinesSkipped.warning(text));
            }
            (!log.fixes.is_empty()).then(|| Telemetry { log, path: path.to_owned(), origin: Origin::ByName })
        }
        Ok(log) => Some(Telemetry { log, path: path.to_owned(), origin: Origin::Named }),
        Err(error) => {
            let text = format!("telemetry gives no scale: {}", with_causes(&error));
            outcome.warn(Topic::TelemetryUnreadable.warning(text));
            None
        }
    }
}

fn from_files(paths: &[PathBuf], memory: MemoryLimit, outcome: &mut Outcome) -> Option<Telemetry> {
    paths.iter().find_map(|path| match telemetry::read_within(path, memory) {
        Ok(log) => Some(Telemetry { log, path: path.clone(), origin: Origin::Beside }),
        Err(error) => {
            let text = format!("file next to the video ignored as telemetry: {}", with_causes(&error));
            let warning = Topic::TelemetryUnreadable.warning(text);
            match error {
                // The file may still be telemetry.
                TelemetryError::TooLarge { .. } | TelemetryError::TooMany { .. } => outcome.warn(warning),
                _ => outcome.mention(warning),
            }
            None
        }
    })
}

fn inside(run: &Run, outcome: &mut Outcome) -> Option<Telemetry> {
    let video = run.input();
    let warning = |error: TelemetryError| {
        let text = format!("data in the video ignored as telemetry: {}", with_causes(&error));
        outcome.mention(Topic::TelemetryUnreadable.warning(text));
    };
    let log = telemetry_inside(video, run.options.video.track).map_err(warning).ok()??;
    Some(Telemetry { log, path: video.to_owned(), origin: Origin::Inside })
}

/// Reads the telemetry of a log file, a folder of photographs, or a video.
///
/// # Errors
/// [`TelemetryError`] names the file and the remedy.
pub fn telemetry_of(path: &Path, memory: MemoryLimit) -> Result<Log, TelemetryError> {
    match telemetry::read_within(path, memory) {
        Err(error @ (TelemetryError::Unknown { .. } | TelemetryError::TooLarge { .. })) => {
            telemetry_inside(path, None)?.ok_or(error)
        }
        found => found,
    }
}

/// Reads the telemetry of a video's text track or else its GPMF track; `None` if it has neither, or is no video.
///
/// * `track` – video track whose clock is used; `None` as in a run.
///
/// # Errors
/// [`TelemetryError::NoFix`] if the track has other content; [`TelemetryError::Playlist`].
fn telemetry_inside(video: &Path, track: Option<u32>) -> Result<Option<Log>, TelemetryError> {
    match in_text_track(video, track) {
        Err(error @ TelemetryError::NoFix { .. }) => in_gpmf_track(video, track)?.ok_or(error).map(Some),
        Ok(None) => in_gpmf_track(video, track),
        found => found,
    }
}

/// Content of a track of a video; `None` where it cannot be read as one.
fn content<T>(found: Result<T, VideoError>) -> Result<Option<T>, TelemetryError> {
    match found {
        Ok(content) => Ok(Some(content)),
        Err(VideoError::TextTooLarge { path, limit }) => {
            Err(TelemetryError::TooLarge { path, size_mib: limit >> 20, most_mib: limit >> 20 })
        }
        Err(VideoError::Playlist { path, format }) => Err(TelemetryError::Playlist { path, format }),
        Err(_) => Ok(None),
    }
}

fn in_gpmf_track(video: &Path, track: Option<u32>) -> Result<Option<Log>, TelemetryError> {
    let Some(found) = content(video::gpmf(video, track))?.flatten() else { return Ok(None) };
    telemetry::read_gpmf(&found.payloads, &found.settings, video, MemoryLimit::of_machine()).map(Some)
}

fn in_text_track(video: &Path, track: Option<u32>) -> Result<Option<Log>, TelemetryError> {
    let entries = content(video::subtitles(video, track))?.unwrap_or_default();
    (!entries.is_empty()).then(|| telemetry::read_subtitles(&entries, video)).transpose()
}

fn photographs(run: &Run) -> Option<Telemetry> {
    let frames = run.frames().ok()?;
    let paths: Vec<PathBuf> = frames.iter().map(|frame| run.input().join(&frame.name)).collect();
    // If none of a few photographs has a position, the others are not read.
    telemetry::read_photographs(&paths[..paths.len().min(8)]).ok()?;
    let mut log = telemetry::read_photographs(&paths).ok()?;
    for fix in &mut log.fixes {
        // Names in folders are longer than those of their files.
        fix.photograph = frames.get(fix.line - 1).map(|frame| frame.name.clone());
    }
    Some(Telemetry { log, path: run.input().to_owned(), origin: Origin::Photographs })
}

/// Positions of the frames by name, meters east, north and up of one of them, if photographs or a log by image name
/// have them.
pub(in crate::pipeline) fn positions_by_name(run: &Run) -> BTreeMap<String, Point3<f64>> {
    let found = match &run.options.metric.telemetry {
        TelemetryChoice::None => None,
        TelemetryChoice::File(path) => named(path, run, &mut Outcome::default()),
        TelemetryChoice::Auto if run.info().kind == Kind::Video => None,
        TelemetryChoice::Auto => photographs(run),
    };
    found.filter(|found| found.log.is_by_name()).map_or_else(BTreeMap::new, |found| found.log.positions_by_name())
}

/// Replaces the image names in a log by those of the frames that they belong to; labels often lack folder or extension.
/// Fixes of other images are dropped; returns their number.
fn match_names(log: &mut Log, frames: &[Frame]) -> usize {
    let mut frame_of: BTreeMap<String, Option<&str>> = BTreeMap::new();
    for frame in frames {
        for key in keys(&frame.name) {
            let entry = frame_of.entry(key).or_insert(Some(&frame.name));
            // A key of two frames is ambiguous.
            *entry = entry.filter(|name| *name == frame.name);
        }
    }
    let before = log.fixes.len();
    log.fixes.retain_mut(|fix| {
        let label = fix.photograph.as_deref().unwrap_or_default();
        let name = keys(label).into_iter().find_map(|key| *frame_of.get(&key)?);
        fix.photograph = name.map(str::to_owned);
        name.is_some()
    });
    before - log.fixes.len()
}

/// Lookup keys of an image name, the strictest first: whole, without folders, without extension.
fn keys(name: &str) -> [String; 3] {
    let whole = name.replace('\\', "/").to_lowercase();
    let file = whole.rsplit('/').next().unwrap_or_default().to_owned();
    let stem = file.rsplit_once('.').map_or(file.as_str(), |(stem, _)| stem).to_owned();
    [whole, file, stem]
}

fn say(found: &Telemetry, outcome: &mut Outcome) {
    let Telemetry { log, path, origin } = found;
    let whence = match origin {
        Origin::Named => "given",
        Origin::Beside => "found next to the video",
        Origin::Inside => "in the video",
        Origin::Photographs => "EXIF positions of the photographs",
        Origin::ByName => "given, by image name",
    };
    tracing::info!("telemetry: {} ({whence}), {} positions", path.display(), log.fixes.len());
    let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    outcome.figure("telemetry", serde_json::json!({ "file": name, "found": whence, "num_fixes": log.fixes.len() }));
    if let Some(first) = log.passed_over.first() {
        let text =
            format!("{}: {} skipped, the first: {first}", path.display(), counted(log.num_passed_over, "position"));
        outcome.warn(Topic::TelemetryLinesSkipped.warning(text));
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn logs_next_to_a_video_have_its_stem() {
        let folder = tempfile::tempdir().unwrap();
        let video = folder.path().join("DJI_0001.MP4");
        for name in ["DJI_0001.MP4", "DJI_0001.csv", "DJI_0001.SRT", "DJI_0002.SRT", "DJI_0001.jpg", "DJI_0001"] {
            fs::write(folder.path().join(name), "x").unwrap();
        }
        let names: Vec<_> = logs_next_to(&video).iter().map(|path| path.file_name().unwrap().to_owned()).collect();
        assert_eq!(names, ["DJI_0001.SRT", "DJI_0001.csv"]);
    }

    #[test]
    fn other_files_next_to_a_video_are_reported_and_skipped() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        fs::write(path("a.srt"), "1\n00:00:00,000 --> 00:00:01,000\nHello\n").unwrap();
        fs::write(path("a.csv"), "time,latitude,longitude\n0,47.1,8.5\n1,47.2,8.5\n").unwrap();
        let mut outcome = Outcome::default();
        let found = from_files(&[path("a.srt"), path("a.csv")], MemoryLimit::of_machine(), &mut outcome).unwrap();
        assert_eq!((found.path, found.log.fixes.len(), found.origin), (path("a.csv"), 2, Origin::Beside));
        assert!(outcome.warnings.len() == 1 && outcome.warnings[0].contains("a.srt"), "{:?}", outcome.warnings);
    }

    #[test]
    fn telemetry_inside_a_video_is_found() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("GX010042.MP4");
        let write = |payloads: &[Vec<u8>]| {
            fs::write(&path, video::made::with_telemetry(payloads, &telemetry::made::settings())).unwrap();
        };
        write(&[telemetry::made::max(0), telemetry::made::max(1)]);
        let log = telemetry_of(&path, MemoryLimit::of_machine()).unwrap();
        assert_eq!(log.fixes.iter().map(|fix| fix.video_s.unwrap()).collect::<Vec<_>>(), [0.0, 0.5, 1.0, 1.5]);
        assert_eq!(log.lens.unwrap().camera.unwrap(), "HERO12 Black");
        write(&[telemetry::made::hero(0, 0)]);
        let refused = telemetry_of(&path, MemoryLimit::of_machine()).unwrap_err().to_string();
        assert!(refused.contains("GX010042.MP4: GPMF without any position"), "{refused}");
    }

    #[test]
    fn a_playlist_is_refused_as_one() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("list.m3u8");
        fs::write(&path, "#EXTM3U\n#EXT-X-TARGETDURATION:2\n#EXTINF:1.0,\na.mp4\n#EXT-X-ENDLIST\n").unwrap();
        assert!(matches!(telemetry::read(&path), Err(TelemetryError::Unknown { .. })));
        let found = telemetry_inside(&path, None);
        assert!(matches!(&found, Err(TelemetryError::Playlist { format, .. }) if format == "hls"), "{found:?}");
        let mut options = crate::pipeline::Options::default();
        options.metric.telemetry = TelemetryChoice::File(path);
        let refused = crate::pipeline::stages::metric::check(&options).unwrap_err();
        assert!(refused.to_string().contains("playlist (hls)"), "{refused}");
    }
}
