"""Houses along the streets: lots, façades with windows, shops, balconies, roofs."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from . import materials, plan
from .mesh import Mesh, MeshBuilder
from .seeds import Key, rng

FLOOR_M = 3.0
SHOP_NAMES = (
    "BÄCKEREI",
    "APOTHEKE",
    "CAFE LUNA",
    "RADHAUS",
    "BUCH + BILD",
    "MARKT 24",
    "OPTIK",
    "BLUMEN",
    "PIZZA",
    "FRISEUR",
    "KIOSK",
    "MÖBEL",
    "SCHUHE",
    "BAR NOVA",
    "FOTO",
    "TEE",
    "BANK",
    "UHREN",
    "WEIN",
    "SPORT",
)


@dataclass(frozen=True)
class Lot:
    """A house's place: middle of its street front, heading along the street, size (m)."""

    key: tuple[Key, ...]
    front: np.ndarray
    heading: float
    width: float
    depth: float
    floors: int

    @property
    def frame(self) -> np.ndarray:
        """4x4 world_from_house: x along the front, y into the house, z up from the ground."""
        c, s = np.cos(self.heading), np.sin(self.heading)
        matrix = np.eye(4)
        matrix[:2, :2] = [[c, -s], [s, c]]
        matrix[:3, 3] = (*self.front, self.ground())
        return matrix

    def corners(self) -> np.ndarray:
        """The footprint's corners (4, 2)."""
        local = np.array(
            [(-self.width / 2, 0), (self.width / 2, 0), (self.width / 2, self.depth), (-self.width / 2, self.depth)]
        )
        c, s = np.cos(self.heading), np.sin(self.heading)
        return local @ np.array([[c, s], [-s, c]]) + self.front

    def ground(self) -> float:
        """Height of the lowest ground under the house (m)."""
        x, y = self.corners().T
        return float(plan.ground_height(x, y).min())

    def height(self) -> float:
        """Height of the ridge over the ground at most (m)."""
        return self.floors * FLOOR_M + 5.0

    def covers(self, points: np.ndarray, margin: float) -> np.ndarray:
        """Whether world points (N, 2) lie within ``margin`` metres of the footprint."""
        c, s = np.cos(self.heading), np.sin(self.heading)
        local = (points - self.front) @ np.array([[c, -s], [s, c]])
        inside_x = np.abs(local[:, 0]) < self.width / 2 + margin
        return inside_x & (local[:, 1] > -margin) & (local[:, 1] < self.depth + margin)


def _candidate(street: plan.Street, side: int, slot: int, s: float, width: float) -> Lot:
    """The lot at arc length ``s`` on one side (+1 left, -1 right) of a street."""
    r = rng("lot", street.name, side, slot)
    tangent = street.path.tangent(np.array([s]))[0]
    setback = plan.SIDEWALK_M + 0.4 + r.choice([0.0, 0.0, 1.5, 3.5])
    front = street.path.offset_point(np.array([s]), side * (street.half_width + setback))[0]
    heading = float(np.arctan2(tangent[1], tangent[0])) + (0.0 if side > 0 else np.pi)
    floors = int(r.integers(2, 5)) if street.parking else int(r.integers(1, 4))
    return Lot((street.name, side, slot), front, heading, width, float(r.uniform(8.5, 12)), floors)


def _free(lot: Lot, taken: list[Lot]) -> bool:
    """Whether a lot keeps off all streets, the river and the houses before it."""
    t = np.linspace(-0.5, 0.5, 7)
    along, into = np.meshgrid(t * lot.width, (t + 0.5) * lot.depth)
    c, s = np.cos(lot.heading), np.sin(lot.heading)
    points = np.stack([along.ravel(), into.ravel()], 1) @ np.array([[c, s], [-s, c]]) + lot.front
    if plan.survey(*points.T).kerb.min() < plan.SIDEWALK_M + 0.2 or plan.river_bed(*points.T).max() > 0.3:
        return False
    if np.abs(points).max() > plan.HALF_EXTENT_M - 5:
        return False
    return not any(other.covers(points, 0.6).any() for other in taken if np.hypot(*(other.front - lot.front)) < 45)


@lru_cache(maxsize=1)
def lots() -> tuple[Lot, ...]:
    """All houses of the town."""
    taken: list[Lot] = []
    for street in plan.streets():
        if street.rural:
            continue
        for side in (1, -1):
            s, slot = 6.0, 0
            while s < street.path.length - 6:
                r = rng("row", street.name, side, slot)
                width = float(r.uniform(9, 17))
                lot = _candidate(street, side, slot, s + width / 2, width)
                if r.random() > 0.10 and _free(lot, taken):
                    taken.append(lot)
                    s += width + (0.5 if r.random() < 0.5 else r.uniform(2.5, 6))
                else:
                    s += 4.0
                slot += 1
    return tuple(taken)


