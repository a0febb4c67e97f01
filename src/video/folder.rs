//! A folder of images as a video.

use std::cmp::Ordering;
use std::collections::{BTreeMap, BTreeSet};
use std::ffi::OsStr;
use std::fs::{self, File};
use std::io::BufReader;
use std::path::{Path, PathBuf};

use ::image::metadata::Orientation;
use ::image::{DynamicImage, ImageDecoder, ImageFormat, ImageReader, RgbImage};

use super::cameras::Cameras;
use super::decode::Decoder;
use super::{Turning, VideoError, exif, jpeg};
use crate::files;
use crate::image::resize_rgb;
use crate::scene::{Frame, FrameId, Topic, Warning};

/// Extensions of supported images, in lower case.
const EXTENSIONS: [&str; 3] = ["jpg", "jpeg", "png"];
/// Extensions of unsupported images.
const UNREAD: [&str; 20] = [
    "arw", "avif", "bmp", "cr2", "cr3", "dng", "exr", "gpr", "heic", "heif", "jp2", "jxl", "nef", "orf", "raf", "rw2",
    "srw", "tif", "tiff", "webp",
];

/// Maximum length of an image name, bytes.
///
/// File systems limit names to 255 bytes, and a mask's name is that of its image followed by `.png`.
const MAX_NAME_BYTES: usize = 255 - ".png".len();

/// Image of a folder with a valid header.
#[derive(Clone, Debug)]
pub(super) struct Entry {
    /// Index among all images of the folder.
    id: u32,
    path: PathBuf,
    name: String,
    orientation: Orientation,
    /// Size after rotation, before resizing.
    size: (u32, u32),
    /// Index in [`Listing::cameras`].
    camera: usize,
}

/// Camera of some of the images: same size, orientation, and EXIF camera and focal length.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct ImageGroup {
    /// Size after rotation, before resizing.
    pub(super) size: (u32, u32),
    /// Focal length from the EXIF block of the first image, pixels of that size.
    pub(super) exif_focal_px: Option<f64>,
    /// Indices of the images among all images of the folder.
    pub(super) ids: Vec<u32>,
    orientation: Orientation,
    camera: Vec<String>,
    /// Reason why the EXIF block cannot be read, if it cannot.
    exif_flaw: Option<String>,
}

/// Images of a folder that can be used together.
#[derive(Clone, Debug)]
pub(super) struct Listing {
    pub(super) entries: Vec<Entry>,
    /// Number of files with an image's extension.
    pub(super) num_files: u32,
    /// Cameras, in order of their first image; one if all images must have the same size.
    pub(super) cameras: Vec<ImageGroup>,
    /// Skipped images, with the reasons.
    pub(super) warnings: Vec<Warning>,
}

