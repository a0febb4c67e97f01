//! Positions on the WGS 84 ellipsoid, and local meters east, north and up.
//!
//! The arithmetic is that of the crate `map_3d` (geodetic → earth-centerd → local, and back in closed form: R.-J. You,
//! *Transformation of Cartesian to geodetic coordinates without iterations*, Journal of Surveying Engineering 2000).

use map_3d::{Ellipsoid, enu2geodetic, geodetic2enu};
use nalgebra::{Point3, UnitQuaternion, Vector2, Vector3, point};

use crate::math::Sim3;
use crate::scene::MapOrigin;

/// Position by longitude, latitude and height.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Geodetic {
    /// East of Greenwich, degrees.
    pub longitude_deg: f64,
    /// North of the equator, degrees.
    pub latitude_deg: f64,
    /// Height, meters. It is used as ellipsoidal height; another vertical datum changes horizontal distances by parts
    /// in a hundred thousand.
    pub height_m: f64,
}

/// Local axes east, north and up, meters; the origin is (0, 0, 0).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LocalFrame {
    /// Origin, and true if heights are absolute.
    pub origin: MapOrigin,
}

impl LocalFrame {
    /// Creates the frame at an origin whose height is absolute.
    pub fn at(place: Geodetic) -> Self {
        let Geodetic { longitude_deg: longitude, latitude_deg: latitude, height_m } = place;
        Self { origin: MapOrigin { longitude, latitude, height_m, knows_height: true } }
    }

    /// Converts a position to meters east, north, up.
    pub fn from_geodetic(&self, place: Geodetic) -> Point3<f64> {
        let Self { origin } = self;
        let (east, north, up) = geodetic2enu(
            place.latitude_deg.to_radians(),
            place.longitude_deg.to_radians(),
            place.height_m,
            origin.latitude.to_radians(),
            origin.longitude.to_radians(),
            origin.height_m,
            Ellipsoid::WGS84,
        );
        point![east, north, up]
    }

    /// Converts a point in meters east, north, up to longitude, latitude and height.
    pub fn to_geodetic(&self, point_in_frame: Point3<f64>) -> Geodetic {
        let Self { origin } = self;
        let (latitude, longitude, height_m) = enu2geodetic(
            point_in_frame.x,
            point_in_frame.y,
            point_in_frame.z,
            origin.latitude.to_radians(),
            origin.longitude.to_radians(),
            origin.height_m,
            Ellipsoid::WGS84,
        );
        Geodetic { longitude_deg: longitude.to_degrees(), latitude_deg: latitude.to_degrees(), height_m }
    }
}

/// Grid of the Universal Transverse Mercator projection, near an origin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UtmGrid {
    /// Code of the zone in the EPSG register.
    pub epsg: u32,
    /// Easting, northing and height from east, north, up. The grid is a similarity of the local frame to 4 cm within
    /// 3 km: its scale changes with the distance from the zone's meridian.
    pub grid_from_local: Sim3,
}

