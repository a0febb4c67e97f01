"""What lies flat on the streets: markings, patches, tar seams, manholes, litter.

Everything is thin geometry a few millimetres above the ground, draped over it.
"""

from __future__ import annotations

import numpy as np

from . import plan
from .ground import Focus
from .mesh import Mesh, MeshBuilder
from .seeds import rng

REACH_M = 75.0
PATCH_LIFT_M, TAR_LIFT_M, PAINT_LIFT_M, IRON_LIFT_M, LITTER_LIFT_M = 0.005, 0.007, 0.010, 0.012, 0.016


def _draped(points: np.ndarray, lift: float) -> np.ndarray:
    """Plane points (N, 2) with their lift as height; :func:`build_markings` lays them on the ground."""
    return np.column_stack([points, np.full(len(points), lift)])


def _band(
    builder: MeshBuilder,
    street: plan.Street,
    s0: float,
    s1: float,
    left: float,
    right: float,
    material: str,
    lift: float = PAINT_LIFT_M,
) -> None:
    """A band along a street between two arc lengths and two lateral offsets."""
    s = np.linspace(s0, s1, max(2, int(abs(s1 - s0) / 0.4) + 1))
    rows = [
        _draped(street.path.offset_point(s, u), lift)
        for u in np.linspace(right, left, max(2, int((left - right) / 0.5) + 1))
    ]
    for lower, upper in zip(rows, rows[1:]):
        builder.strip(lower, upper, material)


def _others(street: plan.Street, s: np.ndarray) -> np.ndarray:
    """Distance from points on a street's centre line to the kerbs of all other streets."""
    return plan.survey(*street.path.point(s).T, without=street.name).kerb


def _near(street: plan.Street, focus: Focus, s: np.ndarray) -> np.ndarray:
    """Those of the arc lengths that lie near the focus."""
    return s[focus.distance(*street.path.point(s).T) < REACH_M]


def _lines(builder: MeshBuilder, street: plan.Street, focus: Focus) -> None:
    """Centre dashes, edge lines, parking bays."""
    for s in _near(street, focus, np.arange(0, street.path.length - 3, 6.0)):
        if _others(street, np.array([s, s + 1.5, s + 3.0])).min() < 6.5:
            continue
        _band(builder, street, s, s + 3.0, 0.06, -0.06, "marking")
    if not street.parking:
        return
    for side in (1, -1):
        edge = street.half_width - 2.1
        for s in _near(street, focus, np.arange(0, street.path.length - 5.5, 5.5)):
            if _others(street, np.array([s, s + 5.5])).min() < 8:
                continue
            low, high = sorted((side * edge, side * (street.half_width - 0.15)))
            _band(builder, street, s, s + 0.1, high, low, "marking")
            for k in np.arange(s, s + 5.4, 1.1):
                _band(builder, street, k, k + 0.55, side * edge + 0.05, side * edge - 0.05, "marking")


def crossings(street: plan.Street) -> list[tuple[float, int]]:
    """Where a street meets another: arc length of the zebra's near edge and direction away."""
    s = np.arange(0.0, street.path.length, 0.25)
    outside = _others(street, s) > 1.2
    flips = np.nonzero(outside[1:] != outside[:-1])[0]
    return [(float(s[i + 1]), 1 if outside[i + 1] else -1) for i in flips]


def _zebras(builder: MeshBuilder, street: plan.Street, focus: Focus) -> None:
    """Zebra crossings and stop lines at the junctions."""
    for start, away in crossings(street):
        if focus.distance(*street.path.point(np.array([start])).T)[0] > REACH_M:
            continue
        for u in np.arange(-street.half_width + 0.5, street.half_width - 0.6, 1.0):
            _band(builder, street, *sorted((start, start + away * 3.0)), u + 0.5, u, "marking")
        edge = street.half_width - (2.2 if street.parking else 0.3)
        low, high = (0.15, edge) if away > 0 else (-edge, -0.15)
        _band(builder, street, *sorted((start + away * 3.9, start + away * 4.3)), high, low, "marking")


def _patches(builder: MeshBuilder, street: plan.Street, focus: Focus) -> None:
    """Repaired pieces of asphalt with tarred seams, and wandering tar lines."""
    for s in _near(street, focus, np.arange(2, street.path.length - 6, 3.2)):
        r = rng("patch", street.name, round(s / 3.2))
        if r.random() < 0.55 and not street.rural:
            u0 = r.uniform(-street.half_width + 0.3, street.half_width - 1.2)
            u1 = min(u0 + r.uniform(0.5, 2.6), street.half_width - 0.1)
            length = r.uniform(0.7, 5.0)
            material = str(r.choice(["patch_dark", "patch_light", "patch_mid"]))
            _band(builder, street, s, s + length, u1, u0, material, PATCH_LIFT_M)
            for u in (u0, u1):
                _band(builder, street, s, s + length, u + 0.025, u - 0.025, "tar", TAR_LIFT_M)
        if r.random() < 0.75:
            _tar_line(builder, street, s, r)


