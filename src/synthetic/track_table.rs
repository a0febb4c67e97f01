//! Track tables filled with made-up observations.

use nalgebra::Point2;

use crate::features::tracks::{Feature, Track, TrackTable, View};
use crate::scene::ImageId;

/// Returns a table of views without observations. Image ids count from 1 in time.
pub fn empty_table(num_views: usize) -> TrackTable {
    let view = |k: usize| View {
        image: ImageId(k as u32 + 1),
        name: format!("{k:06}.jpg"),
        camera: 0,
        pixels: Vec::new(),
        rgb: Vec::new(),
        whitening: Vec::new(),
    };
    TrackTable { views: (0..num_views).map(view).collect(), tracks: Vec::new() }
}

/// Adds an observation to a view of the table and to a track.
pub fn observe(table: &mut TrackTable, track: &mut Track, view: usize, pixel: Point2<f64>) {
    let source = &mut table.views[view];
    track.push(Feature { view: view as u32, feature: source.pixels.len() as u32 });
    source.pixels.push(pixel);
    source.rgb.push([120; 3]);
}
