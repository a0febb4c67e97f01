"""Trees, bushes, hedges and tufts of grass."""

from __future__ import annotations

import numpy as np

from . import plan
from .ground import Focus
from .mesh import Mesh, MeshBuilder
from .seeds import rng

N_TREE_KINDS = 5
N_BUSH_KINDS = 3


def _leaves(r: np.random.Generator, centers: np.ndarray, size: tuple[float, float], material: str) -> Mesh:
    """A leaf (one folded quad) at each centre, turned at random."""
    n = len(centers)
    normal = r.normal(size=(n, 3)) + [0, 0, 0.8]
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    u = np.cross(normal, r.normal(size=(n, 3)))
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    v = np.cross(normal, u)
    s = r.uniform(*size, (n, 1))
    points = np.stack([centers - u * s, centers - v * s * 0.6, centers + u * s, centers + v * s * 0.6], 1).reshape(
        -1, 3
    )
    faces = [tuple(range(4 * i, 4 * i + 4)) for i in range(n)]
    shade = np.repeat(np.clip(r.normal(0.15, 0.2, n), 0, 0.7), 4)
    return Mesh(points, faces, [material] * n, False, {"shade": shade})


def _joined(a: Mesh, b: Mesh) -> Mesh:
    """Two meshes as one; ``a`` gets zeros for the attributes it lacks."""
    faces = a.faces + [tuple(i + len(a.vertices) for i in f) for f in b.faces]
    attributes = {name: np.concatenate([np.zeros(len(a.vertices)), values]) for name, values in b.attributes.items()}
    return Mesh(np.vstack([a.vertices, b.vertices]), faces, a.materials + b.materials, False, attributes)


def _limb(r: np.random.Generator, start: np.ndarray, direction: np.ndarray, length: float) -> np.ndarray:
    """A bent branch (6, 3) that turns upward."""
    t = np.linspace(0, 1, 6)[:, None]
    bend = r.normal(0, 0.10, 3) + [0, 0, 0.22]
    return start + direction * length * t + bend * length * t**2


def build_tree(kind: int) -> Mesh:
    """One of the tree models, about 5 to 8 m high, foot at the origin."""
    r = rng("tree", kind)
    height, crown = r.uniform(5.0, 8.0), r.uniform(1.6, 2.5)
    builder = MeshBuilder()
    trunk = np.array(
        [
            (0, 0, -0.3),
            (r.normal(0, 0.05), r.normal(0, 0.05), height * 0.3),
            (r.normal(0, 0.15), r.normal(0, 0.15), height * 0.62),
            (r.normal(0, 0.2), r.normal(0, 0.2), height * 0.9),
        ]
    )
    builder.tube(trunk, np.array([0.17, 0.13, 0.09, 0.03]), "bark", 8)
    centers = []
    for _ in range(16):
        z = r.uniform(0.38, 0.85) * height
        start = np.array([np.interp(z, trunk[:, 2], trunk[:, k]) for k in range(2)] + [z])
        angle = r.uniform(0, 2 * np.pi)
        reach = crown * r.uniform(0.55, 1.0) * (1.15 - abs(z / height - 0.6))
        limb = _limb(r, start, np.array([np.cos(angle), np.sin(angle), 0.35]), reach)
        builder.tube(limb, np.linspace(0.05, 0.012, 6), "bark", 5)
        for point in limb[2:]:
            centers.append(point + r.normal(0, 0.32, (44, 3)) * [1, 1, 0.75])
    leaves = _leaves(r, np.vstack(centers), (0.07, 0.15), f"leaf_{kind % 4}")
    return _joined(builder.mesh(), leaves)


def build_bush(kind: int) -> Mesh:
    """A round bush about 1 m wide, foot at the origin."""
    r = rng("bush", kind)
    direction = r.normal(size=(700, 3))
    direction[:, 2] = np.abs(direction[:, 2])
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    centers = direction * r.uniform(0.5, 1.0, (700, 1)) ** 0.5 * [0.55, 0.55, 0.75] + [0, 0, 0.05]
    leaves = _leaves(r, centers, (0.04, 0.09), f"leaf_{(kind + 1) % 4}")
    core = MeshBuilder()
    core.box((-0.25, -0.25, 0), (0.25, 0.25, 0.45), "bark")
    return _joined(core.mesh(), leaves)


def build_hedge(key: tuple, length: float) -> Mesh:
    """A clipped hedge along x from the origin, 1.1 m high."""
    r = rng("hedge", *key)
    n = int(length * 260)
    centers = r.uniform([0, -0.3, 0], [length, 0.3, 1.1], (n, 3))
    face = r.integers(3, size=n)
    side = r.choice([-0.3, 0.3], n)
    centers[face == 0, 1] = side[face == 0]
    centers[face == 1, 2] = 1.1
    centers += r.normal(0, 0.03, (n, 3))
    core = MeshBuilder()
    core.box((0, -0.25, 0), (length, 0.25, 1.0), "leaf_2")
    return _joined(core.mesh(), _leaves(r, centers, (0.04, 0.08), "leaf_0"))


def build_tufts(focus: Focus, reach: float = 24.0, per_m2: float = 1.6) -> Mesh:
    """Blades of grass and weeds on all lawns near the focus."""
    low, high = focus.low - reach, focus.high + reach
    r = rng("tufts", *(round(float(v), 2) for v in (*low, *high)))
    n = int(np.prod(high - low) * per_m2)
    centers = r.uniform(low, high, (n, 2))
    s = plan.survey(*centers.T)
    edge = np.where(s.rural > 0.5, 0.0, plan.SIDEWALK_M + 0.05)
    centers = centers[
        (s.kerb > edge)
        & (plan.river_bed(*centers.T) < 5.5)
        & ~(plan.over_river(*centers.T) & (np.abs(centers[:, 1]) < 8))
    ]
    n = len(centers)
    base = np.column_stack([centers, plan.ground_height(*centers.T)])
    angle = r.uniform(0, 2 * np.pi, n)
    across = np.stack([np.cos(angle), np.sin(angle), np.zeros(n)], 1) * r.uniform(0.03, 0.10, (n, 1))
    tip = base + np.column_stack([r.normal(0, 0.06, (n, 2)), r.uniform(0.06, 0.26, n)])
    points = np.stack([base - across, base + across, tip], 1).reshape(-1, 3)
    faces = [(3 * i, 3 * i + 1, 3 * i + 2) for i in range(n)]
    dry = r.random((n, 1)) < 0.3
    tint = np.where(dry, [(0.26, 0.22, 0.10)], [(0.085, 0.14, 0.03)]) * r.uniform(0.5, 1.4, (n, 1))
    return Mesh(points, faces, ["tint"] * n, False, {"tint": tint})
