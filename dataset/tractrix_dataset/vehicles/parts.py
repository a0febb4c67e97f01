"""What is bolted to a body: wheels, mirrors, wipers, rails, aerials, exhaust."""

from __future__ import annotations

import numpy as np

from ..mesh import Mesh, MeshBuilder
from .body import belt_height, top_curve, upper_half_width
from .spec import VehicleSpec


def build_wheel(spec: VehicleSpec) -> Mesh:
    """A wheel round the y axis, centre at the origin, outer face at positive y."""
    builder = MeshBuilder()
    r, half, rim = spec.wheel_radius, spec.tyre_width / 2, spec.wheel_radius * 0.66
    tyre = [(rim, -half), (r * 0.94, -half), (r, -half * 0.75), (r, half * 0.75), (r * 0.94, half), (rim, half * 0.94)]
    builder.lathe(np.array(tyre), 40, "tyre", axis="y")
    well = [(rim, half * 0.94), (rim * 0.94, half * 0.9), (rim * 0.93, -half * 0.2), (0.05, -half * 0.2)]
    builder.lathe(np.array(well), 32, "brake", axis="y")
    builder.lathe(
        np.array([(rim * 1.0, half * 0.90), (rim * 0.99, half), (rim * 0.88, half * 0.96)]), 32, "rim", axis="y"
    )
    builder.lathe(
        np.array([(rim * 0.26, half * 0.55), (rim * 0.24, half * 0.86), (0.0, half * 0.9)]), 20, "rim", axis="y"
    )
    for k in range(spec.spokes):
        angle = 2 * np.pi * k / spec.spokes
        c, s = np.cos(angle), np.sin(angle)
        builder.frame = np.array([[c, 0, s, 0], [0, 1, 0, 0], [-s, 0, c, 0], [0, 0, 0, 1.0]])
        width = rim * (0.62 if spec.spokes == 3 else 1.1 / spec.spokes)
        builder.box((rim * 0.15, half * 0.5, -width / 2), (rim * 0.93, half * 0.88, width / 2), "rim")
    return builder.mesh()


def _mirrors(spec: VehicleSpec, builder: MeshBuilder) -> None:
    """Two door mirrors at the foot of the windscreen."""
    x = spec.side_glass[3] - 0.10
    z = float(belt_height(spec, x)) + 0.10
    y = float(upper_half_width(spec, x, z))
    size = 1.0 if spec.height < 1.7 else 1.3
    for sign in (-1, 1):
        profile = np.array([(0.02, -0.07), (0.075, -0.05), (0.09, 0.0), (0.075, 0.05), (0.03, 0.075)]) * size
        builder.frame = np.eye(4)
        builder.frame[:3, :3] = np.diag([0.75, sign * 1.25, 1.0])
        builder.frame[:3, 3] = (x, sign * (y + 0.13 * size), z)
        builder.lathe(profile, 14, "paint_plain")
        builder.frame = np.eye(4)
        low, high = sorted((sign * (y - 0.04), sign * (y + 0.10)))
        builder.box((x - 0.03, low, z - 0.08), (x + 0.03, high, z - 0.05), "trim")


def _wipers(spec: VehicleSpec, builder: MeshBuilder) -> None:
    """Two wipers that lie at the foot of the windscreen."""
    curve = top_curve(spec)
    for y0, y1 in ((0.10, 0.62), (-0.48, 0.04)):
        x0, x1 = spec.cowl_x - 0.01, spec.cowl_x - 0.09
        z0, z1 = (float(np.interp(x, curve[:, 0], curve[:, 1])) + 0.012 for x in (x0, x1))
        builder.tube(np.array([(x0, y0, z0), (x1, y1, z1 - 0.015)]), 0.012, "trim", 4)


def _roof(spec: VehicleSpec, builder: MeshBuilder) -> None:
    """Rails where the car has them, and a short aerial."""
    curve = top_curve(spec)
    if spec.roof_rails:
        for sign in (-1, 1):
            xs = np.linspace(spec.tail_glass_x[1] + 0.15, spec.header_x - 0.35, 12)
            z = np.interp(xs, curve[:, 0], curve[:, 1]) + 0.03
            z[[0, -1]] -= 0.05
            builder.tube(np.stack([xs, np.full(12, sign * spec.width * 0.36), z], 1), 0.02, "chrome", 6)
    x = spec.tail_glass_x[1] + 0.22
    z = float(np.interp(x, curve[:, 0], curve[:, 1]))
    builder.tube(np.array([(x, 0, z - 0.02), (x - 0.09, 0, z + 0.22)]), 0.008, "trim", 5)


def _underneath(spec: VehicleSpec, builder: MeshBuilder) -> None:
    """Exhaust, mud flaps and axles."""
    builder.tube(np.array([(spec.tail_x + 0.30, -0.45, 0.25), (spec.tail_x + 0.03, -0.45, 0.25)]), 0.032, "chrome", 8)
    for axle in spec.axles:
        y = spec.track_half - spec.tyre_width - 0.02
        builder.tube(np.array([(axle, -y, spec.wheel_radius), (axle, y, spec.wheel_radius)]), 0.05, "trim", 6)


def build_fittings(spec: VehicleSpec) -> Mesh:
    """Everything fixed to the body, in object coordinates."""
    builder = MeshBuilder()
    for add in (_mirrors, _wipers, _roof, _underneath):
        builder.frame = np.eye(4)
        add(spec, builder)
    return builder.mesh()


def wheel_centers(spec: VehicleSpec) -> np.ndarray:
    """Wheel centres at rest (4, 3): rear left, rear right, front left, front right."""
    y = spec.track_half - spec.tyre_width / 2
    return np.array([(x, sign * y, spec.wheel_radius) for x in spec.axles for sign in (1, -1)])
