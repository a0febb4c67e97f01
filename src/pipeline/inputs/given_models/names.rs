//! Assignment of the images of a given model to frames.

use std::collections::BTreeMap;
use std::path::Path;

use crate::pipeline::{PipelineError, Result};
use crate::scene::{Frame, Image, ImageId, Reconstruction, Topic, Warning};

/// The model restricted to images that are frames, with the frames' ids and names, and notes on the other images.
/// Cameras and points without a frame are removed.
///
/// An image belongs to the frame with its name, else with its stem, else with its stem as index. If no frame matches,
/// the same is tried with the names without folders.
///
/// # Errors
/// [`PipelineError::Options`] if no image is a frame, or two images are the same frame.
pub(super) fn with_frame_ids(
    path: &Path,
    mut model: Reconstruction,
    frames: &[Frame],
) -> Result<(Reconstruction, Vec<Warning>)> {
    let frame_of = frames_of(&model.images, frames);
    if frame_of.is_empty() {
        return Err(PipelineError::Options(nothing_in_common(path, &model, frames)));
    }
    check_unique(path, &model.images, &frame_of)?;
    let remarks = [left_out(path, &model.images, &frame_of), counted_from_one(path, &model.images, frames)];
    let images = std::mem::take(&mut model.images);
    for (id, mut image) in images {
        if let Some(frame) = frame_of.get(&id) {
            image.name.clone_from(&frame.name);
            model.images.insert(frame.id.into(), image);
        }
    }
    let used: Vec<_> = model.images.values().map(|image| image.camera).collect();
    model.cameras.retain(|id, _| used.contains(id));
    model.camera_forms.retain(|id, _| used.contains(id));
    for point in model.points.values_mut() {
        point.track.retain_mut(|element| match frame_of.get(&element.image) {
            Some(frame) => {
                element.image = frame.id.into();
                true
            }
            None => false,
        });
    }
    model.points.retain(|_, point| !point.track.is_empty());
    Ok((model, remarks.into_iter().flatten().map(|text| Topic::GivenModelDoesNotFit.warning(text)).collect()))
}

/// The file name without folders; both kinds of separators count.
fn file_name(name: &str) -> &str {
    name.rsplit(['/', '\\']).next().unwrap_or(name)
}

fn stem(name: &str) -> &str {
    name.rsplit_once('.').map_or(name, |(stem, _)| stem)
}

/// The number in a numeric stem, without leading zeros; else the stem.
fn index(name: &str) -> String {
    stem(name).parse::<u32>().map_or_else(|_| stem(name).to_owned(), |index| index.to_string())
}

fn frames_of<'a>(images: &BTreeMap<ImageId, Image>, frames: &'a [Frame]) -> BTreeMap<ImageId, &'a Frame> {
    let of_frame = |frame: &Frame| [frame.name.clone(), frame.stem().to_owned(), frame.id.0.to_string()];
    let of_name = |name: &str| [name.to_owned(), stem(name).to_owned(), index(name)];
    let found = |is_whole: bool, key: usize| -> BTreeMap<ImageId, &'a Frame> {
        let by_key: BTreeMap<String, &Frame> =
            frames.iter().map(|frame| (of_frame(frame)[key].clone(), frame)).collect();
        let key_of =
            |image: &Image| of_name(if is_whole { image.name.as_str() } else { file_name(&image.name) })[key].clone();
        images.iter().filter_map(|(&id, image)| Some((id, *by_key.get(&key_of(image))?))).collect()
    };
    let tried = [true, false].into_iter().flat_map(|is_whole| [0, 1, 2].map(|key| (is_whole, key)));
    tried.map(|(is_whole, key)| found(is_whole, key)).find(|found| !found.is_empty()).unwrap_or_default()
}

fn nothing_in_common(path: &Path, model: &Reconstruction, frames: &[Frame]) -> String {
    let image = model.images.values().next().map_or("", |image| image.name.as_str());
    let frame = frames.first().map_or("", |frame| frame.name.as_str());
    format!(
        "{}: none of its {} images is a frame of the input: its first image is '{image}', the first frame '{frame}'; \
         rename its images like the frames (or by their index from 0)",
        path.display(),
        model.images.len()
    )
}

fn check_unique(path: &Path, images: &BTreeMap<ImageId, Image>, frame_of: &BTreeMap<ImageId, &Frame>) -> Result<()> {
    let mut taken: BTreeMap<&str, &str> = BTreeMap::new();
    for (id, frame) in frame_of {
        let name = images.get(id).map_or("", |image| image.name.as_str());
        if let Some(other) = taken.insert(&frame.name, name) {
            return Err(PipelineError::Options(format!(
                "{}: its images '{other}' and '{name}' would both be frame '{}'; remove one of them from the model",
                path.display(),
                frame.name
            )));
        }
    }
    Ok(())
}

