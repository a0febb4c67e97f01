//! Input of frames: its properties before decoding, the frames that the options select, and their images.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::cameras::{Cameras, PictureCamera};
use super::decode::{Decoder, next_chosen};
use super::file::{FileDecoder, Sizes, Video};
use super::folder::{self, FolderDecoder, ImageGroup, Listing};
use super::options::Selection;
use super::survey::Survey;
use super::{Frames, Options, VideoError, shape};
use crate::ffi::ffmpeg::Purpose;
use crate::files::{self, Growth};
use crate::image::scale_to_fit;
use crate::scene::{Frame, FrameId, TimeBase, Topic, Warning};

/// Kind of input.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// A file that FFmpeg decodes.
    Video,
    /// A folder of images.
    Folder,
}

/// Properties of an input that are known before its frames are decoded.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Info {
    /// Video or folder.
    pub kind: Kind,
    /// Width of the upright and resized frames, pixels.
    pub width: u32,
    /// Height of the upright and resized frames, pixels.
    pub height: u32,
    /// Upright width before resizing, in square pixels.
    pub source_width: u32,
    /// Upright height before resizing, in square pixels.
    pub source_height: u32,
    /// Upright width as stored in the file; it differs from `source_width` if pixels are not square.
    pub stored_width: u32,
    /// Upright height as stored in the file.
    pub stored_height: u32,
    /// Number of the video track among those of the file, from 0.
    pub video_track: Option<u32>,
    /// Frames per second: the container's nominal rate, or the one given for a folder.
    pub fps: Option<f64>,
    /// Number of frames according to the container (it may be an estimate), or of image files in the folder.
    pub num_frames: Option<u32>,
    /// Rotation declared by the container, degrees; it has been applied to the frames.
    pub rotation_deg: i32,
    /// Focal length from EXIF data, pixels of the upright and resized frames.
    pub exif_focal_px: Option<f64>,
}

impl Info {
    /// Unit of the frames' times: a video has its own times, a folder has times only with a given rate.
    pub fn time_base(&self) -> TimeBase {
        match (self.kind, self.fps) {
            (Kind::Folder, None) => TimeBase::Frames,
            (Kind::Folder, Some(_)) | (Kind::Video, _) => TimeBase::Seconds,
        }
    }
}

/// Frames that the options select.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Scan {
    /// Ascending by index; never empty.
    pub frames: Vec<Frame>,
    /// Number of selected frames that are not listed, as they repeat their predecessor.
    pub num_repeated: usize,
    /// Problems of a usable input, one sentence each.
    pub warnings: Vec<Warning>,
}

/// A video file or a folder of images.
#[derive(Debug)]
pub struct Source {
    path: PathBuf,
    options: Options,
    info: Info,
    cameras: Vec<PictureCamera>,
    listing: Option<Listing>,
    /// Growth of a video that is still being written.
    growth: Option<Arc<Growth>>,
    /// Notes for the user on how a video is read.
    remarks: Vec<Warning>,
}

impl Source {
    /// Opens an input and decodes the size of its first image. Images of a folder with another size are skipped.
    ///
    /// # Errors
    /// Every [`VideoError`] that can be determined before the scan: missing, unreadable, empty, not a video, no image,
    /// contradicting options.
    pub fn open(path: &Path, options: &Options) -> Result<Self, VideoError> {
        Self::open_as(path, options, Cameras::One, None)
    }

    /// As [`Source::open`], for a video that is still being written.
    ///
    /// Waits for its first image, and [`Source::frames`] waits for all others.
    ///
    /// # Errors
    /// As [`Source::open`].
    pub fn open_growing(path: &Path, options: &Options, growth: Arc<Growth>) -> Result<Self, VideoError> {
        Self::open_as(path, options, Cameras::One, Some(growth))
    }

    /// As [`Source::open`], with all images of a folder, whatever their sizes.
    ///
    /// [`Source::cameras`] groups them by size and camera. [`Source::info`] refers to the first one.
    ///
    /// # Errors
    /// As [`Source::open`].
    pub fn open_photographs(path: &Path, options: &Options) -> Result<Self, VideoError> {
        Self::open_as(path, options, Cameras::Several, None)
    }

