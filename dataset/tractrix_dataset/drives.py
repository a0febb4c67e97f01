"""The seven drives: where a vehicle goes, how fast, and who else is on the street.

A drive follows a street in its right lane; lane changes are lateral moves.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from . import plan
from .ground import Focus
from .seeds import rng

Knots = tuple[tuple[float, float], ...]

FPS = 10.0
CURVE_STEP_M = 0.1
SMOOTHING_M = 1.6


@dataclass(frozen=True)
class Drive:
    """A drive along a street.

    ``start`` is the arc length (m) at time 0, ``direction`` +1 or -1 along the
    street, ``lane`` the distance to the right of the centre line (m).
    ``speed`` and ``shift`` are knots (time s, speed m/s) and (distance m,
    metres to the left).
    """

    street: str
    start: float
    direction: int
    lane: float
    speed: Knots
    shift: Knots = ((0.0, 0.0),)

    def distance(self, time: np.ndarray) -> np.ndarray:
        """Distance driven (m) at the given times (s)."""
        fine = np.arange(-2.0, float(np.max(time)) + 2.0, 0.01)
        speed = smooth_knots(fine, self.speed)
        driven = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * 0.01)])
        return np.interp(time, fine, driven - np.interp(0.0, fine, driven))

    def curve(self) -> Curve:
        """The curve of the lane, smooth as a driver steers."""
        path = plan.street(self.street).path
        along = np.arange(-30.0, 110.0, CURVE_STEP_M)
        left = smooth_knots(along, self.shift) - self.lane
        points = path.offset_point(self.start + self.direction * along, self.direction * left)
        width = int(SMOOTHING_M / CURVE_STEP_M)
        kernel = np.hanning(2 * width + 1)
        kernel /= kernel.sum()
        smooth = np.stack([np.convolve(points[:, k], kernel, "valid") for k in range(2)], 1)
        return Curve(smooth, along[width : len(along) - width])


class Curve:
    """A smooth plane curve by arc length; 0 is where the drive begins."""

    def __init__(self, points: np.ndarray, along: np.ndarray) -> None:
        length = np.concatenate([[0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
        self.points = points
        self.length = length - np.interp(0.0, along, length)

    def point(self, s: np.ndarray) -> np.ndarray:
        """Points (N, 2) at arc lengths."""
        return np.stack([np.interp(s, self.length, self.points[:, k]) for k in range(2)], 1)

    def tangent(self, s: np.ndarray) -> np.ndarray:
        """Unit tangents (N, 2)."""
        d = self.point(np.asarray(s) + 0.2) - self.point(np.asarray(s) - 0.2)
        return d / np.linalg.norm(d, axis=1, keepdims=True)


def smooth_knots(at: np.ndarray, knots: Knots) -> np.ndarray:
    """Values between knots by smooth steps: no jumps, level at every knot."""
    t, v = np.array(knots).T
    if len(t) == 1:
        return np.full(len(at), v[0])
    i = np.clip(np.searchsorted(t, at) - 1, 0, len(t) - 2)
    u = np.clip((at - t[i]) / (t[i + 1] - t[i]), 0, 1)
    return v[i] + (v[i + 1] - v[i]) * u * u * (3 - 2 * u)


@dataclass(frozen=True)
class Flight:
    """How the drone flies. Azimuths are relative to the heading at half time (degrees).

    The view turns from ``azimuth`` by ``sweep`` while distance (m, along the
    ground) and height over the vehicle's ground (m) go from first to second.
    ``gaze`` are knots (time s, degrees to the left) by which the camera looks
    past the vehicle. With ``wind`` (m) the drone hovers where the middle of the
    drive is in view, and sways by that much. ``away`` are knots (time s,
    metres flown along the heading, besides).
    """

    azimuths: tuple[float, ...]
    sweep: float
    distance: tuple[float, float]
    height: tuple[float, float]
    gaze: Knots = ((0.0, 0.0),)
    wind: float | None = None
    away: Knots = ((0.0, 0.0),)


@dataclass(frozen=True)
class Dashcam:
    """A camera behind the windscreen of a car that drives on its springs.

    ``height`` over the road (m), ``view`` the horizontal field of view and
    ``pitch`` how far the camera looks down (degrees). The springs let the car
    pitch and roll by ``sway`` (degrees) and heave by ``heave`` (m) at most.
    """

    drive: Drive
    height: float
    view: float
    pitch: float
    sway: float
    heave: float


@dataclass(frozen=True)
class Stand:
    """Something put beside the target's street on purpose.

    ``kind``, ``variant`` and ``scale`` are those of a piece of furniture, ``along``
    the street's arc length (m), ``side`` +1 left or -1 right of the street,
    ``off`` metres beyond the kerb.
    """

    kind: str
    variant: int
    along: float
    side: int
    off: float
    scale: float = 1.0
    turn: float = 0.0


@dataclass(frozen=True)
class Trajectory:
    """A drive, the camera that watches it, and the other vehicles.

    ``asphalt`` is ``worn`` or ``smooth`` (no patches, cracks or litter: few corners).
    ``watched`` says that the camera keeps the target in the picture all the time.
    """

    name: str
    drive: Drive
    flight: Flight | Dashcam
    others: tuple[tuple[str, Drive], ...] = ()
    near_degenerate: bool = False
    terrain: str = "flat"
    ground_step: float = 0.35
    sun: tuple[float, float] = (48.0, 130.0)
    planted: tuple[Stand, ...] = ()
    asphalt: Literal["worn", "smooth"] = "worn"
    watched: bool = True

    @property
    def drives(self) -> tuple[Drive, ...]:
        """All drives: the target's, the others', that of the camera's car."""
        own = (self.flight.drive,) if isinstance(self.flight, Dashcam) else ()
        return (self.drive, *(drive for _, drive in self.others), *own)


