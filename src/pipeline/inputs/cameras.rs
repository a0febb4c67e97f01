//! Cameras of the background's images.
//!
//! A video has one camera. Photographs may have several: one for each combination of size, orientation, camera and
//! focal length in their EXIF data. Where vehicles are detected, and where images are in temporal order, all images
//! must have one size, and one camera is assumed.

use std::collections::BTreeMap;
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::{order, telemetry};
use crate::camera::Camera;
use crate::io::interchange::colmap;
use crate::mapper::Intrinsics;
use crate::pipeline::driver::run::Run;
use crate::pipeline::options::{IntrinsicsSource, not_intrinsics};
use crate::pipeline::{Instances, Options, PipelineError, Result};
use crate::scene::{Frame, FrameId, Warning};
use crate::video::{PictureCamera, Source, focal_px_of_equivalent};

/// A camera before the reconstruction of the background, at the size of its images.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::pipeline) struct InitialCamera {
    pub(in crate::pipeline) camera: Camera,
    pub(in crate::pipeline) origin: CameraOrigin,
    /// Prior standard deviations of its intrinsics.
    pub(in crate::pipeline) known: Intrinsics,
}

/// Opens the input. Images may differ in size if they may be photographs and only the background is reconstructed.
pub(in crate::pipeline) fn open(input: &Path, options: &Options) -> Result<Source> {
    let only_a_model = options.instances == Instances::None && options.background_model.is_none();
    let photographs = only_a_model && order::of_options(options) != Some(true);
    Ok(match photographs {
        true => Source::open_photographs(input, &options.video)?,
        false => Source::open(input, &options.video)?,
    })
}

/// The cameras of the images: one if they are in temporal order. The stage `frames` must be done.
pub(in crate::pipeline) fn initial(run: &Run) -> Result<Vec<InitialCamera>> {
    let taken = taken(run)?;
    let given = of_options(run, taken)?;
    let example = given.iter().flatten().next().copied();
    let logged = if example.is_none() { telemetry::film_focal_mm(run) } else { None };
    let camera = |(taken, given): (&PictureCamera, Option<Camera>)| {
        let (camera, origin) = match given {
            Some(camera) => (camera, CameraOrigin::Given),
            None => {
                let (camera, origin) = unknown_camera(taken, &order::found(run)?, logged);
                let derived =
                    example.filter(|_| origin == CameraOrigin::Guess).map(|given| guess_from_given(&given, taken));
                (derived.unwrap_or(camera), origin)
            }
        };
        let known = match origin {
            CameraOrigin::Given => run.options.intrinsics_std,
            CameraOrigin::Exif => Intrinsics::STATED,
            CameraOrigin::Log => Intrinsics::LOGGED,
            CameraOrigin::Guess => Intrinsics::GUESSED,
        };
        Ok(InitialCamera { camera, origin, known })
    };
    taken.iter().zip(given).map(camera).collect()
}

/// Guesses the camera of images without metadata if another camera is given. They may be reduced or rotated images of
/// that camera, so its field of view, pixel aspect ratio and distortion are used.
fn guess_from_given(given: &Camera, pictures: &PictureCamera) -> Camera {
    let (width, height) = (pictures.width, pictures.height);
    let scale = f64::from(width.max(height)) / f64::from(given.width.max(given.height));
    let [fx, fy] = given.focal.map(|focal| focal * scale);
    let is_turned = (given.width > given.height) != (width > height);
    Camera {
        focal: if is_turned { [fy, fx] } else { [fx, fy] },
        radial: given.radial,
        ..Camera::prior_of_photograph(width, height)
    }
}

fn of_options(run: &Run, taken: &[PictureCamera]) -> Result<Vec<Option<Camera>>> {
    match &run.options.intrinsics {
        Some(given) => given_cameras(given, taken),
        None => Ok(vec![None; taken.len()]),
    }
}

/// The cameras given by the options, before any stage, without consecutive duplicates.
pub(in crate::pipeline) fn given(run: &Run) -> Result<Vec<Camera>> {
    let mut given: Vec<Camera> = of_options(run, run.source.cameras())?.into_iter().flatten().collect();
    given.dedup();
    Ok(given)
}

/// The first camera, that of all images where vehicles are detected.
pub(in crate::pipeline) fn first(run: &Run) -> Result<InitialCamera> {
    let path = run.input().display();
    initial(run)?.first().copied().ok_or_else(|| PipelineError::Options(format!("{path}: no image in it")))
}

/// Cameras of the used images.
fn taken<'a>(run: &Run<'a>) -> Result<&'a [PictureCamera]> {
    let all = run.source.cameras();
    let is_one = all.len() > 1 && order::found(run)?.in_time;
    Ok(if is_one { &all[..1] } else { all })
}