impl LocalFrame {
    /// Grid of the zone of the origin.
    pub fn utm(&self) -> UtmGrid {
        let MapOrigin { longitude, latitude, height_m, .. } = self.origin;
        let zone = utm::lat_lon_to_zone_number(latitude, longitude);
        let on_grid = |latitude, longitude| {
            let (northing, easting, _) = utm::to_utm_wgs84(latitude, longitude, zone);
            Vector2::new(easting, northing)
        };
        // A kilometer to the north gives the rotation and the scale of the grid.
        const STEP_M: f64 = 1000.0;
        let step = |north| {
            let place = self.to_geodetic(point![0.0, north, 0.0]);
            on_grid(place.latitude_deg, place.longitude_deg)
        };
        let (origin, north) = (on_grid(latitude, longitude), (step(STEP_M) - step(-STEP_M)) / (2.0 * STEP_M));
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), (-north.x).atan2(north.y));
        let epsg = if latitude >= 0.0 { 32_600 } else { 32_700 } + u32::from(zone);
        let shift = Vector3::new(origin.x, origin.y, height_m);
        UtmGrid { epsg, grid_from_local: Sim3::new(north.norm(), turn, shift) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn place(longitude_deg: f64, latitude_deg: f64, height_m: f64) -> Geodetic {
        Geodetic { longitude_deg, latitude_deg, height_m }
    }

    /// Earth-centerd coordinates, from the definition of the ellipsoid.
    fn earth_centered(place: Geodetic) -> Point3<f64> {
        let (a, f): (f64, f64) = (6_378_137.0, 1.0 / 298.257_223_563);
        let e2 = f * (2.0 - f);
        let (sin, cos) = place.latitude_deg.to_radians().sin_cos();
        let (sin_lon, cos_lon) = place.longitude_deg.to_radians().sin_cos();
        let n = a / (1.0 - e2 * sin * sin).sqrt();
        let h = place.height_m;
        point![(n + h) * cos * cos_lon, (n + h) * cos * sin_lon, (n * (1.0 - e2) + h) * sin]
    }

    #[test]
    fn geodetic_positions_round_trip() {
        for latitude in [-89.9, -34.2, 0.0, 0.001, 48.1, 70.0, 89.99] {
            for longitude in [-180.0, -58.85, 0.0, 9.2, 179.999] {
                let frame = LocalFrame::at(place(longitude, latitude, 450.0));
                for point in [point![7000.0, -7000.0, 120.0], point![0.0, 0.0, 0.0], point![-3.0, 9999.0, -300.0]] {
                    let back = frame.from_geodetic(frame.to_geodetic(point));
                    assert!((back - point).norm() < 1e-4, "{latitude} {longitude}: {point} {back}");
                }
            }
        }
    }

    #[test]
    fn ten_kilometers_agree_with_the_definition() {
        let origin = place(9.2, 48.1, 450.0);
        let there = place(9.28, 48.17, 520.0);
        let found = LocalFrame::at(origin).from_geodetic(there);
        let chord = earth_centered(there) - earth_centered(origin);
        assert!((found.coords.norm() - chord.norm()).abs() < 1e-6, "{found}");
        // Along the normals of the ellipsoid at the origin.
        let (sin, cos) = 48.1f64.to_radians().sin_cos();
        let (sin_lon, cos_lon) = 9.2f64.to_radians().sin_cos();
        let up = nalgebra::vector![cos * cos_lon, cos * sin_lon, sin];
        let east = nalgebra::vector![-sin_lon, cos_lon, 0.0];
        let expected = point![east.dot(&chord), up.cross(&east).dot(&chord), up.dot(&chord)];
        assert!((found - expected).norm() < 1e-6, "{found} {expected}");
        assert!(found.x > 5900.0 && found.y > 7700.0, "{found}");
    }

    #[test]
    fn the_grid_agrees_with_published_coordinates_and_with_itself() {
        // Reference: pyproj 3.7 (PROJ 9.5), EPSG:4326 to EPSG:32632.
        let frame = LocalFrame::at(place(8.4, 49.0, 115.0));
        let grid = frame.utm();
        assert_eq!((grid.epsg, LocalFrame::at(place(-70.0, -33.0, 0.0)).utm().epsg), (32_632, 32_719));
        let found = grid.grid_from_local * point![0.0, 0.0, 0.0];
        assert!((found - point![456_114.595_9, 5_427_629.203_9, 115.0]).norm() < 0.01, "{found}");
        // Another position, directly and through the similarity.
        for (east, north) in [(800.0, -500.0), (-2000.0, 1500.0)] {
            let there = frame.to_geodetic(point![east, north, 0.0]);
            let (northing, easting, _) = ::utm::to_utm_wgs84(there.latitude_deg, there.longitude_deg, 32);
            let found = grid.grid_from_local * point![east, north, 0.0];
            assert!((found.x - easting).hypot(found.y - northing) < 0.01, "{found} {easting} {northing}");
        }
    }
}
