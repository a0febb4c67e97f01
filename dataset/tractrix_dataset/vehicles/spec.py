"""Measures of the five vehicles, in metres, object coordinates (x forward, z up)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

Curve = tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class Pillar:
    """A pillar between side windows: x at its foot and head, and its width."""

    foot_x: float
    head_x: float
    width: float
    painted: bool = False


@dataclass(frozen=True)
class VehicleSpec:
    """What tells one vehicle from another.

    ``top`` and ``belt`` are curves of (x, z) from tail to nose: the silhouette
    and the lower edge of the windows. ``cowl_x`` and ``header_x`` bound the
    windscreen, ``tail_glass`` the rear window (bottom z, top z).
    """

    name: str
    length: float
    width: float
    wheelbase: float
    front_overhang: float
    wheel_radius: float
    tyre_width: float
    clearance: float
    top: Curve
    belt: Curve
    cowl_x: float
    header_x: float
    tail_glass: tuple[float, float]
    tail_glass_x: tuple[float, float]
    side_glass: tuple[float, float, float, float]
    pillars: tuple[Pillar, ...]
    doors: tuple[float, ...]
    headlight: tuple[tuple[float, float], ...]
    taillight: tuple[tuple[float, float], ...]
    grille: tuple[tuple[float, float], ...]
    paint: tuple[float, float, float]
    plate_text: str
    tumblehome: float = 0.22
    corner: float = 0.20
    squareness: float = 5.0
    spokes: int = 5
    trim_height: float = 0.0
    roof_rails: bool = False
    badge: str = ""
    text: str = ""
    coat: float = 1.0
    arch_trim: bool = False

    @property
    def nose_x(self) -> float:
        """X of the foremost point."""
        return self.wheelbase / 2 + self.front_overhang

    @property
    def tail_x(self) -> float:
        """X of the hindmost point."""
        return self.nose_x - self.length

    @property
    def height(self) -> float:
        """Z of the roof."""
        return max(z for _, z in self.top)

    @property
    def arch_radius(self) -> float:
        """Radius of the wheel arches."""
        return self.wheel_radius + 0.05

    @property
    def reach(self) -> float:
        """How far from either end the body is drawn in (m); short of the wheels."""
        return min(0.65, self.nose_x - self.wheelbase / 2 + 0.1, -self.tail_x - self.wheelbase / 2 + 0.1)

    @property
    def track_half(self) -> float:
        """|y| of the wheels' outer faces."""
        return self.width / 2 - 0.045

    @property
    def axles(self) -> tuple[float, float]:
        """X of the rear and the front axle."""
        return -self.wheelbase / 2, self.wheelbase / 2


def rounded(curve: Curve, passes: int = 3) -> np.ndarray:
    """A curve (N, 2) with its corners cut (Chaikin), end points kept."""
    points = np.array(curve, float)
    for _ in range(passes):
        near, far = 0.8 * points[:-1] + 0.2 * points[1:], 0.2 * points[:-1] + 0.8 * points[1:]
        middle = np.stack([near, far], 1).reshape(-1, 2)
        points = np.vstack([points[:1], middle[1:-1], points[-1:]])
    return points


SALOON = VehicleSpec(
    name="saloon",
    length=4.57,
    width=1.76,
    wheelbase=2.635,
    front_overhang=0.95,
    wheel_radius=0.315,
    tyre_width=0.21,
    clearance=0.19,
    top=(
        (-2.30, 0.62),
        (-2.285, 0.96),
        (-2.20, 1.06),
        (-1.66, 1.09),
        (-0.92, 1.43),
        (-0.30, 1.49),
        (0.28, 1.455),
        (1.05, 1.03),
        (1.75, 0.92),
        (2.14, 0.80),
        (2.267, 0.62),
    ),
    belt=((-2.30, 0.90), (-1.3, 0.955), (1.0, 0.93), (1.8, 0.84), (2.267, 0.66)),
    cowl_x=1.02,
    header_x=0.30,
    tail_glass=(1.13, 1.40),
    tail_glass_x=(-1.60, -0.95),
    side_glass=(-1.50, -1.02, 0.38, 0.90),
    pillars=(Pillar(-0.12, -0.16, 0.10), Pillar(-1.02, -1.00, 0.04)),
    doors=(0.93, -0.12, -1.06),
    headlight=((0.38, 0.60), (0.80, 0.68), (0.86, 0.80), (0.66, 0.79), (0.42, 0.70)),
    taillight=((0.50, 0.74), (0.88, 0.74), (0.88, 0.95), (0.56, 0.93)),
    grille=((-0.36, 0.58), (0.36, 0.58), (0.42, 0.72), (-0.42, 0.72)),
    paint=(0.32, 0.022, 0.018),
    plate_text="TX 417 L",
    badge="GLX",
    spokes=7,
)

