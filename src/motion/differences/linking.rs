//! Regions of successive looks that are one object.

use std::collections::BTreeMap;

use nalgebra::{Point2, Point3, Vector3};

use super::{Look, MovingObject};
use crate::math::upper_median;
use crate::motion::{Surroundings, View};
use crate::scene::Rect;

/// Looks that may miss an object before it is given up.
const MAX_MISSED: usize = 2;
/// Largest distance between a region and where the object should be, in lengths of the object: in a fifth of a second
/// at 15 m/s a car drives 0.7 of its own.
const MAX_STEP: f64 = 1.5;
/// Largest ratio of the areas of two boxes of one object in successive looks.
const MAX_AREA_RATIO: f64 = 2.5;
/// Fewest looks at an object: a second.
const MIN_LOOKS: usize = 5;
/// Least share of the looks from the first to the last that see it: edges of houses flicker.
const MIN_SEEN: f64 = 0.7;
/// Least share of its way by which an object departs: what only sways returns.
const MIN_STRAIGHTNESS: f64 = 0.7;
/// Least displacement of an object, in lengths of its own.
const MIN_DISPLACEMENT: f64 = 0.7;

/// Confidence after a displacement by d lengths: 1 - exp(-d times this), so that one length starts a track.
const CERTAINTY: f64 = 2.0;

/// A region in a frame.
#[derive(Clone, Copy, Debug)]
struct Sight {
    index: u32,
    /// Number of the look.
    look: usize,
    time_s: f64,
    /// Direction of its middle in the world, of length 1.
    direction: Vector3<f64>,
    /// Sides as angles, radians.
    sides: [f64; 2],
}

impl Sight {
    fn new(number: usize, look: &Look, rect: &Rect) -> Self {
        let middle = Point2::from(rect.center());
        let ray = look.view.cam_from_world.rotation.inverse() * look.view.camera.ray_from_pixel(middle);
        let sides = [rect.width(), rect.height()].map(|side| side / look.view.camera.mean_focal());
        Self { index: look.index, look: number, time_s: look.time_s, direction: ray.normalize(), sides }
    }

    fn length(&self) -> f64 {
        self.sides[0].max(self.sides[1])
    }

    fn area(&self) -> f64 {
        self.sides[0] * self.sides[1]
    }

    /// Its box in a view; `None` behind the camera.
    fn rect(&self, view: &View) -> Option<Rect> {
        let middle = view.camera.pixel_from_cam(Point3::from(view.cam_from_world.rotation * self.direction))?;
        let [dx, dy] = self.sides.map(|side| 0.5 * side * view.camera.mean_focal());
        Some(Rect { x0: middle.x - dx, y0: middle.y - dy, x1: middle.x + dx, y1: middle.y + dy })
    }

    /// The object between two looks.
    fn between(&self, other: &Self, time_s: f64) -> Self {
        let share = (time_s - self.time_s) / (other.time_s - self.time_s);
        let mixed = |a: f64, b: f64| a + share * (b - a);
        Self {
            direction: (self.direction + (other.direction - self.direction) * share).normalize(),
            sides: [0, 1].map(|side| mixed(self.sides[side], other.sides[side])),
            time_s,
            ..*self
        }
    }
}

/// Regions of successive looks.
#[derive(Clone, Debug)]
struct Followed {
    sights: Vec<Sight>,
    num_missed: usize,
}

impl Followed {
    fn last(&self) -> &Sight {
        &self.sights[self.sights.len() - 1]
    }

    /// Where it should be at a time.
    fn predicted(&self, time_s: f64) -> Vector3<f64> {
        let last = self.last();
        let [.., before, _] = self.sights.as_slice() else { return last.direction };
        let velocity = (last.direction - before.direction) / (last.time_s - before.time_s);
        last.direction + velocity * (time_s - last.time_s)
    }

