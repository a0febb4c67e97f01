"""Silhouettes of projected meshes, and how much of a vehicle a picture shows."""

from __future__ import annotations

import cv2
import numpy as np

NEAR_M = 0.1
SUBPIXEL_BITS = 8
BORDER_SHARE = 1.0


def in_camera(points: np.ndarray, world_from_camera: np.ndarray, world_from_object: np.ndarray) -> np.ndarray:
    """Object points (N, 3) in camera coordinates."""
    camera_from_object = np.linalg.inv(world_from_camera) @ world_from_object
    return points @ camera_from_object[:3, :3].T + camera_from_object[:3, 3]


def _clipped(corners: np.ndarray) -> np.ndarray:
    """The part of a triangle (3, 3) in front of the near plane: a polygon of three or four corners (N, 3)."""
    kept = []
    for here, there in zip(corners, np.roll(corners, -1, axis=0)):
        if here[2] >= NEAR_M:
            kept.append(here)
        if (here[2] >= NEAR_M) != (there[2] >= NEAR_M):
            kept.append(here + (NEAR_M - here[2]) / (there[2] - here[2]) * (there - here))
    return np.array(kept)


def silhouette(points: np.ndarray, triangles: np.ndarray, k: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Pixels (H, W, bool) whose centres lie in the projection of a mesh in camera coordinates."""
    corners = points[triangles]
    in_front = corners[:, :, 2] >= NEAR_M
    polygons = [*corners[in_front.all(1)]]
    polygons += [_clipped(c) for c in corners[in_front.any(1) & ~in_front.all(1)]]
    drawn = np.zeros(shape, np.uint8)
    for polygon in polygons:
        image = polygon @ k.T
        pixels = image[:, :2] / image[:, 2:] - 0.5
        fixed = np.rint(pixels * 2**SUBPIXEL_BITS).astype(np.int32)
        cv2.fillConvexPoly(drawn, fixed, 1, lineType=cv2.LINE_8, shift=SUBPIXEL_BITS)
    return drawn.astype(bool)


def whole_pixels(points: np.ndarray, triangles: np.ndarray, k: np.ndarray, shape: tuple[int, int]) -> int:
    """Pixels of the whole silhouette of a mesh in camera coordinates, beyond the picture's edges too.

    What lies more than one picture beyond an edge is not counted.
    """
    border = np.array([shape[1], shape[0]]) * BORDER_SHARE
    wider = k.copy()
    wider[:2, 2] += border
    size = (int(shape[0] + 2 * border[1]), int(shape[1] + 2 * border[0]))
    return int(silhouette(points, triangles, wider, size).sum())


def visible_share(n_visible: int, n_whole: int) -> float:
    """Visible over whole pixels, 0 to 1; 0 where there is nothing to see."""
    return min(1.0, n_visible / n_whole) if n_whole else 0.0
