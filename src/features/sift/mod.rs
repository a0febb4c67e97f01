//! SIFT keypoints and descriptors.
//!
//! D. Lowe, *Distinctive Image Features from Scale-Invariant Keypoints*, IJCV 2004: extrema of differences of Gaussians
//! in space and scale, refined by a quadratic, with one dominant gradient direction each, described by 4 × 4 × 8
//! histograms of gradient directions. This is an own implementation, for three reasons. The first octave need not be
//! the doubled image, which costs three to five times as much and gains little on easy scenes. Only the keypoints that
//! are kept are described. Positions are those of the image without a shift, as the pixel convention requires.
//!
//! Everything is computed in the same order and without fused multiplications on every machine.

mod descriptor;
mod extrema;
mod scale_space;

pub use descriptor::DESCRIPTOR_LEN;
pub use scale_space::Plane;

use scale_space::Octave;

/// Number of layers of an octave that are searched for extrema.
const LAYERS: usize = 3;
/// Blur of the first layer of every octave, in its own pixels.
const SIGMA: f32 = 1.6;

/// Options of detection.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// Maximum number of keypoints, the strongest first.
    pub max_keypoints: usize,
    /// Minimum difference of Gaussians at an extremum, of an image whose values are from 0 to 1.
    pub min_contrast: f32,
    /// True if the first octave is the doubled image: finds smaller structures, at several times the cost.
    pub doubled: bool,
}

/// A keypoint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Keypoint {
    /// Position, pixels, first pixel center at (0.5, 0.5).
    pub x: f32,
    /// Position, pixels.
    pub y: f32,
    /// Standard deviation of the Gaussian at which it was found, pixels.
    pub scale: f32,
    /// Dominant gradient direction, radians.
    pub angle: f32,
    /// Interpolated difference of Gaussians at the extremum.
    pub contrast: f32,
    /// Position in its octave.
    position: ScaleSpacePosition,
}

/// Position of a keypoint in the scale space.
#[derive(Clone, Copy, Debug, PartialEq)]
struct ScaleSpacePosition {
    octave: usize,
    layer: usize,
    /// Sample coordinates in the octave; the first sample is at (0, 0).
    x: f32,
    y: f32,
    /// In samples of the octave.
    sigma: f32,
}

/// Keypoints, and their descriptors row by row: [`DESCRIPTOR_LEN`] values each, not yet of unit length.
pub struct Keypoints {
    /// The strongest first.
    pub keypoints: Vec<Keypoint>,
    /// Row-major.
    pub descriptors: Vec<f32>,
}

/// Detects and describes keypoints at the pixel positions for which `wanted` is true.
pub fn detect(picture: &Plane, options: &Options, wanted: impl Fn(f32, f32) -> bool) -> Keypoints {
    let mut octaves = Vec::new();
    let mut keypoints = Vec::new();
    let mut next = Some(Octave::first(picture, options.doubled));
    while let Some(octave) = next {
        extrema::find(&octave, octaves.len(), options.min_contrast, |k| {
            if wanted(k.x, k.y) {
                keypoints.push(k);
            }
        });
        next = octave.next();
        octaves.push(octave);
    }
    keep_strongest(&mut keypoints, options.max_keypoints);
    let mut descriptors = Vec::with_capacity(keypoints.len() * DESCRIPTOR_LEN);
    for keypoint in &mut keypoints {
        let position = &keypoint.position;
        let layer = &octaves[position.octave].layers[position.layer];
        let (angle, descriptor) = descriptor::describe(layer, position);
        keypoint.angle = angle;
        descriptors.extend(descriptor);
    }
    Keypoints { keypoints, descriptors }
}

/// Keeps the keypoints of the highest contrast, in that order.
fn keep_strongest(keypoints: &mut Vec<Keypoint>, count: usize) {
    // A stable sort: equals keep the order of octaves, rows and layers.
    keypoints.sort_by(|a, b| b.contrast.total_cmp(&a.contrast));
    keypoints.truncate(count);
}

#[cfg(test)]
mod tests {
    use super::*;

    const ALL: Options = Options { max_keypoints: 1000, min_contrast: 0.005, doubled: false };

