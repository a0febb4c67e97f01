//! Tables of the reconstructions: their sizes, residuals, cameras and images.

use std::collections::BTreeMap;

use serde::Serialize;

use crate::eval::comparison::{ModelFigures, error_of_image, intrinsics_in_figures};
use crate::report::chart::Drawing;
use crate::report::comparison::MAX_ROWS;
use crate::report::comparison::charts::histograms;
use crate::report::data::{Data, Model};
use crate::report::overlay::{css_colour, object_colour};
use crate::report::words::{UNKNOWN, figure, thousands};
use crate::scene::{CameraId, Reconstruction};

/// Maximum number of vehicles with a separate row and line, those with most points.
const MAX_VEHICLES: usize = 9;

/// Models of the page.
#[derive(Debug, Serialize)]
pub(super) struct Models {
    rows: Vec<Row>,
    histograms: Vec<Drawing>,
    /// Number of images and description of the intrinsics of each camera of the background.
    cameras: Vec<[String; 2]>,
    /// Name, observations with a point, and mean residual of each image of the background, the largest first.
    images: Vec<[String; 3]>,
    left_out: usize,
}

/// Figures of one model.
#[derive(Debug, Serialize)]
struct Row {
    name: String,
    colour: String,
    cells: [String; 6],
}

/// `None` without a registered image.
pub(super) fn models(data: &Data, names: &[String]) -> Option<Models> {
    let background = data.background.reconstruction;
    if background.images.is_empty() {
        return None;
    }
    let mut vehicles: Vec<(&String, &Model, String)> = data
        .objects
        .iter()
        .zip(names)
        .filter_map(|(object, name)| Some((name, object.model.as_ref()?, css_colour(object_colour(object.id)))))
        .collect();
    vehicles.sort_by_key(|(_, model, _)| std::cmp::Reverse(model.reconstruction.points.len()));
    vehicles.truncate(MAX_VEHICLES);
    let whole = "Background".to_owned();
    let all = std::iter::once((&whole, &data.background, "var(--camera)".to_owned())).chain(vehicles);
    let found: Vec<(String, ModelFigures, String, usize)> = all
        .map(|(name, model, colour)| {
            (name.clone(), ModelFigures::new(model.reconstruction), colour, model.unregistered.len())
        })
        .collect();
    let sides: Vec<(&str, &ModelFigures, &str)> =
        found.iter().map(|(name, figures, colour, _)| (name.as_str(), figures, colour.as_str())).collect();
    Some(Models {
        histograms: histograms(&sides),
        rows: found.iter().map(|(name, figures, colour, lost)| row(name, figures, colour, *lost)).collect(),
        cameras: cameras(background),
        images: images(background),
        left_out: background.images.len().saturating_sub(MAX_ROWS),
    })
}

fn row(name: &str, figures: &ModelFigures, colour: &str, lost: usize) -> Row {
    let number = |value: Option<f64>| value.map_or_else(|| UNKNOWN.to_owned(), |value| figure(value, 3));
    let errors = figures.reprojection;
    Row {
        name: name.to_owned(),
        colour: colour.to_owned(),
        cells: [
            format!("{} of {}", figures.num_images, figures.num_images + lost),
            thousands(figures.num_points),
            thousands(figures.num_observations),
            number(figures.mean_track_length),
            number(errors.map(|errors| errors.mean_px)),
            number(errors.map(|errors| errors.rms_px)),
        ],
    }
}

fn cameras(model: &Reconstruction) -> Vec<[String; 2]> {
    let mut counts: BTreeMap<CameraId, usize> = BTreeMap::new();
    for image in model.images.values() {
        *counts.entry(image.camera).or_default() += 1;
    }
    let camera =
        |(id, count): (&CameraId, &usize)| Some([thousands(*count), intrinsics_in_figures(model.cameras.get(id)?)]);
    counts.iter().filter_map(camera).take(MAX_ROWS).collect()
}

fn images(model: &Reconstruction) -> Vec<[String; 3]> {
    let mut rows: Vec<(&str, usize, Option<f64>)> = model
        .images
        .values()
        .map(|image| {
            let seen = image.observations.iter().filter(|observation| observation.point.is_some()).count();
            (image.name.as_str(), seen, error_of_image(model, image))
        })
        .collect();
    rows.sort_by(|a, b| b.2.unwrap_or(0.0).total_cmp(&a.2.unwrap_or(0.0)).then(a.0.cmp(b.0)));
    let cells = |(name, seen, error): &(&str, usize, Option<f64>)| {
        [(*name).to_owned(), thousands(*seen), error.map_or_else(|| UNKNOWN.to_owned(), |error| figure(error, 3))]
    };
    rows.iter().take(MAX_ROWS).map(cells).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::testing;

    #[test]
    fn models_have_their_size_their_residuals_and_their_images() {
        let world = testing::world();
        let found = models(&world.data(), &world.names()).unwrap();
        let names: Vec<&str> = found.rows.iter().map(|row| row.name.as_str()).collect();
        assert_eq!(names, ["Background", "car 1"]);
        let images = world.background.images.len();
        assert_eq!(
            (found.rows[0].cells[0].clone(), found.images.len()),
            (format!("{images} of {}", images + 1), images)
        );
        assert_eq!((found.cameras.len(), found.histograms.len()), (1, 2));
        assert!(models(&testing::nothing(&Reconstruction::default()), &[]).is_none());
    }
}
