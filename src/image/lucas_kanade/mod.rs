//! Pyramidal Lucas-Kanade point tracking (J.-Y. Bouguet, *Pyramidal Implementation of the Lucas Kanade Feature
//! Tracker*, 2000).
//!
//! A window around the point is registered to the other image, from the coarsest pyramid level to the finest. With its
//! gradient g and the intensity difference e, a step is the solution of Σ g gᵀ d = −Σ g e (least squares). Algorithm
//! and limits are those of OpenCV. The widest vectors of the processor are used, which takes half the time, and
//! gradients are computed around points only, not in whole images.

mod area;
mod pyramid;
mod template;
mod window;

use ::image::GrayImage;
use nalgebra::Point2;
use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

pub use pyramid::Pyramid;

use area::{Area, whole_below};
use template::{Difference, Template};
use window::Window;

/// Pixels of the widest vector. Rows of windows and of areas around them are multiples of it, and thus of any narrower
/// vector, too.
const LANES: usize = 8;
/// Points tracked per task.
const AT_A_TIME: usize = 64;
/// Maximum displacement of a window before pixels are read again.
const MARGIN: usize = 2;
/// Factor from products of gray-value gradients to the unit of OpenCV's smallest eigenvalue.
const EIGENVALUE_SCALE: f32 = 1.0 / 1024.0;

/// Options of point tracking.
#[derive(Clone, Copy, Debug)]
pub struct LucasKanade {
    /// Half the side of the window, pixels, at least 1.
    pub window_radius_px: usize,
    /// Number of pyramid levels above the image itself.
    pub num_smaller: usize,
    /// Maximum number of steps per pyramid level.
    pub max_steps: usize,
    /// Step length below which the iterations end, pixels.
    pub converged_px: f32,
    /// Minimum eigenvalue of a window's normal matrix, in OpenCV's unit: that of the mean of g gᵀ, over 1024.
    pub min_eigenvalue: f32,
}

/// Result of tracking a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrackedPoint {
    /// Pixels, the first pixel's center at (0.5, 0.5).
    pub position: Point2<f32>,
    /// Mean difference of the windows, gray values.
    pub difference: f32,
}

/// Result of tracking a point forward and backward.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Returned {
    /// Position in the second image, pixels, the first pixel's center at (0.5, 0.5).
    pub position: Point2<f32>,
    /// Mean difference of the windows, gray values: the larger one of both directions.
    pub difference: f32,
    /// Forward-backward error: distance between the point and its position after tracking back, pixels.
    pub round_trip_px: f32,
}

impl LucasKanade {
    /// Tracks points from one image to another, from initial guesses; `None` for lost points.
    ///
    /// * `points`, `guesses` – as many of each, pixels, the first pixel's center at (0.5, 0.5).
    pub fn follow(
        &self,
        from: &Pyramid,
        to: &Pyramid,
        points: &[Point2<f32>],
        guesses: &[Point2<f32>],
    ) -> Vec<Option<TrackedPoint>> {
        let levels = (from.up_to(self.num_smaller), to.up_to(self.num_smaller));
        let parts = points.par_chunks(AT_A_TIME).zip(guesses.par_chunks(AT_A_TIME));
        let found = parts.flat_map_iter(|(points, guesses)| {
            Arch::new().dispatch(Work { method: self, from: levels.0, to: levels.1, points, guesses })
        });
        found.collect()
    }

    /// Tracks points forward and backward; `None` for points lost in either direction.
    ///
    /// The initial offset of the backward guess equals that of the forward guess.
    pub fn there_and_back(
        &self,
        from: &Pyramid,
        to: &Pyramid,
        points: &[Point2<f32>],
        guesses: &[Point2<f32>],
    ) -> Vec<Option<Returned>> {
        let there = self.follow(from, to, points, guesses);
        let ways = there.iter().zip(points.iter().zip(guesses));
        let ends: Vec<(Point2<f32>, Point2<f32>)> = ways
            .filter_map(|(there, (start, guess))| Some(((*there)?.position, (*there)?.position + (start - guess))))
            .collect();
        let (ends, guesses): (Vec<_>, Vec<_>) = ends.into_iter().unzip();
        let mut back = self.follow(to, from, &ends, &guesses).into_iter();
        let returned = there.into_iter().zip(points).map(|(there, start)| {
            let there = there?;
            let back = back.next().flatten()?;
            Some(Returned {
                position: there.position,
                difference: there.difference.max(back.difference),
                round_trip_px: (back.position - start).norm(),
            })
        });
        returned.collect()
    }

    /// Tracker for accurate guesses, which use only the two finest pyramid levels.
    pub fn near(self) -> Self {
        Self { num_smaller: self.num_smaller.min(1), ..self }
    }
}

/// Tracking of some points, compiled for all vector instruction sets and dispatched at run time.
struct Work<'a> {
    method: &'a LucasKanade,
    from: &'a [GrayImage],
    to: &'a [GrayImage],
    points: &'a [Point2<f32>],
    guesses: &'a [Point2<f32>],
}