def _tar_line(builder: MeshBuilder, street: plan.Street, s: float, r: np.random.Generator) -> None:
    """A sealed crack: a dark line that wanders over the carriageway."""
    n = int(r.integers(12, 34))
    heading = r.uniform(0, 2 * np.pi)
    steps = heading + np.cumsum(r.normal(0, 0.33, n))
    at = np.cumsum(np.stack([np.cos(steps), np.sin(steps)], 1) * 0.22, axis=0)
    along = s + at[:, 0]
    across = r.uniform(-0.8, 0.8) * street.half_width + at[:, 1]
    keep = np.abs(across) < street.half_width - 0.1
    if keep.sum() < 4 or not keep.all():
        along, across = along[: int(np.argmin(keep)) or n], across[: int(np.argmin(keep)) or n]
    if len(along) < 4:
        return
    points = street.path.offset_point(along, across)
    tangent = np.gradient(points, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True) + 1e-9
    width = r.uniform(0.02, 0.045) * r.uniform(0.6, 1.4, len(points))
    normal = np.stack([-tangent[:, 1], tangent[:, 0]], 1) * width[:, None]
    material = "tar" if not street.rural else "patch_dark"
    builder.strip(_draped(points - normal, TAR_LIFT_M), _draped(points + normal, TAR_LIFT_M), material)


def _disc(builder: MeshBuilder, center: np.ndarray, radius: float, material: str, lift: float, sides: int = 16) -> None:
    """A flat disc draped over the ground."""
    a = np.linspace(0, 2 * np.pi, sides, endpoint=False)
    ring = center + radius * np.stack([np.cos(a), np.sin(a)], 1)
    builder.add(_draped(ring, lift), [tuple(range(sides))], material)


def _iron(builder: MeshBuilder, street: plan.Street, focus: Focus) -> None:
    """Manholes in the carriageway and drains in the gutter."""
    if street.rural:
        return
    for s in _near(street, focus, np.arange(5, street.path.length - 5, 9.0)):
        at = np.array([s])
        r = rng("iron", street.name, round(s / 9))
        center = street.path.offset_point(at + r.uniform(-2, 2), r.uniform(-0.7, 0.7) * (street.half_width - 0.6))[0]
        _disc(builder, center, 0.42, "concrete", IRON_LIFT_M - 0.004)
        _disc(builder, center, 0.34, "iron", IRON_LIFT_M)
        for k in range(-2, 3):
            half = 0.3 * np.sqrt(1 - (k / 3) ** 2)
            corners = center + np.array(
                [(-half, k * 0.11 - 0.02), (half, k * 0.11 - 0.02), (half, k * 0.11 + 0.02), (-half, k * 0.11 + 0.02)]
            )
            builder.add(_draped(corners, IRON_LIFT_M + 0.003), [(0, 1, 2, 3)], "concrete")
        side = street.half_width - 0.35
        for sign in (-1, 1):
            _band(builder, street, s + 3, s + 3.5, sign * side + 0.22, sign * side - 0.22, "iron", IRON_LIFT_M)
            for k in range(4):
                _band(
                    builder,
                    street,
                    s + 3.04 + 0.12 * k,
                    s + 3.09 + 0.12 * k,
                    sign * side + 0.18,
                    sign * side - 0.18,
                    "tar",
                    IRON_LIFT_M + 0.003,
                )


def build_markings(focus: Focus, worn: bool = True) -> Mesh:
    """All markings and, on worn streets, patches and covers near the focus, as one mesh laid on the ground."""
    builder = MeshBuilder()
    for street in plan.streets():
        if worn:
            _patches(builder, street, focus)
            _iron(builder, street, focus)
        if not street.rural:
            _lines(builder, street, focus)
            _zebras(builder, street, focus)
    mesh = builder.mesh()
    mesh.vertices[:, 2] += plan.surface_height(mesh.vertices[:, 0], mesh.vertices[:, 1])
    return mesh


LITTER = np.array(
    [
        (0.30, 0.15, 0.03),
        (0.22, 0.10, 0.03),
        (0.38, 0.26, 0.06),
        (0.55, 0.53, 0.48),
        (0.10, 0.12, 0.04),
        (0.16, 0.15, 0.14),
        (0.45, 0.30, 0.08),
        (0.60, 0.58, 0.55),
    ]
)


def build_litter(focus: Focus, per_m2: float = 0.30, reach: float = 26.0) -> Mesh:
    """Leaves, scraps and pebbles, each with a tint of its own."""
    low, high = focus.low - reach, focus.high + reach
    r = rng("litter", *(round(float(v), 2) for v in (*low, *high)))
    n = int(np.prod(high - low) * per_m2)
    centers = r.uniform(low, high, (n, 2))
    kerb = plan.survey(*centers.T).kerb
    keep = r.random(n) < np.select([kerb < -0.6, kerb < 0.0, kerb < plan.SIDEWALK_M], [0.35, 1.0, 0.6], 0.8)
    centers = centers[keep]
    n = len(centers)
    angle, size = r.uniform(0, 2 * np.pi, n), r.uniform(0.03, 0.11, n) * np.where(r.random(n) < 0.06, 2.2, 1.0)
    aspect, tilt = r.uniform(0.4, 1.0, n), r.uniform(0.0, 0.03, n)
    corners = []
    for cu, cv in ((-1, 0), (0, -1), (1, 0), (0.2, 1)):
        u, v = cu * size, cv * size * aspect
        corners.append(
            centers + np.stack([u * np.cos(angle) - v * np.sin(angle), u * np.sin(angle) + v * np.cos(angle)], 1)
        )
    points = np.stack(corners, 1).reshape(-1, 2)
    z = plan.surface_height(*points.T) + LITTER_LIFT_M + np.repeat(tilt, 4) * np.tile([0, 1, 0, 1], n)
    faces = [tuple(range(4 * i, 4 * i + 4)) for i in range(n)]
    tint = LITTER[r.integers(len(LITTER), size=n)] * r.uniform(0.6, 1.3, (n, 1))
    return Mesh(np.column_stack([points, z]), faces, ["tint"] * n, False, {"tint": tint})
