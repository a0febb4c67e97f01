"""Tables of results, with the columns of `tractrix export --format csv`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from .errors import MissingError
from .geometry import Floats
from .vehicles import Estimate, GroundTrack, Track, Vehicle

if TYPE_CHECKING:
    import geopandas
    import pandas

    from .results import Cameras

NAMES = ("trajectories", "vehicles", "ground_positions", "ground_tracks", "camera")
Table = dict[str, npt.NDArray[Any]]
# Columns of positions that are keys of the file's frames.
SCALARS = (
    "speed_m_s", "speed_std_m_s", "raw_speed_m_s", "acceleration_m_s2", "acceleration_std_m_s2", "heading_deg",
    "heading_std_deg", "yaw_rate_deg_s", "yaw_rate_std_deg_s", "distance_to_camera_m", "distance_to_camera_std_m",
    "longitude", "latitude", "height_m",
)  # fmt: skip
VECTORS = {
    "position": ("x_units", "y_units", "z_units"),
    "position_m": ("x_m", "y_m", "z_m"),
    "position_std_m": ("x_std_m", "y_std_m", "z_std_m"),
    "smoothed_position_m": ("x_smoothed_m", "y_smoothed_m", "z_smoothed_m"),
    "smoothed_position_std_m": ("x_smoothed_std_m", "y_smoothed_std_m", "z_smoothed_std_m"),
}
TRAVEL = ("path_units", "path_m", "displacement_m", "mean_speed_m_s", "max_speed_m_s")
DIMENSIONS = ("length_m", "width_m", "height_m")


def positions(tracks: Sequence[Track]) -> Table:
    """Rows per track and frame."""
    counts = [len(track) for track in tracks]
    table: Table = {
        "vehicle": np.repeat(np.array([track.id for track in tracks], np.int64), counts),
        "class": np.repeat(_texts([track.class_name for track in tracks]), counts),
        "verdict": np.repeat(_texts([_state(track) for track in tracks]), counts),
        "frame": np.concatenate([np.zeros(0, np.int64), *(track.frames for track in tracks)]),
        "image": _texts([name for track in tracks for name in track.names]),
        "time_s": _joined([track.time_s for track in tracks]),
    }
    for key, columns in VECTORS.items():
        values = [track.column(key, 3) for track in tracks]
        table.update({column: _joined([value[:, i] for value in values]) for i, column in enumerate(columns)})
    table.update({key: _joined([track.column(key) for track in tracks]) for key in SCALARS})
    # The horizontal σ, as in the exported tables.
    place = [np.hypot(*track.column("place_std_m", 3)[:, :2].T) for track in tracks]
    table["place_std_m"] = _joined(place)
    return table


def vehicles(tracks: Sequence[Vehicle]) -> Table:
    """Rows per vehicle."""
    table = _overview(tracks)
    for key in DIMENSIONS:
        table.update(_estimates(key, [getattr(track.dimensions, key, None) for track in tracks]))
    table["scale_ratio"] = np.array([track.scale.ratio for track in tracks], float)
    table["scale_ratio_std"] = np.array([track.scale.std for track in tracks], float)
    return table


def ground_tracks(tracks: Sequence[GroundTrack]) -> Table:
    """Rows per ground track."""
    table = _overview(tracks)
    table["method"] = _texts([track.method for track in tracks])
    table["reason"] = _texts([track.reason for track in tracks])
    table["distance_std"] = np.array([getattr(track.verdict, "distance_std", None) for track in tracks], float)
    table["omitted_frames"] = np.array([sum(track.omitted.values()) for track in tracks], np.int64)
    return table


def camera(cameras: Cameras) -> Table:
    """Rows per registered frame."""
    table: Table = {"frame": cameras.frames, "image": _texts(cameras.names)}
    table.update({f"{axis}_units": cameras.center[:, i] for i, axis in enumerate("xyz")})
    table.update({f"q{part}": cameras.world_from_cam_wxyz[:, i] for i, part in enumerate("wxyz")})
    center = cameras.center_m
    table.update({f"{axis}_m": center[:, i] for i, axis in enumerate("xyz")})
    return table


def to_pandas(table: Table) -> pandas.DataFrame:
    """A table as a DataFrame."""
    try:
        import pandas
    except ImportError:
        raise MissingError("pandas", "not installed", "pip install pandas") from None
    return pandas.DataFrame(table)


def to_geopandas(name: str, table: Table, tracks: Sequence[Track]) -> geopandas.GeoDataFrame:
    """A table with points or lines on WGS 84."""
    try:
        import geopandas
        from shapely.geometry import LineString
    except ImportError:
        raise MissingError("geopandas", "not installed", "pip install geopandas") from None
    if name in ("trajectories", "ground_positions"):
        geometry = geopandas.points_from_xy(table["longitude"], table["latitude"])
    elif name in ("vehicles", "ground_tracks"):
        known = [track.lon_lat[np.isfinite(track.lon_lat).all(axis=1)] for track in tracks]
        geometry = [LineString(line if len(line) > 1 else []) for line in known]
    else:
        raise ValueError(f"name: {name!r} has no geometry; give one of {', '.join(NAMES[:4])}")
    return geopandas.GeoDataFrame(table, geometry=geometry, crs="EPSG:4326")


def _overview(tracks: Sequence[Track]) -> Table:
    spans = [_span(track) for track in tracks]
    table: Table = {
        "vehicle": np.array([track.id for track in tracks], np.int64),
        "class": _texts([track.class_name for track in tracks]),
        "confidence": np.array([track.confidence for track in tracks], float),
        "verdict": _texts([_state(track) for track in tracks]),
        "frames": np.array([len(track) for track in tracks], np.int64),
        "first_frame": np.array([track.frames[0] if len(track) else -1 for track in tracks], np.int64),
        "last_frame": np.array([track.frames[-1] if len(track) else -1 for track in tracks], np.int64),
        "first_time_s": np.array([first for first, _ in spans], float),
        "last_time_s": np.array([last for _, last in spans], float),
        "duration_s": np.array([last - first for first, last in spans], float),
    }
    for key in TRAVEL:
        table.update(_estimates(key, [getattr(track.travel, key, None) for track in tracks]))
    return table


def _estimates(key: str, values: Sequence[Estimate | None]) -> Table:
    """A quantity and its σ; the unit is the end of both names: `path_m`, `path_std_m`."""
    unit = next(unit for unit in ("_units", "_m_s", "_m") if key.endswith(unit))
    column = {key: np.array([value and value.value for value in values], float)}
    return column | {f"{key.removesuffix(unit)}_std{unit}": np.array([value and value.std for value in values], float)}


def _span(track: Track) -> tuple[float, float]:
    times = track.time_s[np.isfinite(track.time_s)]
    return (float(times[0]), float(times[-1])) if len(times) else (np.nan, np.nan)


def _state(track: Track) -> str | None:
    return track.verdict.state if track.verdict else None


def _texts(values: Sequence[str | None]) -> npt.NDArray[np.object_]:
    return np.array(values, dtype=object)


def _joined(parts: Sequence[Floats]) -> Floats:
    return np.concatenate([np.zeros(0), *parts])