impl WithSimd for Work<'_> {
    type Output = Vec<Option<TrackedPoint>>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
        let mut workplace = Workplace {
            method: self.method,
            window: Window::of_radius(self.method.window_radius_px),
            template: Template::default(),
            area: Area::default(),
        };
        let mut found = Vec::with_capacity(self.points.len());
        for (point, guess) in self.points.iter().zip(self.guesses) {
            found.push(workplace.follow(simd, self.from, self.to, *point, *guess));
        }
        found
    }
}

/// Buffers for tracking, used for one point after the other. The first pixel's center is at (0, 0).
struct Workplace<'a> {
    method: &'a LucasKanade,
    window: Window,
    template: Template,
    area: Area,
}

impl Workplace<'_> {
    #[inline(always)]
    fn follow<S: Simd>(
        &mut self,
        simd: S,
        from: &[GrayImage],
        to: &[GrayImage],
        point: Point2<f32>,
        guess: Point2<f32>,
    ) -> Option<TrackedPoint> {
        let num_smaller = from.len().min(to.len()) - 1;
        let scale = 1.0 / (1u32 << num_smaller) as f32;
        let mut position = [(guess.x - 0.5) * scale, (guess.y - 0.5) * scale];
        for level in (0..=num_smaller).rev() {
            let scale = 1.0 / (1u32 << level) as f32;
            let start = [(point.x - 0.5) * scale, (point.y - 0.5) * scale];
            let seen = self.follow_in(simd, &from[level], &to[level], start, position);
            if level == 0 {
                let ([x, y], difference) = seen?;
                return Some(TrackedPoint { position: Point2::new(x + 0.5, y + 0.5), difference });
            }
            // Finer levels may succeed where a coarser one fails.
            position = seen.map_or(position, |(position, _)| position).map(|value| 2.0 * value);
        }
        None
    }

    /// Position and mean difference in one pyramid level; `None` if the window leaves the image or lacks texture.
    #[inline(always)]
    fn follow_in<S: Simd>(
        &mut self,
        simd: S,
        from: &GrayImage,
        to: &GrayImage,
        start: [f32; 2],
        guess: [f32; 2],
    ) -> Option<([f32; 2], f32)> {
        let half = self.window.half();
        let first = [start[0] - half[0], start[1] - half[1]];
        if !self.is_near(first, from) {
            return None;
        }
        self.template.fill(simd, &mut self.area, from, first, self.window);
        let inverse = self.inverse()?;
        let mut first = [guess[0] - half[0], guess[1] - half[1]];
        let (mut previous, mut mean) = ([0.0f32; 2], 0.0);
        for step in 0..self.method.max_steps {
            if !self.is_near(first, to) {
                return None;
            }
            if step == 0 || self.area.place(first, self.window).is_none() {
                self.area.cut_around(to, first, self.window, MARGIN);
            }
            let place = self.area.place(first, self.window)?;
            let Difference { along_gradient: [x, y], mean: now } =
                self.template.difference(simd, &self.area, &place, self.window);
            mean = now;
            let delta = [-(inverse[0] * x + inverse[1] * y), -(inverse[1] * x + inverse[2] * y)];
            first = [first[0] + delta[0], first[1] + delta[1]];
            if delta[0] * delta[0] + delta[1] * delta[1] <= self.method.converged_px * self.method.converged_px {
                break;
            }
            // Oscillation: the midpoint is as good as either end.
            if step > 0 && delta.iter().zip(previous).all(|(now, before)| (now + before).abs() < 0.01) {
                first = [first[0] - 0.5 * delta[0], first[1] - 0.5 * delta[1]];
                break;
            }
            previous = delta;
        }
        Some(([first[0] + half[0], first[1] + half[1]], mean))
    }

    /// Returns true if the window may overlap the image.
    #[inline(always)]
    fn is_near(&self, first: [f32; 2], picture: &GrayImage) -> bool {
        let is_near = |first: f32, length: usize, side: u32| {
            // False for NaN.
            side > 0
                && first.abs() < 1e8
                && whole_below(first) >= -(length as i64)
                && whole_below(first) < i64::from(side)
        };
        is_near(first[0], self.window.width, picture.width()) && is_near(first[1], self.window.height, picture.height())
    }

    /// Inverse of Σ g gᵀ: its first, mixed and last entry. `None` if the window lacks texture.
    #[inline(always)]
    fn inverse(&self) -> Option<[f32; 3]> {
        let [a, b, c] = self.template.products;
        let determinant = a * c - b * b;
        let smaller = (a + c - ((a - c) * (a - c) + 4.0 * b * b).sqrt()) / (2 * self.window.num_pixels()) as f32;
        let is_enough = EIGENVALUE_SCALE * smaller >= self.method.min_eigenvalue && determinant > f32::EPSILON;
        is_enough.then(|| [c / determinant, -b / determinant, a / determinant])
    }
}

#[cfg(test)]
mod tests;
