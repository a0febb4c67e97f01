//! All image points tracked on the background, including those without a 3D point or a pose.

use std::path::Path;

use super::{BACKGROUND, tracks_of};
use crate::features::TrackTable;
use crate::features::tracks::{self, Feature};
use crate::io::interchange::database::{Features, View};
use crate::pipeline::driver::intermediate;
use crate::pipeline::driver::workspace::{marker_name, read_state};
use crate::pipeline::{Marker, Result, Stage};
use crate::scene::{CameraId, TrackElement};

/// The features of the background's frames and their tracks; `None` if the folder has none: it is no output folder, or
/// its background was given.
///
/// # Errors
/// A folder that cannot be read, or a damaged file in it.
pub fn found_features(output: &Path) -> Result<Option<Features>> {
    let marker = read_state::<Marker>(output, &marker_name(Stage::Features)).ok();
    let paths = marker.into_iter().flat_map(|marker| marker.outputs).map(|folder| output.join(folder));
    let path = paths.map(|folder| tracks_of(&folder, BACKGROUND)).find(|path| path.is_file());
    path.map(|path| Ok(features(intermediate::read(&path)?))).transpose()
}

fn features(table: TrackTable) -> Features {
    let element = |feature: &Feature| {
        let image = table.views.get(feature.view as usize)?.image;
        Some(TrackElement { image, observation_idx: feature.feature })
    };
    let tracks = table.tracks.iter().map(|track| track.iter().filter_map(element).collect()).collect();
    let view = |view: tracks::View| {
        let camera = CameraId(view.camera as u32 + 1);
        (view.image, View { name: view.name, camera, pixels: view.pixels })
    };
    Features { views: table.views.into_iter().map(view).collect(), tracks }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use nalgebra::Point2;

    use super::*;
    use crate::pipeline::Cost;
    use crate::scene::ImageId;

    #[test]
    fn the_tracks_of_a_run_are_found_in_its_folder() {
        let folder = tempfile::tempdir().unwrap();
        assert!(found_features(folder.path()).unwrap().is_none());
        let state = folder.path().join(".tractrix/features-0123");
        std::fs::create_dir_all(&state).unwrap();
        let marker = Marker {
            fingerprint: "0123".to_owned(),
            cost: Cost::default(),
            warnings: Vec::new(),
            figures: BTreeMap::new(),
            outputs: vec![".tractrix/features-0123".into()],
        };
        crate::io::atomic::write_json(&folder.path().join(".tractrix/features.json"), &marker).unwrap();
        assert!(found_features(folder.path()).unwrap().is_none());
        let view = |k: u32| tracks::View {
            image: ImageId(k),
            name: format!("{k}.jpg"),
            camera: 0,
            pixels: vec![Point2::new(1.5, 2.5); 3],
            rgb: vec![[0; 3]; 3],
            whitening: Vec::new(),
        };
        let track = vec![Feature { view: 0, feature: 2 }, Feature { view: 1, feature: 0 }];
        let table = TrackTable { views: vec![view(4), view(7)], tracks: vec![track] };
        intermediate::write(&tracks_of(&state, BACKGROUND), &table).unwrap();
        let found = found_features(folder.path()).unwrap().unwrap();
        assert_eq!(found.views.keys().copied().collect::<Vec<_>>(), [ImageId(4), ImageId(7)]);
        let element = |image, observation_idx| TrackElement { image: ImageId(image), observation_idx };
        assert_eq!(found.tracks, [vec![element(4, 2), element(7, 0)]]);
        std::fs::write(state.join("background.bin"), [255; 7]).unwrap();
        let said = found_features(folder.path()).unwrap_err().to_string();
        assert!(said.contains(&format!("delete {}, and", state.display())), "{said}");
    }
}