/// Lists a folder in natural order (`img2` before `img10`).
///
/// Reads headers, and checks that JPEG files are complete. A file that has an image extension but is no image still
/// counts: the indices and times of the others do not change.
///
/// If all images must have the same size, it is the most common one.
pub(super) fn list(path: &Path, turning: Turning, cameras: Cameras) -> Result<Listing, VideoError> {
    let Contents { mut names, others, unread, .. } = contents(path)?;
    let skipped = skipped(path, &names, unread);
    names.sort_by(|a, b| natural_cmp(&a.text, &b.text));
    let mut listing =
        Listing { entries: Vec::new(), num_files: names.len() as u32, cameras: Vec::new(), warnings: Vec::new() };
    let mut found = Vec::new();
    for (id, name) in (0u32..).zip(names) {
        let file = path.join(&name.text);
        match name.flaw.map_or_else(|| image_group(id, &file, turning), Err) {
            Ok(group) => found.push((id, file, name.text, group)),
            Err(reason) => {
                let text = format!("{}: skipped, cannot be read: {reason}", file.display());
                listing.warnings.push(Topic::ImageUnreadable.warning(text));
            }
        }
    }
    let flawed = || found.iter().filter_map(|(_, file, _, group)| Some((file, group.exif_flaw.as_ref()?)));
    if let Some((file, flaw)) = flawed().next() {
        let (file, count) = (file.display(), flawed().count());
        listing.warnings.push(Topic::ExifUnreadable.warning(format!(
            "{file}: EXIF data of {count} images cannot be read ({flaw}): focal length, orientation, position unknown"
        )));
    }
    let common = match cameras {
        Cameras::One => commonest(found.iter().map(|(.., group)| group.size)),
        Cameras::Several => None,
    };
    for (id, path, name, group) in found {
        let (size, orientation) = (group.size, group.orientation);
        match common.filter(|common| *common != size) {
            Some(common) => listing.warnings.push(of_another_size(&path, size, common, "most images have")),
            None => {
                let camera = listing.camera_of(group, cameras);
                listing.entries.push(Entry { id, path, name, orientation, size, camera });
            }
        }
    }
    if listing.entries.is_empty() {
        let found = listing.warnings.into_iter().next().map_or_else(|| described(&others), |warning| warning.text);
        return Err(VideoError::NoImages { path: path.to_owned(), found });
    }
    listing.warnings.extend(turned(&listing.entries).into_iter().chain(skipped));
    Ok(listing)
}

/// Warns of images in unsupported formats, except those that also exist as JPEG or PNG.
fn skipped(path: &Path, names: &[Name], unread: Vec<String>) -> Option<Warning> {
    let stem = |name: &str| Path::new(name).with_extension("").to_string_lossy().to_lowercase();
    let read: BTreeSet<String> = names.iter().map(|name| stem(&name.text)).collect();
    let mut alone: Vec<String> = unread.into_iter().filter(|name| !read.contains(&stem(name))).collect();
    alone.sort_by(|a, b| natural_cmp(a, b));
    let first = alone.first()?;
    let kind = Path::new(first).extension().and_then(OsStr::to_str).unwrap_or_default();
    Some(Topic::ImagesOfOtherKinds.warning(format!(
        "{}: {} images skipped, only JPEG and PNG are read; the first is {first}; convert them (ImageMagick: `mogrify \
         -format png *.{kind}`)",
        path.display(),
        alone.len()
    )))
}

/// Camera of an image from its header and EXIF data.
///
/// # Errors
/// The reason why the image cannot be used.
fn image_group(id: u32, file: &Path, turning: Turning) -> Result<ImageGroup, String> {
    let stored = header(file)?;
    let is_png = file.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("png"));
    let (exif, exif_flaw) = match exif::read(file) {
        Ok(exif) => (exif, None),
        // A truncated PNG file is reported when it is decoded.
        Err(flaw) => (None, (!is_png).then_some(flaw)),
    };
    let orientation = match turning {
        Turning::AsStored => Orientation::NoTransforms,
        Turning::Auto | Turning::Upright => exif.as_ref().map_or(Orientation::NoTransforms, exif::orientation),
    };
    let size = upright(stored, orientation);
    Ok(ImageGroup {
        size,
        exif_focal_px: exif.as_ref().and_then(|e| exif::focal_px(e, size.0, size.1)),
        ids: vec![id],
        orientation,
        camera: exif.as_ref().map(exif::camera).unwrap_or_default(),
        exif_flaw,
    })
}

/// Most common size; the first one of equally common sizes.
fn commonest(sizes: impl Iterator<Item = (u32, u32)>) -> Option<(u32, u32)> {
    let mut counts: Vec<((u32, u32), usize)> = Vec::new();
    for size in sizes {
        match counts.iter_mut().find(|(known, _)| *known == size) {
            Some((_, count)) => *count += 1,
            None => counts.push((size, 1)),
        }
    }
    let most = counts.iter().map(|(_, count)| *count).max()?;
    counts.into_iter().find(|(_, count)| *count == most).map(|(size, _)| size)
}

