"""An output folder of `tractrix run`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from . import tables
from ._json import RERUN, Node
from .errors import DamagedError, MissingError, VersionError
from .geometry import Floats, Sim3
from .masks import Masks
from .points import PointCloud, read_ply
from .reconstruction import Camera, Image, Reconstruction, read_reconstruction
from .vehicles import VERDICTS, GroundTrack, Vehicle

if TYPE_CHECKING:
    import geopandas
    import pandas

# The version of trajectories.json that is read.
VERSION = 3
UNITS = ("background", "metre")


@dataclass(frozen=True)
class Metric:
    """Relation of the background to meters.

    Attributes:
        verdict: source of largest weight: `surveyed`, `telemetry`, `prior-only`, `unknown`.
        reason: remark for people.
        metric_from_world: transform to the metric frame; None where meters are unknown.
        scale_std: 1σ of its scale; None where meters are unknown.
        axes: `east-north-up` or `up`; None where meters are unknown.
        origin: longitude, latitude, height_m, knows_height of the metric origin; None without telemetry.
        raw: `metric` of the file.
    """

    verdict: str
    reason: str | None
    metric_from_world: Sim3 | None
    scale_std: float | None
    axes: str | None
    origin: Mapping[str, Any] | None
    raw: Mapping[str, Any]


class Cameras:
    """Camera path: one row per registered frame, N in all, ascending.

    Attributes:
        frames: frame ids, shape (N,).
        names: image names, N.
        center: camera centers, shape (N, 3), background frame, its unit.
        world_from_cam_wxyz: rotations as unit quaternions w x y z, w ≥ 0, shape (N, 4).
    """

    def __init__(self, background: Reconstruction, metric: Metric | None) -> None:
        self._background, self._metric = background, metric
        images = sorted(background.images.values(), key=lambda image: image.image_id)
        self.frames: npt.NDArray[np.int64] = np.array([image.frame for image in images], np.int64)
        self.names = [image.name for image in images]
        self.center: Floats = np.array([image.projection_center() for image in images]).reshape(-1, 3)
        rotations = [image.cam_from_world.inverse().wxyz() for image in images]
        self.world_from_cam_wxyz: Floats = np.array(rotations).reshape(-1, 4)

    def __len__(self) -> int:
        return len(self.frames)

    def image(self, frame: int) -> Image:
        """Registered image of a frame, with its pose and observations."""
        return self._background.image_of_frame(frame)

    def camera(self, frame: int) -> Camera:
        """Intrinsics of a frame."""
        return self._background.camera_of(self.image(frame))

    def cam_from_world(self, frame: int) -> Sim3:
        """Pose of a frame: from the background's frame to the camera's (x right, y down, z forward)."""
        return self.image(frame).cam_from_world

    def world_from_cam(self, frame: int) -> Sim3:
        """Inverse of `cam_from_world`."""
        return self.cam_from_world(frame).inverse()

    def project(self, points: npt.ArrayLike, frame: int) -> Floats:
        """Project points of the background's frame, shape (..., 3), into a frame: pixels, shape (..., 2)."""
        return self._background.project(points, self.image(frame))

    @property
    def center_m(self) -> Floats:
        """Camera centers, shape (N, 3), metric frame, meters; NaN where meters are unknown."""
        transform = self._metric and self._metric.metric_from_world
        return transform * self.center if transform else np.full_like(self.center, np.nan)


