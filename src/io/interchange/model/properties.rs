//! Properties of every model and format: a round trip preserves it, and damage never panics.

use proptest::prelude::*;

use super::{Format, files_of, read, write};
use crate::camera::Camera;
use crate::io::interchange::colmap;
use crate::io::testing::{model_with, near, near_but_for_sizes};
use crate::math::Sim3;
use crate::scene::Reconstruction;

/// Few cases, since each writes and reads files.
fn few(cases: u32) -> ProptestConfig {
    ProptestConfig { cases, failure_persistence: None, ..ProptestConfig::default() }
}

/// Focal length, principal point near the center, k₁, k₂, p₁, p₂, k₃, in ranges valid for any camera within the image.
fn lens() -> impl Strategy<Value = [f64; 8]> {
    let small = -2e-3..2e-3;
    (400.0..2000.0, -9.0..9.0, -9.0..9.0, -0.1..0.1, -0.02..0.02, small.clone(), small, -5e-3..5e-3)
        .prop_map(|(f, x, y, k1, k2, p1, p2, k3)| [f, x, y, k1, k2, p1, p2, k3])
}

/// The camera with as many distortion terms as a format has, zeros for the rest.
fn camera([f, x, y, k1, k2, p1, p2, k3]: [f64; 8], terms: usize, middle: bool) -> Camera {
    let [x, y] = if middle { [0.0; 2] } else { [x, y] };
    let mut all = [f, f, 480.0 + x, 270.0 + y, k1, k2, p1, p2, k3];
    all[4 + terms..].fill(0.0);
    Camera::prior(960, 540).with_parameters(&all).unwrap()
}

/// The small test model with this camera, somewhere in space.
fn model(camera: Camera, place: [f64; 6], scale: f64) -> Reconstruction {
    let [rx, ry, rz, x, y, z] = place;
    let turn = nalgebra::UnitQuaternion::from_euler_angles(rx, ry, rz);
    let mut model = model_with(&[camera]);
    model.transform(&Sim3::new(scale, turn, nalgebra::Vector3::new(x, y, z)));
    model
}

fn back(model: &Reconstruction, format: Format, name: &str) -> Reconstruction {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join(name);
    write(&place, model, format).unwrap();
    let (found, detected) = read(&place).unwrap();
    assert_eq!(detected, format);
    found
}

/// Text that is sometimes a number.
fn noise() -> impl Strategy<Value = Vec<u8>> {
    prop_oneof![
        proptest::collection::vec(any::<u8>(), 0..9),
        proptest::sample::select(vec!["nan", "1e999", "-1", "18446744073709551615", "4294967295", "", "[]", "\n"])
            .prop_map(|word| word.as_bytes().to_vec()),
    ]
}

/// A format that is written, and the file of it that is damaged.
fn written_files() -> impl Strategy<Value = (Format, usize)> {
    let count = |format| if matches!(format, Format::ColmapText | Format::ColmapBinary) { 3usize } else { 1 };
    let formats = [
        Format::ColmapText,
        Format::ColmapBinary,
        Format::OpenMvg,
        Format::OpenSfm,
        Format::Nerfstudio,
        Format::Nvm,
        Format::Bundler,
    ];
    proptest::sample::select(formats.to_vec()).prop_flat_map(move |format| (Just(format), 0..count(format)))
}

proptest! {
    #![proptest_config(few(24))]

    #[test]
    fn any_model_round_trips(lens in lens(), place in prop::array::uniform6(-3.0..3.0), scale in 0.1..10.0) {
        let whole = model(camera(lens, 5, false), place, scale);
        near(&back(&whole, Format::OpenMvg, "sfm_data.json"), &whole, 1e-8);
        // There, ids are indices in the order of names.
        let mut ordered = whole.clone();
        ordered.images.iter_mut().for_each(|(id, image)| image.name = format!("{}/{}", id.0, image.name));
        near_but_for_sizes(&back(&ordered, Format::OpenSfm, "reconstruction.json"), &ordered, 1e-8);
        let mut named = whole.clone();
        named.images.values_mut().for_each(|image| image.name = image.name.replace(' ', "_"));
        for format in [Format::ColmapText, Format::ColmapBinary] {
            let found = back(&named, format, "model");
            prop_assert_eq!(&found.cameras, &named.cameras);
            prop_assert_eq!(&found.images, &named.images);
            prop_assert_eq!(&found.points, &named.points);
        }
        let two_terms = model(camera(lens, 2, true), place, scale);
        near_but_for_sizes(&back(&two_terms, Format::Bundler, "bundle.out"), &two_terms, 1e-8);
        let pinhole = model(camera(lens, 0, true), place, scale);
        near_but_for_sizes(&back(&pinhole, Format::Nvm, "model.nvm"), &pinhole, 1e-8);
    }
}

/// Of a number that is finite, and what follows from it is not.
#[test]
fn numbers_too_large_to_compute_with_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("sfm_data.json");
    write(&path, &model_with(&[Camera::with_focal(960, 540, 700.0)]), Format::OpenMvg).unwrap();
    let mut document: serde_json::Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    document["structure"][0]["value"]["observations"][0]["value"]["x"][0] = serde_json::json!(1e308);
    std::fs::write(&path, document.to_string()).unwrap();
    let error = read(&path).unwrap_err().to_string();
    assert!(error.contains("point 1 is not finite"), "{error}");
}

proptest! {
    #![proptest_config(few(256))]

    /// Nothing panics, and a model that was read can be written and read again.
    #[test]
    fn damage_is_refused_or_read(
        (format, file) in written_files(),
        at in 0.0..1.0,
        length in 0usize..40,
        noise in noise(),
        cut in any::<bool>(),
    ) {
        let folder = tempfile::tempdir().unwrap();
        let place = folder.path().join(if format == Format::Bundler { "bundle.out" } else { "model" });
        let mut whole = model_with(&[Camera::with_focal(960, 540, 700.0)]);
        whole.images.values_mut().for_each(|image| image.name = image.name.replace(' ', "_"));
        write(&place, &whole, format).unwrap();
        let path = &files_of(&place, format)[file];
        let mut bytes = std::fs::read(path).unwrap();
        let start = (at * bytes.len() as f64) as usize;
        let end = if cut { bytes.len() } else { (start + length).min(bytes.len()) };
        bytes.splice(start..end, noise);
        std::fs::write(path, bytes).unwrap();
        if let Ok((found, _)) = read(&place) {
            let copy = folder.path().join("copy");
            if colmap::write_binary(&copy, &found).is_ok() {
                prop_assert_eq!(colmap::read_any(&copy).unwrap().images, found.images);
            }
        }
    }
}
