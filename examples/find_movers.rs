//! What moves in a video whose background has been reconstructed, with the time that each part takes; pictures of the
//! points and the boxes if a folder for them is named, and how well the boxes fit given masks:
//!
//! ```text
//! cargo run --release --example find_movers -- VIDEO BACKGROUND_MODEL [FOLDER FOR PICTURES | -] [FOLDER WITH MASKS]
//! ```
//!
//! BACKGROUND_MODEL is a COLMAP model of the video's frames, as `OUT/background` of a run. Masks are PNG, one per
//! frame, in which 1 is the vehicle looked for and other values are vehicles, too.

use std::collections::BTreeMap;
use std::error::Error;
use std::path::{Path, PathBuf};
use std::time::Instant;

use image::{Rgb, RgbImage};
use tractrix::ground;
use tractrix::image::Picture;
use tractrix::motion::{
    GroundModel, Mover, PointFollower, PointTrack, Surroundings, TrackLabel, Verdict, View, classify, movers,
};
use tractrix::scene::{ImageId, Reconstruction, Rect};
use tractrix::video::Source;

type Result<T> = std::result::Result<T, Box<dyn Error>>;

/// Frames of a video and the points followed through them.
struct Followed {
    tracks: Vec<PointTrack>,
    times_s: Vec<f64>,
    ids: Vec<ImageId>,
    size: (u32, u32),
    seconds: f64,
}

fn main() -> Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [video, model, rest @ ..] = arguments.as_slice() else {
        return Err("usage: find_movers VIDEO BACKGROUND_MODEL [FOLDER FOR PICTURES | -] [FOLDER WITH MASKS]".into());
    };
    let followed = follow(video.as_ref())?;
    let background = tractrix::io::interchange::colmap::read(model.as_ref())?;
    let ground = ground_of(&background);
    let views = views(&background, &followed.ids);
    let surroundings =
        Surroundings { size: followed.size, times_s: &followed.times_s, views: &views, ground: ground.as_ref() };
    let start = Instant::now();
    let labels = classify(&followed.tracks, &surroundings);
    let found = movers(&followed.tracks, &labels, &surroundings);
    print_counts(&followed, &views, &labels, start.elapsed().as_secs_f64());
    for (k, mover) in found.iter().enumerate() {
        print_mover(k, mover);
    }
    if let Some(masks) = rest.get(1) {
        print_agreement(masks.as_ref(), &found, followed.ids.len())?;
    }
    match rest.first().filter(|folder| *folder != "-") {
        Some(folder) => write_pictures(video.as_ref(), folder.as_ref(), &followed, &labels, &found),
        None => Ok(()),
    }
}

fn follow(video: &Path) -> Result<Followed> {
    let source = Source::open(video, &tractrix::video::Options::default())?;
    let (mut follower, mut times_s, mut ids, mut seconds) = (None, Vec::new(), Vec::new(), 0.0);
    let mut size = (0, 0);
    for item in source.frames()? {
        let (frame, image) = item?;
        size = image.dimensions();
        let start = Instant::now();
        follower.get_or_insert_with(|| PointFollower::new(size)).push(&Picture::new(&image))?;
        seconds += start.elapsed().as_secs_f64();
        times_s.push(frame.time_s);
        ids.push(ImageId::from(frame.id));
    }
    let tracks = follower.map(PointFollower::finish).unwrap_or_default();
    Ok(Followed { tracks, times_s, ids, size, seconds })
}

fn ground_of(background: &Reconstruction) -> Option<GroundModel> {
    let found = ground::dominant_plane_points(background, &ground::Options::default(), 0).ok()?;
    let points: Vec<_> = found.point_ids.iter().map(|id| background.points[id].position).collect();
    GroundModel::new(found.normal, found.point, &points)
}

fn views(background: &Reconstruction, ids: &[ImageId]) -> Vec<Option<View>> {
    let view = |id: &ImageId| {
        let image = background.images.get(id)?;
        Some(View { camera: *background.camera_of(image), cam_from_world: image.cam_from_world })
    };
    ids.iter().map(view).collect()
}

fn print_counts(followed: &Followed, views: &[Option<View>], labels: &[TrackLabel], seconds: f64) {
    let count = |is: fn(&TrackLabel) -> bool| labels.iter().filter(|label| is(label)).count();
    let num_frames = followed.ids.len().max(1) as f64;
    println!(
        "{} frames, {} with cameras; {} tracks: {} move, {} float, {} stand, {} fixed; ms per frame: following {:.0}, \
         the rest {:.0}",
        followed.ids.len(),
        views.iter().flatten().count(),
        labels.len(),
        count(TrackLabel::is_moving),
        count(|l| l.verdict == Verdict::Floating),
        count(|l| l.verdict == Verdict::Stationary),
        count(|l| l.verdict == Verdict::Fixed),
        1000.0 * followed.seconds / num_frames,
        1000.0 * seconds / num_frames
    );
}

fn print_mover(k: usize, mover: &Mover) {
    let (first, last) = (mover.boxes.keys().next(), mover.boxes.keys().next_back());
    let mut sides: Vec<f64> = mover.boxes.values().map(|b| b.area_px2().sqrt()).collect();
    sides.sort_by(f64::total_cmp);
    println!(
        "{k:>3} {:.2} {:?} frames {}-{} ({}), {} tracks, side {:.0} px, purity {:.2}, round {:?}",
        mover.confidence,
        mover.evidence,
        first.unwrap_or(&0),
        last.unwrap_or(&0),
        mover.life(),
        mover.tracks.len(),
        sides[sides.len() / 2],
        mover.purity,
        mover.boxes.values().nth(mover.life() / 2).map(|b| [b.x0 + b.x1, b.y0 + b.y1].map(|x| (x / 2.0) as u32))
    );
}

