"""What is bolted to lorry, bus and parcel car: mirrors, guards, tank, steps, axles."""

from __future__ import annotations

import numpy as np

from ..mesh import Mesh, MeshBuilder
from .heavy import HeavySpec


def _mirror(builder: MeshBuilder, x: float, y: float, z: float, size: float) -> None:
    """A mirror on an arm, at the side ``y`` points to."""
    sign = np.sign(y)
    builder.tube(np.array([(x, y, z), (x + 0.1 * size, y + sign * 0.16 * size, z + 0.02)]), 0.018, "trim", 5)
    low, high = sorted((y + sign * 0.10 * size, y + sign * 0.28 * size))
    builder.box((x + 0.05 * size, low, z - 0.28 * size), (x + 0.14 * size, high, z + 0.12 * size), "trim")


def _axles(spec: HeavySpec, builder: MeshBuilder) -> None:
    """A tube between the wheels of each axle."""
    y = spec.track_half - spec.tyre_width - 0.02
    for x in spec.axles:
        builder.tube(np.array([(x, -y, spec.wheel_radius), (x, y, spec.wheel_radius)]), 0.08, "trim", 8)


def _lorry(spec: HeavySpec, builder: MeshBuilder) -> None:
    """Mirrors, side guards, tank, mudguards, an aerial."""
    for sign in (-1, 1):
        _mirror(builder, 3.30, sign * 1.22, 2.25, 1.3)
        for z in (0.55, 0.80):
            low, high = sorted((sign * 1.16, sign * 1.19))
            builder.box((-1.60, low, z), (1.0 if sign > 0 else 0.1, high, z + 0.12), "rim")
        for x in (-1.3, -0.2):
            low, high = sorted((sign * 1.08, sign * 1.16))
            builder.box((x, low, 0.5), (x + 0.06, high, 1.06), "trim")
        low, high = sorted((sign * 0.84, sign * 1.22))
        rear = spec.axles[0]
        angles = np.linspace(0.15 * np.pi, 0.85 * np.pi, 10)
        arc = [(rear + 0.56 * np.cos(a), 0.48 + 0.55 * np.sin(a)) for a in angles]
        builder.strip(np.array([(x, low, z) for x, z in arc]), np.array([(x, high, z) for x, z in arc]), "trim")
        builder.box((rear - 0.60, low, 0.30), (rear - 0.58, high, 0.72), "trim")
    builder.box((0.35, -1.18, 0.50), (1.25, -0.62, 1.00), "chrome")
    builder.tube(np.array([(2.6, 0.8, 2.8), (2.45, 0.8, 3.3)]), 0.01, "trim", 5)


def _bus(spec: HeavySpec, builder: MeshBuilder) -> None:
    """Mirrors that hang in front of the windscreen, a towing eye."""
    for sign in (-1, 1):
        builder.tube(
            np.array([(5.35, sign * 1.1, 2.75), (5.72, sign * 1.28, 2.68), (5.76, sign * 1.30, 2.45)]), 0.03, "trim", 6
        )
        low, high = sorted((sign * 1.20, sign * 1.42))
        builder.box((5.70, low, 1.98), (5.82, high, 2.46), "trim")
    builder.tube(np.array([(5.3, -0.45, 0.40), (5.66, -0.45, 0.40)]), 0.03, "chrome", 6)


def _courier(spec: HeavySpec, builder: MeshBuilder) -> None:
    """Two small mirrors and a step."""
    for sign in (-1, 1):
        _mirror(builder, 1.02, sign * 0.66, 1.36, 0.8)
    builder.box((0.5, -0.68, 0.20), (0.95, 0.68, 0.25), "trim")


FITTINGS = {"lorry": _lorry, "bus": _bus, "courier": _courier}


def build_fittings(spec: HeavySpec) -> Mesh:
    """Everything fixed to the body, in object coordinates."""
    builder = MeshBuilder()
    FITTINGS[spec.name](spec, builder)
    _axles(spec, builder)
    return builder.mesh()