    /// Distance of a sight in lengths of the object; `None` where it cannot be the object's.
    fn distance(&self, sight: &Sight) -> Option<f64> {
        let last = self.last();
        let ratio = sight.area() / last.area();
        let length = last.length().max(sight.length());
        let nearest = [self.predicted(sight.time_s), last.direction].map(|at| (sight.direction - at).norm() / length);
        let distance = nearest[0].min(nearest[1]);
        ((MAX_AREA_RATIO.recip()..=MAX_AREA_RATIO).contains(&ratio) && distance <= MAX_STEP).then_some(distance)
    }

    /// The object, if it left its place.
    fn object(&self, surroundings: &Surroundings) -> Option<MovingObject> {
        let (first, last) = (self.sights.first()?, self.sights.last()?);
        let length = upper_median(self.sights.iter().map(Sight::length).collect())?;
        let way: f64 = self.sights.windows(2).map(|pair| (pair[1].direction - pair[0].direction).norm()).sum();
        let displacement = (last.direction - first.direction).norm();
        let seen = self.sights.len() as f64 / (1 + last.look - first.look) as f64;
        let leaves = displacement >= MIN_DISPLACEMENT * length && displacement >= MIN_STRAIGHTNESS * way;
        let is_object = self.sights.len() >= MIN_LOOKS && seen >= MIN_SEEN && leaves;
        tracing::trace!(
            first = first.index,
            last = last.index,
            num_looks = self.sights.len(),
            seen,
            displacement = displacement / length,
            way = way / length,
            is_object,
            "difference"
        );
        if !is_object {
            return None;
        }
        let mut boxes = BTreeMap::new();
        for pair in self.sights.windows(2) {
            for index in pair[0].index..=pair[1].index {
                let sight = pair[0].between(&pair[1], surroundings.times_s[index as usize]);
                boxes.extend(surroundings.view(index).and_then(|view| Some((index, sight.rect(view)?))));
            }
        }
        Some(MovingObject { boxes, confidence: 1.0 - (-CERTAINTY * displacement / length).exp() })
    }
}

/// Links regions from look to look.
#[derive(Default)]
pub(super) struct Linker {
    num_looks: usize,
    live: Vec<Followed>,
    ended: Vec<Followed>,
}

impl Linker {
    /// Takes the regions of the next look, pixels of its view.
    pub(super) fn push(&mut self, look: &Look, regions: &[Rect]) {
        let sights: Vec<Sight> = regions.iter().map(|rect| Sight::new(self.num_looks, look, rect)).collect();
        self.num_looks += 1;
        let mut pairs: Vec<(f64, usize, usize)> = Vec::new();
        for (k, followed) in self.live.iter().enumerate() {
            let near = sights.iter().enumerate().filter_map(|(s, sight)| Some((followed.distance(sight)?, k, s)));
            pairs.extend(near);
        }
        pairs.sort_by(|a, b| a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2))));
        let (mut is_found, mut is_used) = (vec![false; self.live.len()], vec![false; sights.len()]);
        for (_, k, s) in pairs {
            if !is_found[k] && !is_used[s] {
                (is_found[k], is_used[s]) = (true, true);
                self.live[k].sights.push(sights[s]);
                self.live[k].num_missed = 0;
            }
        }
        for (followed, is_found) in self.live.iter_mut().zip(is_found) {
            followed.num_missed += usize::from(!is_found);
        }
        let ended = self.live.extract_if(.., |followed| followed.num_missed > MAX_MISSED);
        self.ended.extend(ended.filter(|followed| followed.sights.len() >= MIN_LOOKS));
        let new = sights.iter().zip(is_used).filter(|(_, is_used)| !is_used);
        self.live.extend(new.map(|(sight, _)| Followed { sights: vec![*sight], num_missed: 0 }));
    }

    /// The objects of all looks, those that were seen first at the front.
    pub(super) fn finish(mut self, surroundings: &Surroundings) -> Vec<MovingObject> {
        self.ended.append(&mut self.live);
        self.ended.sort_by_key(|followed| followed.sights[0].index);
        self.ended.iter().filter_map(|followed| followed.object(surroundings)).collect()
    }
}
