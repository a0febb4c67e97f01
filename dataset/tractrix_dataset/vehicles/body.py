"""The body shell: cross sections along the car, closed at both ends, wheel arches cut out.

A section at x goes from the middle of the floor round the sill, up the side to
the belt line, and over the windows to the middle of the roof (or bonnet) as a
superellipse that leans inward. Faces are told apart later by their normals.
"""

from __future__ import annotations

import numpy as np

from .spec import VehicleSpec, rounded

STATION_STEP_M = 0.04
N_FLOOR, N_SIDE, N_UPPER = 4, 20, 22
EDGE_RADIUS_M = 0.07
CAP_SCALES = (0.85, 0.68, 0.5, 0.32, 0.14, 0.04)


def _lookup(curve: np.ndarray, x: np.ndarray | float) -> np.ndarray:
    """Z of a curve at x; beyond its ends the end values."""
    return np.interp(x, curve[:, 0], curve[:, 1])


def top_curve(spec: VehicleSpec) -> np.ndarray:
    """The silhouette (N, 2), corners rounded, x increasing."""
    curve = rounded(spec.top)
    curve[:, 0] = np.maximum.accumulate(curve[:, 0] + np.arange(len(curve)) * 1e-7)
    return curve


def belt_height(spec: VehicleSpec, x: np.ndarray | float) -> np.ndarray:
    """Z of the belt line, at least 3.5 cm below the silhouette."""
    return np.minimum(_lookup(rounded(spec.belt), x), _lookup(top_curve(spec), x) - 0.035)


def plan_half_width(spec: VehicleSpec, x: np.ndarray | float) -> np.ndarray:
    """Half width at x: full in the middle, drawn in towards nose and tail."""
    to_end = np.minimum(spec.nose_x - np.asarray(x), np.asarray(x) - spec.tail_x)
    missing = np.clip(1 - to_end / spec.reach, 0, 1)
    return spec.width / 2 * (1 - spec.corner * missing**2.2)


def upper_half_width(spec: VehicleSpec, x: np.ndarray | float, z: np.ndarray | float) -> np.ndarray:
    """Half width of the windows' side at height z above the belt line."""
    return plan_half_width(spec, x) * 0.975 - 0.025 - spec.tumblehome * (z - belt_height(spec, x))


def _arch_flare(spec: VehicleSpec, x: float, z: np.ndarray) -> np.ndarray:
    """How far the sides bulge out round the wheel arches (m)."""
    flare = np.zeros_like(z)
    for axle in spec.axles:
        r = np.hypot(x - axle, z - spec.wheel_radius)
        flare += 0.016 * np.exp(-(((r - spec.arch_radius) / 0.07) ** 2))
    return flare


def _section(spec: VehicleSpec, x: float) -> np.ndarray:
    """Half a cross section at x: (N, 2) pairs y, z from floor middle to roof middle."""
    w, belt = float(plan_half_width(spec, x)), float(belt_height(spec, x))
    top = float(_lookup(top_curve(spec), x))
    to_end = min(spec.nose_x - x, x - spec.tail_x)
    floor = spec.clearance + 0.10 * np.clip(1 - to_end / 0.6, 0, 1) ** 2
    sill = floor + 0.07
    bottom = np.stack([np.linspace(0, 0.93 * w, N_FLOOR), np.full(N_FLOOR, floor)], 1)
    z = np.linspace(sill, belt, N_SIDE)
    bulge = 1 - 0.055 * ((z - 0.62 * belt) / (belt - sill)) ** 2
    crease = 0.010 * (1 / (1 + np.exp(-(z - 0.80 * belt) / 0.012)) - 1)
    side = np.stack([w * bulge + crease + _arch_flare(spec, x, z), z], 1)
    foot = side[-1, 0] - 0.02
    angle = np.linspace(0, np.pi / 2, 160)
    power = 2 / spec.squareness
    rise = (top - belt) * np.sin(angle) ** power
    shape = np.cos(angle) ** power
    upper = np.stack(
        [(foot - spec.tumblehome * rise) * shape, belt + 0.004 + rise * (0.965 + 0.035 * (1 - shape**2))], 1
    )
    length = np.concatenate([[0], np.cumsum(np.hypot(*np.diff(upper, axis=0).T))])
    at = np.linspace(0, length[-1], N_UPPER)
    upper = np.stack([np.interp(at, length, upper[:, 0]), np.interp(at, length, upper[:, 1])], 1)
    upper[-1, 0] = 0.0
    return np.vstack([bottom, side, upper])


