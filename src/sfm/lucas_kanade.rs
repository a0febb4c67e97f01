//! Points followed from one picture to another and back, by pyramidal Lucas-Kanade (OpenCV).

use opencv::core::{Point2f, TermCriteria, ToInputArray, Vector};
use opencv::video::OPTFLOW_USE_INITIAL_FLOW;

use super::SfmError;
use crate::image::window_of_radius;

/// How points are followed.
#[derive(Clone, Copy, Debug)]
pub(super) struct LucasKanade {
    /// Half the side of the window, pixels; its shape is that of [`window_of_radius`].
    pub window_radius_px: i32,
    /// Levels of the pyramid above the image.
    pub pyramid_levels: i32,
    /// Smallest eigenvalue of a window's normal matrix.
    pub min_eigenvalue: f64,
}

/// Where a point was found, first pixel centre at (0, 0) as in OpenCV.
#[derive(Clone, Copy, Debug)]
pub(super) struct Followed {
    /// In the second picture.
    pub position: Point2f,
    /// Distance between the point and where following it back leads, pixels.
    pub round_trip_px: f32,
}

impl LucasKanade {
    /// Follows points from one picture (or its pyramid) to another and back; `None` for those that are lost either way.
    pub fn there_and_back(
        &self,
        from: &impl ToInputArray,
        to: &impl ToInputArray,
        points: &Vector<Point2f>,
    ) -> Result<Vec<Option<Followed>>, SfmError> {
        let (there, found) = self.follow(from, to, points, None)?;
        let (back, found_back) = self.follow(to, from, &there, None)?;
        Ok(followed(points, &there, &found, &back, &found_back))
    }

    /// The same from near predictions, which need no more than the finest pictures. The way back begins as far off as
    /// the way there.
    pub fn there_and_back_near(
        &self,
        from: &impl ToInputArray,
        to: &impl ToInputArray,
        points: &Vector<Point2f>,
        predicted: &Vector<Point2f>,
    ) -> Result<Vec<Option<Followed>>, SfmError> {
        let near = Self { pyramid_levels: self.pyramid_levels.min(1), ..*self };
        let (there, found) = near.follow(from, to, points, Some(predicted.clone()))?;
        let ends = points.iter().zip(&there).zip(predicted);
        let predicted_back = ends.map(|((start, end), predicted)| end + start - predicted).collect();
        let (back, found_back) = near.follow(to, from, &there, Some(predicted_back))?;
        Ok(followed(points, &there, &found, &back, &found_back))
    }

    /// Where the points are, and which were found; `guesses` are where they are looked for first.
    fn follow(
        &self,
        from: &impl ToInputArray,
        to: &impl ToInputArray,
        points: &Vector<Point2f>,
        guesses: Option<Vector<Point2f>>,
    ) -> Result<(Vector<Point2f>, Vector<u8>), SfmError> {
        let flags = if guesses.is_some() { OPTFLOW_USE_INITIAL_FLOW } else { 0 };
        let (mut moved, mut status, mut error) = (guesses.unwrap_or_default(), Vector::new(), Vector::<f32>::new());
        opencv::video::calc_optical_flow_pyr_lk(
            from,
            to,
            points,
            &mut moved,
            &mut status,
            &mut error,
            window_of_radius(self.window_radius_px),
            self.pyramid_levels,
            TermCriteria::new(3, 20, 0.03)?,
            flags,
            self.min_eigenvalue,
        )?;
        Ok((moved, status))
    }
}

fn followed(
    points: &Vector<Point2f>,
    there: &Vector<Point2f>,
    found: &Vector<u8>,
    back: &Vector<Point2f>,
    found_back: &Vector<u8>,
) -> Vec<Option<Followed>> {
    let ways = points.iter().zip(there).zip(back).zip(found.iter().zip(found_back));
    let followed = ways.map(|(((start, position), back), (found, found_back))| {
        let round_trip_px = (start.x - back.x).hypot(start.y - back.y);
        (found != 0 && found_back != 0).then_some(Followed { position, round_trip_px })
    });
    followed.collect()
}
