//! The strip of pictures.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use serde::Serialize;

use crate::report::data::Data;
use crate::report::overlay::{Label, css_colour, object_colour, spread};
use crate::report::timeline::Timeline;

/// Bytes of JPEG in the strip; pictures are left out to keep to it.
const MAX_STRIP_BYTES: usize = 5 << 19;

/// A picture of the strip.
#[derive(Debug, Serialize)]
pub(super) struct Picture {
    frame: u32,
    time: f64,
    /// Its moment, as it is reported.
    stamp: String,
    name: String,
    width: u32,
    height: u32,
    jpeg: String,
    labels: Vec<PictureLabel>,
}

#[derive(Debug, Serialize)]
struct PictureLabel {
    id: u32,
    colour: String,
    left: f64,
    top: f64,
}

/// The pictures that fit; `notes` says what was left out.
pub(super) fn strip(data: &Data, timeline: &Timeline, notes: &mut Vec<String>) -> Vec<Picture> {
    let total: usize = data.strip.iter().map(|t| t.jpeg.len()).sum();
    let limit = if total > MAX_STRIP_BYTES { data.strip.len() * MAX_STRIP_BYTES / total } else { data.strip.len() };
    let chosen = spread(data.strip.len(), limit.max(1));
    if chosen.len() < data.frames.len() && !chosen.is_empty() {
        notes.push(format!("The frame strip shows {} of {} frames, evenly spaced.", chosen.len(), data.frames.len()));
    }
    let picture = |i: usize| {
        let thumbnail = &data.strip[i];
        let frame = data.frames.iter().find(|f| f.id == thumbnail.frame);
        let label = |l: &Label| PictureLabel {
            id: l.object.0,
            colour: css_colour(object_colour(l.object)),
            left: (l.x * 1000.0).round() / 10.0,
            top: (l.y * 1000.0).round() / 10.0,
        };
        Picture {
            frame: thumbnail.frame.0,
            time: timeline.of(thumbnail.frame).unwrap_or_default(),
            stamp: timeline.stamp(thumbnail.frame),
            name: frame.map_or_else(String::new, |f| f.name.clone()),
            width: thumbnail.width,
            height: thumbnail.height,
            jpeg: STANDARD.encode(&thumbnail.jpeg),
            labels: thumbnail.labels.iter().map(label).collect(),
        }
    };
    chosen.into_iter().map(picture).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::{Thumbnail, testing};
    use crate::scene::FrameId;

    #[test]
    fn the_strip_keeps_to_its_budget() {
        let mut world = testing::world();
        let heavy = Thumbnail { frame: FrameId(0), width: 4, height: 3, jpeg: vec![7; 1 << 20], labels: Vec::new() };
        world.strip = vec![heavy; 20];
        let mut notes = Vec::new();
        let data = world.data();
        assert_eq!(strip(&data, &Timeline::new(&data), &mut notes).len(), 2);
        assert_eq!(notes.len(), 1);
    }
}
