"""The ground as triangles: carriageways, kerbs, sidewalks and land, in one mesh.

A rectilinear grid, dense where the drive is, is cut along the lines of equal
distance to the kerb, so that kerbs and pavements have exact, smooth edges.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from . import plan

MATERIALS = ("road", "kerb", "sidewalk", "lawn", "lane", "deck")


@dataclass(frozen=True)
class Focus:
    """The part of the world that a sequence shows: the drive's bounding box (m)."""

    low: np.ndarray
    high: np.ndarray

    def distance(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Distance of points to the box (m), 0 inside."""
        dx = np.maximum(np.maximum(self.low[0] - x, x - self.high[0]), 0)
        dy = np.maximum(np.maximum(self.low[1] - y, y - self.high[1]), 0)
        return np.hypot(dx, dy)


@dataclass
class Ground:
    """Triangles with a material index each, and per vertex the distance to the kerb."""

    vertices: np.ndarray
    triangles: np.ndarray
    material: np.ndarray
    kerb: np.ndarray


def _grid_lines(low: float, high: float, step: float, margin: float) -> np.ndarray:
    """Coordinates: ``step`` apart inside, 9 % wider each further out, to the world's end."""
    inner = np.arange(low - margin, high + margin + step, step)
    steps = np.minimum(step * 1.09 ** np.arange(1, 400), 9.0)
    outward = np.cumsum(steps)
    left = (inner[0] - outward)[inner[0] - outward > -plan.HALF_EXTENT_M]
    right = (inner[-1] + outward)[inner[-1] + outward < plan.HALF_EXTENT_M]
    return np.concatenate([left[::-1], inner, right])


def _grid(xs: np.ndarray, ys: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Plane points (N, 2) and triangles (M, 3) of a rectilinear grid."""
    x, y = np.meshgrid(xs, ys)
    index = np.arange(x.size).reshape(x.shape)
    a, b, c, d = index[:-1, :-1].ravel(), index[:-1, 1:].ravel(), index[1:, 1:].ravel(), index[1:, :-1].ravel()
    triangles = np.vstack([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return np.stack([x.ravel(), y.ravel()], 1), triangles


def _cut(values: np.ndarray, triangles: np.ndarray, level: float) -> tuple[np.ndarray, np.ndarray]:
    """Cuts triangles along ``values[:, 2] == level``; values are (N, 3) rows x, y, kerb."""
    above = values[triangles, 2] > level
    count = above.sum(1)
    whole = (count == 0) | (count == 3)
    mixed = triangles[~whole]
    lone = np.where(count[~whole, None] == 1, above[~whole], ~above[~whole]).argmax(1)
    rows = np.arange(len(mixed))
    apex, left, right = (mixed[rows, (lone + k) % 3] for k in range(3))
    edges = np.vstack([np.stack([apex, left], 1), np.stack([apex, right], 1)])
    edges.sort(axis=1)
    unique, inverse = np.unique(edges, axis=0, return_inverse=True)
    start, end = values[unique[:, 0]], values[unique[:, 1]]
    t = (level - start[:, 2:]) / (end[:, 2:] - start[:, 2:])
    fresh = start + t * (end - start)
    fresh[:, 2] = level
    on_left, on_right = (inverse.ravel() + len(values)).reshape(2, -1)
    pieces = [triangles[whole], np.stack([apex, on_left, on_right], 1)]
    pieces += [np.stack([on_left, left, right], 1), np.stack([on_left, right, on_right], 1)]
    return np.vstack([values, fresh]), np.vstack(pieces)


def _materials(values: np.ndarray, triangles: np.ndarray, rural: np.ndarray) -> np.ndarray:
    """Material index of every triangle, from the mean distance to the kerb."""
    kerb = values[triangles, 2].mean(1)
    town = rural[triangles].mean(1) < 0.5
    limits = [0.0, plan.KERB_STONE_M, plan.SIDEWALK_M]
    material = np.searchsorted(limits, kerb)
    return np.where(town, material, np.where(kerb < 0, MATERIALS.index("lane"), MATERIALS.index("lawn")))


def build_ground(focus: Focus, step: float) -> Ground:
    """The ground of the whole world, ``step`` metres fine within 14 m of the focus."""
    xs = _grid_lines(focus.low[0], focus.high[0], step, 14.0)
    ys = _grid_lines(focus.low[1], focus.high[1], step, 14.0)
    points, triangles = _grid(xs, ys)
    s = plan.survey(points[:, 0], points[:, 1])
    kerb = plan.open_kerb(points[:, 0], points[:, 1], s.kerb)
    values = np.column_stack([points, kerb])
    for level in (0.0, plan.KERB_FACE_M, plan.KERB_STONE_M, plan.SIDEWALK_M):
        values, triangles = _cut(values, triangles, level)
    x, y, kerb = values.T
    s = plan.survey(x, y)
    s = plan.Survey(np.where(plan.over_river(x, y), s.kerb, kerb), s.rural, s.half_width)
    vertices = np.column_stack([x, y, plan.ground_height(x, y, s)])
    return Ground(vertices, triangles, _materials(values, triangles, s.rural), kerb)


def build_deck() -> Ground:
    """The bridge's carriageway and sidewalks as a strip mesh over the river."""
    half = plan.street("main").half_width
    across = np.array([0, half / 2, half, half + plan.KERB_FACE_M, half + plan.KERB_STONE_M, plan.DECK_HALF_M])
    across = np.concatenate([-across[:0:-1], across])
    along = np.arange(plan.BRIDGE_START_M - 1.5, plan.BRIDGE_END_M + 1.51, 0.5)
    points, triangles = _grid(along, across)
    kerb = np.abs(points[:, 1]) - half
    lift = plan.KERB_HEIGHT_M * np.clip(kerb / plan.KERB_FACE_M, 0, 1)
    z = plan.deck_height(points[:, 0], points[:, 1]) + lift
    material = np.searchsorted([0.0, plan.KERB_STONE_M], kerb[triangles].mean(1))
    return Ground(np.column_stack([points, z]), triangles, material, kerb)


def crop(ground: Ground, focus: Focus, margin: float) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles within ``margin`` metres of the focus, reindexed."""
    near = focus.distance(ground.vertices[:, 0], ground.vertices[:, 1]) < margin
    triangles = ground.triangles[near[ground.triangles].all(1)]
    used, inverse = np.unique(triangles, return_inverse=True)
    return ground.vertices[used], inverse.reshape(-1, 3)