ALL_ROUND = (140.0, -140.0, 110.0, -110.0, 70.0, -70.0, 40.0, -40.0, 165.0, -165.0)

TRAJECTORIES = {
    t.name: t
    for t in (
        Trajectory(
            "right_curves",
            Drive("linden", 26.0, 1, 1.7, ((0, 8.2), (1.6, 6.2), (3.4, 6.4), (6, 8.0))),
            Flight(ALL_ROUND, 38.0, (17.0, 14.0), (5.5, 11.5)),
            sun=(50.0, 215.0),
        ),
        Trajectory(
            "left_curves",
            Drive("mill", 25.0, 1, 1.7, ((0, 6.5), (2.0, 7.4), (4.2, 7.0), (6, 9.0))),
            Flight(ALL_ROUND, -42.0, (15.0, 17.5), (11.0, 5.0)),
            sun=(42.0, 95.0),
        ),
        Trajectory(
            "crossing",
            Drive("main", 464.0, 1, 1.5, ((0, 8.5), (2.4, 4.2), (3.2, 4.4), (6, 9.0))),
            Flight(ALL_ROUND, 55.0, (18.0, 15.0), (6.0, 13.0)),
            (
                ("hatchback", Drive("north", 269.0, 1, 1.5, ((0, 9.0), (6, 9.0)))),
                ("van", Drive("main", 526.0, -1, 1.5, ((0, 7.5), (3.0, 6.0), (6, 8.0)))),
                ("suv", Drive("north", 340.0, -1, 1.5, ((0, 8.0), (6, 0.4)))),
            ),
            sun=(55.0, 160.0),
        ),
        Trajectory(
            "overtaking",
            Drive(
                "main",
                250.0,
                1,
                1.5,
                ((0, 7.5), (2.5, 12.5), (6, 12.0)),
                ((4.0, 0.0), (20.0, 3.1), (42.0, 3.1), (58.0, 0.0)),
            ),
            Flight(ALL_ROUND, 60.0, (19.0, 16.0), (5.0, 12.0)),
            (("van", Drive("main", 262.0, 1, 1.5, ((0, 6.5), (6, 6.8)))),),
            sun=(45.0, 190.0),
        ),
        Trajectory(
            "bridge",
            Drive("main", 795.0, 1, 1.6, ((0, 8.5), (3.0, 7.0), (6, 9.5))),
            Flight(ALL_ROUND, -55.0, (17.0, 15.0), (11.5, 5.5)),
            terrain="bridge",
            sun=(40.0, 235.0),
        ),
        Trajectory(
            "steep_street",
            Drive("north", 492.0, 1, 1.5, ((0, 5.0), (3.0, 8.0), (6, 7.0))),
            Flight(ALL_ROUND, 55.0, (16.0, 18.0), (5.0, 11.0)),
            terrain="slope",
            sun=(52.0, 120.0),
        ),
        Trajectory(
            "bumpy_road",
            Drive("lane", 215.0, 1, 0.4, ((0, 5.5), (3.0, 7.0), (6, 5.0))),
            Flight(ALL_ROUND, 50.0, (14.0, 14.0), (7.5, 7.5)),
            near_degenerate=True,
            terrain="bumpy",
            ground_step=0.2,
            sun=(46.0, 150.0),
        ),
    )
}

TIME_SCALE_SPREAD, START_SPREAD_M, FLIGHT_SPREAD = 0.06, 3.0, 0.08


def variant(name: str, vehicle: str, seed: int) -> Trajectory:
    """The named trajectory as one vehicle drives it: start, pace, flight and sun vary a little."""
    base = TRAJECTORIES[name]
    r = rng("variant", name, vehicle, seed)
    pace = 1 + r.uniform(-TIME_SCALE_SPREAD, TIME_SCALE_SPREAD)
    speed = tuple((t, v * pace) for t, v in base.drive.speed)
    start = base.drive.start + r.uniform(-START_SPREAD_M, START_SPREAD_M) * (0.4 if base.others else 1.0)
    stretch = 1 + r.uniform(-FLIGHT_SPREAD, FLIGHT_SPREAD, 3)
    flight = replace(
        base.flight,
        sweep=base.flight.sweep * stretch[0],
        distance=tuple(d * stretch[1] for d in base.flight.distance),
        height=tuple(h * stretch[2] for h in base.flight.height),
    )
    sun = (base.sun[0] + r.uniform(-5, 5), base.sun[1] + r.uniform(-20, 20))
    return replace(base, drive=replace(base.drive, start=start, speed=speed), flight=flight, sun=sun)


def frame_times(n_frames: int) -> np.ndarray:
    """Times of the frames (s)."""
    return np.arange(n_frames) / FPS


def focus_of(drive: Drive, n_frames: int) -> Focus:
    """The bounding box of a drive."""
    points = drive.curve().point(drive.distance(frame_times(n_frames)))
    return Focus(points.min(0), points.max(0))


def focus_of_all(drives: tuple[Drive, ...], n_frames: int) -> Focus:
    """The bounding box of several drives."""
    boxes = [focus_of(drive, n_frames) for drive in drives]
    return Focus(np.min([b.low for b in boxes], 0), np.max([b.high for b in boxes], 0))