SUV = VehicleSpec(
    name="suv",
    length=5.29,
    width=2.00,
    wheelbase=3.02,
    front_overhang=0.98,
    wheel_radius=0.395,
    tyre_width=0.27,
    clearance=0.26,
    top=(
        (-2.80, 0.85),
        (-2.79, 1.25),
        (-2.70, 1.78),
        (-2.55, 1.92),
        (-1.0, 1.98),
        (0.10, 1.95),
        (0.50, 1.90),
        (1.15, 1.34),
        (1.9, 1.25),
        (2.38, 1.18),
        (2.49, 0.95),
    ),
    belt=((-2.80, 1.20), (1.1, 1.22), (2.0, 1.14), (2.49, 0.98)),
    cowl_x=1.12,
    header_x=0.52,
    tail_glass=(1.28, 1.78),
    tail_glass_x=(-2.8, -2.6),
    side_glass=(-2.62, -2.50, 0.52, 1.02),
    pillars=(Pillar(-0.20, -0.24, 0.14), Pillar(-1.35, -1.36, 0.18, True)),
    doors=(1.02, -0.20, -1.32),
    headlight=((0.56, 0.86), (0.94, 0.88), (0.94, 1.07), (0.58, 1.06)),
    taillight=((0.78, 0.98), (0.97, 0.98), (0.97, 1.46), (0.84, 1.46)),
    grille=((-0.48, 0.82), (0.48, 0.82), (0.50, 1.08), (-0.50, 1.08)),
    paint=(0.028, 0.055, 0.11),
    plate_text="TX 902 N",
    tumblehome=0.17,
    corner=0.14,
    squareness=7.0,
    spokes=6,
    trim_height=0.46,
    roof_rails=True,
    badge="4X4",
    arch_trim=True,
)

SMART = VehicleSpec(
    name="smart",
    length=2.70,
    width=1.56,
    wheelbase=1.87,
    front_overhang=0.44,
    wheel_radius=0.285,
    tyre_width=0.19,
    clearance=0.17,
    top=(
        (-1.325, 0.62),
        (-1.32, 0.98),
        (-1.20, 1.36),
        (-0.98, 1.49),
        (-0.35, 1.54),
        (0.18, 1.50),
        (0.80, 1.04),
        (1.08, 0.93),
        (1.28, 0.82),
        (1.375, 0.60),
    ),
    belt=((-1.325, 0.94), (0.75, 0.94), (1.375, 0.66)),
    cowl_x=0.80,
    header_x=0.20,
    tail_glass=(1.02, 1.38),
    tail_glass_x=(-1.31, -1.1),
    side_glass=(-1.02, -0.92, 0.26, 0.68),
    pillars=(Pillar(-0.50, -0.46, 0.13, True),),
    doors=(0.70, -0.46),
    headlight=((0.36, 0.62), (0.64, 0.62), (0.70, 0.80), (0.52, 0.84), (0.38, 0.72)),
    taillight=((0.56, 0.68), (0.75, 0.68), (0.75, 0.92), (0.60, 0.92)),
    grille=((-0.34, 0.46), (0.34, 0.46), (0.30, 0.56), (-0.30, 0.56)),
    paint=(0.62, 0.60, 0.55),
    plate_text="TX 55 S",
    tumblehome=0.20,
    corner=0.24,
    spokes=3,
    badge="42",
    trim_height=0.36,
)