/// Warning about an image that is skipped because of its size, with the remedy.
///
/// * `whose` – images with the expected size, followed by `have` or `has`.
pub(super) fn of_another_size(
    file: &Path,
    (width, height): (u32, u32),
    (other_width, other_height): (u32, u32),
    whose: &str,
) -> Warning {
    Topic::ImageSizeDiffers.warning(format!(
        "{}: skipped, {width}x{height} pixels where {whose} {other_width}x{other_height}; frames of a video and images \
         in which vehicles are detected must have one size (`tractrix sfm` without masks and with --order none accepts \
         photographs of all sizes)",
        file.display()
    ))
}

impl Listing {
    /// Quarter turns, clockwise, of the image of a frame; `None` if it is mirrored as well.
    pub(super) fn quarter_turns(&self, frame: FrameId) -> Option<u8> {
        let entry = self.entries.iter().find(|entry| entry.id == frame.0)?;
        match entry.orientation {
            Orientation::NoTransforms => Some(0),
            Orientation::Rotate90 => Some(1),
            Orientation::Rotate180 => Some(2),
            Orientation::Rotate270 => Some(3),
            _ => None,
        }
    }

    /// Index of the camera of an image; adds a new camera if none matches.
    fn camera_of(&mut self, group: ImageGroup, cameras: Cameras) -> usize {
        let is_same = |known: &ImageGroup| match cameras {
            Cameras::One => true,
            Cameras::Several => {
                (known.size, known.orientation, &known.camera) == (group.size, group.orientation, &group.camera)
            }
        };
        match self.cameras.iter().position(is_same) {
            Some(camera) => {
                self.cameras[camera].ids.extend(group.ids);
                camera
            }
            None => {
                self.cameras.push(group);
                self.cameras.len() - 1
            }
        }
    }
}

/// Warns of images that are not stored upright: models refer to upright images.
fn turned(entries: &[Entry]) -> Option<Warning> {
    let is_turned = |entry: &&Entry| entry.orientation != Orientation::NoTransforms;
    let first = entries.iter().find(is_turned)?;
    let count = entries.iter().filter(is_turned).count();
    Some(Topic::ImagesRotated.warning(format!(
        "{}: {count} of {} images rotated upright by their EXIF data; models refer to the upright images; other \
         programs need upright files (ImageMagick: `mogrify -auto-orient *`)",
        first.path.display(),
        entries.len()
    )))
}

/// Files of a folder, without hidden ones.
#[derive(Default)]
struct Contents {
    /// Files with an image extension.
    names: Vec<Name>,
    /// Number of other files, by their extension in lower case.
    others: BTreeMap<String, usize>,
    /// Names of images in unsupported formats.
    unread: Vec<String>,
    /// Names of the subfolders.
    folders: Vec<String>,
}

/// Directory entry with an image extension.
struct Name {
    /// Name as text; invalid characters are replaced.
    text: String,
    /// Reason why it is unusable, if that can be determined without opening it.
    flaw: Option<String>,
}

impl Name {
    fn new(name: &OsStr, path: &Path) -> Self {
        let text = name.to_string_lossy().into_owned();
        let flaw = match fs::metadata(path) {
            Err(error) => Some(error.to_string()),
            Ok(found) if !found.is_file() => Some(format!("it is {}", files::in_words(found.file_type()))),
            Ok(_) if name.to_str().is_none() => Some("file name is not UTF-8; rename it".to_owned()),
            Ok(_) if is_unwritable(&text) => Some(
                "file name begins or ends with a space or has a line break, which models cannot store; rename it"
                    .to_owned(),
            ),
            Ok(_) if name.len() > MAX_NAME_BYTES => {
                Some(format!("file name has {} bytes, at most {MAX_NAME_BYTES} allowed; rename it", name.len()))
            }
            Ok(_) => None,
        };
        Self { text, flaw }
    }
}

/// Returns true if model files cannot store a name.
fn is_unwritable(name: &str) -> bool {
    name.trim() != name || name.contains(['\n', '\r', '\0'])
}

