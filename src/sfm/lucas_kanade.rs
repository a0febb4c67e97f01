//! Points followed from one picture to another and back, by pyramidal Lucas-Kanade (OpenCV).

use opencv::core::{Point2f, Size, TermCriteria, ToInputArray, Vector};

use super::SfmError;

/// How points are followed.
#[derive(Clone, Copy, Debug)]
pub(super) struct LucasKanade {
    /// Half the side of the window, pixels.
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
        let (there, found) = self.follow(from, to, points)?;
        let (back, found_back) = self.follow(to, from, &there)?;
        let ways = points.iter().zip(&there).zip(&back).zip(found.iter().zip(&found_back));
        let followed = ways.map(|(((start, position), back), (found, found_back))| {
            let round_trip_px = (start.x - back.x).hypot(start.y - back.y);
            (found != 0 && found_back != 0).then_some(Followed { position, round_trip_px })
        });
        Ok(followed.collect())
    }

    fn follow(
        &self,
        from: &impl ToInputArray,
        to: &impl ToInputArray,
        points: &Vector<Point2f>,
    ) -> Result<(Vector<Point2f>, Vector<u8>), SfmError> {
        let side = 2 * self.window_radius_px + 1;
        let (mut moved, mut status, mut error) = (Vector::new(), Vector::new(), Vector::<f32>::new());
        opencv::video::calc_optical_flow_pyr_lk(
            from,
            to,
            points,
            &mut moved,
            &mut status,
            &mut error,
            Size::new(side, side),
            self.pyramid_levels,
            TermCriteria::new(3, 20, 0.03)?,
            0,
            self.min_eigenvalue,
        )?;
        Ok((moved, status))
    }
}
