//! PLY: colored points are written, triangle meshes are read and written.
//!
//! Reading covers ASCII and both binary forms, any order of elements and properties, and polygons with more than three
//! corners (as a fan). The format is G. Turk's; it is small enough to be read here, and the one crate for it panics on
//! some headers.

mod header;
mod payload;

use std::path::Path;

use nalgebra::Point3;

use crate::files;
use crate::io::extent::{LARGEST, is_sensible};
use crate::io::{IoError, atomic};
use crate::scene::TriangleMesh;
use header::{Header, Kind};

/// Writes colored points: binary, positions as doubles.
///
/// # Errors
/// A system error, or a position that is not finite.
pub fn write_points(path: &Path, points: &[(Point3<f64>, [u8; 3])]) -> Result<(), IoError> {
    if let Some(index) = points.iter().position(|(p, _)| !p.iter().all(|c| c.is_finite())) {
        return Err(IoError::content(path, format!("point {index} is not finite")));
    }
    atomic::write_with(path, |out| {
        write!(out, "ply\nformat binary_little_endian 1.0\nelement vertex {}\n", points.len())?;
        write!(out, "property double x\nproperty double y\nproperty double z\n")?;
        write!(out, "property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n")?;
        points.iter().try_for_each(|(position, rgb)| {
            position.iter().try_for_each(|c| out.write_all(&c.to_le_bytes()))?;
            out.write_all(rgb)
        })
    })
}

/// Writes a triangle mesh: ASCII, with the shortest numbers that read back as the same doubles.
///
/// # Errors
/// A system error.
pub fn write_mesh(path: &Path, mesh: &TriangleMesh) -> Result<(), IoError> {
    atomic::write_with(path, |out| {
        write!(out, "ply\nformat ascii 1.0\nelement vertex {}\n", mesh.vertices.len())?;
        write!(out, "property double x\nproperty double y\nproperty double z\n")?;
        write!(out, "element face {}\nproperty list uchar int vertex_indices\nend_header\n", mesh.triangles.len())?;
        mesh.vertices.iter().try_for_each(|p| writeln!(out, "{} {} {}", p.x, p.y, p.z))?;
        mesh.triangles.iter().try_for_each(|[a, b, c]| writeln!(out, "3 {a} {b} {c}"))
    })
}

/// Reads a triangle mesh; polygons become fans of triangles, properties other than positions and corners are ignored.
///
/// # Errors
/// A missing or broken file, no faces, or a face with the index of a missing vertex.
pub fn read_mesh(path: &Path) -> Result<TriangleMesh, IoError> {
    let content = files::read(path).map_err(IoError::system("read", path))?;
    let (header, body) = Header::parse(path, &content)?;
    let mut values = payload::Values::new(path, header.encoding, body, content.len() - body.len());
    let mut mesh = TriangleMesh::default();
    for element in &header.elements {
        for _ in 0..element.count {
            match element.name.as_str() {
                "vertex" => mesh.vertices.push(vertex(&mut values, &element.properties)?),
                "face" => face(&mut values, &element.properties, &mut mesh.triangles)?,
                _ => element.properties.iter().try_for_each(|p| values.property(p, |_| {}))?,
            }
        }
    }
    check(path, &mesh)?;
    Ok(mesh)
}

fn vertex(values: &mut payload::Values<'_>, properties: &[header::Property]) -> Result<Point3<f64>, IoError> {
    let mut position = [f64::NAN; 3];
    for property in properties {
        let axis = ["x", "y", "z"].iter().position(|name| *name == property.name);
        values.property(property, |value| {
            if let Some(axis) = axis {
                position[axis] = value;
            }
        })?;
    }
    if position.iter().all(is_sensible) {
        Ok(Point3::from(position))
    } else {
        Err(values.error("vertex", &format!("expected properties x, y and z, each a number of at most {LARGEST:e}")))
    }
}

fn face(
    values: &mut payload::Values<'_>,
    properties: &[header::Property],
    triangles: &mut Vec<[u32; 3]>,
) -> Result<(), IoError> {
    let mut corners = Vec::new();
    for property in properties {
        let is_corners = matches!(property.kind, Kind::List { .. })
            && ["vertex_indices", "vertex_index"].contains(&property.name.as_str());
        values.property(property, |value| {
            if is_corners {
                corners.push(value);
            }
        })?;
    }
    if corners.iter().any(|c| c.fract() != 0.0 || !(0.0..=f64::from(u32::MAX)).contains(c)) {
        return Err(values.error("vertex_indices", "expected whole numbers from 0"));
    }
    for pair in corners.windows(2).skip(1) {
        triangles.push([corners[0] as u32, pair[0] as u32, pair[1] as u32]);
    }
    Ok(())
}

fn check(path: &Path, mesh: &TriangleMesh) -> Result<(), IoError> {
    if mesh.triangles.is_empty() {
        return Err(IoError::content(path, "no faces, so this is not a mesh"));
    }
    let num_vertices = mesh.vertices.len();
    match mesh.triangles.iter().flatten().find(|v| **v as usize >= num_vertices) {
        Some(index) => Err(IoError::content(path, format!("a face refers to vertex {index} of {num_vertices}"))),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests;