/// Lists the files of a folder; if it has no images, also those of its subfolders, with the subfolder's name as prefix.
fn contents(path: &Path) -> Result<Contents, VideoError> {
    let mut contents = directly_in(path)?;
    if contents.names.is_empty() {
        for folder in std::mem::take(&mut contents.folders) {
            let inner = directly_in(&path.join(&folder))?;
            let below = |name: Name| Name { text: format!("{folder}/{}", name.text), ..name };
            contents.names.extend(inner.names.into_iter().map(below));
            contents.unread.extend(inner.unread.iter().map(|name| format!("{folder}/{name}")));
            inner.others.into_iter().for_each(|(kind, count)| *contents.others.entry(kind).or_default() += count);
        }
    }
    Ok(contents)
}

fn directly_in(path: &Path) -> Result<Contents, VideoError> {
    let unreadable = |source| VideoError::Unreadable { path: path.to_owned(), source };
    let mut contents = Contents::default();
    for entry in fs::read_dir(path).map_err(unreadable)? {
        let entry = entry.map_err(unreadable)?;
        let name = entry.file_name();
        let extension = Path::new(&name).extension().and_then(OsStr::to_str).unwrap_or_default().to_lowercase();
        if name.as_encoded_bytes().starts_with(b".") {
            continue;
        }
        let is_folder = entry.path().is_dir();
        if EXTENSIONS.contains(&extension.as_str()) {
            contents.names.push(Name::new(&name, &entry.path()));
        } else if let (true, Some(name)) = (is_folder, name.to_str()) {
            contents.folders.push(name.to_owned());
        } else if !is_folder {
            if UNREAD.contains(&extension.as_str()) {
                contents.unread.push(name.to_string_lossy().into_owned());
            }
            *contents.others.entry(extension).or_default() += 1;
        }
    }
    contents.folders.sort();
    Ok(contents)
}

/// Description of the files of a folder without images, with the remedy.
fn described(others: &BTreeMap<String, usize>) -> String {
    const VIDEOS: [&str; 9] = ["mp4", "mov", "avi", "mkv", "webm", "m4v", "mts", "mpg", "gif"];
    let Some((commonest, count)) = others.iter().max_by_key(|(_, count)| **count) else {
        return "empty, and so are its subfolders; give the folder that contains the images".to_owned();
    };
    let files = if *count == 1 { "file" } else { "files" };
    let files = match commonest.is_empty() {
        true => format!("{files} without an extension"),
        false => format!(".{commonest} {files}"),
    };
    let cure = match commonest.as_str() {
        video if VIDEOS.contains(&video) => "give one video file",
        image if UNREAD.contains(&image) => "convert them to PNG or JPEG (ImageMagick: `mogrify -format png *`)",
        _ => "give a folder of JPEG or PNG images, or a video",
    };
    format!("{count} {files}; {cure}")
}

/// Stored size of an image from its header, if the file seems complete.
fn header(path: &Path) -> Result<(u32, u32), String> {
    let reader = reader(path)?;
    let size = reader.into_decoder().map_err(|e| e.to_string())?.dimensions();
    // Decoding fails for a truncated PNG, but not for a truncated JPEG.
    match jpeg::is_truncated(path).map_err(|e| e.to_string())? {
        true => Err("the file is truncated; copy it again".to_owned()),
        false => Ok(size),
    }
}

/// Size after rotation.
fn upright((width, height): (u32, u32), orientation: Orientation) -> (u32, u32) {
    match orientation {
        Orientation::Rotate90 | Orientation::Rotate270 | Orientation::Rotate90FlipH | Orientation::Rotate270FlipH => {
            (height, width)
        }
        _ => (width, height),
    }
}

