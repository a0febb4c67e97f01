//! The strip of frame images, and the film.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use minijinja::{Value, context};
use serde::Serialize;
use serde_json::json;

use crate::report::data::Data;
use crate::report::overlay::{Label, css_colour, object_colour, spread};
use crate::report::pictures::FILM_RATE;
use crate::report::timeline::Timeline;

/// Maximum size of the strip's JPEG data, bytes; images beyond it are omitted.
const MAX_STRIP_BYTES: usize = 5 << 19;

#[derive(Debug, Serialize)]
struct PictureLabel {
    id: u32,
    colour: String,
    left: f64,
    top: f64,
}

/// The film for `page.js`, its MP4 file in base64; `notes` reports omitted frames.
pub(super) fn film(data: &Data, timeline: &Timeline, notes: &mut Vec<String>) -> Option<serde_json::Value> {
    let film = data.pictures.film.as_ref()?;
    if film.frames.len() < data.frames.len() {
        notes.push(format!("The film shows {} of {} frames, evenly spaced.", film.frames.len(), data.frames.len()));
    }
    let times = film.frames.iter().map(|&frame| timeline.of(frame).unwrap_or_default());
    let labels = film.labels.iter().map(|labels| labels.iter().map(PictureLabel::new).collect::<Vec<_>>());
    Some(json!({
        "mp4": STANDARD.encode(&film.mp4),
        "rate": FILM_RATE,
        "width": film.width,
        "height": film.height,
        "times": times.collect::<Vec<_>>(),
        "labels": labels.collect::<Vec<_>>(),
    }))
}

impl PictureLabel {
    fn new(label: &Label) -> Self {
        Self {
            id: label.object.0,
            colour: css_colour(object_colour(label.object)),
            left: (label.x * 1000.0).round() / 10.0,
            top: (label.y * 1000.0).round() / 10.0,
        }
    }
}

/// The images within the size limit; `notes` reports omitted ones.
pub(super) fn strip(data: &Data, timeline: &Timeline, notes: &mut Vec<String>) -> Vec<Value> {
    let total: usize = data.pictures.strip.iter().map(|t| t.jpeg.len()).sum();
    let limit = data.pictures.strip.len() * MAX_STRIP_BYTES / total.max(MAX_STRIP_BYTES);
    let chosen = spread(data.pictures.strip.len(), limit.max(1));
    if chosen.len() < data.frames.len() && !chosen.is_empty() && data.pictures.film.is_none() {
        notes.push(format!("The frame strip shows {} of {} frames, evenly spaced.", chosen.len(), data.frames.len()));
    }
    let picture = |i: usize| {
        let thumbnail = &data.pictures.strip[i];
        let frame = data.frames.iter().find(|f| f.id == thumbnail.frame);
        context! {
            frame => thumbnail.frame.0,
            time => timeline.of(thumbnail.frame).unwrap_or_default(),
            stamp => timeline.stamp(thumbnail.frame),
            name => frame.map_or("", |f| &f.name),
            width => thumbnail.width,
            height => thumbnail.height,
            jpeg => STANDARD.encode(&thumbnail.jpeg),
            labels => thumbnail.labels.iter().map(PictureLabel::new).collect::<Vec<_>>(),
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
    fn strip_respects_its_budget() {
        let mut world = testing::world();
        let heavy = Thumbnail { frame: FrameId(0), width: 4, height: 3, jpeg: vec![7; 1 << 20], labels: Vec::new() };
        world.strip = vec![heavy; 20];
        let mut notes = Vec::new();
        let data = world.data();
        assert_eq!(strip(&data, &Timeline::new(&data), &mut notes).len(), 2);
        assert_eq!(notes.len(), 1);
    }
}