/// Boxes of the vehicles in a mask, by value.
fn boxes_of(path: &Path) -> Result<BTreeMap<u8, (Rect, u32)>> {
    let mut boxes: BTreeMap<u8, (Rect, u32)> = BTreeMap::new();
    for (x, y, value) in image::open(path)?.to_luma8().enumerate_pixels().filter(|(_, _, v)| v.0[0] > 0) {
        let (x, y) = (f64::from(x), f64::from(y));
        let pixel = Rect { x0: x, y0: y, x1: x + 1.0, y1: y + 1.0 };
        let entry = boxes.entry(value.0[0]).or_insert((pixel, 0));
        *entry = (entry.0.union(&pixel), entry.1 + 1);
    }
    Ok(boxes)
}

/// How often the vehicle of value 1 has a box that fits, and which movers are of no vehicle.
fn print_agreement(masks: &Path, found: &[Mover], num_frames: usize) -> Result<()> {
    const LEAST_AREA: u32 = 200;
    let (mut seen, mut hit, mut sum, mut owners) = (0, 0, 0.0, BTreeMap::<usize, u32>::new());
    let mut on_vehicle = vec![0usize; found.len()];
    for frame in 0..num_frames {
        let vehicles = boxes_of(&masks.join(format!("{frame:05}.png")))?;
        let boxes = found.iter().enumerate().filter_map(|(k, m)| Some((k, *m.boxes.get(&(frame as u32))?)));
        let boxes: Vec<(usize, Rect)> = boxes.collect();
        for (k, rect) in &boxes {
            let inside = |v: &(Rect, u32)| rect.intersection(&v.0).area_px2() >= 0.5 * rect.area_px2();
            on_vehicle[*k] += usize::from(vehicles.values().any(inside));
        }
        let Some((target, _)) = vehicles.get(&1).filter(|(_, area)| *area >= LEAST_AREA) else { continue };
        seen += 1;
        let best = boxes.iter().map(|(k, rect)| (rect.iou(target), *k)).max_by(|a, b| a.0.total_cmp(&b.0));
        if let Some((iou, k)) = best {
            sum += iou;
            hit += usize::from(iou >= 0.5);
            *owners.entry(k).or_default() += u32::from(iou >= 0.5);
        }
    }
    let false_movers: Vec<usize> = (0..found.len()).filter(|&k| 2 * on_vehicle[k] < found[k].life()).collect();
    println!(
        "vehicle 1: in {seen} frames, found in {hit} (IoU 0.5), mean IoU {:.2}, by movers {:?}; false movers: {:?}",
        sum / f64::max(seen as f64, 1.0),
        owners,
        false_movers
    );
    Ok(())
}

/// Writes every frame with its points (red moves, orange floats, green stands, grey nothing known, violet fixed) and
/// boxes.
fn write_pictures(
    video: &Path,
    folder: &Path,
    followed: &Followed,
    labels: &[TrackLabel],
    found: &[Mover],
) -> Result<()> {
    std::fs::create_dir_all(folder)?;
    let source = Source::open(video, &tractrix::video::Options::default())?;
    for (frame, item) in source.frames()?.enumerate() {
        let (_, mut picture) = item?;
        for (track, label) in followed.tracks.iter().zip(labels) {
            if let Some(place) = track.at(frame as u32) {
                dot(&mut picture, place, colour(label));
            }
        }
        for rect in found.iter().filter_map(|mover| mover.boxes.get(&(frame as u32))) {
            outline(&mut picture, rect);
        }
        picture.save(picture_path(folder, frame))?;
    }
    Ok(())
}

fn picture_path(folder: &Path, frame: usize) -> PathBuf {
    folder.join(format!("{frame:06}.png"))
}

fn colour(label: &TrackLabel) -> [u8; 3] {
    match label.verdict {
        Verdict::Moving(_) => [255, 30, 30],
        Verdict::Floating => [255, 170, 0],
        Verdict::Stationary => [0, 190, 60],
        Verdict::Fixed => [200, 0, 255],
        Verdict::Undetermined => [150, 150, 150],
    }
}

fn dot(picture: &mut RgbImage, [x, y]: [f64; 2], colour: [u8; 3]) {
    for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
        if let Some(pixel) = picture.get_pixel_mut_checked(x as u32 + dx, y as u32 + dy) {
            *pixel = Rgb(colour);
        }
    }
}

fn outline(picture: &mut RgbImage, rect: &Rect) {
    let (x0, y0, x1, y1) = (rect.x0 as u32, rect.y0 as u32, rect.x1 as u32, rect.y1 as u32);
    let horizontal = (x0..=x1).flat_map(|x| [(x, y0), (x, y1)]);
    for (x, y) in horizontal.chain((y0..=y1).flat_map(|y| [(x0, y), (x1, y)])) {
        if let Some(pixel) = picture.get_pixel_mut_checked(x, y) {
            *pixel = Rgb([255, 255, 0]);
        }
    }
}
