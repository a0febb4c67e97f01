//! Containers of many formats, read in the same way as by a run.

use std::fs;
use std::path::{Path, PathBuf};

use ::image::{Rgb, RgbImage};

use super::*;
use crate::synthetic::write_clip;

fn golden(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden").join(name)
}

fn ids(scan: &Scan) -> Vec<u32> {
    scan.frames.iter().map(|frame| frame.id.0).collect()
}

fn images(source: &Source) -> Vec<RgbImage> {
    source.frames().unwrap().map(|item| item.unwrap().1).collect()
}

#[test]
fn playlists_are_rejected_under_every_name() {
    let folder = tempfile::tempdir().unwrap();
    let segment = folder.path().join("near.mp4");
    fs::copy(golden("text_track.mp4"), &segment).unwrap();
    let far = golden("text_track.mp4").display().to_string();
    let hls = |end: &str, what: &str| {
        format!("#EXTM3U\n#EXT-X-TARGETDURATION:2\n#EXT-X-MEDIA-SEQUENCE:0\n#EXTINF:1.0,\n{what}\n{end}")
    };
    let session = "v=0\no=- 0 0 IN IP4 127.0.0.1\ns=a\nc=IN IP4 127.0.0.1\nt=0 0\nm=video 5004 RTP/AVP 96\n\
        a=rtpmap:96 H264/90000\n";
    let manifest = "<?xml version=\"1.0\"?><MPD xmlns=\"urn:mpeg:dash:schema:mpd:2011\" type=\"static\" \
        mediaPresentationDuration=\"PT1S\" profiles=\"urn:mpeg:dash:profile:isoff-on-demand:2011\"><Period>\
        <AdaptationSet mimeType=\"video/mp4\"><Representation id=\"0\" bandwidth=\"1\"><BaseURL>near.mp4</BaseURL>\
        </Representation></AdaptationSet></Period></MPD>";
    let lists = [
        ("hls", hls("#EXT-X-ENDLIST\n", "near.mp4")),
        ("hls", hls("#EXT-X-ENDLIST\n", &far)),
        // A live playlist, which FFmpeg waits for to grow.
        ("hls", hls("", "near.mp4")),
        ("concat", "ffconcat version 1.0\nfile near.mp4\n".to_owned()),
        ("dash", manifest.to_owned()),
        ("sdp", session.to_owned()),
    ];
    for (format, content) in &lists {
        for name in ["list.mp4", "list.m3u8", "list.avi"] {
            let path = folder.path().join(name);
            fs::write(&path, content).unwrap();
            let error = Source::open(&path, &Options::default()).unwrap_err();
            let is_named = matches!(&error, VideoError::Playlist { format: found, .. } if found == format);
            assert!(is_named, "{format} as {name}: {error}");
            assert!(subtitles(&path, None).is_err() && stated_start(&path).is_none());
        }
    }
}

#[test]
fn of_several_video_tracks_the_camera_is_read_alone() {
    let path = golden("three_tracks.mp4");
    let of_track = |track| Source::open(&path, &Options { track, ..Options::default() });
    // Track 0 is a single image, 1 gets red, 2 gets blue.
    for (track, channel, expected) in [(None, 0, 1), (Some(1), 0, 1), (Some(2), 2, 2)] {
        let source = of_track(track).unwrap();
        assert_eq!(source.info().video_track, Some(expected));
        let scan = source.scan().unwrap();
        assert_eq!(ids(&scan), (0..20).collect::<Vec<_>>());
        assert_eq!(scan.warnings.len(), usize::from(track.is_none()), "{:?}", scan.warnings);
        for (k, image) in images(&source).iter().enumerate() {
            let pixel = image.get_pixel(30, 20);
            let off = i32::from(pixel[channel]) - (20 + 10 * k as i32);
            assert!(off.abs() < 20 && pixel[2 - channel] < 60, "frame {k} of track {track:?}: {pixel:?}");
        }
    }
    assert!(of_track(None).unwrap().scan().unwrap().warnings[0].text.contains("3 video tracks: using track 1"));
    assert_eq!(of_track(Some(0)).unwrap().scan().unwrap().frames.len(), 1);
    let error = of_track(Some(3)).unwrap_err().to_string();
    assert!(error.contains("video track 3 does not exist; the file has 3"), "{error}");
}

#[test]
fn pixels_become_square_before_frames_are_turned() {
    let source = Source::open(&golden("anamorphic_rotated.mp4"), &Options::default()).unwrap();
    let info = source.info();
    // 48x48 with pixels of 4:3, a quarter turn.
    assert_eq!((info.stored_width, info.stored_height), (48, 48));
    assert_eq!((info.source_width, info.source_height, info.width, info.height), (48, 64, 48, 64));
    let scan = source.scan().unwrap();
    assert_eq!((scan.frames.len(), scan.num_repeated), (5, 0), "{:?}", scan.warnings);
    assert!(scan.warnings[0].text.contains("48x48 pixels are stretched to 48x64"));
    assert!(images(&source).iter().all(|image| image.dimensions() == (48, 64)));
    let smaller = Options { max_dimension: Some(32), ..Options::default() };
    let source = Source::open(&golden("anamorphic_rotated.mp4"), &smaller).unwrap();
    assert!(images(&source).iter().all(|image| image.dimensions() == (24, 32)));
}

