"""The camera: a drone's smooth flight round the vehicle with a free line of sight, or a dashcam's ride."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from . import plan
from .buildings import Lot
from .drives import Dashcam, Flight, smooth_knots
from .furniture import Place
from .seeds import noise, rng

LAG_S = 0.9
SIGHT_SAMPLES = 26
FOCAL_PX_AT_960 = 880.0
MOUNT_AHEAD_M = 0.45


@dataclass
class CameraPath:
    """Per frame world_from_camera (N, 4, 4), camera axes x right, y down, z forward; focal length in pixels."""

    world_from_camera: np.ndarray
    focal_px_at_960: float = FOCAL_PX_AT_960

    @property
    def centers(self) -> np.ndarray:
        """Camera centres (N, 3)."""
        return self.world_from_camera[:, :3, 3]

    def intrinsics(self, width: int, height: int) -> np.ndarray:
        """K (3x3, pixels, first pixel's centre at 0.5, 0.5)."""
        f = self.focal_px_at_960 * width / 960.0
        return np.array([[f, 0, width / 2], [0, f, height / 2], [0, 0, 1.0]])


def _look_at(center: np.ndarray, target: np.ndarray, roll: float) -> np.ndarray:
    """world_from_camera that looks from ``center`` at ``target``, rolled by radians."""
    z = (target - center) / np.linalg.norm(target - center)
    x = np.cross(z, [0, 0, 1.0])
    x /= np.linalg.norm(x)
    y = np.cross(z, x)
    x, y = np.cos(roll) * x + np.sin(roll) * y, -np.sin(roll) * x + np.cos(roll) * y
    matrix = np.eye(4)
    matrix[:3, :3] = np.stack([x, y, z], 1)
    matrix[:3, 3] = center
    return matrix


def _lagged(positions: np.ndarray, fps: float) -> np.ndarray:
    """Positions smoothed in time: what a pilot keeps in the middle."""
    n = len(positions)
    t = np.arange(n) / fps
    weight = np.exp(-0.5 * ((t[:, None] - t[None, :]) / LAG_S) ** 2)
    slope = np.gradient(positions, axis=0)
    before = positions[0] + slope[0] * np.arange(-3 * int(fps), 0)[:, None]
    after = positions[-1] + slope[-1] * np.arange(1, 3 * int(fps) + 1)[:, None]
    padded = np.vstack([before, positions, after])
    tp = np.arange(-3 * int(fps), n + 3 * int(fps)) / fps
    weight = np.exp(-0.5 * ((t[:, None] - tp[None, :]) / LAG_S) ** 2)
    return weight @ padded / weight.sum(1, keepdims=True)


def _wobble(times: np.ndarray, size: float, *key: str | int) -> np.ndarray:
    """A slow, small, smooth motion (N, 3)."""
    return np.stack([size * noise(times, np.zeros(len(times)), 1.3, axis, *key) for axis in range(3)], 1)


def fly(flight: Flight, azimuth: float, poses: np.ndarray, times: np.ndarray, key: tuple) -> CameraPath:
    """The camera's path round a vehicle with the given poses (N, 4, 4)."""
    fps = 1.0 / (times[1] - times[0])
    middle = poses[len(poses) // 2]
    heading = np.arctan2(middle[1, 0], middle[0, 0])
    u = (times - times[0]) / (times[-1] - times[0])
    eased = u + 0.12 * np.sin(2 * np.pi * u) / (2 * np.pi)
    angle = heading + np.radians(azimuth + flight.sweep * (eased - 0.5))
    distance = flight.distance[0] + (flight.distance[1] - flight.distance[0]) * u
    height = flight.height[0] + (flight.height[1] - flight.height[0]) * eased
    hovers = flight.wind is not None
    center = np.tile(poses[:, :3, 3].mean(0), (len(times), 1)) if hovers else _lagged(poses[:, :3, 3], fps)
    sign = rng("wobble", *key).choice([-1.0, 1.0])
    steady = 0.35 if flight.height[0] == flight.height[1] else 1.0
    camera = center + np.stack([distance * np.cos(angle), distance * np.sin(angle), height], 1)
    flown = smooth_knots(times, flight.away)[:, None] * [np.cos(heading), np.sin(heading), 0.0]
    center, camera = center + flown, camera + flown
    camera += _wobble(times, flight.wind if hovers else 0.22, "camera", *key) * [sign, 1.0, steady]
    target = center + _wobble(times, 0.8, "target", *key) * [1, 1, 0.4] + [0, 0, 0.7]
    roll = np.radians(1.3) * noise(times, np.zeros(len(times)), 1.7, "roll", *key)
    target = _past(camera, target, flight, times)
    return CameraPath(np.stack([_look_at(c, t, r) for c, t, r in zip(camera, target, roll)]))


def _past(camera: np.ndarray, target: np.ndarray, flight: Flight, times: np.ndarray) -> np.ndarray:
    """Where the camera looks (N, 3): at the target, turned to the left by the flight's gaze."""
    if len(flight.gaze) == 1:
        return target
    angle = np.radians(smooth_knots(times, flight.gaze))
    away = target - camera
    c, s = np.cos(angle), np.sin(angle)
    turned = np.stack([c * away[:, 0] - s * away[:, 1], s * away[:, 0] + c * away[:, 1], away[:, 2]], 1)
    return camera + turned


def ride(dashcam: Dashcam, host: np.ndarray, times: np.ndarray, key: tuple) -> CameraPath:
    """The path of a camera in a car with the given poses (N, 4, 4), on top of its springs' motion.

    Body and springs are rigid: pitch and heave of about 1.2 Hz, roll of about 0.8 Hz.
    """
    still = np.zeros(len(times))
    size = np.radians(dashcam.sway)
    pitch = size * (0.7 * noise(times, still, 0.42, "pitch", *key) + 0.3 * noise(times, still, 1.6, "nod", *key))
    roll = size * (0.7 * noise(times, still, 0.62, "roll", *key) + 0.3 * noise(times, still, 2.1, "lean", *key))
    heave = dashcam.heave * noise(times, still, 0.42, "heave", *key)
    mount = _mount(dashcam)
    poses = [pose @ _sprung(p, r, h) @ mount for pose, p, r, h in zip(host, pitch, roll, heave)]
    return CameraPath(np.stack(poses), 480.0 / np.tan(np.radians(dashcam.view) / 2))


def _sprung(pitch: float, roll: float, heave: float) -> np.ndarray:
    """Motion (4x4) of a body on its springs: radians about y and x, metres along z."""
    matrix = np.eye(4)
    c, s = np.cos(pitch), np.sin(pitch)
    about_y = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    c, s = np.cos(roll), np.sin(roll)
    matrix[:3, :3] = np.array([[1, 0, 0], [0, c, -s], [0, s, c]]) @ about_y
    matrix[2, 3] = heave
    return matrix


def _mount(dashcam: Dashcam) -> np.ndarray:
    """car_from_camera (4x4): behind the windscreen, looking ahead and a little down."""
    c, s = np.cos(np.radians(dashcam.pitch)), np.sin(np.radians(dashcam.pitch))
    matrix = np.eye(4)
    matrix[:3, :3] = np.array([[0.0, -s, c], [-1.0, 0.0, 0.0], [0.0, -c, -s]])
    matrix[:3, 3] = (MOUNT_AHEAD_M, 0.0, dashcam.height)
    return matrix


def _sight_points(camera: CameraPath, poses: np.ndarray) -> np.ndarray:
    """Points (N, S, 3) on the lines from the camera to the vehicle, the near end included."""
    t = np.linspace(0.0, 0.93, SIGHT_SAMPLES)[None, :, None]
    target = poses[:, None, :3, 3] + [0, 0, 0.6]
    return camera.centers[:, None] + t * (target - camera.centers[:, None])


def lots_in_the_way(camera: CameraPath, poses: np.ndarray, lots: list[Lot]) -> list[Lot]:
    """Houses that stand between the camera and the vehicle, or round the camera."""
    points = _sight_points(camera, poses).reshape(-1, 3)
    found = []
    for lot in lots:
        if np.linalg.norm(points[:, :2] - lot.front, axis=1).min() > 30:
            continue
        low = points[:, 2] < lot.ground() + lot.height() + 1.0
        if (lot.covers(points[:, :2], 2.2) & low).any():
            found.append(lot)
    return found


def places_in_the_way(camera: CameraPath, poses: np.ndarray, places: list[Place], clearance: float) -> list[Place]:
    """Movable things that hide the vehicle or stand in the drone's way."""
    points = _sight_points(camera, poses).reshape(-1, 3)
    found = []
    for place in places:
        apart = np.linalg.norm(points[:, :2] - place.position, axis=1)
        if apart.min() > place.radius + clearance:
            continue
        top = float(plan.ground_height(*np.array(place.position)[:, None])[0]) + place.height
        if ((apart < place.radius + clearance) & (points[:, 2] < top + 0.4)).any():
            found.append(place)
    return found