    fn open_as(
        path: &Path,
        options: &Options,
        cameras: Cameras,
        growth: Option<Arc<Growth>>,
    ) -> Result<Self, VideoError> {
        options.check()?;
        let metadata = fs::metadata(path).map_err(VideoError::unreadable(path))?;
        let (info, listing, remarks) = if metadata.is_dir() {
            let listing = folder::list(path, options.turning, cameras)?;
            (folder_info(&listing, options), Some(listing), Vec::new())
        } else {
            files::open(path).map_err(VideoError::unreadable(path))?;
            if metadata.len() == 0 {
                return Err(VideoError::Empty { path: path.to_owned() });
            }
            let (info, remarks) = file_info(path, options, growth.as_ref())?;
            (info, None, remarks)
        };
        let cameras = match &listing {
            Some(listing) => listing.cameras.iter().map(|group| picture_camera(group, options)).collect(),
            None => vec![only_camera(&info)],
        };
        Ok(Self { path: path.to_owned(), options: options.clone(), info, cameras, listing, growth, remarks })
    }

    /// Cameras of the images, in order of their first image; never empty.
    pub fn cameras(&self) -> &[PictureCamera] {
        &self.cameras
    }

    /// Warning about an image that is skipped because its size differs from the first one's, if all must have one size.
    pub fn of_another_size(&self, frame: &Frame) -> Option<Warning> {
        let (first, own) = (self.cameras.first()?, self.cameras.iter().find(|c| c.frames.contains(&frame.id))?);
        let size = |camera: &PictureCamera| (camera.source_width, camera.source_height);
        (size(first) != size(own)).then(|| {
            folder::of_another_size(&self.path.join(&frame.name), size(own), size(first), "the first image has")
        })
    }

    /// Quarter turns, clockwise, from the stored image to the frame, 0 to 3; `None` if it is mirrored as well.
    pub fn quarter_turns(&self, frame: FrameId) -> Option<u8> {
        match &self.listing {
            Some(listing) => listing.quarter_turns(frame),
            None => Some((self.info.rotation_deg.rem_euclid(360) / 90) as u8),
        }
    }

    /// Properties of the input.
    pub fn info(&self) -> &Info {
        &self.info
    }

    /// Step between selected frames: one of every n.
    pub fn every(&self) -> u32 {
        self.options.every.max(1)
    }

    /// File path of the input.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Lists the frames of the whole input and their times, without converting images.
    ///
    /// Frames of a video that have another size than the first, or repeat their predecessor, are not listed.
    ///
    /// # Errors
    /// [`VideoError::NothingChosen`] if the options select no frame; those of reopening the file.
    pub fn scan(&self) -> Result<Scan, VideoError> {
        let mut decoder = self.decoder(Purpose::Times)?;
        let mut selection = Selection::new(&self.options);
        let mut survey = Survey::default();
        while let Some(frame) = next_chosen(decoder.as_mut(), &mut selection)? {
            survey.push(frame, decoder.inspect());
        }
        if survey.is_empty() {
            return Err(self.nothing_chosen()?);
        }
        let surveyed = survey.finish(&self.path, (self.info.source_width, self.info.source_height));
        let mut warnings = self.listing.as_ref().map_or_else(Vec::new, |listing| listing.warnings.clone());
        warnings.extend(self.remarks.iter().map(|remark| remark.of(&self.path.display().to_string())));
        warnings.extend(surveyed.warnings);
        warnings.extend(self.time_warning(decoder.num_guessed()));
        warnings.extend(self.count_warning(decoder.as_ref()));
        Ok(Scan { frames: surveyed.frames, num_repeated: surveyed.num_repeated, warnings })
    }

    /// Decodes the selected frames in order, including those that [`Source::scan`] does not list.
    ///
    /// # Errors
    /// Those of reopening the file; the iterator returns the errors of single frames.
    pub fn frames(&self) -> Result<Frames, VideoError> {
        Frames::start(self.decoder(Purpose::Pictures)?, Selection::new(&self.options), None)
    }

    /// Decodes the requested ones of the selected frames, in order.
    ///
    /// # Errors
    /// As [`Source::frames`].
    pub fn frames_at(&self, ids: BTreeSet<FrameId>) -> Result<Frames, VideoError> {
        Frames::start(self.decoder(Purpose::Pictures)?, Selection::new(&self.options), Some(ids))
    }