/// Compares names in natural order: runs of digits by value, everything else by character.
fn natural_cmp(a: &str, b: &str) -> Ordering {
    let (mut left, mut right) = (a, b);
    loop {
        let (x, y) = match (left.chars().next(), right.chars().next()) {
            (Some(x), Some(y)) => (x, y),
            (x, y) => return x.cmp(&y).then_with(|| a.cmp(b)),
        };
        if x.is_ascii_digit() && y.is_ascii_digit() {
            let (m, n) = (digits(left), digits(right));
            let value = |run: &str| run.trim_start_matches('0').to_owned();
            let (p, q) = (value(m), value(n));
            let order = p.len().cmp(&q.len()).then_with(|| p.cmp(&q));
            if order != Ordering::Equal {
                return order;
            }
            (left, right) = (&left[m.len()..], &right[n.len()..]);
        } else if x != y {
            return x.cmp(&y);
        } else {
            (left, right) = (&left[x.len_utf8()..], &right[y.len_utf8()..]);
        }
    }
}

/// The digits at the beginning of a text.
fn digits(text: &str) -> &str {
    &text[..text.find(|c: char| !c.is_ascii_digit()).unwrap_or(text.len())]
}

/// Steps through the images of a folder.
pub(super) struct FolderDecoder {
    entries: std::vec::IntoIter<Entry>,
    current: Option<Entry>,
    seconds_per_frame: f64,
    /// Size after resizing, per camera.
    targets: Vec<(u32, u32)>,
}

impl FolderDecoder {
    pub(super) fn new(listing: &Listing, fps: Option<f64>, targets: Vec<(u32, u32)>) -> Self {
        Self {
            entries: listing.entries.clone().into_iter(),
            current: None,
            seconds_per_frame: 1.0 / fps.unwrap_or(1.0),
            targets,
        }
    }
}

impl Decoder for FolderDecoder {
    fn step(&mut self) -> Result<Option<Frame>, VideoError> {
        let Some(entry) = self.entries.next() else { return Ok(None) };
        let (id, name) = (entry.id, entry.name.clone());
        self.current = Some(entry);
        Ok(Some(Frame { id: FrameId(id), name, time_s: f64::from(id) * self.seconds_per_frame }))
    }

    fn image(&mut self) -> Result<RgbImage, VideoError> {
        let entry = self.current.as_ref().expect("image() follows step()");
        let mut image = decode(&entry.path).map_err(|reason| VideoError::Frame {
            path: entry.path.clone(),
            frame: entry.id,
            reason,
        })?;
        image.apply_orientation(entry.orientation);
        let image = image.into_rgb8();
        let (found_width, found_height) = image.dimensions();
        if (found_width, found_height) != entry.size {
            // Occurs only if the file has changed since it was listed.
            let ((width, height), path, frame) = (entry.size, entry.path.clone(), entry.id);
            return Err(VideoError::SizeChanges { path, frame, width, height, found_width, found_height });
        }
        let target = self.targets[entry.camera];
        Ok(if entry.size == target { image } else { resize_rgb(&image, target.0, target.1)? })
    }

    fn num_stepped(&self) -> u32 {
        self.current.as_ref().map_or(0, |entry| entry.id + 1)
    }
}

fn decode(path: &Path) -> Result<DynamicImage, String> {
    reader(path)?.decode().map_err(|e| e.to_string())
}

