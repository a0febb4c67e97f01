//! Outlines of masks, as convex hulls.

use nalgebra::Point2;

use crate::scene::Mask;

/// Outline of an object in one frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Silhouette {
    /// Corners of the convex hull of the mask's pixel centers, in order.
    pub hull: Vec<Point2<f64>>,
}

impl Silhouette {
    /// Minimum number of pixels of a mask with an outline.
    const MIN_AREA_PX2: usize = 50;
    /// Distance of an outline from the outermost pixel centers of the mask, averaged over directions.
    pub(in crate::trajectory) const BORDER_PX: f64 = 0.3;

    /// Outline of a mask; `None` for one that is tiny or truncated by the image border.
    pub fn of(mask: &Mask) -> Option<Self> {
        let bounds = mask.bounding_box()?;
        let cut = bounds.is_truncated(mask.width(), mask.height());
        if cut || mask.area_px2() < Self::MIN_AREA_PX2 {
            return None;
        }
        let ends = mask.rows().filter_map(|(y, left, row)| {
            let first = row.iter().position(|inside| *inside)?;
            let last = row.iter().rposition(|inside| *inside)?;
            Some([first, last].map(|x| Point2::new(f64::from(left) + x as f64 + 0.5, f64::from(y) + 0.5)))
        });
        Some(Self { hull: convex_hull(ends.flatten().collect()) })
    }

    /// Returns true if a pixel is inside the outline, or at most `margin` pixels outside.
    pub(in crate::trajectory) fn contains(&self, pixel: Point2<f64>, margin: f64) -> bool {
        let next = self.hull.iter().cycle().skip(1);
        self.hull.iter().zip(next).all(|(a, b)| {
            let side = b - a;
            side.perp(&(pixel - a)) >= -margin * side.norm()
        })
    }
}

/// Corners of the convex hull.
///
/// Monotone chain: A. Andrew, *Another efficient algorithm for convex hulls in two dimensions*, 1979.
pub(in crate::trajectory) fn convex_hull(mut points: Vec<Point2<f64>>) -> Vec<Point2<f64>> {
    points.sort_by(|a, b| (a.x, a.y).partial_cmp(&(b.x, b.y)).unwrap_or(std::cmp::Ordering::Equal));
    let chain = |points: &mut dyn Iterator<Item = &Point2<f64>>| {
        let mut corners: Vec<Point2<f64>> = Vec::new();
        for p in points {
            while let [.., a, b] = corners[..]
                && (b - a).perp(&(p - a)) <= 0.0
            {
                corners.pop();
            }
            corners.push(*p);
        }
        corners.pop();
        corners
    };
    let mut hull = chain(&mut points.iter());
    hull.extend(chain(&mut points.iter().rev()));
    hull
}
