//! Comparison with OpenCV's tracker.

use ::opencv::core::{Mat, Point2f, Size, TermCriteria, Vector};
use ::opencv::video::OPTFLOW_USE_INITIAL_FLOW;

use super::*;
use crate::image::mat_from_gray;

/// Result of OpenCV.
fn by_opencv(
    first: &GrayImage,
    second: &GrayImage,
    points: &[Point2<f32>],
    window: Window,
) -> Vec<Option<TrackedPoint>> {
    let starts: Vector<Point2f> = points.iter().map(|p| Point2f::new(p.x - 0.5, p.y - 0.5)).collect();
    let (mut moved, mut status, mut error) = (starts.clone(), Vector::<u8>::new(), Vector::<f32>::new());
    let [from, to]: [Mat; 2] = [first, second].map(|picture| mat_from_gray(picture).unwrap());
    let size = Size::new(window.width as i32, window.height as i32);
    let stop = TermCriteria::new(3, METHOD.max_steps as i32, f64::from(METHOD.converged_px)).unwrap();
    let (levels, least) = (METHOD.num_smaller as i32, f64::from(METHOD.min_eigenvalue));
    let flags = OPTFLOW_USE_INITIAL_FLOW;
    ::opencv::video::calc_optical_flow_pyr_lk(
        &from,
        &to,
        &starts,
        &mut moved,
        &mut status,
        &mut error,
        size,
        levels,
        stop,
        flags,
        least,
    )
    .unwrap();
    let found = moved.iter().zip(status.iter().zip(&error));
    let found = found.map(|(p, (status, difference))| {
        (status != 0).then_some(TrackedPoint { position: Point2::new(p.x + 0.5, p.y + 0.5), difference })
    });
    found.collect()
}

#[test]
fn points_are_where_opencv_finds_them() {
    let first = texture(6);
    for (radius, shift) in [(7, [3.3, -2.1]), (5, [1.7, 0.4]), (2, [0.6, 0.9])] {
        let second = moved(&first, shift);
        let method = LucasKanade { window_radius_px: radius, ..METHOD };
        let points = grid(7, 3);
        let (from, to) = pyramids(&first, &second);
        let ours = method.follow(&from, &to, &points, &points);
        let theirs = by_opencv(&first, &second, &points, Window::of_radius(radius));
        let is_same = |(ours, theirs): &(&Option<TrackedPoint>, &Option<TrackedPoint>)| match (ours, theirs) {
            (Some(a), Some(b)) => (a.position - b.position).norm() < 0.05 && (a.difference - b.difference).abs() < 1.0,
            (None, None) => true,
            _ => false,
        };
        let num_same = ours.iter().zip(&theirs).filter(is_same).count();
        assert!(num_same as f64 > 0.95 * points.len() as f64, "{radius}: {num_same} of {}", points.len());
    }
}