/// Opens an image file within the memory limit: some decoders read all of it, whatever the image size.
fn reader(path: &Path) -> Result<ImageReader<BufReader<File>>, String> {
    let file = files::open_within_memory(path).map_err(|e| e.to_string())?;
    let mut reader = ImageReader::new(BufReader::new(file));
    ImageFormat::from_path(path).into_iter().for_each(|format| reader.set_format(format));
    reader.with_guessed_format().map_err(|e| e.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_sort_in_natural_order() {
        let mut names = ["img10.png", "img9.png", "img009.png", "a.png", "img10a.png", "img2.jpg", "img.png"];
        names.sort_by(|a, b| natural_cmp(a, b));
        assert_eq!(names, ["a.png", "img.png", "img2.jpg", "img009.png", "img9.png", "img10.png", "img10a.png"]);
    }

    #[test]
    fn rotated_images_give_a_warning_with_a_remedy() {
        let entry = |id: u32, orientation| {
            let name = format!("{id}.jpg");
            Entry { id, path: Path::new("photos").join(&name), name, orientation, size: (8, 6), camera: 0 }
        };
        let stored = entry(0, Orientation::NoTransforms);
        assert_eq!(turned(std::slice::from_ref(&stored)), None);
        let said = turned(&[stored, entry(1, Orientation::Rotate90)]).unwrap().text;
        assert!(said.contains("1.jpg: 1 of 2") && said.contains("auto-orient"), "{said}");
    }

    #[test]
    fn images_of_unsupported_formats_give_a_warning() {
        let folder = tempfile::tempdir().unwrap();
        RgbImage::new(8, 6).save(folder.path().join("1.png")).unwrap();
        let warnings = || list(folder.path(), Turning::Auto, Cameras::One).unwrap().warnings;
        // A raw file of the same image, a clip of the same still.
        for name in ["1.DNG", "1.MOV", "notes.txt"] {
            fs::write(folder.path().join(name), b"x").unwrap();
        }
        assert_eq!(warnings(), []);
        for name in ["10.HEIC", "9.HEIC"] {
            fs::write(folder.path().join(name), b"x").unwrap();
        }
        let said = warnings();
        assert!(
            said.len() == 1 && said[0].text.contains("2 images skipped") && said[0].text.contains("9.HEIC"),
            "{said:?}"
        );
    }

    #[test]
    fn images_in_subfolders_have_the_names_of_both() {
        let root = tempfile::tempdir().unwrap();
        let image = RgbImage::new(8, 6);
        for (folder, name) in [("b", "0.png"), ("a", "1.png"), ("a", "0.png")] {
            fs::create_dir_all(root.path().join(folder)).unwrap();
            image.save(root.path().join(folder).join(name)).unwrap();
        }
        let names = || {
            list(root.path(), Turning::Auto, Cameras::One)
                .unwrap()
                .entries
                .into_iter()
                .map(|entry| entry.name)
                .collect::<Vec<_>>()
        };
        assert_eq!(names(), ["a/0.png", "a/1.png", "b/0.png"]);
        image.save(root.path().join("top.png")).unwrap();
        assert_eq!(names(), ["top.png"]);
    }

    #[test]
    fn names_leave_room_for_mask_names() {
        let root = tempfile::tempdir().unwrap();
        let name = |length: usize| format!("{}.png", "n".repeat(length - 4));
        [251, 252, 255].iter().for_each(|length| RgbImage::new(8, 6).save(root.path().join(name(*length))).unwrap());
        let listing = list(root.path(), Turning::Auto, Cameras::One).unwrap();
        assert_eq!(listing.entries.iter().map(|entry| entry.name.len()).collect::<Vec<_>>(), [251]);
        assert!(
            listing.warnings.len() == 2 && listing.warnings[0].text.contains("at most 251"),
            "{:?}",
            listing.warnings
        );
    }

    #[test]
    fn files_larger_than_memory_are_skipped_unread() {
        let root = tempfile::tempdir().unwrap();
        RgbImage::new(8, 6).save(root.path().join("0.png")).unwrap();
        let heads: [(&str, &[u8]); 3] =
            [("1.jpg", b"\xff\xd8\xff\xe0"), ("2.jpg", b"\0\0\0\x18ftypheic"), ("3.png", b"\x89PNG\r\n\x1a\n")];
        for (name, head) in heads {
            let path = root.path().join(name);
            fs::write(&path, head).unwrap();
            // A sparse file, if the file system supports them.
            if File::options().write(true).open(&path).unwrap().set_len(1 << 43).is_err() {
                return;
            }
        }
        let listing = list(root.path(), Turning::Auto, Cameras::One).unwrap();
        assert_eq!(listing.entries.len(), 1);
        assert!(listing.warnings.iter().all(|warning| warning.text.contains("memory limit")), "{:?}", listing.warnings);
    }
}
