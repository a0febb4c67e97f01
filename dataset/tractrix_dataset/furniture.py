"""What stands along the streets: lamps, signs, benches, bins, lights, bollards, boxes, fences.

Each kind has a builder that makes it at the origin (front towards -y, the
street), and :func:`places` says what stands where.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from . import buildings, plan
from .drives import Stand
from .markings import crossings
from .mesh import Mesh, MeshBuilder
from .nature import N_TREE_KINDS
from .seeds import rng


@dataclass(frozen=True)
class Place:
    """Something movable: kind, variant, plane position (m), heading (radians) and scale.

    ``height`` and ``radius`` (m) are for collisions; ``kerb_gap`` is how far from
    all carriageways it must be (m).
    """

    kind: str
    variant: int
    position: tuple[float, float]
    heading: float
    scale: float
    height: float
    radius: float
    kerb_gap: float = -10.0

    def matrix(self, ground_z: float) -> np.ndarray:
        """4x4 world_from_thing on ground of the given height (m)."""
        c, s = np.cos(self.heading), np.sin(self.heading)
        matrix = np.eye(4)
        matrix[:3, :3] = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) * self.scale
        matrix[:3, 3] = (*self.position, ground_z)
        return matrix


def _lamp(b: MeshBuilder, variant: int) -> None:
    height = 5.2 + 0.6 * (variant % 2)
    b.tube(np.array([(0, 0, -0.3), (0, 0, 1.0), (0, 0, height)]), np.array([0.09, 0.075, 0.045]), "steel", 8)
    b.tube(np.array([(0, 0, height - 0.1), (0, -0.5, height + 0.25), (0, -1.2, height + 0.3)]), 0.035, "steel", 6)
    b.box((-0.13, -1.55, height + 0.22), (0.13, -0.95, height + 0.34), "dark")
    b.box((-0.1, -0.09, 0.35), (0.1, 0.02, 0.85), "steel")
    if variant % 3 == 0:
        b.box((-0.2, -0.10, 1.5), (0.2, -0.08, 2.05), "paint_5")


def _sign(b: MeshBuilder, variant: int) -> None:
    b.tube(np.array([(0, 0, -0.3), (0, 0, 2.75)]), 0.035, "steel", 8)
    r, rim, inner = (
        0.32,
        ("signal_red", "signal_blue", "signal_red", "signal_yellow")[variant % 4],
        ("white", "white", "white", "white")[variant % 4],
    )
    sides = (24, 4, 3, 4)[variant % 4]
    turn = (0, np.pi / 4, -np.pi / 6, 0)[variant % 4]
    a = np.linspace(0, 2 * np.pi, sides, endpoint=False) + turn
    for scale, y, material in ((1.0, -0.05, rim), (0.72, -0.058, inner)):
        b.add(
            np.stack([r * scale * np.cos(a), np.full(sides, y), 2.35 + r * scale * np.sin(a)], 1),
            [tuple(range(sides))],
            material,
        )
    b.add(np.stack([r * np.cos(a), np.full(sides, -0.04), 2.35 + r * np.sin(a)], 1), [tuple(range(sides))], "steel")
    b.box((-0.10, -0.066, 2.28), (0.10, -0.06, 2.33), "dark")
    b.box((-0.02, -0.066, 2.22), (0.02, -0.06, 2.45), "dark")
    if variant % 2:
        b.box((-0.3, -0.06, 1.75), (0.3, -0.045, 1.95), "white")


def _bench(b: MeshBuilder, variant: int) -> None:
    for k in range(4):
        b.box((-0.85, -0.22 + 0.12 * k, 0.44), (0.85, -0.13 + 0.12 * k, 0.48), "wood")
    for k in range(3):
        b.box((-0.85, 0.26, 0.58 + 0.13 * k), (0.85, 0.30, 0.67 + 0.13 * k), "wood")
    for x in (-0.7, 0.7):
        b.box((x - 0.04, -0.22, -0.1), (x + 0.04, 0.28, 0.44), "dark")
        b.box((x - 0.04, 0.22, 0.4), (x + 0.04, 0.3, 0.98), "dark")


def _bin(b: MeshBuilder, variant: int) -> None:
    material = ("signal_green", "steel", "paint_1", "signal_yellow")[variant % 4]
    b.lathe(np.array([(0.0, 0.05), (0.2, 0.05), (0.24, 0.85), (0.25, 0.9), (0.0, 0.98)]), 14, material)
    b.box((-0.12, -0.26, 0.62), (0.12, -0.2, 0.76), "dark")


def _wheelie_bin(b: MeshBuilder, variant: int) -> None:
    material = ("dark", "paint_1", "paint_4", "signal_green")[variant % 4]
    b.box((-0.28, -0.32, 0.08), (0.28, 0.3, 0.95), material)
    b.box(
        (-0.31, -0.37, 0.95), (0.31, 0.34, 1.04), ("dark", "signal_yellow", "signal_blue", "dark")[(variant // 2) % 4]
    )
    b.box((-0.15, -0.33, 0.5), (0.15, -0.318, 0.7), "white")


def _bollard(b: MeshBuilder, variant: int) -> None:
    b.lathe(
        np.array([(0.07, -0.1), (0.07, 0.7), (0.085, 0.72), (0.085, 0.82), (0.0, 0.92)]),
        12,
        "dark" if variant % 2 else "concrete",
    )
    b.lathe(np.array([(0.073, 0.5), (0.073, 0.62)]), 12, "signal_red" if variant % 3 == 0 else "white")


def _hydrant(b: MeshBuilder, variant: int) -> None:
    b.lathe(
        np.array([(0.14, -0.1), (0.14, 0.06), (0.10, 0.08), (0.10, 0.62), (0.13, 0.64), (0.12, 0.72), (0.0, 0.82)]),
        12,
        "signal_red",
    )
    b.box((-0.2, -0.05, 0.42), (0.2, 0.05, 0.52), "signal_red")


def _cabinet(b: MeshBuilder, variant: int) -> None:
    w = 0.45 + 0.3 * (variant % 3)
    b.box((-w, -0.2, -0.1), (w, 0.25, 0.1), "concrete")
    b.box((-w + 0.03, -0.18, 0.1), (w - 0.03, 0.22, 1.25), ("concrete", "paint_2", "steel", "paint_6")[variant % 4])
    r = rng("cabinet", variant)
    for _ in range(6):
        x, z = r.uniform(-w + 0.1, w - 0.35), r.uniform(0.2, 0.95)
        b.box(
            (x, -0.195, z), (x + r.uniform(0.08, 0.3), -0.18, z + r.uniform(0.08, 0.25)), f"paint_{int(r.integers(10))}"
        )


def _phone_booth(b: MeshBuilder, variant: int) -> None:
    for x in (-0.43, 0.37):
        for y in (-0.43, 0.37):
            b.box((x, y, 0), (x + 0.06, y + 0.06, 2.2), "signal_red")
    b.box((-0.45, -0.45, 2.15), (0.45, 0.45, 2.45), "signal_red")
    b.box((-0.45, -0.45, 0), (0.45, 0.45, 0.12), "signal_red")
    b.box((-0.35, -0.46, 2.22), (0.35, -0.45, 2.38), "white")
    b.box((-0.40, 0.38, 0.1), (0.40, 0.40, 2.2), "window")
    b.box((-0.2, 0.2, 1.0), (0.2, 0.38, 1.7), "dark")


def _bus_stop(b: MeshBuilder, variant: int) -> None:
    b.box((-1.9, 0.55, 0.15), (1.9, 0.6, 2.3), "window")
    for x in (-1.9, 0.0, 1.9):
        b.box((x - 0.04, 0.5, -0.1), (x + 0.04, 0.62, 2.4), "dark")
    b.box((-2.1, -0.75, 2.35), (2.1, 0.75, 2.47), "steel")
    b.box((-2.0, -0.1, 0.3), (-1.93, 0.55, 2.2), "paint_0")
    b.box((-2.01, 0.0, 0.6), (-1.92, 0.45, 1.9), "signal_yellow")
    b.box((-1.3, 0.2, 0.42), (1.3, 0.5, 0.48), "wood")
    b.box((0.5, 0.54, 1.0), (1.3, 0.55, 1.9), "white")


def _traffic_light(b: MeshBuilder, variant: int) -> None:
    b.tube(np.array([(0, 0, -0.2), (0, 0, 3.3)]), 0.06, "dark", 8)
    b.box((-0.16, -0.28, 2.35), (0.16, -0.02, 3.3), "dark")
    for k, material in enumerate(("signal_green", "signal_yellow", "signal_red")):
        a = np.linspace(0, 2 * np.pi, 16, endpoint=False)
        center = 2.5 + 0.31 * k
        b.add(
            np.stack([0.1 * np.cos(a), np.full(16, -0.29), center + 0.1 * np.sin(a)], 1), [tuple(range(16))], material
        )
        b.box((-0.14, -0.40, center + 0.1), (0.14, -0.28, center + 0.12), "dark")
    b.box((-0.08, -0.09, 1.0), (0.08, -0.05, 1.25), "signal_yellow")


def _planter(b: MeshBuilder, variant: int) -> None:
    b.box((-0.55, -0.35, 0), (0.55, 0.35, 0.5), "concrete" if variant % 2 else "wood")
    r = rng("planter", variant)
    for _ in range(26):
        x, y, h = r.uniform(-0.45, 0.45), r.uniform(-0.28, 0.28), r.uniform(0.08, 0.3)
        b.box(
            (x - 0.06, y - 0.06, 0.45),
            (x + 0.06, y + 0.06, 0.5 + h),
            str(r.choice(["leaf_0", "leaf_1", "signal_red", "signal_yellow", "paint_8"])),
        )


def _crates(b: MeshBuilder, variant: int) -> None:
    r = rng("crates", variant)
    for _ in range(5):
        x, y, z, s = r.uniform(-0.6, 0.6), r.uniform(-0.3, 0.3), float(r.choice([0.0, 0.0, 0.4])), r.uniform(0.18, 0.32)
        b.box(
            (x - s, y - s * 0.8, z),
            (x + s, y + s * 0.8, z + 0.4),
            str(r.choice(["wood", "paint_5", "concrete", "rust", "paint_1"])),
        )


def _rock(b: MeshBuilder, variant: int) -> None:
    r = rng("rock", variant)
    n = 9
    profile = np.array([(0.01, -0.2), (0.5, -0.1), (0.55, 0.15), (0.4, 0.38), (0.01, 0.5)])
    b.lathe(profile, n, "concrete")
    b._vertices[-1] *= r.uniform(0.7, 1.3, (len(b._vertices[-1]), 1))


def _post(b: MeshBuilder, variant: int) -> None:
    b.box((-0.06, -0.06, -0.2), (0.06, 0.06, 1.1), "wood" if variant % 2 else "white")
    b.box((-0.065, -0.065, 0.75), (0.065, 0.065, 0.9), "dark")


def _fence(b: MeshBuilder, variant: int) -> None:
    r = rng("fence", variant)
    material = ("wood", "white", "rust")[variant % 3]
    for x in np.arange(-1.5, 1.5, 0.16):
        if r.random() < 0.95:
            b.box((x, -0.02, 0.05), (x + 0.10, 0.0, 0.95 + r.uniform(-0.06, 0.06)), material)
    for z in (0.3, 0.75):
        b.box((-1.5, 0.0, z), (1.5, 0.04, z + 0.08), material)
    b.box((-1.55, -0.05, -0.2), (-1.43, 0.07, 1.1), material)


def _poster_wall(b: MeshBuilder, variant: int) -> None:
    r = rng("poster_wall", variant)
    for x in (-2.9, 0.0, 2.9):
        b.box((x - 0.06, 0.0, -0.3), (x + 0.06, 0.1, 4.1), "steel")
    b.box((-3.1, -0.06, 0.5), (3.1, 0.0, 4.1), "dark")
    for x in (-3.0, 0.05):
        b.box((x, -0.09, 0.65), (x + 2.95, -0.06, 3.95), f"paint_{int(r.integers(10))}")
        for _ in range(14):
            u, z = x + r.uniform(0.1, 2.3), r.uniform(0.8, 3.5)
            size = r.uniform(0.1, 0.55, 2)
            material = str(r.choice([f"paint_{k}" for k in range(10)] + ["white", "signal_red", "signal_blue"]))
            b.box((u, -0.10, z), (min(u + size[0], x + 2.9), -0.09, z + size[1] * 0.8), material)


BUILDERS: dict[str, Callable[[MeshBuilder, int], None]] = {
    "lamp": _lamp,
    "sign": _sign,
    "bench": _bench,
    "bin": _bin,
    "wheelie_bin": _wheelie_bin,
    "bollard": _bollard,
    "hydrant": _hydrant,
    "cabinet": _cabinet,
    "phone_booth": _phone_booth,
    "bus_stop": _bus_stop,
    "traffic_light": _traffic_light,
    "planter": _planter,
    "crates": _crates,
    "rock": _rock,
    "post": _post,
    "fence": _fence,
    "poster_wall": _poster_wall,
}
SIZES = {
    "lamp": (6.3, 0.3),
    "sign": (2.8, 0.35),
    "bench": (1.0, 0.9),
    "bin": (1.0, 0.3),
    "wheelie_bin": (1.1, 0.4),
    "bollard": (0.9, 0.1),
    "hydrant": (0.8, 0.2),
    "cabinet": (1.3, 0.8),
    "phone_booth": (2.5, 0.6),
    "bus_stop": (2.5, 2.2),
    "traffic_light": (3.4, 0.3),
    "planter": (0.9, 0.6),
    "crates": (0.9, 0.8),
    "rock": (0.6, 0.6),
    "post": (1.1, 0.1),
    "fence": (1.1, 1.5),
    "tree": (8.0, 2.3),
    "bush": (1.0, 0.6),
    "parked": (2.0, 2.6),
    "poster_wall": (4.1, 3.1),
}
SIDEWALK_KINDS = (
    "sign",
    "bench",
    "bin",
    "bollard",
    "hydrant",
    "cabinet",
    "phone_booth",
    "planter",
    "wheelie_bin",
    "crates",
    "bollard",
    "wheelie_bin",
    "planter",
    "cabinet",
)
FIELD_KINDS = ("bush", "rock", "bush", "post", "tree", "bush", "rock", "tree")


def build(kind: str, variant: int) -> Mesh:
    """The mesh of one kind of street furniture, at the origin."""
    builder = MeshBuilder()
    BUILDERS[kind](builder, variant)
    return builder.mesh()


def _placed(
    kind: str, variant: int, street: plan.Street, s: float, side: int, off: float, scale: float = 1.0, turn: float = 0.0
) -> Place:
    """Something ``off`` metres beyond the kerb, facing the street."""
    at = np.array([s])
    position = street.path.offset_point(at, side * (street.half_width + off))[0]
    tangent = street.path.tangent(at)[0]
    heading = float(np.arctan2(tangent[1], tangent[0])) + (0.0 if side > 0 else np.pi) + turn
    height, radius = SIZES[kind]
    at_xy = (float(position[0]), float(position[1]))
    return Place(kind, variant, at_xy, heading, scale, height * scale, radius * scale, min(off, 0.35) - 0.1)


def planted(stand: Stand, street: plan.Street) -> Place:
    """The place of something that a trajectory puts beside its street."""
    return _placed(stand.kind, stand.variant, street, stand.along, stand.side, stand.off, stand.scale, stand.turn)


def _town_row(street: plan.Street, side: int) -> list[Place]:
    """Lamps, trees and small things on one sidewalk of a town street."""
    row: list[Place] = []
    for slot, s in enumerate(np.arange(3, street.path.length - 2, 25.0)):
        r = rng("lamp", street.name, side, slot)
        row.append(_placed("lamp", int(r.integers(6)), street, s + (12 if side < 0 else 0), side, 0.5))
    for slot, s in enumerate(np.arange(6, street.path.length - 2, 8.5)):
        r = rng("street_tree", street.name, side, slot)
        if r.random() < 0.6:
            row.append(
                _placed(
                    "tree",
                    int(r.integers(N_TREE_KINDS)),
                    street,
                    s + r.uniform(-2, 2),
                    side,
                    1.0,
                    r.uniform(0.6, 0.95),
                    r.uniform(0, 6),
                )
            )
    for slot, s in enumerate(np.arange(4, street.path.length - 2, 2.6)):
        r = rng("small", street.name, side, slot)
        if r.random() < 0.72:
            kind = str(r.choice(SIDEWALK_KINDS))
            off = 0.4 if kind in ("bollard", "sign", "hydrant") else float(r.uniform(1.7, 2.35))
            row.append(
                _placed(kind, int(r.integers(12)), street, s + r.uniform(-1, 1), side, off, 1.0, r.normal(0, 0.15))
            )
        r = rng("front_garden", street.name, side, slot)
        if r.random() < 0.5:
            kind = str(r.choice(["bush", "fence", "bush", "rock", "wheelie_bin", "crates"]))
            row.append(
                _placed(kind, int(r.integers(12)), street, s, side, 3.1, r.uniform(0.7, 1.2) if kind == "bush" else 1.0)
            )
    for slot, s in enumerate(np.arange(45, street.path.length, 120.0)):
        row.append(_placed("bus_stop", slot, street, s, side, 1.6))
    return row


def _lights(street: plan.Street) -> list[Place]:
    """Traffic lights where main and north street cross."""
    if street.name not in ("main", "north"):
        return []
    found = [c for c in crossings(street) if np.linalg.norm(street.path.point(np.array([c[0]]))[0]) < 15]
    return [_placed("traffic_light", 0, street, s + 6.5 * away, -away, 0.5, 1.0, np.pi / 2) for s, away in found]


def _country_row(street: plan.Street, side: int) -> list[Place]:
    """Trees, bushes, rocks and posts along a country lane."""
    row: list[Place] = []
    for slot, s in enumerate(np.arange(1, street.path.length, 1.5)):
        r = rng("country", street.name, side, slot)
        kind = str(r.choice(FIELD_KINDS))
        off = float(r.uniform(1.0, 14.0)) + (2.2 if kind == "tree" else 0.0)
        scale = float(r.uniform(0.6, 1.3)) if kind in ("bush", "tree", "rock") else 1.0
        row.append(
            _placed(
                kind, int(r.integers(12)), street, s, side, off, scale, r.uniform(0, 6.3) if kind != "post" else 0.0
            )
        )
        if r.random() < 0.12:
            row.append(_placed("fence", int(r.integers(12)), street, s, side, 2.0))
    return row


def _parked_row(street: plan.Street, side: int) -> list[Place]:
    """Parked cars in the bays of a street; variant chooses model and paint."""
    if not street.parking:
        return []
    row: list[Place] = []
    bays = np.arange(2.75, street.path.length - 5, 5.5)
    clear = plan.survey(*street.path.point(bays).T, without=street.name).kerb > 10
    for slot, s in enumerate(bays):
        r = rng("parked", street.name, side, slot)
        if r.random() < 0.45 or not clear[slot]:
            continue
        at = np.array([s])
        position = street.path.offset_point(at, side * (street.half_width - 1.05 + r.normal(0, 0.06)))[0]
        tangent = street.path.tangent(at)[0]
        heading = float(np.arctan2(tangent[1], tangent[0])) + (np.pi if side > 0 else 0.0) + r.normal(0, 0.012)
        height, radius = SIZES["parked"]
        row.append(
            Place("parked", int(r.integers(50)), (float(position[0]), float(position[1])), heading, 1.0, height, radius)
        )
    return row


def _gardens() -> list[Place]:
    """Bushes and trees scattered behind the houses and over the land."""
    r = rng("gardens")
    found: list[Place] = []
    for x, y in r.uniform(-plan.HALF_EXTENT_M + 10, plan.HALF_EXTENT_M - 10, (4200, 2)):
        kind = "tree" if r.random() < 0.5 else "bush"
        variant, scale, turn = int(r.integers(12)), float(r.uniform(0.7, 1.35)), float(r.uniform(0, 6.3))
        height, radius = SIZES[kind]
        gap = 5.5 if kind == "tree" else 3.6
        found.append(Place(kind, variant, (float(x), float(y)), turn, scale, height * scale, radius * scale, gap))
    return found


def _allowed(places: list[Place]) -> np.ndarray:
    """Which of them stand clear of carriageways, river and houses."""
    positions = np.array([p.position for p in places])
    gaps = np.array([p.kerb_gap for p in places])
    allowed = plan.survey(*positions.T).kerb >= gaps
    allowed &= (plan.river_bed(*positions.T) < 1.0) & ~plan.over_river(*positions.T)
    for lot in buildings.lots():
        near = np.abs(positions - lot.front).max(1) < 40
        allowed[near] &= ~lot.covers(positions[near], 0.35)
    return allowed


@lru_cache(maxsize=1)
def places() -> tuple[Place, ...]:
    """Everything movable in the world; nothing stands in a house."""
    found = _gardens()
    for street in plan.streets():
        for side in (1, -1):
            found += _country_row(street, side) if street.rural else _town_row(street, side)
            found += _parked_row(street, side)
        found += _lights(street)
    return tuple(place for place, good in zip(found, _allowed(found)) if good)
