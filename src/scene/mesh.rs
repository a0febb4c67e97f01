//! Triangle meshes of vehicles, as ground truth.

use nalgebra::Point3;

/// Indexed triangle mesh.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TriangleMesh {
    /// Vertices, in the frame and unit of the object.
    pub vertices: Vec<Point3<f64>>,
    /// Three vertex indices each, all below `vertices.len()`.
    pub triangles: Vec<[u32; 3]>,
}
