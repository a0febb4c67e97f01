//! Distances and rays to a triangle mesh.

use nalgebra::{Point3, Vector3};
use parry3d_f64::query::{PointQuery, Ray, RayCast};
use parry3d_f64::shape::TriMesh;

use crate::scene::TriangleMesh;

/// A mesh with a tree of boxes over its triangles.
pub struct MeshIndex(TriMesh);

impl MeshIndex {
    /// Builds the tree; `None` for a mesh without triangles or with an index beyond its vertices.
    pub fn new(mesh: &TriangleMesh) -> Option<Self> {
        let num_vertices = mesh.vertices.len();
        if mesh.triangles.iter().flatten().any(|v| *v as usize >= num_vertices) {
            return None;
        }
        TriMesh::new(mesh.vertices.clone(), mesh.triangles.clone()).ok().map(Self)
    }

    /// Shortest distance from a point to the surface, from inside or outside.
    pub fn distance(&self, point: Point3<f64>) -> f64 {
        (self.0.project_local_point(&point, false).point - point).norm()
    }

    /// Distance along a unit direction to the first triangle that a ray meets, from either side.
    pub fn first_hit(&self, origin: Point3<f64>, unit_direction: Vector3<f64>) -> Option<f64> {
        self.0.cast_local_ray(&Ray::new(origin, unit_direction), f64::MAX, false)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The unit cube, 12 triangles.
    fn cube() -> MeshIndex {
        let corner = |i: u32| Point3::new(f64::from(i & 1), f64::from(i >> 1 & 1), f64::from(i >> 2 & 1));
        let quads = [[0, 1, 3, 2], [4, 5, 7, 6], [0, 1, 5, 4], [2, 3, 7, 6], [0, 2, 6, 4], [1, 3, 7, 5]];
        let triangles = quads.iter().flat_map(|[a, b, c, d]| [[*a, *b, *c], [*a, *c, *d]]).collect();
        MeshIndex::new(&TriangleMesh { vertices: (0..8).map(corner).collect(), triangles }).unwrap()
    }

    #[test]
    fn distances_are_to_the_surface_from_both_sides() {
        let cube = cube();
        assert!((cube.distance(Point3::new(2.0, 0.5, 0.5)) - 1.0).abs() < 1e-12);
        assert!((cube.distance(Point3::new(0.5, 0.9, 0.5)) - 0.1).abs() < 1e-12);
        assert!((cube.distance(Point3::new(2.0, 2.0, 2.0)) - 3f64.sqrt()).abs() < 1e-12);
        assert!(cube.distance(Point3::new(0.3, 1.0, 0.8)) < 1e-12);
    }

    #[test]
    fn rays_stop_at_the_first_side() {
        let cube = cube();
        assert!((cube.first_hit(Point3::new(-3.0, 0.2, 0.3), Vector3::x()).unwrap() - 3.0).abs() < 1e-12);
        assert_eq!(cube.first_hit(Point3::new(-3.0, 0.2, 0.3), -Vector3::x()), None);
        assert_eq!(cube.first_hit(Point3::new(-3.0, 2.0, 0.3), Vector3::x()), None);
    }

    #[test]
    fn what_is_no_mesh_has_no_index() {
        assert!(MeshIndex::new(&TriangleMesh::default()).is_none());
        let vertices = vec![Point3::origin(); 2];
        assert!(MeshIndex::new(&TriangleMesh { vertices, triangles: vec![[0, 1, 2]] }).is_none());
    }
}
