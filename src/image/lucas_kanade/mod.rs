//! Points followed from one picture to another, by pyramidal Lucas-Kanade (J.-Y. Bouguet, *Pyramidal Implementation of
//! the Lucas Kanade Feature Tracker*, 2000).
//!
//! A window round the point is held against the other picture, from the smallest pictures to the largest. With its
//! gradient g and the difference e of what is seen, a step is the solution of Σ g gᵀ d = −Σ g e (least squares). It
//! does what OpenCV's does, with the same limits, in vectors as wide as the processor has, which takes half the time;
//! and gradients are worked out where points are, not in whole pictures.

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

/// Pixels of the widest vector. Windows and what is cut round them have a whole number of these in a row, hence of any
/// narrower vector, too.
const LANES: usize = 8;
/// Points that one task follows.
const AT_A_TIME: usize = 64;
/// Maximum displacement of a window before pixels are read again.
const MARGIN: usize = 2;
/// Between the products of gradients in grey values, summed up, and the unit of OpenCV's smallest eigenvalue.
const EIGENVALUE_SCALE: f32 = 1.0 / 1024.0;

/// Options of point tracking.
#[derive(Clone, Copy, Debug)]
pub struct LucasKanade {
    /// Half the side of the window, pixels, at least 1.
    pub window_radius_px: usize,
    /// Smaller pictures that are looked at before the picture itself.
    pub num_smaller: usize,
    /// Steps in each picture.
    pub max_steps: usize,
    /// Length of a step after which there is no other.
    pub converged_px: f32,
    /// Smallest eigenvalue of a window's normal matrix, as OpenCV counts it: that of the mean of g gᵀ, over 1024.
    pub min_eigenvalue: f32,
}

/// Where a point was found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrackedPoint {
    /// Pixels, the first pixel's centre at (0.5, 0.5).
    pub position: Point2<f32>,
    /// Mean difference of the windows, grey values.
    pub difference: f32,
}

/// Where a point was found from which the way leads back.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Returned {
    /// In the second picture, pixels, the first pixel's centre at (0.5, 0.5).
    pub position: Point2<f32>,
    /// Mean difference of the windows, grey values: the larger one of both ways.
    pub difference: f32,
    /// Distance between the point and where following it back leads, pixels.
    pub round_trip_px: f32,
}

impl LucasKanade {
    /// Follows points from one picture to another, from where they may be found; `None` for those that are not.
    ///
    /// * `points`, `guesses` – as many of each, pixels, the first pixel's centre at (0.5, 0.5).
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

    /// The same there and back; `None` for those that are lost either way. The way back begins as far off as the way
    /// there.
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

    /// The same from near guesses, which need no more than the finest pictures.
    pub fn near(self) -> Self {
        Self { num_smaller: self.num_smaller.min(1), ..self }
    }
}

/// Some points, for whatever vector instructions the processor has.
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
            // The larger pictures may show what a smaller one does not.
            position = seen.map_or(position, |(position, _)| position).map(|value| 2.0 * value);
        }
        None
    }

    /// Position and mean difference in one picture of the pyramid; `None` where the window leaves the picture, or shows
    /// too little.
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
            // To and fro: the middle is as good as either.
            if step > 0 && delta.iter().zip(previous).all(|(now, before)| (now + before).abs() < 0.01) {
                first = [first[0] - 0.5 * delta[0], first[1] - 0.5 * delta[1]];
                break;
            }
            previous = delta;
        }
        Some(([first[0] + half[0], first[1] + half[1]], mean))
    }

    /// Returns true if some of the window may lie in the image.
    #[inline(always)]
    fn is_near(&self, first: [f32; 2], picture: &GrayImage) -> bool {
        let is_near = |first: f32, length: usize, side: u32| {
            // Not a number is nowhere.
            side > 0
                && first.abs() < 1e8
                && whole_below(first) >= -(length as i64)
                && whole_below(first) < i64::from(side)
        };
        is_near(first[0], self.window.width, picture.width()) && is_near(first[1], self.window.height, picture.height())
    }

    /// The inverse of Σ g gᵀ: its first, mixed and last entry. `None` where the window shows too little.
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
