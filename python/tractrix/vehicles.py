"""Vehicles with a trajectory, and ground tracks: entries of `trajectories.json`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ._json import RERUN, Node
from .errors import DamagedError, MissingError
from .geometry import Floats, Sim3, as_floats
from .masks import Mask, Masks, masks_of
from .points import PointCloud, read_ply
from .reconstruction import Reconstruction, read_reconstruction

# Verdicts of trajectories, the best first.
VERDICTS = ("good", "fair", "doubtful", "rejected")
KM_H = 3.6


@dataclass(frozen=True)
class Estimate:
    """A value and its standard deviation (1σ), in one unit."""

    value: float
    std: float


@dataclass(frozen=True)
class Reason:
    """Evidence of a verdict: `finding` is `supports`, `doubts` or `refutes`; `weight` 0 to 1; `says` a sentence."""

    kind: str
    finding: str
    says: str
    weight: float


@dataclass(frozen=True)
class Verdict:
    """Verdict on a trajectory: `good`, `fair`, `doubtful` or `rejected`; `reasons` with the gravest first."""

    state: str
    reasons: tuple[Reason, ...]


@dataclass(frozen=True)
class GroundVerdict:
    """Verdict on a ground track: `usable`, `coarse` or `inconsistent`.

    `distance_std` is the median σ of the distance to the camera, as a share.
    """

    state: str
    distance_std: float
    says: str


@dataclass(frozen=True)
class Scale:
    """Scale ratio of a vehicle's model to the background.

    `std` is 1σ, None where the method gives none; `degenerate`: the data leave the ratio open, for the `reason`.
    """

    ratio: float
    std: float | None
    method: str
    degenerate: bool
    reason: str | None
    raw: Mapping[str, Any]


@dataclass(frozen=True)
class Travel:
    """Path length and displacement in units of the background and in meters, speeds; None where unknown."""

    path_units: Estimate | None
    displacement_units: Estimate | None
    path_m: Estimate | None
    displacement_m: Estimate | None
    mean_speed_m_s: Estimate | None
    max_speed_m_s: Estimate | None


@dataclass(frozen=True)
class Dimensions:
    """Size of a vehicle, meters; None for a dimension that was never visible."""

    length_m: Estimate | None
    width_m: Estimate | None
    height_m: Estimate | None


class Track:
    """Positions of one vehicle over time: common part of `Vehicle` and `GroundTrack`.

    All arrays have one row per frame, N in all, ascending. Quantities that a frame or the result does not have are NaN.
    Further keys of the file are in `raw` and `column`.

    Attributes:
        id: id of the vehicle, from 1.
        class_name: class of most detections (`class` in the file).
        confidence: mean score of the detections.
        frames: frame ids, shape (N,).
        names: image names, N.
        time_s: seconds of the video, shape (N,).
        position: center of the body, or of the points, shape (N, 3), background frame, its unit.
        raw: the entry of the file.
    """

    def __init__(self, folder: Path, node: Node) -> None:
        self._folder = folder
        self.raw: Mapping[str, Any] = node.value
        self.id = node.integer("id")
        self.class_name = node.text("class")
        self.confidence = node.number("confidence")
        rows = node.nodes("frames")
        self._rows = rows
        self.frames: npt.NDArray[np.int64] = np.array([row.integer("frame") for row in rows], np.int64)
        if np.any(np.diff(self.frames) <= 0):
            raise DamagedError(node.path, f"frames of vehicle {self.id} are not ascending", RERUN)
        self.names = [row.text("name") for row in rows]
        self.time_s = as_floats([row.number_or_none("time_s") for row in rows])
        self.position = as_floats([row.vector("position", 3) for row in rows]).reshape(-1, 3)
        self.travel = _travel(node.node_or_none("travel"))

    def __len__(self) -> int:
        return len(self.frames)

    def __repr__(self) -> str:
        state = self.verdict.state if self.verdict else None
        return f"<{type(self).__name__} {self.id}: {self.class_name}, {len(self)} frames, verdict {state}>"

    @property
    def verdict(self) -> Verdict | GroundVerdict | None:
        raise NotImplementedError

    def index(self, frame: int) -> int:
        """Row of a frame in the arrays."""
        at = int(np.searchsorted(self.frames, frame))
        if at == len(self.frames) or self.frames[at] != frame:
            raise MissingError(f"vehicle {self.id}", f"no position in frame {frame}", "take a frame of `frames`")
        return at

    def column(self, key: str, length: int = 1) -> Floats:
        """A key of all frames, shape (N,), or (N, length) for lists of numbers; NaN where absent or null."""
        if length == 1:
            return as_floats([row.number_or_none(key) for row in self._rows])
        values = [row.vector_or_none(key, length) or [np.nan] * length for row in self._rows]
        return as_floats(values).reshape(-1, length)

    @property
    def position_m(self) -> Floats:
        """Positions, shape (N, 3), metric frame, meters."""
        return self.column("position_m", 3)

    @property
    def position_std_m(self) -> Floats:
        """Standard deviations (1σ) of `position_m`, relative to the camera of the frame, shape (N, 3), meters."""
        return self.column("position_std_m", 3)

    @property
    def smoothed_position_m(self) -> Floats:
        """Smoothed positions, shape (N, 3), metric frame, meters."""
        return self.column("smoothed_position_m", 3)

    @property
    def smoothed_position_std_m(self) -> Floats:
        """Standard deviations (1σ) of `smoothed_position_m`, shape (N, 3), meters."""
        return self.column("smoothed_position_std_m", 3)

    @property
    def distance_to_camera_m(self) -> Floats:
        """Distances to the camera, shape (N,), meters."""
        return self.column("distance_to_camera_m")

    @property
    def speed_m_s(self) -> Floats:
        """Speeds along the heading, negative in reverse, shape (N,), m/s."""
        return self.column("speed_m_s")

    @property
    def speed_std_m_s(self) -> Floats:
        """Standard deviations (1σ) of `speed_m_s`, including that of the scale, shape (N,), m/s."""
        return self.column("speed_std_m_s")

    @property
    def speed_kmh(self) -> Floats:
        """Speeds along the heading, shape (N,), km/h."""
        return KM_H * self.speed_m_s

    @property
    def speed_std_kmh(self) -> Floats:
        """Standard deviations (1σ) of `speed_kmh`, shape (N,), km/h."""
        return KM_H * self.speed_std_m_s

    @property
    def acceleration_m_s2(self) -> Floats:
        """Accelerations along the heading, shape (N,), m/s²."""
        return self.column("acceleration_m_s2")

    @property
    def heading_deg(self) -> Floats:
        """Headings, clockwise from y (north where known), shape (N,), degrees."""
        return self.column("heading_deg")

    @property
    def yaw_rate_deg_s(self) -> Floats:
        """Yaw rates, shape (N,), degrees per second, positive when the heading increases."""
        return self.column("yaw_rate_deg_s")

    @property
    def lon_lat(self) -> Floats:
        """Longitudes and latitudes (WGS 84), shape (N, 2), degrees."""
        return np.stack([self.column("longitude"), self.column("latitude")], axis=1)

    @property
    def masks(self) -> Masks:
        """Masks of the vehicle by image name."""
        return masks_of(self._folder, self.id)

    def mask(self, frame: int) -> Mask:
        """Mask in a frame of the track, boolean, shape (height, width)."""
        name, masks = self.names[self.index(frame)], self.masks
        if name not in masks:
            raise MissingError(f"vehicle {self.id}", f"no mask in frame {frame}", "take an image of `masks`")
        return masks[name]


class Vehicle(Track):
    """A vehicle with a trajectory. Its model (`reconstruction`) has a frame and a unit of its own.

    Attributes:
        scale: scale ratio.
        dimensions: size; None where meters are unknown.
    """

    def __init__(self, folder: Path, node: Node) -> None:
        super().__init__(folder, node)
        scale = node.node("scale")
        reason = None if scale.get("reason") is None else scale.text("reason")
        self.scale = Scale(
            scale.number("ratio"),
            scale.number_or_none("std"),
            scale.text("method"),
            scale.boolean("degenerate"),
            reason,
            scale.value,
        )
        self._verdict = _verdict(node.node_or_none("verdict"))
        dimensions = node.node_or_none("dimensions")
        self.dimensions = dimensions and Dimensions(
            *(_estimate(dimensions, key) for key in ("length_m", "width_m", "height_m"))
        )
        self._poses = [_pose(row.node("world_from_object")) for row in self._rows]

    @property
    def verdict(self) -> Verdict | None:
        """Verdict on the trajectory; None where not judged."""
        return self._verdict

    def world_from_object(self, frame: int) -> Sim3:
        """Pose in a frame: from `reconstruction`'s frame to that of the background."""
        return self._poses[self.index(frame)]

    @property
    def reconstruction(self) -> Reconstruction:
        """COLMAP model of the vehicle (`objects/<id>`), read on each access."""
        return read_reconstruction(self._folder / "objects" / str(self.id))

    @property
    def points(self) -> PointCloud:
        """Points of the vehicle at its poses of all frames, in the background's frame (`ply/object-<id>.ply`)."""
        return read_ply(self._folder / "ply" / f"object-{self.id}.ply")