    /// Gaussian blobs on a plain ground: x, y, standard deviation, height.
    fn blobs(width: usize, height: usize, blobs: &[[f32; 4]]) -> Plane {
        let value = |x: usize, y: usize| -> f32 {
            let (x, y) = (x as f32 + 0.5, y as f32 + 0.5);
            0.2 + blobs
                .iter()
                .map(|[cx, cy, s, h]| h * (-((x - cx).powi(2) + (y - cy).powi(2)) / (2.0 * s * s)).exp())
                .sum::<f32>()
        };
        Plane { width, height, values: (0..width * height).map(|i| value(i % width, i / width)).collect() }
    }

    #[test]
    fn blobs_are_found_with_their_positions_and_sizes() {
        let truth = [[60.3, 50.8, 2.5, 0.6], [150.0, 70.25, 4.0, 0.5], [100.6, 30.1, 7.0, -0.15]];
        let picture = blobs(220, 120, &truth);
        for doubled in [false, true] {
            let found = detect(&picture, &Options { doubled, ..ALL }, |_, _| true);
            for [x, y, s, _] in truth {
                let near = found
                    .keypoints
                    .iter()
                    .min_by(|a, b| (a.x - x).hypot(a.y - y).total_cmp(&(b.x - x).hypot(b.y - y)))
                    .unwrap();
                let off = (near.x - x).hypot(near.y - y);
                // The difference of two Gaussians of nearly one size is greatest where the blob has their size; the
                // image is assumed to have half a pixel of blur, which the sampled blob has not.
                let ratio = near.scale / s;
                assert!(
                    off < 0.06 && (0.8..1.25).contains(&ratio),
                    "{off} px off, scale {ratio} x, doubled: {doubled}"
                );
            }
        }
    }

    #[test]
    fn a_rotated_image_has_the_same_descriptors() {
        let truth = [[60.0, 50.0, 3.0, 0.5], [66.0, 53.0, 2.0, 0.3], [55.0, 58.0, 2.5, -0.15], [58.0, 43.0, 2.0, 0.2]];
        let picture = blobs(120, 110, &truth);
        // A quarter turn: (x, y) becomes (height − y, x).
        let mut turned = Plane { width: 110, height: 120, values: vec![0.0; 110 * 120] };
        for y in 0..110 {
            for x in 0..120 {
                turned.values[x * 110 + (109 - y)] = picture.values[y * 120 + x];
            }
        }
        let (a, b) = (detect(&picture, &ALL, |_, _| true), detect(&turned, &ALL, |_, _| true));
        assert_eq!(a.keypoints.len(), b.keypoints.len());
        let unit = |d: &[f32]| {
            let norm = d.iter().map(|v| v * v).sum::<f32>().sqrt();
            d.iter().map(|v| v / norm).collect::<Vec<_>>()
        };
        for (k, first) in a.keypoints.iter().zip(a.descriptors.chunks(DESCRIPTOR_LEN)) {
            let same = |o: &&(&Keypoint, &[f32])| (o.0.x - (110.0 - k.y)).hypot(o.0.y - k.x) < 0.02;
            let others: Vec<_> = b.keypoints.iter().zip(b.descriptors.chunks(DESCRIPTOR_LEN)).collect();
            let (_, second) = others.iter().find(same).expect("the keypoint is there again");
            let product: f32 = unit(first).iter().zip(unit(second)).map(|(a, b)| a * b).sum();
            assert!(product > 0.99, "{product}");
        }
    }

    #[test]
    fn the_strongest_are_kept_and_small_or_plain_images_have_none() {
        let truth = [[60.3, 50.8, 2.5, 0.2], [150.0, 70.25, 4.0, 0.5]];
        let picture = blobs(220, 120, &truth);
        let one = detect(&picture, &Options { max_keypoints: 1, ..ALL }, |_, _| true);
        assert_eq!((one.keypoints.len(), one.keypoints[0].x.round()), (1, 150.0));
        let left = detect(&picture, &ALL, |x, _| x < 100.0);
        assert!(!left.keypoints.is_empty() && left.keypoints.iter().all(|k| k.x < 100.0));
        for (width, height) in [(0, 0), (1, 1), (3, 200), (17, 16), (220, 120)] {
            let plain = Plane { width, height, values: vec![0.4; width * height] };
            for doubled in [false, true] {
                assert!(detect(&plain, &Options { doubled, ..ALL }, |_, _| true).keypoints.is_empty());
            }
        }
    }
}
