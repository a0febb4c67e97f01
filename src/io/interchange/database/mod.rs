//! COLMAP's database: image features and their matches, as SQLite tables.
//!
//! The tables are those of COLMAP 3.8 (`src/base/database.cc`), which later versions upgrade when they open one:
//! `cameras`, `images`, `keypoints`, `matches` and `two_view_geometries`; `descriptors` exists and is empty. COLMAP's
//! mapper, `image_registrator` and `point_triangulator` can start from this database.
//!
//! * Keypoints are the features of the images, first pixel center at (0.5, 0.5) as everywhere, in single precision.
//! * Matches are those that tracks imply: any two features of one point. No feature has two matches in one image.
//! * Two-view geometries follow from the poses where both are known, else from the matches (see `geometry`).
//! * `prior_focal_length` is set: the focal lengths of a reconstruction are known.

mod geometry;
mod matches;
mod tables;

use std::collections::BTreeMap;
use std::path::Path;

use nalgebra::Point2;
use rusqlite::Connection;

use super::assembly::check_finite;
use crate::io::{IoError, Losses, atomic};
use crate::scene::{CameraForm, CameraId, ImageId, Reconstruction, TrackElement};

/// Maximum image id of a database, and base of the numbers of image pairs.
const MAX_IMAGES: u64 = 2_147_483_647;

/// Features of an image with or without a pose.
#[derive(Clone, Debug, PartialEq)]
pub struct View {
    /// File name.
    pub name: String,
    /// Its intrinsics.
    pub camera: CameraId,
    /// Feature positions, pixels.
    pub pixels: Vec<Point2<f64>>,
}

/// Features of images and their tracks.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Features {
    /// By image.
    pub views: BTreeMap<ImageId, View>,
    /// Tracks: features of one point each, at most one per image.
    pub tracks: Vec<Vec<TrackElement>>,
}

impl Features {
    /// Features of a reconstruction: the observations of its images and the tracks of its points.
    pub fn of(model: &Reconstruction) -> Self {
        let view = |image: &crate::scene::Image| View {
            name: image.name.clone(),
            camera: image.camera,
            pixels: image.observations.iter().map(|seen| seen.pixel).collect(),
        };
        Self {
            views: model.images.iter().map(|(id, image)| (*id, view(image))).collect(),
            tracks: model.points.values().map(|point| point.track.clone()).collect(),
        }
    }

    /// Adds the other features of a run: images without a pose and tracks without a point. `None` if they are
    /// inconsistent: an image of the model is another image there, or has other features.
    pub fn joined(mut self, others: Self) -> Option<Self> {
        let fits = |(id, own): (&ImageId, &View)| {
            others.views.get(id).is_some_and(|other| own.name == other.name && own.pixels.len() == other.pixels.len())
        };
        if !self.views.iter().all(fits) {
            return None;
        }
        others.views.into_iter().for_each(|(id, view)| {
            self.views.entry(id).or_insert(view);
        });
        self.tracks.extend(others.tracks);
        Some(self)
    }
}

/// Writes a database, whole.
///
/// * `model` – cameras and poses.
/// * `features` – of the model's images and of others; features whose camera is not in the model are skipped.
///
/// # Errors
/// A system error; no features at all; a number that is not finite; a camera without any intrinsics; an image whose id
/// is too large for COLMAP, or two of one name.
pub fn write(path: &Path, model: &Reconstruction, features: &Features) -> Result<Losses, IoError> {
    check(path, model, features)?;
    let views: BTreeMap<ImageId, &View> = features
        .views
        .iter()
        .filter(|(_, view)| model.cameras.contains_key(&view.camera))
        .map(|(id, view)| (*id, view))
        .collect();
    let matches = matches::of_tracks(&views, &features.tracks);
    atomic::write_through(path, |place| {
        fill(place, model, &views, &matches).map_err(|e| IoError::system("write", path)(std::io::Error::other(e)))
    })?;
    let without_camera = features.views.len() - views.len();
    let losses = Losses::default().with("feature positions are rounded to single precision".to_owned());
    Ok(losses
        .counted(
            model.points.len(),
            "3D point skipped: a database stores features and matches only",
            "3D points skipped: a database stores features and matches only",
        )
        .counted(without_camera, "image without a camera skipped", "images without a camera skipped"))
}

fn fill(
    place: &Path,
    model: &Reconstruction,
    views: &BTreeMap<ImageId, &View>,
    matches: &matches::Matches,
) -> rusqlite::Result<()> {
    let mut connection = Connection::open(place)?;
    tables::create(&connection)?;
    let all = connection.transaction()?;
    model.cameras.iter().try_for_each(|(id, camera)| tables::insert_camera(&all, model, *id, camera))?;
    views.iter().try_for_each(|(id, view)| tables::insert_view(&all, *id, view))?;
    for (pair, matched) in matches {
        tables::insert_matches(&all, *pair, matched)?;
        if let Some(geometry) = geometry::of_pair(model, views, *pair, matched) {
            tables::insert_geometry(&all, *pair, &geometry)?;
        }
    }
    all.commit()?;
    connection.close().map_err(|(_, error)| error)
}

fn check(path: &Path, model: &Reconstruction, features: &Features) -> Result<(), IoError> {
    check_finite(path, model)?;
    if features.views.values().all(|view| view.pixels.is_empty()) {
        let cure = "give a model with observations: COLMAP, OpenMVG, OpenSfM, NVM or Bundler";
        return Err(IoError::unsupported(path, "a database from a model without observations", cure));
    }
    if model.camera_forms.values().any(|form| *form == CameraForm::Unknown) {
        return Err(IoError::content(path, "cameras have no intrinsics that can be written"));
    }
    let mut names = BTreeMap::new();
    for (id, view) in &features.views {
        if u64::from(id.0) >= MAX_IMAGES {
            return Err(IoError::content(
                path,
                format!("image {}: id too large, a database has ids below {MAX_IMAGES}", id.0),
            ));
        }
        if let Some(other) = names.insert(view.name.as_str(), id) {
            return Err(IoError::content(
                path,
                format!("images {} and {} have the same name {:?}", other.0, id.0, view.name),
            ));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests;