#[test]
fn fields_of_two_instants_become_one_and_others_are_left_alone() {
    let source = Source::open(&golden("interlaced.mp4"), &Options::default()).unwrap();
    let scan = source.scan().unwrap();
    assert!(
        scan.warnings.iter().any(|warning| warning.text.contains("fields of 3 of 5 frames")),
        "{:?}",
        scan.warnings
    );
    for (k, image) in images(&source).iter().enumerate() {
        let samples = crate::image::gray_from_rgb(image).unwrap().into_raw();
        let luma = crate::ffi::ffmpeg::Luma { width: image.width() as usize, samples };
        assert!(!fields::is_combed(&luma), "frame {k}");
    }
}

#[test]
fn repeated_frames_are_counted_and_not_listed() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.avi");
    let image = |k: u32| RgbImage::from_fn(64, 48, |x, y| Rgb([((x + 3 * k) * 37 % 200) as u8, (y * 5) as u8, 90]));
    let write = |images: &[RgbImage]| write_clip(&path, 30, images).unwrap();
    write(&(0..36).map(|k| image(k / 3)).collect::<Vec<_>>());
    let source = Source::open(&path, &Options::default()).unwrap();
    let scan = source.scan().unwrap();
    assert_eq!((ids(&scan), scan.num_repeated), ((0..36).step_by(3).collect(), 24));
    assert!((scan.frames[1].time_s - 0.1).abs() < 1e-6, "times are the video's");
    assert!(
        scan.warnings.len() == 1 && scan.warnings[0].text.contains("24 of 36 frames skipped: they repeat"),
        "{:?}",
        scan.warnings
    );
    // A camera that moves, stops for a second, and moves again.
    let halt = |k: u32| if k < 20 { k } else { 20 + k.saturating_sub(50) };
    write(&(0..70).map(|k| image(halt(k))).collect::<Vec<_>>());
    let scan = Source::open(&path, &Options::default()).unwrap().scan().unwrap();
    assert_eq!((scan.frames.len(), scan.num_repeated), (70, 0), "{:?}", scan.warnings);
}

/// A gray object in front of a stationary camera: it moves steadily, or in jumps with pauses; the light may flicker.
#[test]
fn a_stationary_camera_has_no_repeated_frames() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.avi");
    for (pause, flicker) in [(1, 0), (5, 0), (1, 60)] {
        let image = |k: u32| {
            let (left, light) = (20 + 8 * (k / pause), if (k / 5).is_multiple_of(2) { 0 } else { flicker });
            RgbImage::from_fn(320, 240, |x, y| {
                let is_object = (left..left + 24).contains(&x) && (100..116).contains(&y);
                let gray = if is_object { 180 } else { 80 + (x * 7 + y * 13) % 20 };
                Rgb([(gray + light) as u8; 3])
            })
        };
        write_clip(&path, 30, &(0..30).map(image).collect::<Vec<_>>()).unwrap();
        let scan = Source::open(&path, &Options::default()).unwrap().scan().unwrap();
        assert_eq!((scan.frames.len(), scan.num_repeated), (30, 0), "{pause} {flicker}: {:?}", scan.warnings);
    }
}

#[test]
fn frames_hidden_by_an_edit_list_are_not_missed() {
    let source = Source::open(&golden("edit_list.mp4"), &Options::default()).unwrap();
    let scan = source.scan().unwrap();
    assert_eq!(source.info().num_frames, Some(13));
    assert_eq!((scan.frames.len(), scan.num_repeated), (13, 0), "{:?}", scan.warnings);
    assert!(!scan.warnings.iter().any(|warning| warning.text.contains("truncated")), "{:?}", scan.warnings);
}

#[test]
fn frames_of_another_size_are_skipped_with_one_warning() {
    let source = Source::open(&golden("size_changes.ts"), &Options::default()).unwrap();
    let scan = source.scan().unwrap();
    // The last frame of a size shows nothing new: it may count as repeated.
    assert!(ids(&scan).len() >= 5 && ids(&scan).iter().all(|id| *id < 6), "{:?}", ids(&scan));
    let said: Vec<_> = scan.warnings.iter().filter(|warning| warning.text.contains("other size")).collect();
    assert!(
        said.len() == 1 && said[0].text.contains("6 of 12 frames") && said[0].text.contains("from frame 6 (48x32) on"),
        "{:?}",
        scan.warnings
    );
}
