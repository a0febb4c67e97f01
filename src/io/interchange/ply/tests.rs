use super::*;

fn tetrahedron() -> TriangleMesh {
    let vertices = [[0.0, 0.0, 0.1], [1.0, 0.0, 1.0 / 3.0], [0.0, 1e-17, 0.0], [0.5, 0.5, -1e9]];
    TriangleMesh {
        vertices: vertices.map(Point3::from).to_vec(),
        triangles: vec![[0, 1, 2], [0, 1, 3], [1, 2, 3], [2, 0, 3]],
    }
}

/// The tetrahedron in a binary form, with unused properties and an unused element.
fn binary(big_endian: bool) -> Vec<u8> {
    let mut out = format!(
        "ply\r\nformat binary_{}_endian 1.0\ncomment made here\nelement vertex 4\nproperty uchar red\n\
         property double z\nproperty double x\nproperty double y\nelement edge 2\n\
         property list ushort float weights\nelement face 4\nproperty list uchar uint vertex_index\nproperty short \
         flag\nend_header\n",
        if big_endian { "big" } else { "little" }
    )
    .into_bytes();
    let mut put = |bytes: &[u8]| {
        let mut bytes = bytes.to_vec();
        if big_endian {
            bytes.reverse();
        }
        out.extend(bytes);
    };
    for p in tetrahedron().vertices {
        put(&[200]);
        [p.z, p.x, p.y].iter().for_each(|c| put(&c.to_le_bytes()));
    }
    for weights in [vec![0.5f32], vec![]] {
        put(&(weights.len() as u16).to_le_bytes());
        weights.iter().for_each(|w| put(&w.to_le_bytes()));
    }
    for triangle in tetrahedron().triangles {
        put(&[3]);
        triangle.iter().for_each(|v| put(&v.to_le_bytes()));
        put(&(-5i16).to_le_bytes());
    }
    out
}

fn read_bytes(bytes: &[u8]) -> Result<TriangleMesh, IoError> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("mesh.ply");
    std::fs::write(&path, bytes).unwrap();
    read_mesh(&path)
}

#[test]
fn every_encoding_gives_the_same_mesh() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("mesh.ply");
    write_mesh(&path, &tetrahedron()).unwrap();
    assert_eq!(read_mesh(&path).unwrap(), tetrahedron());
    assert_eq!(read_bytes(&binary(false)).unwrap(), tetrahedron());
    assert_eq!(read_bytes(&binary(true)).unwrap(), tetrahedron());
}

#[test]
fn a_polygon_becomes_a_fan() {
    let text = "ply\nformat ascii 1.0\nelement vertex 5\nproperty float x\nproperty float y\nproperty float z\n\
                element face 2\nproperty list uchar int vertex_indices\nend_header\n\
                0 0 0\n1 0 0\n1 1 0\n0 1 0\n-1 0.5 0\n5 0 1 2 3 4\n2 0 1\n";
    assert_eq!(read_bytes(text.as_bytes()).unwrap().triangles, [[0, 1, 2], [0, 2, 3], [0, 3, 4]]);
}

#[test]
fn a_truncated_mesh_is_an_error() {
    for whole in [binary(false), binary(true)] {
        for length in 0..whole.len() {
            assert!(read_bytes(&whole[..length]).is_err(), "cut at {length}");
        }
    }
}

#[test]
fn invalid_files_report_their_problem() {
    let header = |count: &str| format!("ply\nformat ascii 1.0\nelement vertex {count}\nproperty float x\nend_header\n");
    let cases = [
        ("obj\n".to_string(), "line 1: first line"),
        ("ply\nformat ascii 1.0\nelement vertex 99999999999999999999\n".into(), "line 3: element"),
        (header("99999999999999"), "do not fit"),
        ("ply\nformat ascii 1.0\nelement vertex 5\nend_header\n".into(), "do not fit"),
        ("ply\nproperty float x\n".into(), "before any element"),
        ("ply\nend_header\n".into(), "format line missing"),
        ("ply\nformat ascii 1.0\nelement a 1\nproperty list float int x\n".into(), "line 4: property"),
        (format!("{}1\n", header("1")), "x, y and z"),
        ("ply\nformat ascii 1.0\nend_header\n".into(), "no faces"),
    ];
    for (text, expected) in cases {
        let error = read_bytes(text.as_bytes()).unwrap_err().to_string();
        assert!(error.contains(expected), "{text:?}: {error}");
    }
    let mut mesh = tetrahedron();
    mesh.triangles[2][1] = 4;
    let path = tempfile::tempdir().unwrap().path().join("m.ply");
    write_mesh(&path, &mesh).unwrap();
    assert!(read_mesh(&path).unwrap_err().to_string().contains("vertex 4 of 4"));
}

#[test]
fn points_are_written_for_other_programs() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("points.ply");
    write_points(&path, &[(Point3::new(1.5, -2.0, 0.1), [1, 2, 255])]).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    let (header, body) = Header::parse(&path, &bytes).unwrap();
    assert_eq!(header.elements[0].count, 1);
    assert_eq!(body.len(), 27);
    assert_eq!((&body[16..24], &body[24..]), (0.1f64.to_le_bytes().as_slice(), [1, 2, 255].as_slice()));
    assert!(write_points(&path, &[(Point3::new(f64::NAN, 0.0, 0.0), [0; 3])]).is_err());
}

#[test]
fn the_mesh_of_the_bundled_sequence_is_read() {
    let mesh = read_mesh(&crate::io::testing::in_repository("dataset/demo/object_mesh.ply")).unwrap();
    assert_eq!((mesh.vertices.len(), mesh.triangles.len()), (5983, 10796));
    assert_eq!(mesh.vertices[0], Point3::new(-2.0330, -0.0228, 0.6426));
}
