"""Charts with matplotlib. Each function draws into `ax`, or a new figure, and returns the axes."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np

from .errors import MissingError
from .geometry import Floats
from .vehicles import KM_H, Track

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from .results import Results

# Factors from m/s.
SPEED_UNITS = {"km/h": KM_H, "m/s": 1.0, "mph": 2.2369362920544}


def plot_speeds(results: Results, ax: Axes | None = None, unit: str = "km/h", min_verdict: str | None = None) -> Axes:
    """Plot smoothed speeds with bands of ±1σ over time; rejected trajectories are dotted.

    Args:
        results: results of a run.
        ax: axes to draw into.
        unit: `km/h`, `m/s` or `mph`.
        min_verdict: only vehicles with this verdict or a better one.
    """
    if unit not in SPEED_UNITS:
        raise ValueError(f"unit: {unit!r} is no unit of speed; give one of {', '.join(SPEED_UNITS)}")
    ax, factor = _axes(ax), SPEED_UNITS[unit]
    tracks = results.vehicles.values() if min_verdict is None else results.select(min_verdict)
    colors, drawn = _colors(results), 0
    for track in tracks:
        speed, std = factor * track.speed_m_s, factor * track.speed_std_m_s
        if not np.isfinite(speed).any():
            continue
        color = colors[track.id]
        ax.plot(track.time_s, speed, color=color, label=_label(track), linestyle=_style(track))
        ax.fill_between(track.time_s, speed - std, speed + std, color=color, alpha=0.2, linewidth=0)
        drawn += 1
    if not drawn:
        raise _unknown(results, "no speeds")
    ax.set(xlabel="time, s", ylabel=f"speed, {unit}")
    _legend(ax)
    return ax


def plot_paths(results: Results, ax: Axes | None = None, min_verdict: str | None = None) -> Axes:
    """Plot a plan view in meters: vehicles, ground tracks (dashed), camera (gray).

    Args:
        results: results of a run.
        ax: axes to draw into.
        min_verdict: only vehicles with this verdict or a better one, and no ground tracks.
    """
    tracks = _tracks(results, min_verdict)
    lines = [(track, _smoothed(track)[:, :2]) for track in tracks]
    if not any(np.isfinite(line).any() for _, line in lines):
        raise _unknown(results, "no positions in meters")
    ax = _axes(ax)
    center = results.cameras.center_m
    ax.plot(center[:, 0], center[:, 1], color="gray", label="camera")
    _draw(ax, lines, _colors(results))
    north = results.metric and results.metric.axes == "east-north-up"
    ax.set(xlabel="east, m" if north else "x, m", ylabel="north, m" if north else "y, m", aspect="equal")
    _legend(ax)
    return ax


def plot_map(results: Results, ax: Axes | None = None, min_verdict: str | None = None) -> Axes:
    """Plot georeferenced positions (longitude, latitude) at the right aspect; arguments as of `plot_paths`."""
    lines = [(track, track.lon_lat) for track in _tracks(results, min_verdict)]
    known = np.concatenate([np.zeros((0, 2)), *(line[np.isfinite(line).all(axis=1)] for _, line in lines)])
    if not len(known):
        raise MissingError(results.folder, "no georeferenced positions", "repeat the run with --telemetry")
    ax = _axes(ax)
    _draw(ax, lines, _colors(results))
    ax.set(xlabel="longitude, °", ylabel="latitude, °", aspect=1 / np.cos(np.radians(known[:, 1].mean())))
    ax.ticklabel_format(useOffset=False)
    ax.tick_params(axis="x", labelrotation=90)
    _legend(ax)
    return ax


def _axes(ax: Axes | None) -> Axes:
    if ax is not None:
        return ax
    try:
        from matplotlib import pyplot
    except ImportError:
        raise MissingError("matplotlib", "not installed", "pip install matplotlib") from None
    _, new = pyplot.subplots(constrained_layout=True)
    axes: Any = new
    return axes  # type: ignore[no-any-return]


def _tracks(results: Results, min_verdict: str | None) -> list[Track]:
    if min_verdict is not None:
        return list(results.select(min_verdict))
    return [*results.vehicles.values(), *results.ground_tracks.values()]


def _smoothed(track: Track) -> Floats:
    smoothed = track.smoothed_position_m
    return np.where(np.isfinite(smoothed), smoothed, track.position_m)


def _colors(results: Results) -> dict[int, Any]:
    """A color per vehicle id, the same in all charts and for its ground track; repeated after twenty."""
    from matplotlib import colormaps

    palette: Any = colormaps["tab20"]
    # Full tones first, then light ones.
    order = [*range(0, 20, 2), *range(1, 20, 2)]
    ids = sorted({*results.vehicles, *results.ground_tracks})
    return {number: palette(order[place % 20]) for place, number in enumerate(ids)}


def _legend(ax: Axes) -> None:
    ax.legend(fontsize="small", loc="upper left", bbox_to_anchor=(1.02, 1), borderaxespad=0)


def _draw(ax: Axes, lines: Iterable[tuple[Track, Floats]], colors: dict[int, Any]) -> None:
    for track, line in lines:
        if not np.isfinite(line).any():
            continue
        color = colors[track.id]
        ax.plot(line[:, 0], line[:, 1], color=color, linestyle=_style(track), label=_label(track))
        last = line[np.isfinite(line).all(axis=1)][-1]
        ax.plot(*last, color=color, marker="o", markersize=4)


def _label(track: Track) -> str:
    kind = "" if _is_trajectory(track) else "ground track, "
    return f"{track.class_name} {track.id} ({kind}{track.verdict.state if track.verdict else 'not judged'})"


def _style(track: Track) -> str:
    if not _is_trajectory(track):
        return "--"
    return ":" if track.verdict is None or track.verdict.state == "rejected" else "-"


def _is_trajectory(track: Track) -> bool:
    from .vehicles import Vehicle

    return isinstance(track, Vehicle)


def _unknown(results: Results, problem: str) -> MissingError:
    remedy = "repeat the run with --telemetry, --camera-height or --known-length"
    return MissingError(results.folder, problem, remedy)