class _House:
    """Builds one house; local x along the front, y into the house, z up."""

    def __init__(self, lot: Lot) -> None:
        self.lot = lot
        self.r = rng("house", *lot.key)
        self.builder = MeshBuilder()
        self.builder.frame = lot.frame
        kind = "plaster" if self.r.random() < 0.62 else "brick"
        self.wall = materials.pick(kind, *lot.key)
        self.trim = "white" if self.r.random() < 0.6 else "concrete"
        self.accent = materials.pick("paint", *lot.key)
        self.eaves = lot.floors * FLOOR_M + 0.5
        self.base = self.builder.frame
        self.sign: tuple[np.ndarray, str] | None = None

    def _face(self, turn: int) -> tuple[np.ndarray, float]:
        """World frame of one of the four walls (x along, y into, z up) and its length."""
        w, d = self.lot.width, self.lot.depth
        origin = {0: (0, 0), 1: (w / 2, d / 2), 2: (0, d), 3: (-w / 2, d / 2)}[turn]
        a = turn * np.pi / 2
        local = np.eye(4)
        local[:2, :2] = [[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]]
        local[:2, 3] = origin
        return self.base @ local, w if turn % 2 == 0 else d

    def build(self) -> Mesh:
        """The whole house."""
        w, d = self.lot.width / 2, self.lot.depth
        self.builder.box((-w, 0, -2.0), (w, d, self.eaves), self.wall)
        self.builder.box((-w - 0.04, -0.04, -2.0), (w + 0.04, d + 0.04, 0.45), "concrete")
        for turn in range(4):
            self.builder.frame, length = self._face(turn)
            self._wall(turn, length)
        self.builder.frame = self.base
        self._roof(w, d)
        mesh = self.builder.mesh()
        inverse = np.linalg.inv(self.base)
        local = mesh.vertices @ inverse[:3, :3].T + inverse[:3, 3]
        mesh.attributes = {
            "above": local[:, 2].astype(np.float32),
            "along": (local[:, 0] + local[:, 1]).astype(np.float32),
        }
        return mesh

    def _wall(self, turn: int, length: float) -> None:
        """One wall: a shop or a door below, windows in every floor."""
        bays = max(2, int(length / self.r.uniform(2.3, 3.2)))
        xs = (np.arange(bays) + 0.5) / bays * length - length / 2
        shop = turn == 0 and self.lot.floors > 1 and self.r.random() < 0.55
        if shop:
            self._shop(length)
        elif turn == 0:
            self._door(xs[int(self.r.integers(bays))])
        width = min(1.5, length / bays * self.r.uniform(0.38, 0.55))
        height = self.r.uniform(1.25, 1.75)
        style = int(self.r.integers(4))
        for floor in range(1 if shop else 0, self.lot.floors):
            for x in xs:
                if self.r.random() < 0.93:
                    self._window(x, 0.9 + 0.5 + floor * FLOOR_M - 0.1, width, height, style)
        if turn == 0:
            for floor in range(1, self.lot.floors):
                self.builder.box(
                    (-length / 2, -0.06, floor * FLOOR_M + 0.42), (length / 2, 0, floor * FLOOR_M + 0.54), self.trim
                )
            self._balconies(xs)
            self._clutter(length)
        self.builder.tube(
            np.array([(length / 2 - 0.25, -0.07, 0.0), (length / 2 - 0.25, -0.07, self.eaves)]), 0.05, "steel", 6
        )

    def _window(self, x: float, z: float, width: float, height: float, style: int) -> None:
        """A window with frame, sill, bars; behind it sometimes a curtain or a blind."""
        b, half = self.builder, width / 2
        b.box((x - half - 0.07, -0.045, z - 0.07), (x + half + 0.07, 0, z + height + 0.07), self.trim)
        b.box((x - half, -0.055, z), (x + half, -0.04, z + height), "window")
        b.box((x - half - 0.12, -0.16, z - 0.13), (x + half + 0.12, 0, z - 0.06), "concrete")
        b.box((x - 0.025, -0.07, z), (x + 0.025, -0.05, z + height), self.trim)
        draw = self.r.random(6)
        if draw[0] < 0.40:
            drawn = 0.25 + 0.6 * draw[1]
            b.box((x - half, -0.06, z + height * (1 - drawn)), (x + half, -0.056, z + height), "curtain")
        elif draw[0] < 0.6:
            side = -1 if draw[1] < 0.5 else 1
            low, high = sorted((side * half, side * half * (1 - draw[2])))
            b.box((x + low, -0.06, z), (x + high, -0.056, z + height), "curtain")
        if style == 0:
            for side in (-1, 1):
                if draw[3] < 0.85:
                    swing = half * (0.92 if draw[4] < 0.8 else 0.5)
                    low, high = sorted((x + side * (half + 0.05), x + side * (half + 0.05 + swing)))
                    b.box((low, -0.07, z), (high, -0.03, z + height), self.accent)
        elif style == 1:
            b.box((x - half, -0.075, z + height * 0.62), (x + half, -0.05, z + height * 0.66), self.trim)
        elif style == 2:
            b.box((x - half - 0.18, -0.14, z + height + 0.1), (x + half + 0.18, 0, z + height + 0.22), self.trim)
        if draw[5] < 0.14:
            self._flowers(x, z, width)
        elif draw[5] > 0.94:
            b.box((x - 0.4, -0.42, z - 0.75), (x + 0.4, -0.02, z - 0.2), "white")

    def _flowers(self, x: float, z: float, width: float) -> None:
        """A flower box on the sill."""
        b = self.builder
        b.box((x - width / 2, -0.30, z - 0.12), (x + width / 2, -0.08, z + 0.06), "wood")
        for _ in range(7):
            u, v, w = self.r.random(3)
            at = x + (u - 0.5) * width
            b.box(
                (at - 0.09, -0.34, z + 0.02 + 0.05 * v),
                (at + 0.09, -0.1, z + 0.16 + 0.14 * v),
                "leaf_0" if w < 0.55 else ("signal_red" if w < 0.75 else "signal_yellow"),
            )

    def _door(self, x: float) -> None:
        """A house door with steps and a small roof."""
        b = self.builder
        b.box((x - 0.62, -0.05, 0.2), (x + 0.62, 0, 2.75), self.trim)
        b.box((x - 0.5, -0.08, 0.2), (x + 0.5, -0.03, 2.4), self.accent)
        b.box((x - 0.3, -0.09, 1.5), (x + 0.3, -0.07, 2.2), "window")
        b.box((x - 0.9, -0.8, -0.5), (x + 0.9, 0, 0.2), "concrete")
        b.box((x - 1.0, -1.0, 2.8), (x + 1.0, 0, 2.9), "dark")
        b.box((x + 0.75, -0.05, 1.4), (x + 0.95, -0.01, 1.7), "steel")

    def _shop(self, length: float) -> None:
        """Shop windows, a sign board with a name, an awning."""
        b, half = self.builder, length / 2 - 0.5
        n = max(2, int(length / 2.6))
        edges = np.linspace(-half, half, n + 1)
        door = int(self.r.integers(n))
        for i in range(n):
            low = 0.15 if i == door else 0.6
            b.box((edges[i] + 0.1, -0.04, low), (edges[i + 1] - 0.1, 0, 2.75), "dark")
            b.box((edges[i] + 0.18, -0.06, low + 0.08), (edges[i + 1] - 0.18, -0.03, 2.65), "window")
            for _ in range(int(self.r.integers(1, 5))):
                u, v, w, h = self.r.random(4)
                x = edges[i] + 0.25 + u * (edges[i + 1] - edges[i] - 0.9)
                z = low + 0.15 + v * 1.2
                b.box(
                    (x, -0.07, z),
                    (x + 0.15 + 0.35 * w, -0.058, z + 0.15 + 0.5 * h),
                    materials.pick("paint", *self.lot.key, i, u),
                )
        b.box((-half, -0.16, 2.85), (half, 0, 3.45), self.accent)
        local = np.eye(4)
        local[:3, 3] = (0, -0.175, 2.97)
        self.sign = (b.frame @ local, SHOP_NAMES[int(self.r.integers(len(SHOP_NAMES)))])
        if self.r.random() < 0.6:
            self._awning(half)

    def _awning(self, half: float) -> None:
        """A striped awning."""
        count = int(2 * half / 0.45)
        xs = np.linspace(-half + 0.2, half - 0.2, count + 1)
        for i in range(count):
            corners = [(xs[i], -0.17, 2.85), (xs[i + 1], -0.17, 2.85), (xs[i + 1], -1.25, 2.4), (xs[i], -1.25, 2.4)]
            self.builder.quad(corners, self.accent if i % 2 else "white")

    def _balconies(self, xs: np.ndarray) -> None:
        """Balconies in front of some windows."""
        for floor in range(1, self.lot.floors):
            for x in xs:
                if self.r.random() < 0.12:
                    z = floor * FLOOR_M + 0.25
                    self.builder.box((x - 1.1, -1.0, z), (x + 1.1, 0, z + 0.14), "concrete")
                    for k in np.linspace(-1.05, 1.05, 12):
                        self.builder.box((x + k - 0.015, -0.98, z + 0.14), (x + k + 0.015, -0.95, z + 1.05), "dark")
                    self.builder.box((x - 1.1, -1.0, z + 1.03), (x + 1.1, -0.93, z + 1.09), "dark")

    def _clutter(self, length: float) -> None:
        """Small things on the front: boxes, posters, vents, a house number, a lamp."""
        for _ in range(int(self.r.integers(4, 10))):
            u, v, w, h, k = self.r.random(5)
            x, z = (u - 0.5) * (length - 0.8), 0.6 + v * 1.4
            material = f"paint_{int(k * len(materials.PAINTS))}" if k < 0.999 else "steel"
            self.builder.box((x, -0.03 - 0.08 * w, z), (x + 0.15 + 0.4 * w, 0.0, z + 0.2 + 0.5 * h), material)

    def _roof(self, w: float, d: float) -> None:
        """A gable roof with chimneys and skylights, or a flat one with clutter."""
        b, z = self.builder, self.eaves
        tiles = materials.pick("tiles", *self.lot.key)
        if self.r.random() < 0.3:
            b.box((-w - 0.1, -0.1, z - 0.1), (w + 0.1, d + 0.1, z + 0.25), "concrete")
            b.box((-w + 0.2, 0.2, z + 0.2), (w - 0.2, d - 0.2, z + 0.27), "flat_roof")
            for _ in range(5):
                u, v, s, h = self.r.random(4)
                x, y = (u - 0.5) * 1.6 * w, (0.15 + 0.7 * v) * d
                b.box(
                    (x - 0.3 - s, y - 0.4, z + 0.2),
                    (x + 0.3 + s, y + 0.4, z + 0.6 + h),
                    "steel" if u < 0.5 else "concrete",
                )
            return
        rise, over = min(0.42 * d, 4.2), 0.45
        ridge = z + rise
        for y0, y1 in ((-over, d / 2), (d + over, d / 2)):
            low = z - over * rise / (d / 2)
            b.quad([(-w - 0.3, y0, low), (w + 0.3, y0, low), (w + 0.3, y1, ridge), (-w - 0.3, y1, ridge)], tiles)
            b.quad(
                [
                    (-w - 0.3, y0, low - 0.15),
                    (w + 0.3, y0, low - 0.15),
                    (w + 0.3, y1, ridge - 0.15),
                    (-w - 0.3, y1, ridge - 0.15),
                ],
                "wood",
            )
            b.tube(np.array([(-w - 0.3, y0, low - 0.05), (w + 0.3, y0, low - 0.05)]), 0.08, "steel", 6)
        for x in (-w, w):
            b.quad([(x, 0, z), (x, d, z), (x, d / 2, ridge - 0.1)], self.wall)
        for _ in range(int(self.r.integers(1, 3))):
            x = self.r.uniform(-0.8, 0.8) * w
            b.box(
                (x - 0.3, d / 2 - 0.8, z + rise * 0.4),
                (x + 0.3, d / 2 - 0.2, ridge + 0.8),
                materials.pick("brick", *self.lot.key, 1),
            )
        for x in self.r.uniform(-0.85, 0.85, int(self.r.integers(1, 5))) * w:
            y = d * 0.22
            lift = z + rise * y / (d / 2)
            b.quad(
                [
                    (x - 0.4, y - 0.5, lift - 0.5 * rise / (d / 2) + 0.06),
                    (x + 0.4, y - 0.5, lift - 0.5 * rise / (d / 2) + 0.06),
                    (x + 0.4, y + 0.5, lift + 0.5 * rise / (d / 2) + 0.06),
                    (x - 0.4, y + 0.5, lift + 0.5 * rise / (d / 2) + 0.06),
                ],
                "window",
            )


@dataclass(frozen=True)
class House:
    """A house's mesh in world coordinates, and its shop sign (4x4 frame, words) if any."""

    mesh: Mesh
    sign: tuple[np.ndarray, str] | None


def build_house(lot: Lot) -> House:
    """The house on a lot."""
    house = _House(lot)
    mesh = house.build()
    return House(mesh, house.sign)
