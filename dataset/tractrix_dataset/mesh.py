"""Polygon meshes as numpy arrays, their builder, and PLY files."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

BOX_FACES = np.array([[0, 3, 2, 1], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]])


def rotation_z(angle: float) -> np.ndarray:
    """3x3 rotation about z by ``angle`` radians."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


@dataclass
class Mesh:
    """Vertices (N, 3) in metres, faces as index tuples, one material name per face."""

    vertices: np.ndarray
    faces: list[tuple[int, ...]]
    materials: list[str]
    smooth: bool = False
    attributes: dict[str, np.ndarray] = field(default_factory=dict)

    def triangles(self) -> np.ndarray:
        """(M, 3) vertex indices: every face as a fan."""
        fans = [(f[0], f[k], f[k + 1]) for f in self.faces for k in range(1, len(f) - 1)]
        return np.array(fans, dtype=np.int64).reshape(-1, 3)


class MeshBuilder:
    """Collects boxes, quads and strips into one mesh.

    Coordinates passed to the methods are local; ``frame`` (4x4,
    target_from_local) is applied as they are added.
    """

    def __init__(self) -> None:
        self._vertices: list[np.ndarray] = []
        self._faces: list[tuple[int, ...]] = []
        self._materials: list[str] = []
        self._count = 0
        self.frame = np.eye(4)

    def add(self, vertices: np.ndarray, faces: np.ndarray | list, material: str) -> None:
        """Adds faces over their own vertices (N, 3), in local coordinates."""
        points = np.asarray(vertices, float) @ self.frame[:3, :3].T + self.frame[:3, 3]
        self._vertices.append(points)
        self._faces += [tuple(int(i) + self._count for i in face) for face in faces]
        self._materials += [material] * len(faces)
        self._count += len(points)

    def box(self, low: tuple, high: tuple, material: str) -> None:
        """An axis-aligned box between two local corners."""
        (x0, y0, z0), (x1, y1, z1) = low, high
        corners = [(x0, y0, z0), (x1, y0, z0), (x1, y1, z0), (x0, y1, z0)]
        corners += [(x, y, z1) for x, y, _ in corners]
        self.add(np.array(corners), BOX_FACES, material)

    def quad(self, corners: np.ndarray | list, material: str) -> None:
        """One face through three or more corners, in order."""
        self.add(np.asarray(corners, float), [tuple(range(len(corners)))], material)

    def strip(self, left: np.ndarray, right: np.ndarray, material: str) -> None:
        """Quads between two polylines of equal length (N, 3)."""
        n = len(left)
        faces = [(i, i + 1, n + i + 1, n + i) for i in range(n - 1)]
        self.add(np.vstack([left, right]), faces, material)

    def lathe(self, profile: np.ndarray, segments: int, material: str, axis: str = "z") -> None:
        """A surface of revolution of (radius, height) pairs about a local axis."""
        angles = np.linspace(0, 2 * np.pi, segments, endpoint=False)
        ring = np.stack([np.cos(angles), np.sin(angles)], 1)
        points = np.array([[r * c, r * s, h] for r, h in profile for c, s in ring])
        if axis == "y":
            points = points[:, [0, 2, 1]]
        faces = []
        for i in range(len(profile) - 1):
            for j in range(segments):
                a, b = i * segments + j, i * segments + (j + 1) % segments
                faces.append((a, b, b + segments, a + segments))
        self.add(points, faces, material)

    def tube(self, path: np.ndarray, radius: float | np.ndarray, material: str, sides: int = 6) -> None:
        """A tube of ``sides`` faces round a polyline (N, 3)."""
        path = np.asarray(path, float)
        radii = np.broadcast_to(radius, len(path))
        tangent = np.gradient(path, axis=0)
        tangent /= np.linalg.norm(tangent, axis=1, keepdims=True) + 1e-12
        helper = np.where(np.abs(tangent[:, 2:]) > 0.9, [[1.0, 0, 0]], [[0, 0, 1.0]])
        u = np.cross(helper, tangent)
        u /= np.linalg.norm(u, axis=1, keepdims=True)
        v = np.cross(tangent, u)
        angles = np.linspace(0, 2 * np.pi, sides, endpoint=False)
        rings = [p + r * (np.cos(a) * e + np.sin(a) * f) for p, r, e, f in zip(path, radii, u, v) for a in angles]
        faces = []
        for i in range(len(path) - 1):
            for j in range(sides):
                a, b = i * sides + j, i * sides + (j + 1) % sides
                faces.append((a, b, b + sides, a + sides))
        faces.append(tuple(range(sides - 1, -1, -1)))
        faces.append(tuple(range((len(path) - 1) * sides, len(path) * sides)))
        self.add(np.array(rings), faces, material)

    @property
    def empty(self) -> bool:
        """Whether nothing was added yet."""
        return self._count == 0

    def mesh(self, smooth: bool = False) -> Mesh:
        """The mesh collected so far."""
        vertices = np.vstack(self._vertices) if self._vertices else np.zeros((0, 3))
        return Mesh(vertices, list(self._faces), list(self._materials), smooth)


def write_ply(path: Path, vertices: np.ndarray, triangles: np.ndarray, comment: str) -> None:
    """Writes a binary PLY (float vertices in metres, triangle faces)."""
    header = (
        f"ply\nformat binary_little_endian 1.0\ncomment {comment}\n"
        f"element vertex {len(vertices)}\nproperty float x\nproperty float y\nproperty float z\n"
        f"element face {len(triangles)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    faces = np.zeros(len(triangles), dtype=[("n", "u1"), ("v", "<i4", 3)])
    faces["n"], faces["v"] = 3, triangles
    Path(path).write_bytes(header.encode() + np.asarray(vertices, "<f4").tobytes() + faces.tobytes())


def write_ply_ascii(path: Path, vertices: np.ndarray, triangles: np.ndarray, comment: str) -> None:
    """Writes the same as text with 0.1 mm digits: larger, but any reader takes it."""
    lines = ["ply", "format ascii 1.0", f"comment {comment}", f"element vertex {len(vertices)}"]
    lines += [f"property float {axis}" for axis in "xyz"]
    lines += [f"element face {len(triangles)}", "property list uchar int vertex_indices", "end_header"]
    lines += [f"{x:.4f} {y:.4f} {z:.4f}" for x, y, z in vertices]
    lines += [f"3 {a} {b} {c}" for a, b, c in triangles]
    Path(path).write_text("\n".join(lines) + "\n")


def read_ply(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Reads vertices (N, 3) and triangles (M, 3) of a file written by this module."""
    data = Path(path).read_bytes()
    end = data.index(b"end_header\n") + len(b"end_header\n")
    words = [line.split() for line in data[:end].decode().splitlines()]
    n_vertices, n_faces = (int(w[2]) for w in words if w[0] == "element")
    if ["format", "ascii", "1.0"] in words:
        rows = data[end:].decode().split()
        vertices = np.array(rows[: 3 * n_vertices], float).reshape(-1, 3)
        return vertices, np.array(rows[3 * n_vertices :], int).reshape(n_faces, 4)[:, 1:]
    vertices = np.frombuffer(data, "<f4", 3 * n_vertices, end).reshape(-1, 3)
    faces = np.frombuffer(data, [("n", "u1"), ("v", "<i4", 3)], n_faces, end + 12 * n_vertices)
    return vertices.astype(float), faces["v"].astype(np.int64)