/// Index into [`initial`] of each frame's camera; frames that are missing belong to the first camera.
pub(in crate::pipeline) fn of_frames(run: &Run) -> Result<BTreeMap<FrameId, usize>> {
    let of_camera = |(camera, taken): (usize, &PictureCamera)| {
        taken.frames.iter().map(|&frame| (frame, camera)).collect::<Vec<_>>()
    };
    Ok(taken(run)?.iter().enumerate().flat_map(of_camera).collect())
}

/// Removes the frames of a video whose size differs from the first one, with a warning for each.
pub(in crate::pipeline) fn of_one_size(source: &Source, mut frames: Vec<Frame>) -> (Vec<Frame>, Vec<Warning>) {
    let mut warnings = Vec::new();
    frames.retain(|frame| {
        let reason = source.of_another_size(frame);
        let is_alike = reason.is_none();
        warnings.extend(reason);
        is_alike
    });
    (frames, warnings)
}

/// Images of several sizes that `--intrinsics` does not cover.
pub(in crate::pipeline) fn not_covered(run: &Run, cameras: &[InitialCamera]) -> Option<String> {
    let is_given = |camera: &&InitialCamera| camera.origin == CameraOrigin::Given;
    let open = cameras.iter().zip(taken(run).ok()?).find(|(camera, _)| !is_given(camera))?;
    cameras.iter().find(is_given)?;
    let num_open = cameras.iter().filter(|camera| !is_given(camera)).count();
    let first = open.1.frames.first().and_then(|id| run.frames().ok()?.iter().find(|frame| frame.id == *id));
    let name = first.map_or("", |frame| frame.name.as_str());
    Some(format!(
        "--intrinsics: {num_open} of the {} cameras not covered, the first took {name} ({}x{} pixels); they are \
         estimated with the background, or give a cameras.txt with one camera per image size",
        cameras.len(),
        open.1.source_width,
        open.1.source_height
    ))
}

/// The given cameras at the size of the images; `None` for images that they do not cover. Four or six numbers describe
/// the images of the first size. A file has a camera for each size that it covers. If it has only one camera, whose
/// size matches no image, this camera is scaled to the first size.
fn given_cameras(intrinsics: &IntrinsicsSource, taken: &[PictureCamera]) -> Result<Vec<Option<Camera>>> {
    let source_size = |pictures: &PictureCamera| (pictures.source_width, pictures.source_height);
    let Some(first) = taken.first().map(source_size) else { return Ok(Vec::new()) };
    let of_first = |camera: Camera| {
        let at_size = |pictures: &PictureCamera| {
            (source_size(pictures) == first).then(|| camera.resized(pictures.width, pictures.height))
        };
        taken.iter().map(at_size).collect()
    };
    let path = match intrinsics {
        IntrinsicsSource::Given(values) => {
            let camera = Camera::prior(first.0, first.1).with_parameters(values);
            return camera.map(of_first).ok_or_else(|| PipelineError::Options(not_intrinsics(values.len())));
        }
        IntrinsicsSource::File(path) => path,
    };
    let cameras: Vec<Camera> = colmap::read_cameras(path)?.into_values().collect();
    let given: Vec<Option<Camera>> =
        taken.iter().map(|pictures| of_size(path, &cameras, pictures)).collect::<Result<_, _>>()?;
    match (given.iter().any(Option::is_some), cameras.as_slice()) {
        (true, _) => Ok(given),
        (false, [only]) => Ok(of_first(*only)),
        (false, _) => {
            Err(not_one(path, format!("none of its {} is for {}x{} pixels", cameras.len(), first.0, first.1)))
        }
    }
}

fn not_one(path: &Path, problem: String) -> PipelineError {
    let path = path.display();
    PipelineError::Options(format!("{path}: expected exactly one camera, or one per image size; {problem}"))
}

/// The only camera of a file with the size of the images, as stored or as decoded.
fn of_size(path: &Path, cameras: &[Camera], pictures: &PictureCamera) -> Result<Option<Camera>> {
    let sizes = [(pictures.source_width, pictures.source_height), (pictures.width, pictures.height)];
    for (width, height) in sizes {
        let mut found = cameras.iter().filter(|camera| (camera.width, camera.height) == (width, height));
        match (found.next(), found.next()) {
            (Some(camera), None) => return Ok(Some(camera.resized(pictures.width, pictures.height))),
            (Some(_), Some(_)) => return Err(not_one(path, format!("several are for {width}x{height} pixels"))),
            (None, _) => {}
        }
    }
    Ok(None)
}

/// The camera by the input's metadata, where none is given; a guess depends on the type of images.
///
/// * `film_focal_mm` – 35 mm equivalent focal length by the log of a video.
fn unknown_camera(
    pictures: &PictureCamera,
    order: &order::Order,
    film_focal_mm: Option<f64>,
) -> (Camera, CameraOrigin) {
    let (width, height) = (pictures.width, pictures.height);
    match (pictures.exif_focal_px, film_focal_mm) {
        (Some(focal), _) => (Camera::with_focal(width, height, focal), CameraOrigin::Exif),
        (None, Some(equivalent_mm)) => {
            let focal = focal_px_of_equivalent(equivalent_mm, width, height);
            (Camera::with_focal(width, height, focal), CameraOrigin::Log)
        }
        (None, None) if order.in_time => (Camera::prior(width, height), CameraOrigin::Guess),
        (None, None) => (Camera::prior_of_photograph(width, height), CameraOrigin::Guess),
    }
}