class GroundTrack(Track):
    """Positions of a vehicle on the ground, without orientation, size and scale ratio; not a trajectory.

    `position` is the ground point below the lower edge of the mask.

    Attributes:
        method: `ground-contact`.
        reason: reason for no usable trajectory.
        omitted: number of frames without a position, by reason.
    """

    def __init__(self, folder: Path, node: Node) -> None:
        super().__init__(folder, node)
        self.method = node.text("method")
        self.reason = node.text("reason")
        self._verdict = _ground_verdict(node.node_or_none("verdict"))
        omitted = node.node_or_none("omitted")
        self.omitted: dict[str, int] = {} if omitted is None else {key: omitted.integer(key) for key in omitted.value}

    @property
    def verdict(self) -> GroundVerdict | None:
        """Verdict on the ground track, with words of its own; None where not judged."""
        return self._verdict

    @property
    def covariance(self) -> Floats:
        """Covariances of `position`, shape (N, 3, 3), unit of the background squared.

        Sum of the parts in the file: noise of each frame, slow drift, and the error common to all frames.
        """
        errors = [row.node("error") for row in self._rows]
        noise = as_floats([error.matrix("noise", 3) for error in errors]).reshape(-1, 3, 3)
        for key in ("drift", "common"):
            part = as_floats([error.vector(key, 3) for error in errors]).reshape(-1, 3)
            noise = noise + part[:, :, None] * part[:, None, :]
        return noise


