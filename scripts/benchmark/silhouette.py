"""What part of a rendered sequence's target is visible in a frame: its label's pixels beside its whole outline.

The outline is that of `object_mesh.ply` at the true pose, drawn triangle by triangle, also where it lies beside the
picture. A frame in which any of it is behind the camera counts as one in which nothing can be said.
"""

from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

# Pictures are drawn this many times larger, since drawn triangles have half a pixel too much on every side.
FINER = 3
# Behind this distance from the camera, metres, nothing is projected.
NEAREST_M = 0.1


def read_mesh(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (N×3, metres, object coordinates) and triangles (M×3 indices) of an ASCII PLY file."""
    lines = path.read_text().splitlines()
    end = lines.index("end_header")
    if "format ascii 1.0" not in lines[:end]:
        raise ValueError(f"{path}: only ASCII PLY files are read")
    count = {line.split()[1]: int(line.split()[2]) for line in lines[:end] if line.startswith("element ")}
    first_face = end + 1 + count["vertex"]
    vertices = np.array([line.split()[:3] for line in lines[end + 1 : first_face]], dtype=float)
    faces = [list(map(int, line.split())) for line in lines[first_face : first_face + count["face"]]]
    triangles = [(face[1], face[k], face[k + 1]) for face in faces for k in range(2, face[0])]
    return vertices, np.array(triangles)


def pixels_of_mesh(vertices: np.ndarray, frame: dict, K: np.ndarray) -> np.ndarray | None:
    """The vertices' image points in a frame of scene.json, N×2; None where one of them is not before the camera."""
    cam_from_object = np.linalg.inv(np.array(frame["T_world_camera"])) @ np.array(frame["T_world_object"])
    in_camera = vertices @ cam_from_object[:3, :3].T + cam_from_object[:3, 3]
    if in_camera[:, 2].min() < NEAREST_M:
        return None
    in_image = in_camera @ K.T
    return in_image[:, :2] / in_image[:, 2:]


def outline_area(pixels: np.ndarray, triangles: np.ndarray) -> float:
    """Area of the triangles' union in square pixels of the frame, also beside the frame."""
    low = np.floor(pixels.min(0)) - 1
    width, height = (np.ceil(pixels.max(0)) + 1 - low).astype(int) * FINER
    picture = Image.new("1", (int(width), int(height)))
    draw = ImageDraw.Draw(picture)
    # Pillow's coordinates name the centres of pixels.
    for corners in ((pixels - low) * FINER - 0.5)[triangles].reshape(len(triangles), 6):
        draw.polygon(corners.tolist(), fill=1)
    return float(np.count_nonzero(np.asarray(picture))) / FINER**2


class Target:
    """The target vehicle of a sequence."""

    def __init__(self, sequence: Path, scene: dict) -> None:
        self.vertices, self.triangles = read_mesh(sequence / "object_mesh.ply")
        self.K = np.array(scene["K"])

    def visible_share(self, frame: dict, area_px2: float) -> float:
        """Share of the target that is seen, 0 to 1, where its label covers an area in a frame of scene.json."""
        pixels = pixels_of_mesh(self.vertices, frame, self.K)
        if pixels is None:
            return 0.0
        return min(1.0, area_px2 / max(outline_area(pixels, self.triangles), 1.0))