/// Origin of intrinsics.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(in crate::pipeline) enum CameraOrigin {
    /// Given by the user.
    Given,
    /// EXIF data of the photographs.
    Exif,
    /// Log of a drone.
    Log,
    /// Guess without data, [`Camera::prior`] or [`Camera::prior_of_photograph`].
    Guess,
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pictures(source: (u32, u32), given_out: (u32, u32)) -> PictureCamera {
        PictureCamera {
            width: given_out.0,
            height: given_out.1,
            source_width: source.0,
            source_height: source.1,
            exif_focal_px: None,
            frames: Vec::new(),
        }
    }

    #[test]
    fn numbers_describe_images_of_the_first_size() {
        let given = IntrinsicsSource::Given(vec![880.0, 880.0, 480.0, 270.0, 0.0, 0.0]);
        let taken =
            [pictures((960, 540), (480, 270)), pictures((540, 960), (270, 480)), pictures((960, 540), (480, 270))];
        let found = given_cameras(&given, &taken).unwrap();
        let camera = found[0].unwrap();
        assert_eq!((camera.focal, camera.principal), ([440.0; 2], [240.0, 135.0]));
        assert_eq!((found[1], found[2]), (None, Some(camera)));
    }

    #[test]
    fn a_guess_uses_the_field_of_view_of_a_given_camera() {
        let given = Camera { radial: [0.1, 0.0], ..Camera::with_focal(1000, 600, 900.0) };
        let given = Camera { focal: [900.0, 910.0], ..given };
        let turned = guess_from_given(&given, &pictures((300, 500), (300, 500)));
        assert_eq!((turned.focal, turned.principal, turned.radial), ([455.0, 450.0], [150.0, 250.0], [0.1, 0.0]));
        assert_eq!(guess_from_given(&given, &pictures((2000, 900), (1000, 450))).focal, [900.0, 910.0]);
    }

    #[test]
    fn a_file_has_a_camera_for_each_size() {
        let folder = tempfile::tempdir().unwrap();
        let file = |text: &str| {
            let path = folder.path().join("cameras.txt");
            std::fs::write(&path, text).unwrap();
            IntrinsicsSource::File(path)
        };
        let two = "1 PINHOLE 960 540 880 880 480 270\n2 PINHOLE 540 960 700 700 270 480\n";
        let taken =
            [pictures((540, 960), (270, 480)), pictures((100, 80), (100, 80)), pictures((960, 540), (480, 270))];
        let found = given_cameras(&file(two), &taken).unwrap();
        let focal = |k: usize| found[k].map(|camera: Camera| camera.focal[0]);
        assert_eq!([focal(0), focal(1), focal(2)], [Some(350.0), None, Some(440.0)]);
        // A single camera of another size describes the first images, scaled.
        let one = given_cameras(&file("1 PINHOLE 1080 1920 1400 1400 540 960\n"), &taken).unwrap();
        assert_eq!((one[0].map(|camera| camera.focal[0]), one[1]), (Some(350.0), None));
        let twice = "1 PINHOLE 540 960 880 880 270 480\n2 PINHOLE 540 960 700 700 270 480\n";
        for (text, expected) in
            [(twice, "several are for 540x960"), ("1 PINHOLE 9 9 9 9 4 4\n2 PINHOLE 8 8 9 9 4 4\n", "none of its 2")]
        {
            let error = given_cameras(&file(text), &taken).unwrap_err().to_string();
            assert!(error.contains(expected) && error.contains("cameras.txt"), "{error}");
        }
    }

    #[test]
    fn an_unknown_camera_is_stated_or_guessed() {
        let pictures = |exif_focal_px| PictureCamera {
            width: 480,
            height: 270,
            source_width: 960,
            source_height: 540,
            exif_focal_px,
            frames: Vec::new(),
        };
        for (in_time, expected) in [(true, 360.0), (false, 480.0)] {
            let order = order::Order { in_time, followed_share: None };
            let (camera, origin) = unknown_camera(&pictures(None), &order, Some(35.3));
            assert_eq!((camera.focal, origin), ([480.0; 2], CameraOrigin::Log));
            let (camera, origin) = unknown_camera(&pictures(None), &order, None);
            assert_eq!((camera.focal, origin), ([expected; 2], CameraOrigin::Guess));
            let (camera, origin) = unknown_camera(&pictures(Some(500.0)), &order, Some(35.3));
            assert_eq!((camera.focal, origin), ([500.0; 2], CameraOrigin::Exif));
        }
    }
}
