"""Measures of lorry, bus and parcel car: bodies put together from blocks with rounded edges.

Metres, object coordinates: x forward, y left, z up, origin on the ground below
the middle of the wheelbase. A block is a profile in (x, z), drawn out in y.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..mesh import Mesh
from .spec import VEHICLES, Curve, VehicleSpec


@dataclass(frozen=True)
class Block:
    """A closed piece of the body: convex profile of (x, z), half width, radius of its edges (m)."""

    profile: Curve
    half_width: float
    edge: float
    has_arches: bool = False

    def mesh(self) -> Mesh:
        """The block without rounding, faces outward."""
        outline = np.array(self.profile, float)
        n = len(outline)
        y = self.half_width
        sides = [np.column_stack([outline[:, 0], np.full(n, side), outline[:, 1]]) for side in (-y, y)]
        faces = [(i, (i + 1) % n, n + (i + 1) % n, n + i) for i in range(n)]
        faces += [tuple(reversed(range(n))), tuple(range(n, 2 * n))]
        return Mesh(np.vstack(sides), faces, [])


@dataclass(frozen=True)
class HeavySpec:
    """What tells one vehicle of blocks from another; names as in :class:`VehicleSpec`."""

    name: str
    length: float
    width: float
    height: float
    wheelbase: float
    front_overhang: float
    wheel_radius: float
    tyre_width: float
    clearance: float
    blocks: tuple[Block, ...]
    paint: tuple[float, float, float]
    plate_text: str
    text: str = ""
    coat: float = 0.8
    spokes: int = 10

    @property
    def nose_x(self) -> float:
        """X of the foremost point."""
        return self.wheelbase / 2 + self.front_overhang

    @property
    def tail_x(self) -> float:
        """X of the hindmost point."""
        return self.nose_x - self.length

    @property
    def arch_radius(self) -> float:
        """Radius of the wheel arches."""
        return self.wheel_radius + 0.06

    @property
    def track_half(self) -> float:
        """|y| of the wheels' outer faces."""
        return self.width / 2 - 0.05

    @property
    def axles(self) -> tuple[float, float]:
        """X of the rear and the front axle."""
        return -self.wheelbase / 2, self.wheelbase / 2


def _cuboid(x: tuple[float, float], z: tuple[float, float], half_width: float, edge: float) -> Block:
    """A block of rectangular profile."""
    return Block(((x[0], z[0]), (x[1], z[0]), (x[1], z[1]), (x[0], z[1])), half_width, edge)


LORRY_BOX = (-4.66, 1.72, 1.06, 3.52)
LORRY_CAB_X = 1.84
LORRY = HeavySpec(
    name="lorry",
    length=8.34,
    width=2.50,
    height=3.52,
    wheelbase=4.65,
    front_overhang=1.35,
    wheel_radius=0.48,
    tyre_width=0.30,
    clearance=0.36,
    blocks=(
        _cuboid(LORRY_BOX[:2], LORRY_BOX[2:], 1.25, 0.035),
        Block(
            (
                (LORRY_CAB_X, 0.62),
                (2.0, 0.42),
                (3.60, 0.38),
                (3.67, 0.60),
                (3.675, 1.45),
                (3.46, 2.52),
                (3.22, 2.84),
                (2.0, 2.86),
                (LORRY_CAB_X, 2.70),
            ),
            1.22,
            0.09,
            True,
        ),
        _cuboid((-4.60, 3.2), (0.72, 1.04), 0.43, 0.02),
        _cuboid((-4.64, -4.52), (0.52, 0.98), 1.17, 0.02),
    ),
    paint=(0.03, 0.13, 0.30),
    plate_text="TX 3107 K",
    text="HOLZMANN\nFRISCHDIENST",
)

BUS_GLASS = (1.02, 2.46)
BUS = HeavySpec(
    name="bus",
    length=12.00,
    width=2.55,
    height=3.12,
    wheelbase=5.90,
    front_overhang=2.70,
    wheel_radius=0.48,
    tyre_width=0.30,
    clearance=0.30,
    blocks=(
        Block(
            (
                (-6.33, 0.58),
                (-6.05, 0.32),
                (5.48, 0.30),
                (5.63, 0.55),
                (5.65, 1.05),
                (5.50, 2.55),
                (5.32, 2.90),
                (-6.15, 2.90),
                (-6.34, 2.72),
            ),
            1.275,
            0.12,
            True,
        ),
        _cuboid((-4.9, -2.1), (2.85, 3.12), 0.92, 0.10),
        _cuboid((0.6, 2.4), (2.85, 3.04), 0.80, 0.08),
    ),
    paint=(0.58, 0.42, 0.05),
    plate_text="TX 1450 B",
    text="STADTWERKE",
)

COURIER_BOX = (-1.36, 0.46, 0.50, 2.46)
COURIER = HeavySpec(
    name="courier",
    length=2.60,
    width=1.40,
    height=2.46,
    wheelbase=1.72,
    front_overhang=0.38,
    wheel_radius=0.25,
    tyre_width=0.15,
    clearance=0.20,
    blocks=(
        _cuboid(COURIER_BOX[:2], COURIER_BOX[2:], 0.70, 0.03),
        Block(
            (
                (-1.34, 0.46),
                (-1.30, 0.22),
                (1.16, 0.22),
                (1.235, 0.42),
                (1.24, 0.92),
                (0.98, 1.98),
                (0.80, 2.08),
                (0.44, 2.08),
                (0.42, 0.56),
            ),
            0.66,
            0.05,
            True,
        ),
    ),
    paint=(0.60, 0.36, 0.02),
    plate_text="TX 88 P",
    text="PAKET",
    spokes=5,
)

HEAVY = {spec.name: spec for spec in (LORRY, BUS, COURIER)}
FLEET: dict[str, VehicleSpec | HeavySpec] = {**VEHICLES, **HEAVY}