    fn decoder(&self, purpose: Purpose) -> Result<Box<dyn Decoder>, VideoError> {
        let info = &self.info;
        let target = (info.width, info.height);
        Ok(match &self.listing {
            Some(listing) => {
                let targets = self.cameras.iter().map(|camera| (camera.width, camera.height)).collect();
                Box::new(FolderDecoder::new(listing, self.options.fps, targets))
            }
            None => {
                let size = (info.source_width, info.source_height);
                let growth = self.growth.as_ref();
                Box::new(FileDecoder::open(&self.path, purpose, self.options.track, size, target, growth)?)
            }
        })
    }

    fn nothing_chosen(&self) -> Result<VideoError, VideoError> {
        let mut decoder = self.decoder(Purpose::Times)?;
        let frames: Vec<Frame> = std::iter::from_fn(|| decoder.step().transpose()).collect::<Result<_, _>>()?;
        let place = |frame: &Frame| match self.info.time_base() {
            TimeBase::Seconds => format!("{:.3} s", frame.time_s),
            TimeBase::Frames => format!("frame {}", frame.id.0),
        };
        Ok(match (frames.first(), frames.last()) {
            (Some(first), Some(last)) => {
                VideoError::NothingChosen { path: self.path.clone(), first: place(first), last: place(last) }
            }
            _ => VideoError::NoFrames { path: self.path.clone() },
        })
    }

    fn time_warning(&self, num_guessed: u32) -> Option<Warning> {
        (num_guessed > 0).then(|| {
            let path = self.path.display();
            Topic::TimeStampsMissing.warning(format!(
                "{path}: {num_guessed} time stamps missing or not ascending; extrapolated from the frames before"
            ))
        })
    }

    /// Compares the container's metadata with the frames found, after a scan to the end.
    fn count_warning(&self, decoder: &dyn Decoder) -> Option<Warning> {
        let stated = self.info.num_frames.filter(|_| self.info.kind == Kind::Video && self.options.end.is_none())?;
        let found = decoder.num_stepped();
        // Containers round durations: a count may be off by one.
        (found + 1 < stated).then(|| {
            let path = self.path.display();
            Topic::FramesMissing.warning(format!(
                "{path}: only {found} of {stated} frames can be decoded; the file is truncated or damaged"
            ))
        })
    }
}

fn folder_info(listing: &Listing, options: &Options) -> Info {
    let PictureCamera { width, height, source_width, source_height, exif_focal_px, .. } =
        picture_camera(&listing.cameras[0], options);
    Info {
        kind: Kind::Folder,
        width,
        height,
        source_width,
        source_height,
        stored_width: source_width,
        stored_height: source_height,
        video_track: None,
        fps: options.fps,
        num_frames: Some(listing.num_files),
        rotation_deg: 0,
        exif_focal_px,
    }
}

fn picture_camera(group: &ImageGroup, options: &Options) -> PictureCamera {
    let (source_width, source_height) = group.size;
    let (width, height) = target_size(group.size, options);
    let scale = f64::from(width.max(height)) / f64::from(source_width.max(source_height));
    let exif_focal_px = group.exif_focal_px.map(|focal| focal * scale);
    let frames = group.ids.iter().copied().map(FrameId).collect();
    PictureCamera { width, height, source_width, source_height, exif_focal_px, frames }
}

/// Camera of a video.
fn only_camera(info: &Info) -> PictureCamera {
    let Info { width, height, source_width, source_height, exif_focal_px, .. } = *info;
    PictureCamera { width, height, source_width, source_height, exif_focal_px, frames: Vec::new() }
}

/// Probes a video: its properties, and notes on how it is read.
fn file_info(path: &Path, options: &Options, growth: Option<&Arc<Growth>>) -> Result<(Info, Vec<Warning>), VideoError> {
    let no_frames = || VideoError::NoFrames { path: path.to_owned() };
    let video = Video::open(path, Purpose::Pictures, options.track, growth)?;
    let container = video.container();
    let Sizes { stored, shown } = video.first_sizes()?.ok_or_else(no_frames)?;
    let (width, height) = target_size(shown, options);
    let remarks = container.remarks.into_iter().chain(shape::remark(stored, shown)).collect();
    let info = Info {
        kind: Kind::Video,
        width,
        height,
        source_width: shown.0,
        source_height: shown.1,
        stored_width: stored.0,
        stored_height: stored.1,
        video_track: Some(container.track),
        fps: container.fps,
        num_frames: container.num_frames,
        rotation_deg: container.rotation_deg,
        exif_focal_px: None,
    };
    Ok((info, remarks))
}

