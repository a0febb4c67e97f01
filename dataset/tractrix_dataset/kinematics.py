"""Vehicle poses on the ground: both axles on the curve, wheels on the triangles.

The body follows the ground through its springs (a low pass along the way);
the wheels follow the ground itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from mathutils.bvhtree import BVHTree

from . import plan
from .drives import Drive
from .ground import Ground
from .vehicles.parts import wheel_centers
from .vehicles.spec import VehicleSpec

DENSE_STEP_M = 0.1
SPRING_M = 0.45
MAX_WHEEL_TRAVEL_M = 0.07
DIVE_PER_ACCELERATION = np.radians(0.35)
LEAN_PER_ACCELERATION = np.radians(0.45)


class Probe:
    """Heights of the ground's triangles near a drive, by rays straight down."""

    def __init__(self, grounds: list[Ground], low: np.ndarray, high: np.ndarray) -> None:
        self._trees = []
        for ground in grounds:
            middle = ground.vertices[ground.triangles].mean(1)[:, :2]
            near = ((middle > low) & (middle < high)).all(1)
            used, inverse = np.unique(ground.triangles[near], return_inverse=True)
            if len(used):
                self._trees.append(
                    BVHTree.FromPolygons(ground.vertices[used].tolist(), inverse.reshape(-1, 3).tolist())
                )

    def heights(self, points: np.ndarray) -> np.ndarray:
        """Height (m) of the highest triangle under each plane point (N, 2)."""
        found = np.full(len(points), -np.inf)
        for tree in self._trees:
            for i, (x, y) in enumerate(points):
                hit = tree.ray_cast((x, y, 100.0), (0, 0, -1.0))[0]
                found[i] = max(found[i], hit.z) if hit is not None else found[i]
        missing = ~np.isfinite(found)
        if missing.any():
            found[missing] = plan.surface_height(points[missing, 0], points[missing, 1])
        return found


@dataclass
class Motion:
    """Per frame: world_from_object (N, 4, 4), wheel lift (N, 4) in m, spin and steer (N) in radians."""

    world_from_object: np.ndarray
    lift: np.ndarray
    spin: np.ndarray
    steer: np.ndarray
    distance: np.ndarray


def _axles(drive: Drive, wheelbase: float, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Plane positions of rear and front axle when the middle is near arc length ``s``."""
    curve = drive.curve()
    rear_s, ahead = s - wheelbase / 2, np.full(len(s), wheelbase)
    rear = curve.point(rear_s)
    for _ in range(4):
        gap = np.linalg.norm(curve.point(rear_s + ahead) - rear, axis=1)
        ahead += wheelbase - gap
    return rear, curve.point(rear_s + ahead)


def _smoothed(values: np.ndarray) -> np.ndarray:
    """Low pass along the way (axis 0, dense steps)."""
    width = int(2.5 * SPRING_M / DENSE_STEP_M)
    kernel = np.exp(-0.5 * (np.arange(-width, width + 1) * DENSE_STEP_M / SPRING_M) ** 2)
    kernel /= kernel.sum()
    padded = np.pad(values, ((width, width), (0, 0)), "edge")
    return np.stack([np.convolve(padded[:, k], kernel, "valid") for k in range(values.shape[1])], 1)


def _plane_basis(spec: VehicleSpec) -> np.ndarray:
    """(4, 3) design matrix of heave, pitch slope and roll slope over the wheels."""
    wheels = wheel_centers(spec)
    return np.column_stack([np.ones(4), wheels[:, 0], wheels[:, 1]])


def _wheel_points(spec: VehicleSpec, rear: np.ndarray, front: np.ndarray) -> np.ndarray:
    """Plane positions (N, 4, 2) of the wheels."""
    forward = (front - rear) / np.linalg.norm(front - rear, axis=1, keepdims=True)
    left = np.stack([-forward[:, 1], forward[:, 0]], 1)
    middle = 0.5 * (rear + front)
    wheels = wheel_centers(spec)
    return middle[:, None] + wheels[None, :, :1] * forward[:, None] + wheels[None, :, 1:2] * left[:, None]


def simulate(spec: VehicleSpec, drive: Drive, times: np.ndarray, probe: Probe) -> Motion:
    """The motion of one vehicle at the given times."""
    distance = drive.distance(times)
    dense = np.arange(distance.min() - 3.0, distance.max() + 3.0, DENSE_STEP_M)
    rear, front = _axles(drive, spec.wheelbase, dense)
    points = _wheel_points(spec, rear, front)
    wheel_z = probe.heights(points.reshape(-1, 2)).reshape(-1, 4)
    basis = _plane_basis(spec)
    plane = _smoothed(np.linalg.lstsq(basis, wheel_z.T, rcond=None)[0].T)
    lift = wheel_z - plane @ basis.T
    at = [np.interp(distance, dense, column) for column in np.hstack([plane, lift]).T]
    plane, lift = np.stack(at[:3], 1), np.clip(np.stack(at[3:], 1), -MAX_WHEEL_TRAVEL_M, MAX_WHEEL_TRAVEL_M)
    rear, front = _axles(drive, spec.wheelbase, distance)
    steer = _steering(drive, spec, distance, rear, front)
    poses = _poses(rear, front, plane, _sway(drive, times, distance))
    return Motion(poses, lift, distance / spec.wheel_radius, steer, distance)


def _steering(drive: Drive, spec: VehicleSpec, s: np.ndarray, rear: np.ndarray, front: np.ndarray) -> np.ndarray:
    """Angle of the front wheels: the curve's tangent at the front axle against the heading."""
    tangent = drive.curve().tangent(s + spec.wheelbase / 2)
    heading = np.arctan2(*(front - rear).T[::-1])
    angle = np.arctan2(tangent[:, 1], tangent[:, 0]) - heading
    return np.arctan2(np.sin(angle), np.cos(angle)) * 1.5


def _sway(drive: Drive, times: np.ndarray, distance: np.ndarray) -> np.ndarray:
    """Extra pitch and roll (N, 2) in radians from braking and turning."""
    h = 0.05
    speed = (drive.distance(times + h) - drive.distance(times - h)) / (2 * h)
    pull = (drive.distance(times + h) - 2 * distance + drive.distance(times - h)) / h**2
    curve = drive.curve()
    a, b = curve.tangent(distance - 1.0), curve.tangent(distance + 1.0)
    curvature = (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2.0
    return np.stack([-DIVE_PER_ACCELERATION * pull, LEAN_PER_ACCELERATION * speed**2 * curvature], 1)


def _poses(rear: np.ndarray, front: np.ndarray, plane: np.ndarray, sway: np.ndarray) -> np.ndarray:
    """world_from_object (N, 4, 4) from axle positions, ground plane (z, slopes) and sway."""
    forward = front - rear
    forward /= np.linalg.norm(forward, axis=1, keepdims=True)
    poses = np.tile(np.eye(4), (len(rear), 1, 1))
    for i, (f, (z, ahead, leftward), (pitch, roll)) in enumerate(zip(forward, plane, sway)):
        x = np.array([f[0], f[1], ahead - np.tan(pitch)])
        y = np.array([-f[1], f[0], leftward + np.tan(roll)])
        x /= np.linalg.norm(x)
        up = np.cross(x, y)
        up /= np.linalg.norm(up)
        poses[i, :3, :3] = np.stack([x, np.cross(up, x), up], 1)
        poses[i, :3, 3] = (*(0.5 * (rear[i] + front[i])), z)
    return poses
