"""Rotations and transforms as numpy arrays."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]


def rotation_matrix(wxyz: npt.ArrayLike) -> Floats:
    """Rotation matrices, shape (..., 3, 3), of quaternions w x y z, shape (..., 4)."""
    q = np.asarray(wxyz, dtype=float)
    w, x, y, z = np.moveaxis(q / np.linalg.norm(q, axis=-1, keepdims=True), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


@dataclass(frozen=True, eq=False)
class Sim3:
    """Similarity `target_from_source`: a point X of the source is at `scale * rotation @ X + translation`.

    Attributes:
        scale: ratio of the units; 1 for a rigid transform.
        rotation: shape (3, 3).
        translation: shape (3,), in units of the target.
    """

    scale: float
    rotation: Floats
    translation: Floats

    @classmethod
    def from_wxyz(cls, scale: float, wxyz: npt.ArrayLike, translation: npt.ArrayLike) -> Sim3:
        return cls(scale, rotation_matrix(wxyz), np.asarray(translation, dtype=float))

    def wxyz(self) -> Floats:
        """The rotation as a unit quaternion w x y z with w ≥ 0, shape (4,)."""
        r = self.rotation
        # Row i is the quaternion times 4 q_i; the one with the largest diagonal is the best conditioned.
        rows = np.array(
            [
                [1 + r[0, 0] + r[1, 1] + r[2, 2], r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]],
                [r[2, 1] - r[1, 2], 1 + r[0, 0] - r[1, 1] - r[2, 2], r[0, 1] + r[1, 0], r[0, 2] + r[2, 0]],
                [r[0, 2] - r[2, 0], r[0, 1] + r[1, 0], 1 - r[0, 0] + r[1, 1] - r[2, 2], r[1, 2] + r[2, 1]],
                [r[1, 0] - r[0, 1], r[0, 2] + r[2, 0], r[1, 2] + r[2, 1], 1 - r[0, 0] - r[1, 1] + r[2, 2]],
            ]
        )
        q: Floats = rows[np.argmax(np.diagonal(rows))]
        q = q / np.linalg.norm(q)
        return -q if q[0] < 0 else q

    def __mul__(self, points: npt.ArrayLike) -> Floats:
        """Transform points of shape (..., 3)."""
        moved: Floats = self.scale * np.asarray(points, dtype=float) @ self.rotation.T + self.translation
        return moved

    def matrix(self) -> Floats:
        """The transform as a matrix of shape (4, 4) for homogeneous coordinates."""
        matrix = np.eye(4)
        matrix[:3, :3] = self.scale * self.rotation
        matrix[:3, 3] = self.translation
        return matrix

    def inverse(self) -> Sim3:
        """The transform `source_from_target`."""
        rotation = self.rotation.T
        return Sim3(1 / self.scale, rotation, -(rotation @ self.translation) / self.scale)


def as_floats(values: Any) -> Floats:
    """An array of floats; None becomes NaN."""
    return np.array(values, dtype=float)