def _stations(spec: VehicleSpec) -> np.ndarray:
    """X of the sections: evenly spaced along the silhouette."""
    curve = top_curve(spec)
    length = np.concatenate([[0], np.cumsum(np.hypot(*np.diff(curve, axis=0).T))])
    at = np.linspace(0, length[-1], int(length[-1] / STATION_STEP_M))
    x = np.interp(at, length, curve[:, 0])
    inner = x[(x > spec.tail_x + EDGE_RADIUS_M) & (x < spec.nose_x - EDGE_RADIUS_M)]
    return inner[np.concatenate([[True], np.diff(inner) > 0.004])]


def _shrunk(section: np.ndarray, inset: float, scale: float = 1.0) -> np.ndarray:
    """A section drawn towards its middle by ``inset`` metres, then scaled."""
    middle = 0.5 * (section[:, 1].min() + section[:, 1].max())
    half = 0.5 * (section[:, 1].max() - section[:, 1].min())
    y = section[:, 0] * (1 - inset / section[:, 0].max()) * scale
    z = middle + (section[:, 1] - middle) * (1 - inset / half) * scale
    return np.stack([y, z], 1)


def _end_rings(spec: VehicleSpec, x_end: float, inward: float) -> list[tuple[float, np.ndarray]]:
    """(x, section) pairs that round the edge at one end and close it, outermost last."""
    rings = []
    section = _section(spec, x_end + inward * EDGE_RADIUS_M)
    for t in (0.25, 0.5, 0.75, 1.0):
        x = x_end + inward * EDGE_RADIUS_M * (1 - np.sin(t * np.pi / 2))
        rings.append((x, _shrunk(section, EDGE_RADIUS_M * (1 - np.cos(t * np.pi / 2)))))
    last = rings[-1][1]
    rings += [(x_end, _shrunk(last, 0.0, scale)) for scale in CAP_SCALES]
    return rings


def _bend_ends(spec: VehicleSpec, points: np.ndarray) -> np.ndarray:
    """Gives nose and tail their curve in plan and profile by moving vertices along x."""
    x, y, z = points.T
    moved = x.copy()
    for end, sign, lean in ((spec.nose_x, 1.0, 0.30), (spec.tail_x, -1.0, 0.10)):
        near = np.clip(1 - np.abs(end - x) / (spec.reach + 0.05), 0, 1) ** 2
        bumper = 0.50 if spec.height < 1.7 else 0.60
        retreat = lean * np.maximum(z - bumper, 0) ** 1.3 + 0.25 * np.maximum(bumper - 0.12 - z, 0)
        bow = 0.16 * (np.abs(y) / (spec.width / 2)) ** 2.2
        moved -= sign * near * (np.minimum(retreat, 0.15) + bow)
    return np.stack([moved, y, z], 1)


def build_shell(spec: VehicleSpec) -> tuple[np.ndarray, np.ndarray]:
    """The closed shell without arches: vertices (N, 3), quads (M, 4), outward normals."""
    rings = _end_rings(spec, spec.tail_x, 1.0)[::-1]
    rings += [(x, _section(spec, x)) for x in _stations(spec)]
    rings += _end_rings(spec, spec.nose_x, -1.0)
    loops = []
    for x, half in rings:
        other = half[-2:0:-1] * [-1, 1]
        loop = np.vstack([half, other])
        loops.append(np.column_stack([np.full(len(loop), x), loop]))
    n = len(loops[0])
    points = _bend_ends(spec, np.vstack(loops))
    faces = []
    for i in range(len(loops) - 1):
        a = np.arange(n) + i * n
        b = (np.arange(n) + 1) % n + i * n
        faces.append(np.stack([a, a + n, b + n, b], 1))
    return points, np.vstack(faces)


def end_loops(n_points: int) -> tuple[np.ndarray, np.ndarray]:
    """Vertex indices of the small open rings at tail and nose (to be closed by one face each)."""
    n = 2 * (N_FLOOR + N_SIDE + N_UPPER) - 2
    return np.arange(n), np.arange(n_points - n, n_points)[::-1]
