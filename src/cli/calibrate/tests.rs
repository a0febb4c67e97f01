use std::fs;
use std::path::Path;

use image::{GrayImage, Luma, Rgb, RgbImage};
use serde_json::json;

use super::degrade::write;
use super::variant::Variant;
use crate::io::Sequence;

const FRAMES: u32 = 4;

/// A sequence of grey frames of 40 × 20 pixels with a bright target of 10 × 8.
fn sequence(folder: &Path) -> Sequence {
    let pose = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]];
    for part in ["images", "masks"] {
        fs::create_dir(folder.join(part)).unwrap();
    }
    let is_target = |x: u32, y: u32| (12..22).contains(&x) && (6..14).contains(&y);
    let mut frames = Vec::new();
    for k in 0..FRAMES {
        let name = format!("{k:06}.png");
        let picture = RgbImage::from_fn(40, 20, |x, y| Rgb([if is_target(x, y) { 220 } else { 90 }; 3]));
        picture.save(folder.join("images").join(&name)).unwrap();
        let mask = GrayImage::from_fn(40, 20, |x, y| Luma([u8::from(is_target(x, y))]));
        mask.save(folder.join("masks").join(&name)).unwrap();
        frames.push(json!({
            "index": k, "time_s": 0.1 * f64::from(k),
            "image": format!("images/{name}"), "mask": format!("masks/{name}"),
            "T_world_camera": pose, "T_world_object": pose,
        }));
    }
    let scene = json!({
        "units": "metre", "fps": 10.0, "width": 40, "height": 20,
        "K": [[30.0, 0.0, 20.0], [0.0, 30.0, 10.0], [0.0, 0.0, 1.0]], "frames": frames,
    });
    fs::write(folder.join("scene.json"), scene.to_string()).unwrap();
    fs::write(folder.join("object_mesh.ply"), "not looked at").unwrap();
    Sequence::open(folder).unwrap()
}

/// The variant of the sequence, and the areas of the target's masks in it.
fn made(name: &str) -> (tempfile::TempDir, Sequence, Vec<usize>) {
    let (from, to) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    write(&sequence(from.path()), Variant::parse(name).unwrap(), to.path(), 0).unwrap();
    let made = Sequence::open(to.path()).unwrap();
    let areas = made.frames.iter().map(|frame| made.target_mask(frame).unwrap().area_px2()).collect();
    (to, made, areas)
}

#[test]
fn a_smaller_sequence_has_smaller_masks_and_another_camera() {
    let (folder, made, areas) = made("scale-0.5");
    assert_eq!((made.frame_size(), made.camera.focal, made.camera.principal), ((20, 10), [15.0; 2], [10.0, 5.0]));
    assert_eq!(areas, [20; FRAMES as usize]);
    let picture = image::open(folder.path().join("images/000002.png")).unwrap();
    assert_eq!((picture.width(), picture.height()), (20, 10));
}

#[test]
fn masks_grow_shrink_and_tremble_and_hidden_ones_are_empty() {
    assert_eq!(made("erosion-1").2, [8 * 6; FRAMES as usize]);
    assert!(made("dilation-1").2.iter().all(|area| *area > 10 * 8));
    let (_kept, trembling, areas) = made("jitter-2");
    assert_eq!(areas, [80; FRAMES as usize]);
    let boxes: Vec<_> =
        trembling.frames.iter().map(|frame| trembling.target_mask(frame).unwrap().bounding_box().unwrap()).collect();
    assert!(boxes.iter().any(|bounds| *bounds != boxes[0]), "{boxes:?}");
    let (folder, _, areas) = made("hidden-0.5");
    assert_eq!(areas, [80, 0, 0, 80]);
    let covered = image::open(folder.path().join("images/000001.png")).unwrap().to_rgb8();
    assert!(covered.pixels().all(|pixel| pixel[0] < 200), "the target is still seen");
}

#[test]
fn a_variant_is_the_same_every_time() {
    for name in ["noise-8", "compression-40", "blur-1.5"] {
        let file = |folder: &Path| fs::read_dir(folder.join("images")).unwrap().count();
        let (first, second) = (made(name), made(name));
        assert_eq!(file(first.0.path()), FRAMES as usize);
        for frame in &first.1.frames {
            let bytes = |folder: &Path| fs::read(folder.join(&frame.image)).unwrap();
            assert_eq!(bytes(first.0.path()), bytes(second.0.path()), "{name}");
        }
    }
}