def _estimate(node: Node, key: str) -> Estimate | None:
    found = node.node_or_none(key)
    return None if found is None else Estimate(found.number("value"), found.number("std"))


def _travel(node: Node | None) -> Travel | None:
    return None if node is None else Travel(**{key: _estimate(node, key) for key in Travel.__dataclass_fields__})


def _verdict(node: Node | None) -> Verdict | None:
    if node is None:
        return None
    state = node.text("state")
    if state not in VERDICTS:
        node.fail("state", f"one of {', '.join(VERDICTS)}")
    reasons = [
        Reason(entry.text("kind"), entry.text("finding"), entry.text("says"), entry.number("weight"))
        for entry in node.nodes("reasons")
    ]
    return Verdict(state, tuple(reasons))


def _ground_verdict(node: Node | None) -> GroundVerdict | None:
    if node is None:
        return None
    return GroundVerdict(node.text("state"), node.number("distance_std"), node.text("says"))


def _pose(node: Node) -> Sim3:
    scale, wxyz = node.number("scale"), node.vector("rotation_wxyz", 4)
    if scale <= 0 or abs(np.linalg.norm(wxyz) - 1) > 1e-3:
        node.fail("rotation_wxyz", "a unit quaternion with a positive `scale`")
    return Sim3.from_wxyz(scale, wxyz, node.vector("translation", 3))