fn left_out(path: &Path, images: &BTreeMap<ImageId, Image>, frame_of: &BTreeMap<ImageId, &Frame>) -> Option<String> {
    let (num_images, num_left_out) = (images.len(), images.len() - frame_of.len());
    let path = path.display();
    (num_left_out > 0)
        .then(|| format!("{path}: {num_left_out} of {num_images} images skipped: not frames of the input"))
}

/// Tools that extract frames from a video count from 1: each image would be assigned to the frame after its own.
fn counted_from_one(path: &Path, images: &BTreeMap<ImageId, Image>, frames: &[Frame]) -> Option<String> {
    let number = |name: &str| stem(file_name(name)).parse::<u32>().ok();
    let numbers: Vec<u32> = images.values().filter_map(|image| number(&image.name)).collect();
    let of_frames: Vec<u32> = frames.iter().filter_map(|frame| number(&frame.name)).collect();
    let (smallest, largest) = (numbers.iter().min()?, numbers.iter().max()?);
    let is_shifted = of_frames.iter().min() == Some(&0)
        && *smallest == 1
        && of_frames.iter().max().and_then(|last| last.checked_add(1)) == Some(*largest);
    is_shifted.then(|| {
        let path = path.display();
        format!(
            "{path}: images seem to be numbered from 1, frames are from 0; if so, each is assigned to the following \
             frame: number them from 0 (ffmpeg: -start_number 0)"
        )
    })
}

#[cfg(test)]
mod tests {
    use nalgebra::{Point2, Point3};

    use super::*;
    use crate::math::Rigid3;
    use crate::scene::{CameraId, FrameId, Observation, Point3d, Point3dId, TrackElement};

    fn model(names: &[&str]) -> Reconstruction {
        let mut model = Reconstruction::default();
        let mut track = Vec::new();
        for (k, name) in (10u32..).zip(names) {
            let observations = vec![Observation { pixel: Point2::new(1.0, 2.0), point: Some(Point3dId(5)) }];
            let image = Image {
                name: (*name).to_owned(),
                camera: CameraId(1),
                cam_from_world: Rigid3::identity(),
                observations,
            };
            model.images.insert(ImageId(k), image);
            track.push(TrackElement { image: ImageId(k), observation_idx: 0 });
        }
        let point = Point3d { position: Point3::origin(), rgb: [0; 3], error_px: 0.5, track };
        model.points.insert(Point3dId(5), point);
        model
    }

    fn frames() -> Vec<Frame> {
        (0..4).map(|k| Frame { id: FrameId(k), name: format!("{k:06}.jpg"), time_s: 0.0 }).collect()
    }

    fn matched(names: &[&str]) -> Result<(Reconstruction, Vec<Warning>), String> {
        with_frame_ids(Path::new("m"), model(names), &frames()).map_err(|error| error.to_string())
    }

    #[test]
    fn images_of_given_models_become_frames() {
        for names in [
            ["000002.jpg", "000000.jpg", "x.jpg"],
            ["000002.png", "000000.png", "x"],
            ["2.jpg", "0.jpg", "7.jpg"],
            ["images/000002.jpg", "images/000000.jpg", "images/x.jpg"],
            ["a\\2.png", "a\\0.png", "a\\x.png"],
        ] {
            let (found, remarks) = matched(&names).unwrap();
            assert_eq!(found.images.keys().map(|id| id.0).collect::<Vec<_>>(), [1, 3], "{names:?}");
            assert_eq!(found.images[&ImageId(3)].name, "000002.jpg");
            let track = &found.points[&Point3dId(5)].track;
            assert_eq!(track.iter().map(|element| element.image.0).collect::<Vec<_>>(), [3, 1]);
            assert!(remarks.len() == 1 && remarks[0].text.contains("1 of 3 images skipped"), "{remarks:?}");
        }
    }

    #[test]
    fn names_without_a_frame_are_rejected() {
        let said = matched(&["frame_00001.png", "frame_00002.png"]).unwrap_err();
        assert!(said.contains("'frame_00001.png'") && said.contains("'000000.jpg'"), "{said}");
        let said = matched(&["a/000001.jpg", "b/000001.jpg"]).unwrap_err();
        assert!(said.contains("'a/000001.jpg' and 'b/000001.jpg'"), "{said}");
    }

    #[test]
    fn images_counted_from_one_are_reported() {
        let (_, remarks) = matched(&["1.png", "2.png", "3.png", "4.png"]).unwrap();
        assert!(remarks.iter().any(|remark| remark.text.contains("numbered from 1")), "{remarks:?}");
        assert!(matched(&["1.png", "2.png", "3.png"]).unwrap().1.is_empty());
    }
}
