//! `tracks.csv`: after a line with the version, one observation a line, its fields separated by tabs: image, track,
//! feature, normalized x and y, scale, red, green, blue, and from version 2 on segmentation and instance
//! (`opensfm/src/map`).

use std::collections::BTreeMap;
use std::io::Write;
use std::path::Path;

use nalgebra::Point2;

use crate::io::IoError;
use crate::io::interchange::words::Text;
use crate::scene::{ImageId, Reconstruction};

const VERSIONS: [&str; 2] = ["OPENSFM_TRACKS_VERSION_v1", "OPENSFM_TRACKS_VERSION_v2"];

/// Observations of the tracks' points, pixels; by the name of the track.
pub type Tracks = BTreeMap<String, Vec<(ImageId, Point2<f64>)>>;

/// Reads the observations by track, in images of the model; none if the file is missing.
pub fn read(path: &Path, model: &Reconstruction) -> Result<Tracks, IoError> {
    let mut seen = Tracks::new();
    if !path.is_file() {
        return Ok(seen);
    }
    let text = Text::read_file(path)?;
    let images: BTreeMap<&str, (ImageId, [f64; 2])> = model
        .images
        .iter()
        .map(|(id, image)| {
            let camera = model.camera_of(image);
            (image.name.as_str(), (*id, [f64::from(camera.width), f64::from(camera.height)]))
        })
        .collect();
    let mut records = text.records();
    let version = records.next().map_or("", |(_, line)| line);
    if !VERSIONS.contains(&version) {
        return Err(text.error(1, "version", format!("'{version}' is neither {}", VERSIONS.join(" nor "))));
    }
    for (line, record) in records {
        let fields: Vec<&str> = record.split('\t').collect();
        let [image, track, _feature, x, y, ..] = fields[..] else {
            return Err(text.error(line, "observation", "fewer than five fields"));
        };
        let number = |field: &str, word: &str| {
            let value = word.parse::<f64>().ok().filter(|value| value.is_finite());
            value.ok_or_else(|| text.error(line, field, format!("'{word}' is not a finite number")))
        };
        let (x, y) = (number("x", x)?, number("y", y)?);
        let Some((id, [width, height])) = images.get(image) else { continue };
        let side = width.max(*height);
        seen.entry(track.to_owned())
            .or_default()
            .push((*id, Point2::new(x * side + width / 2.0, y * side + height / 2.0)));
    }
    Ok(seen)
}

/// Writes the observations of points only, image by image.
pub fn write(out: &mut dyn Write, model: &Reconstruction) -> std::io::Result<()> {
    writeln!(out, "{}", VERSIONS[1])?;
    for image in model.images.values() {
        let camera = model.camera_of(image);
        let [width, height] = [camera.width, camera.height].map(f64::from);
        let side = width.max(height);
        for (feature, observation) in image.observations.iter().enumerate() {
            let Some((id, point)) = observation.point.and_then(|id| Some((id, model.points.get(&id)?))) else {
                continue;
            };
            let x = (observation.pixel.x - width / 2.0) / side;
            let y = (observation.pixel.y - height / 2.0) / side;
            let [r, g, b] = point.rgb;
            // OpenSfM requires a scale, which is unknown. −1 means no segmentation and no instance.
            writeln!(out, "{}\t{}\t{feature}\t{x}\t{y}\t{}\t{r}\t{g}\t{b}\t-1\t-1", image.name, id.0, 1.0 / side)?;
        }
    }
    Ok(())
}