class Results:
    """Results of one run. Models, masks and points are read when they are accessed.

    Attributes:
        folder: the output folder.
        unit: unit of positions: `background` (arbitrary) or `metre`.
        metric: relation to meters; None in files without it.
        vehicles: vehicles with a trajectory, by id, rejected ones included.
        ground_tracks: ground tracks by id; a vehicle may also be in `vehicles`, rejected or with few frames.
        raw: content of trajectories.json.
    """

    def __init__(self, folder: Path | str) -> None:
        self.folder = Path(folder)
        if not self.folder.is_dir():
            raise MissingError(self.folder, "no such folder", "give the output folder of `tractrix run`")
        node = Node.read(self.folder / "trajectories.json")
        _check_version(node)
        self.raw: Mapping[str, Any] = node.value
        self.unit = node.text("unit")
        if self.unit not in UNITS:
            node.fail("unit", f"one of {', '.join(UNITS)}")
        self.metric = _metric(node.node_or_none("metric"))
        vehicles = [Vehicle(self.folder, entry) for entry in node.nodes("objects")]
        ground_tracks = [GroundTrack(self.folder, entry) for entry in node.nodes("ground_tracks", [])]
        self.vehicles = {vehicle.id: vehicle for vehicle in vehicles}
        self.ground_tracks = {track.id: track for track in ground_tracks}
        if len(self.vehicles) < len(vehicles) or len(self.ground_tracks) < len(ground_tracks):
            raise DamagedError(node.path, "an id occurs twice", RERUN)

    def __repr__(self) -> str:
        counts = f"{len(self.vehicles)} vehicles, {len(self.ground_tracks)} ground tracks"
        return f"<Results {str(self.folder)!r}: {counts}>"

    @cached_property
    def run(self) -> Mapping[str, Any]:
        """Content of run.json: arguments, input, options, cost, warnings."""
        return Node.read(self.folder / "run.json").value

    @cached_property
    def tracks(self) -> dict[int, Mapping[str, Any]]:
        """Entries of tracks.json by id: all objects with masks, also those without a trajectory."""
        node = Node.read(self.folder / "tracks.json")
        return {entry.integer("id"): entry.value for entry in node.nodes("objects")}

    @cached_property
    def background(self) -> Reconstruction:
        """COLMAP model of the background."""
        return read_reconstruction(self.folder / "background")

    @cached_property
    def cameras(self) -> Cameras:
        """Camera path and intrinsics."""
        return Cameras(self.background, self.metric)

    @cached_property
    def masks(self) -> dict[int, Masks]:
        """Masks of all tracked objects, by id."""
        folders = [path for path in (self.folder / "tracks").glob("*") if path.name.isdigit() and path.is_dir()]
        return {int(path.name): Masks(path) for path in sorted(folders, key=lambda path: int(path.name))}

    @property
    def points(self) -> PointCloud:
        """Points of the background, in its frame (`ply/background.ply`)."""
        return read_ply(self.folder / "ply" / "background.ply")

    def to_metric(self, points: npt.ArrayLike) -> Floats:
        """Transform points of the background's frame, shape (..., 3), to the metric frame, meters."""
        transform = self.metric and self.metric.metric_from_world
        if not transform:
            remedy = "repeat the run with --telemetry, --camera-height or --known-length"
            raise MissingError(self.folder, "meters are unknown", remedy)
        return transform * points

    def select(self, min_verdict: str) -> list[Vehicle]:
        """Vehicles whose verdict is `min_verdict` or better; those without a verdict are not among them."""
        if min_verdict not in VERDICTS:
            raise ValueError(f"min_verdict: {min_verdict!r} is no verdict; give one of {', '.join(VERDICTS)}")
        states = VERDICTS[: VERDICTS.index(min_verdict) + 1]
        return [vehicle for vehicle in self.vehicles.values() if vehicle.verdict and vehicle.verdict.state in states]

    def table(self, name: str = "trajectories", min_verdict: str | None = None) -> tables.Table:
        """A table as columns of equal length; names of tables and columns are those of `tractrix export --format csv`.

        Args:
            name: `trajectories` (row per vehicle and frame), `vehicles`, `ground_positions` (row per ground track and
                frame), `ground_tracks`, or `camera` (row per registered frame).
            min_verdict: of the vehicles, only those with this verdict or a better one.
        """
        vehicles = list(self.vehicles.values()) if min_verdict is None else self.select(min_verdict)
        ground_tracks = list(self.ground_tracks.values())
        if name == "trajectories":
            return tables.positions(vehicles)
        if name == "vehicles":
            return tables.vehicles(vehicles)
        if name == "ground_positions":
            return tables.positions(ground_tracks)
        if name == "ground_tracks":
            return tables.ground_tracks(ground_tracks)
        if name == "camera":
            return tables.camera(self.cameras)
        raise ValueError(f"name: {name!r} is no table; give one of {', '.join(tables.NAMES)}")

    def to_pandas(self, name: str = "trajectories", min_verdict: str | None = None) -> pandas.DataFrame:
        """A table (see `table`) as a DataFrame. Needs pandas."""
        return tables.to_pandas(self.table(name, min_verdict))

    def to_geopandas(self, name: str = "trajectories", min_verdict: str | None = None) -> geopandas.GeoDataFrame:
        """Georeferenced results as a GeoDataFrame in EPSG:4326. Needs geopandas.

        `trajectories` and `ground_positions` have points, `vehicles` and `ground_tracks` a line each, empty where a
        vehicle has fewer than two georeferenced positions. Lines are not cut at the 180th meridian.

        Args:
            name: one of these four tables.
            min_verdict: of the vehicles, only those with this verdict or a better one.
        """
        vehicles = list(self.vehicles.values()) if min_verdict is None else self.select(min_verdict)
        tracks = list(self.ground_tracks.values()) if name.startswith("ground") else vehicles
        if not self.metric or self.metric.origin is None:
            remedy = "repeat the run with --telemetry, or use the metric frame of `to_pandas`"
            raise MissingError(self.folder, "no georeferenced positions", remedy)
        return tables.to_geopandas(name, self.table(name, min_verdict), tracks)


def load(folder: Path | str) -> Results:
    """Read an output folder of `tractrix run`.

    Raises:
        MissingError: there is no such folder, or no result in it.
        VersionError: another version wrote it.
        DamagedError: a file is truncated or contradicts its format.
    """
    return Results(folder)


def _check_version(node: Node) -> None:
    version = node.integer("version")
    if version < VERSION:
        remedy = "repeat the `tractrix run` that wrote it with a current version"
        raise VersionError(node.path, f"version {version}, this package reads {VERSION}", remedy)
    if version > VERSION:
        remedy = "use the Python package of the version that wrote it"
        raise VersionError(node.path, f"version {version}, this package reads {VERSION}", remedy)


def _metric(node: Node | None) -> Metric | None:
    if node is None:
        return None
    reason = None if node.get("reason") is None else node.text("reason")
    origin = node.node_or_none("origin")
    if node.get("scale") is None:
        return Metric(node.text("verdict"), reason, None, None, None, None, node.value)
    transform = Sim3.from_wxyz(node.number("scale"), node.vector("rotation_wxyz", 4), node.vector("translation", 3))
    std, axes = node.node("std").number("scale"), node.text("axes")
    return Metric(node.text("verdict"), reason, transform, std, axes, origin.value if origin else None, node.value)