HATCHBACK = VehicleSpec(
    name="hatchback",
    length=4.20,
    width=1.76,
    wheelbase=2.578,
    front_overhang=0.87,
    wheel_radius=0.315,
    tyre_width=0.21,
    clearance=0.18,
    top=(
        (-2.04, 0.62),
        (-2.03, 0.93),
        (-1.93, 1.08),
        (-1.60, 1.40),
        (-1.25, 1.455),
        (-0.45, 1.485),
        (0.28, 1.455),
        (1.08, 1.03),
        (1.72, 0.92),
        (2.05, 0.80),
        (2.158, 0.62),
    ),
    belt=((-2.04, 0.92), (-1.2, 0.97), (1.0, 0.93), (1.7, 0.85), (2.158, 0.66)),
    cowl_x=1.06,
    header_x=0.30,
    tail_glass=(1.08, 1.38),
    tail_glass_x=(-1.92, -1.62),
    side_glass=(-1.66, -1.44, 0.36, 0.92),
    pillars=(Pillar(-0.14, -0.18, 0.10), Pillar(-1.08, -1.12, 0.12, True)),
    doors=(0.95, -0.14, -1.10),
    headlight=((0.42, 0.62), (0.80, 0.66), (0.86, 0.80), (0.62, 0.82), (0.44, 0.76)),
    taillight=((0.60, 0.80), (0.87, 0.80), (0.86, 1.02), (0.66, 1.02)),
    grille=((-0.42, 0.68), (0.42, 0.68), (0.42, 0.76), (-0.42, 0.76)),
    paint=(0.035, 0.16, 0.36),
    plate_text="TX 260 G",
    badge="TDI",
    spokes=5,
)

VAN = VehicleSpec(
    name="van",
    length=4.89,
    width=1.90,
    wheelbase=3.00,
    front_overhang=0.895,
    wheel_radius=0.33,
    tyre_width=0.22,
    clearance=0.20,
    top=(
        (-2.495, 0.80),
        (-2.49, 1.45),
        (-2.44, 1.84),
        (-2.30, 1.93),
        (-0.5, 1.97),
        (0.70, 1.95),
        (0.98, 1.88),
        (1.72, 1.18),
        (2.12, 1.05),
        (2.33, 0.88),
        (2.393, 0.62),
    ),
    belt=((-2.495, 1.12), (1.5, 1.08), (2.0, 0.92), (2.393, 0.68)),
    cowl_x=1.70,
    header_x=0.98,
    tail_glass=(1.22, 1.72),
    tail_glass_x=(-2.5, -2.4),
    side_glass=(-2.30, -2.22, 1.02, 1.56),
    pillars=(Pillar(0.52, 0.46, 0.16, True), Pillar(-0.85, -0.85, 0.16, True)),
    doors=(1.52, 0.48, -0.86),
    headlight=((0.52, 0.70), (0.86, 0.72), (0.92, 0.92), (0.62, 0.93)),
    taillight=((0.80, 0.85), (0.94, 0.85), (0.94, 1.35), (0.84, 1.35)),
    grille=((-0.50, 0.74), (0.50, 0.74), (0.50, 0.84), (-0.50, 0.84)),
    paint=(0.70, 0.70, 0.68),
    plate_text="TX 781 V",
    tumblehome=0.10,
    corner=0.14,
    squareness=8.0,
    spokes=5,
    trim_height=0.34,
    badge="T5",
    text="HARTMANN\nDACH + FASSADE",
    coat=0.8,
)

VEHICLES = {spec.name: spec for spec in (SALOON, SUV, SMART, HATCHBACK, VAN)}

PARKED_PAINTS = (
    (0.55, 0.55, 0.55),
    (0.02, 0.02, 0.022),
    (0.70, 0.70, 0.70),
    (0.20, 0.21, 0.22),
    (0.25, 0.02, 0.02),
    (0.02, 0.06, 0.18),
    (0.03, 0.12, 0.06),
    (0.32, 0.24, 0.13),
    (0.42, 0.44, 0.47),
    (0.50, 0.16, 0.03),
)


def repainted(spec: VehicleSpec, index: int, plate: str) -> VehicleSpec:
    """The same model in another paint with another plate and no lettering."""
    return replace(spec, paint=PARKED_PAINTS[index % len(PARKED_PAINTS)], plate_text=plate, text="")