fn target_size((width, height): (u32, u32), options: &Options) -> (u32, u32) {
    options.max_dimension.map_or((width, height), |side| scale_to_fit(width, height, side))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic::write_clip;
    use ::image::RgbImage;

    /// A clip of `n` frames; the red channel of frame k is 10 k.
    fn clip(folder: &Path, n: u32) -> PathBuf {
        let path = folder.join("clip.avi");
        let red = |k| RgbImage::from_pixel(64, 48, ::image::Rgb([(k * 10) as u8, 0, 0]));
        write_clip(&path, 10, &(0..n).map(red).collect::<Vec<_>>()).unwrap();
        path
    }

    fn png(path: &Path, width: u32, height: u32) {
        RgbImage::from_pixel(width, height, ::image::Rgb([200, 10, 10])).save(path).unwrap();
    }

    #[test]
    fn frames_of_a_video_have_order_and_times_at_every_call() {
        let folder = tempfile::tempdir().unwrap();
        let options = Options { every: 3, start: "0.2".parse().ok(), max_dimension: Some(32), ..Options::default() };
        let source = Source::open(&clip(folder.path(), 12), &options).unwrap();
        assert_eq!((source.info().width, source.info().height, source.info().source_width), (32, 24, 64));
        let scan = source.scan().unwrap();
        assert_eq!(scan.frames.iter().map(|f| f.id.0).collect::<Vec<_>>(), [2, 5, 8, 11]);
        assert_eq!(scan.frames[1].name, "000005.jpg");
        assert!((scan.frames[1].time_s - 0.5).abs() < 1e-9);
        assert!(scan.warnings.is_empty(), "{:?}", scan.warnings);
        for _ in 0..2 {
            let frames: Vec<_> = source.frames().unwrap().collect::<Result<_, _>>().unwrap();
            assert_eq!(frames.iter().map(|(frame, _)| frame.clone()).collect::<Vec<_>>(), scan.frames);
            for (frame, image) in &frames {
                assert_eq!(image.dimensions(), (32, 24));
                let red = i32::from(image.get_pixel(16, 12)[0]);
                assert!((red - frame.id.0 as i32 * 10).abs() < 8, "frame {} is {red}", frame.id.0);
            }
        }
        let some = source.frames_at(BTreeSet::from([FrameId(5), FrameId(6)])).unwrap();
        assert_eq!(some.map(|f| f.unwrap().0.id.0).collect::<Vec<_>>(), [5]);
    }

    #[test]
    fn a_video_that_is_still_written_gives_all_its_frames() {
        let folder = tempfile::tempdir().unwrap();
        let bytes = fs::read(clip(folder.path(), 20)).unwrap();
        let path = folder.path().join("growing.avi");
        let (begin, rest) = bytes.split_at(bytes.len() / 3);
        fs::write(&path, begin).unwrap();
        let growth = Arc::new(Growth::default());
        let source = Source::open_growing(&path, &Options::default(), growth.clone()).unwrap();
        let mut frames = source.frames().unwrap();
        let mut ids: Vec<u32> = frames.by_ref().take(4).map(|item| item.unwrap().0.id.0).collect();
        let (target, rest) = (path.clone(), rest.to_owned());
        let writer = std::thread::spawn(move || {
            let mut file = fs::OpenOptions::new().append(true).open(target).unwrap();
            for piece in rest.chunks(500) {
                std::io::Write::write_all(&mut file, piece).unwrap();
                assert!(growth.grow(|| Ok(())).unwrap());
            }
            growth.finish();
        });
        ids.extend(frames.map(|item| item.unwrap().0.id.0));
        writer.join().unwrap();
        assert_eq!(ids, (0..20).collect::<Vec<_>>());
    }

    #[test]
    fn a_truncated_video_gives_its_frames_and_a_warning() {
        let folder = tempfile::tempdir().unwrap();
        let path = clip(folder.path(), 30);
        let bytes = fs::read(&path).unwrap();
        fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
        let scan = Source::open(&path, &Options::default()).unwrap().scan().unwrap();
        assert!(scan.frames.len() < 29 && !scan.frames.is_empty());
        assert!(scan.warnings.iter().any(|w| w.text.contains("of 30 frames")), "{:?}", scan.warnings);
    }

    #[test]
    fn inputs_that_are_no_video_have_distinct_errors() {
        let folder = tempfile::tempdir().unwrap();
        let open = |name: &str, content: &[u8]| {
            let path = folder.path().join(name);
            fs::write(&path, content).unwrap();
            Source::open(&path, &Options::default()).unwrap_err()
        };
        assert!(matches!(open("empty.mp4", b""), VideoError::Empty { .. }));
        assert!(matches!(open("text.mp4", b"not a video at all"), VideoError::NotAVideo { .. }));
        let missing = folder.path().join("none.mp4");
        assert!(matches!(Source::open(&missing, &Options::default()), Err(VideoError::Missing { .. })));
        let bare = tempfile::tempdir().unwrap();
        assert!(matches!(Source::open(bare.path(), &Options::default()), Err(VideoError::NoImages { .. })));
        let late = Options { start: "99".parse().ok(), ..Options::default() };
        let source = Source::open(&clip(folder.path(), 3), &late).unwrap();
        assert!(matches!(source.scan(), Err(VideoError::NothingChosen { .. })));
    }

    #[test]
    fn a_folder_is_read_in_natural_order_and_odd_files_are_skipped() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["b10.png", "b9.png", "b11.png"] {
            png(&folder.path().join(name), 20, 16);
        }
        png(&folder.path().join("b12.png"), 16, 20);
        fs::write(folder.path().join("b13.png"), b"not an image").unwrap();
        fs::write(folder.path().join("notes.txt"), b"not listed").unwrap();
        let options = Options { fps: Some(4.0), ..Options::default() };
        let source = Source::open(folder.path(), &options).unwrap();
        let scan = source.scan().unwrap();
        assert_eq!(scan.frames.iter().map(|f| f.name.as_str()).collect::<Vec<_>>(), ["b9.png", "b10.png", "b11.png"]);
        assert_eq!(scan.frames[2].time_s, 0.5);
        assert_eq!(scan.warnings.len(), 2, "{:?}", scan.warnings);
        assert_eq!(source.info().num_frames, Some(5));
        assert_eq!(source.info().time_base(), TimeBase::Seconds);
        let without_rate = Source::open(folder.path(), &Options::default()).unwrap();
        assert_eq!(without_rate.info().time_base(), TimeBase::Frames);
        assert_eq!(source.frames().unwrap().filter(Result::is_ok).count(), 3);
    }

    #[test]
    fn photographs_of_all_sizes_are_accepted_if_requested() {
        let folder = tempfile::tempdir().unwrap();
        for (name, width, height) in [("1.png", 40, 30), ("2.png", 30, 40), ("3.png", 40, 30), ("4.png", 20, 16)] {
            png(&folder.path().join(name), width, height);
        }
        let options = Options { max_dimension: Some(32), ..Options::default() };
        let source = Source::open_photographs(folder.path(), &options).unwrap();
        let cameras = source.cameras().iter();
        let found: Vec<_> = cameras.map(|c| (c.width, c.height, c.source_width, c.frames.as_slice())).collect();
        let ids = |ids: &[u32]| ids.iter().copied().map(FrameId).collect::<Vec<_>>();
        let expected = [(32, 24, 40, ids(&[0, 2])), (24, 32, 30, ids(&[1])), (20, 16, 20, ids(&[3]))];
        assert_eq!(found, expected.iter().map(|(w, h, s, ids)| (*w, *h, *s, ids.as_slice())).collect::<Vec<_>>());
        let sizes: Vec<_> = source.frames().unwrap().map(|item| item.unwrap().1.dimensions()).collect();
        assert_eq!(sizes, [(32, 24), (24, 32), (32, 24), (20, 16)]);
        let scan = source.scan().unwrap();
        assert!(scan.warnings.is_empty() && source.of_another_size(&scan.frames[2]).is_none());
        assert!(source.of_another_size(&scan.frames[3]).unwrap().text.contains("4.png: skipped, 20x16"));
        let one = Source::open(folder.path(), &options).unwrap();
        assert_eq!((one.cameras().len(), one.scan().unwrap().warnings.len()), (1, 2));
    }

    #[test]
    fn truncated_images_are_skipped_with_a_warning() {
        let folder = tempfile::tempdir().unwrap();
        let noise = RgbImage::from_fn(64, 48, |x, y| ::image::Rgb([(x * 37 + y * 91) as u8, (x * y) as u8, y as u8]));
        for name in ["1.jpg", "2.jpg", "3.png", "4.jpg"] {
            noise.save(folder.path().join(name)).unwrap();
        }
        for name in ["2.jpg", "3.png"] {
            let file = folder.path().join(name);
            let bytes = fs::read(&file).unwrap();
            fs::write(&file, &bytes[..bytes.len() * 2 / 3]).unwrap();
        }
        let source = Source::open(folder.path(), &Options::default()).unwrap();
        let scan = source.scan().unwrap();
        // The damaged PNG is detected when it is decoded.
        assert_eq!(scan.frames.iter().map(|f| f.name.as_str()).collect::<Vec<_>>(), ["1.jpg", "3.png", "4.jpg"]);
        assert_eq!(scan.warnings.len(), 1, "{:?}", scan.warnings);
        assert!(scan.warnings[0].text.contains("2.jpg: skipped") && scan.warnings[0].text.contains("truncated"));
        let (images, failed): (Vec<_>, Vec<_>) = source.frames().unwrap().partition(Result::is_ok);
        assert_eq!(images.into_iter().map(|f| f.unwrap().0.id.0).collect::<Vec<_>>(), [0, 3]);
        assert_eq!(failed.len(), 1);
        assert!(failed[0].as_ref().unwrap_err().to_string().contains("3.png: frame 2 cannot be decoded"));
    }

    /// Reads a file by every method of [`Source`], and returns the number of frames if it is a video.
    fn read_fully(path: &Path) -> Option<usize> {
        let _ = crate::video::subtitles(path, None);
        let source = Source::open(path, &Options::default()).ok()?;
        let _ = source.frames().ok()?.filter(Result::is_err).count();
        source.scan().ok().map(|scan| scan.frames.len())
    }

    #[test]
    fn truncated_and_damaged_files_do_no_harm() {
        crate::video::silence_decoders();
        let golden = fs::read(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden/text_track.mp4")).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("broken.mp4");
        let walk = |content: &[u8]| {
            fs::write(&path, content).unwrap();
            read_fully(&path)
        };
        assert_eq!(walk(&golden), Some(10));
        for length in (0..golden.len()).step_by(41) {
            // The index is at the end; FFmpeg accepts the remaining part of a truncated one.
            assert!(walk(&golden[..length]).is_none_or(|count| count <= 10), "cut off at {length}");
        }
        for at in (0..golden.len()).step_by(17) {
            let mut damaged = golden.clone();
            damaged[at] ^= 0xff;
            let (first, second) = (walk(&damaged), walk(&damaged));
            assert_eq!(first, second, "damaged at {at}");
        }
    }

    #[test]
    fn variable_rate_and_rotation_are_the_containers() {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden/variable_rate_rotated.mp4");
        let source = Source::open(&path, &Options::default()).unwrap();
        assert_eq!((source.info().width, source.info().height), (48, 64));
        // FFmpeg's own program rotates it this way; OpenCV 4.6 turned it upside down.
        assert_eq!((source.info().rotation_deg, source.quarter_turns(FrameId(0))), (270, Some(3)));
        let scan = source.scan().unwrap();
        let expected = [0.0, 0.1, 0.2, 0.3, 0.9, 1.0, 1.1, 1.2];
        assert_eq!(scan.frames.len(), expected.len());
        for (frame, expected) in scan.frames.iter().zip(expected) {
            assert!((frame.time_s - expected).abs() < 1e-6, "{:?}", scan.frames);
        }
        assert!(scan.warnings.is_empty(), "{:?}", scan.warnings);
        let (_, image) = source.frames().unwrap().next().unwrap().unwrap();
        assert_eq!(image.dimensions(), (48, 64));
    }
}
