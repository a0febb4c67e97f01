"""Materials of the world. All texture is noise in world coordinates: nothing repeats."""

from __future__ import annotations

from collections.abc import Callable

import bpy

from .seeds import rng
from .shading import Nodes, Socket, material

Color = tuple[float, float, float]
FINE_FADE_M = (12.0, 45.0)


def _fine(n: Nodes) -> Socket:
    """1 near the camera, 0 far off: grain smaller than a pixel would only flicker."""
    return n.step(n.node("ShaderNodeCameraData").outputs["View Distance"], FINE_FADE_M[1], FINE_FADE_M[0])


def _toned(n: Nodes, at: Socket, color: Socket | Color, scales: tuple, strength: float) -> Socket:
    """A colour darkened and lightened by noise at several scales (features per metre)."""
    for per_m in scales:
        value = n.math("MULTIPLY_ADD", n.noise(at, per_m, 4.0, 0.6), 2 * strength)
        value.node.inputs[2].default_value = 1 - strength
        color = n.mix(color, n.combine(value, value, value), 1.0, "MULTIPLY")
    return color


def _cracks(n: Nodes, at: Socket, per_m: float, width: float, cover: tuple[float, float]) -> Socket:
    """A mask of thin, wandering cracks where a slow noise lets them be."""
    edge = n.voronoi(n.warp(at, per_m * 2.5, 0.5 / per_m), per_m, "DISTANCE_TO_EDGE").outputs["Distance"]
    line = n.step(edge, width * per_m, width * per_m * 0.3)
    return n.math("MULTIPLY", line, n.step(n.noise(at, 0.09, 2.0), *cover))


def _grain(n: Nodes, at: Socket, color: Socket, strength: float) -> Socket:
    """Single stones of an asphalt or gravel surface, fading with distance."""
    speck = n.voronoi(at, 28.0).outputs["Color"]
    grey = n.node("ShaderNodeSeparateColor", {0: speck}).outputs[0]
    value = n.math(
        "ADD", 1.0, n.math("MULTIPLY", n.math("MULTIPLY", n.math("SUBTRACT", grey, 0.5), strength), _fine(n))
    )
    return n.mix(color, n.combine(value, value, value), 1.0, "MULTIPLY")


def _road(n: Nodes) -> None:
    at = n.position()
    color = n.ramp(
        n.noise(at, 0.22, 5.0, 0.62),
        [(0.3, (0.075, 0.075, 0.078)), (0.5, (0.12, 0.118, 0.115)), (0.72, (0.19, 0.185, 0.178))],
    )
    color = _toned(n, at, color, (0.9, 4.5), 0.33)
    kerb = n.attribute("kerb")
    worn = n.math("MULTIPLY", n.step(n.math("ABSOLUTE", n.math("ADD", kerb, 1.9)), 0.9, 0.2), 0.22)
    color = n.mix(color, (0.055, 0.055, 0.058), worn)
    gutter = n.math("MULTIPLY", n.step(kerb, -0.55, -0.05), n.noise(at, 1.7, 4.0))
    color = n.mix(color, (0.075, 0.062, 0.045), gutter)
    spots = n.step(n.noise(at, 1.3, 2.0, 0.4), 0.68, 0.74)
    color = n.mix(color, (0.03, 0.03, 0.03), n.math("MULTIPLY", spots, 0.6))
    color = n.mix(color, (0.018, 0.018, 0.018), _cracks(n, at, 0.42, 0.028, (0.42, 0.5)))
    color = n.mix(color, (0.03, 0.03, 0.028), _cracks(n, at, 1.9, 0.016, (0.56, 0.62)))
    color = _grain(n, at, color, 0.75)
    n.surface(color, 0.88, distant=(0.11, 0.108, 0.105))


def _smooth_road(n: Nodes) -> None:
    """New asphalt: one grey with darker wheel tracks, almost without corners."""
    at = n.position()
    color = _toned(n, at, (0.115, 0.115, 0.117), (0.12,), 0.05)
    tracks = n.math("MULTIPLY", n.step(n.math("ABSOLUTE", n.math("ADD", n.attribute("kerb"), 3.4)), 1.1, 0.3), 0.10)
    color = n.mix(color, (0.07, 0.07, 0.072), tracks)
    n.surface(_grain(n, at, color, 0.16), 0.85, distant=(0.115, 0.115, 0.117))


def _lane(n: Nodes) -> None:
    at = n.position()
    color = n.ramp(
        n.noise(at, 0.35, 6.0, 0.65),
        [(0.3, (0.10, 0.085, 0.06)), (0.5, (0.21, 0.18, 0.135)), (0.7, (0.33, 0.29, 0.22))],
    )
    color = _toned(n, at, color, (1.1, 5.0), 0.4)
    color = n.mix(
        color, (0.05, 0.07, 0.02), n.math("MULTIPLY", n.step(n.attribute("kerb"), -0.7, 0.0), n.noise(at, 2.2))
    )
    color = n.mix(color, (0.06, 0.045, 0.03), _cracks(n, at, 0.8, 0.03, (0.45, 0.55)))
    n.surface(_grain(n, at, color, 1.1), 0.95, distant=(0.2, 0.17, 0.13))


def _sidewalk(n: Nodes) -> None:
    at = n.position()
    brick = n.node(
        "ShaderNodeTexBrick",
        {
            "Vector": at,
            "Scale": 1.0,
            "Mortar Size": 0.009,
            "Brick Width": 0.6,
            "Row Height": 0.4,
            "Color1": (0.42, 0.41, 0.385),
            "Color2": (0.27, 0.265, 0.25),
            "Mortar": (0.07, 0.065, 0.055),
        },
        offset=0.5,
    )
    color = _toned(n, at, brick.outputs["Color"], (0.35, 1.6, 6.0), 0.33)
    color = n.mix(color, (0.06, 0.055, 0.05), _cracks(n, at, 0.6, 0.014, (0.5, 0.56)))
    stain = n.step(n.noise(at, 2.1, 2.0), 0.66, 0.70)
    color = n.mix(color, (0.08, 0.075, 0.065), n.math("MULTIPLY", stain, 0.7))
    n.surface(_grain(n, at, color, 0.4), 0.9, distant=(0.3, 0.29, 0.27))


def _kerb(n: Nodes) -> None:
    at = n.position()
    joints = n.step(n.voronoi(at, 1.1, "DISTANCE_TO_EDGE").outputs["Distance"], 0.02, 0.008)
    color = _toned(n, at, (0.40, 0.395, 0.375), (0.5, 3.0, 11.0), 0.3)
    n.surface(n.mix(color, (0.08, 0.08, 0.07), joints), 0.85)


def _lawn(n: Nodes) -> None:
    at = n.position()
    color = n.ramp(
        n.noise(at, 0.25, 7.0, 0.7),
        [
            (0.32, (0.035, 0.055, 0.012)),
            (0.48, (0.075, 0.115, 0.025)),
            (0.6, (0.14, 0.155, 0.05)),
            (0.72, (0.22, 0.18, 0.09)),
        ],
    )
    color = _toned(n, at, color, (1.4, 7.0), 0.42)
    bare = n.step(n.noise(at, 0.7, 4.0), 0.62, 0.70)
    color = n.mix(color, _toned(n, at, (0.15, 0.105, 0.065), (3.0, 12.0), 0.4), bare)
    n.surface(_grain(n, at, color, 1.0), 0.95, distant=(0.08, 0.10, 0.03))


def _marking(n: Nodes) -> None:
    at = n.position()
    worn = n.step(n.noise(at, 5.5, 6.0, 0.72), 0.42, 0.50)
    tone = n.math("MULTIPLY", n.step(n.noise(at, 0.35, 3.0), 0.25, 0.6), 0.25)
    keep = n.math("ADD", n.math("MULTIPLY", worn, 0.75), tone, clamp=True)
    paint = _toned(n, at, (0.66, 0.65, 0.61), (1.2, 6.0), 0.2)
    n.surface(n.mix((0.12, 0.118, 0.115), paint, keep), 0.8)


def _plain(
    color: Color, roughness: float, scales: tuple = (1.5, 7.0), strength: float = 0.2, metallic: float = 0.0
) -> Callable[[Nodes], None]:
    """A builder for a plain material with a little dirt."""

    def build(n: Nodes) -> None:
        n.surface(_toned(n, n.position(), color, scales, strength), roughness, metallic, distant=color)

    return build


def _patch(color: Color) -> Callable[[Nodes], None]:
    """A builder for repaired asphalt."""

    def build(n: Nodes) -> None:
        at = n.position()
        n.surface(_grain(n, at, _toned(n, at, color, (0.8, 5.0), 0.3), 0.7), 0.9)

    return build


def _plaster(color: Color) -> Callable[[Nodes], None]:
    """A builder for a plastered wall: stains, streaks below sills, a dirty foot."""

    def build(n: Nodes) -> None:
        at = n.position()
        tone = _toned(n, at, color, (0.25, 1.1, 5.0), 0.22)
        x, y, z = n.separate(at)
        across = n.noise(
            n.combine(n.math("MULTIPLY", x, 5.0), n.math("MULTIPLY", y, 5.0), n.math("MULTIPLY", z, 0.35)), 1.0
        )
        tone = n.mix(tone, (0.11, 0.10, 0.085), n.math("MULTIPLY", n.step(across, 0.56, 0.75), 0.5))
        foot = n.math("MULTIPLY", n.step(n.attribute("above"), 0.9, 0.0), n.noise(at, 1.5, 4.0))
        tone = n.mix(tone, (0.10, 0.09, 0.075), foot)
        fallen = n.step(n.noise(at, 0.55, 5.0, 0.62), 0.685, 0.695)
        tone = n.mix(tone, _toned(n, at, (0.30, 0.20, 0.15), (4.0, 9.0), 0.4), fallen)
        tone = n.mix(tone, (0.05, 0.05, 0.045), _cracks(n, at, 0.5, 0.012, (0.5, 0.56)))
        n.surface(tone, 0.9, distant=color)

    return build


def _brick(color: Color) -> Callable[[Nodes], None]:
    """A builder for brickwork; the courses run along the wall (attribute ``along``)."""

    def build(n: Nodes) -> None:
        at = n.position()
        wall = n.combine(n.attribute("along"), n.attribute("above"))
        pale = tuple(min(1.0, 1.9 * c) for c in color)
        brick = n.node(
            "ShaderNodeTexBrick",
            {
                "Vector": wall,
                "Scale": 1.0,
                "Mortar Size": 0.012,
                "Brick Width": 0.27,
                "Row Height": 0.085,
                "Color1": color,
                "Color2": pale,
                "Mortar": (0.30, 0.28, 0.25),
            },
        )
        tone = _toned(n, at, brick.outputs["Color"], (0.3, 1.3, 5.0), 0.28)
        n.surface(
            n.mix(tone, (0.09, 0.08, 0.07), n.math("MULTIPLY", n.step(n.noise(at, 0.8, 5.0), 0.58, 0.7), 0.6)),
            0.9,
            distant=color,
        )

    return build


def _tiles(color: Color) -> Callable[[Nodes], None]:
    """A builder for a tiled roof."""

    def build(n: Nodes) -> None:
        at = n.position()
        wall = n.combine(n.attribute("along"), n.attribute("above"))
        pale = tuple(min(1.0, 1.6 * c) for c in color)
        brick = n.node(
            "ShaderNodeTexBrick",
            {
                "Vector": wall,
                "Scale": 1.0,
                "Mortar Size": 0.02,
                "Brick Width": 0.25,
                "Row Height": 0.3,
                "Color1": color,
                "Color2": pale,
                "Mortar": (0.04, 0.03, 0.03),
            },
        )
        tone = _toned(n, at, brick.outputs["Color"], (0.3, 1.5, 6.0), 0.3)
        n.surface(n.mix(tone, (0.10, 0.12, 0.05), n.step(n.noise(at, 0.9, 5.0), 0.60, 0.72)), 0.85, distant=color)

    return build


def _window(n: Nodes) -> None:
    at = n.position()
    n.surface(_toned(n, at, (0.045, 0.055, 0.065), (0.6,), 0.5), 0.18, specular=0.5)


def _leaf(color: Color) -> Callable[[Nodes], None]:
    """A builder for leaves: a tone of its own for every tree and every branch."""

    def build(n: Nodes) -> None:
        at = n.position()
        tone = n.mix(color, tuple(0.55 * c for c in color), n.noise(at, 2.5, 2.0))
        tone = n.mix(tone, (0.20, 0.17, 0.03), n.math("MULTIPLY", n.random(), 0.35))
        leaf = n.attribute("shade")
        n.surface(n.mix(tone, (0.20, 0.26, 0.07), leaf), 0.7, distant=color)

    return build


def _colored(n: Nodes) -> None:
    """Colour from the mesh's corner attribute ``tint``, with dirt."""
    tint = n.node("ShaderNodeAttribute", attribute_name="tint").outputs["Color"]
    n.surface(_toned(n, n.position(), tint, (6.0,), 0.25), 0.75)


def _water(n: Nodes) -> None:
    at = n.position()
    color = n.ramp(n.noise(at, 0.15, 5.0), [(0.35, (0.05, 0.06, 0.045)), (0.65, (0.11, 0.11, 0.075))])
    foam = n.step(n.noise(n.warp(at, 1.0, 1.0), 0.8, 6.0, 0.7), 0.62, 0.70)
    n.surface(n.mix(color, (0.35, 0.36, 0.33), n.math("MULTIPLY", foam, 0.5)), 0.35)


PLASTERS: tuple[Color, ...] = (
    (0.55, 0.50, 0.40),
    (0.62, 0.60, 0.55),
    (0.50, 0.36, 0.22),
    (0.42, 0.44, 0.42),
    (0.58, 0.44, 0.34),
    (0.36, 0.42, 0.46),
    (0.60, 0.52, 0.30),
    (0.45, 0.28, 0.22),
    (0.34, 0.34, 0.32),
    (0.46, 0.50, 0.40),
)
BRICKS: tuple[Color, ...] = ((0.20, 0.075, 0.045), (0.27, 0.13, 0.075), (0.15, 0.075, 0.06), (0.30, 0.22, 0.14))
TILES: tuple[Color, ...] = ((0.20, 0.07, 0.04), (0.10, 0.055, 0.045), (0.07, 0.07, 0.075))
LEAVES: tuple[Color, ...] = ((0.05, 0.10, 0.018), (0.075, 0.11, 0.02), (0.035, 0.075, 0.02), (0.11, 0.12, 0.025))
PAINTS: tuple[Color, ...] = (
    (0.30, 0.05, 0.04),
    (0.05, 0.12, 0.22),
    (0.06, 0.16, 0.09),
    (0.55, 0.53, 0.48),
    (0.09, 0.06, 0.045),
    (0.50, 0.36, 0.05),
    (0.15, 0.16, 0.17),
    (0.30, 0.20, 0.12),
    (0.42, 0.10, 0.20),
    (0.03, 0.03, 0.035),
)

_BUILDERS: dict[str, Callable[[Nodes], None]] = {
    "road": _road,
    "deck": _road,
    "smooth_road": _smooth_road,
    "lane": _lane,
    "sidewalk": _sidewalk,
    "kerb": _kerb,
    "lawn": _lawn,
    "marking": _marking,
    "window": _window,
    "tint": _colored,
    "water": _water,
    "patch_dark": _patch((0.045, 0.045, 0.048)),
    "patch_light": _patch((0.21, 0.205, 0.195)),
    "patch_mid": _patch((0.085, 0.083, 0.082)),
    "tar": _plain((0.014, 0.014, 0.015), 0.5),
    "iron": _plain((0.07, 0.06, 0.05), 0.6, (3.0, 20.0), 0.4),
    "steel": _plain((0.30, 0.31, 0.32), 0.45, metallic=0.3),
    "concrete": _plain((0.36, 0.35, 0.33), 0.9, (0.4, 2.0, 8.0), 0.32),
    "wood": _plain((0.22, 0.13, 0.065), 0.8, (2.0, 9.0), 0.4),
    "bark": _plain((0.10, 0.07, 0.045), 0.95, (4.0, 15.0), 0.5),
    "white": _plain((0.66, 0.66, 0.63), 0.6, (2.0,), 0.15),
    "dark": _plain((0.035, 0.035, 0.038), 0.6),
    "glass_light": _plain((0.75, 0.74, 0.68), 0.3),
    "gravel": _patch((0.26, 0.24, 0.21)),
    "flat_roof": _plain((0.16, 0.155, 0.15), 0.95, (0.4, 2.0, 8.0), 0.4),
    "rust": _plain((0.20, 0.085, 0.035), 0.9, (3.0, 12.0), 0.4),
    "signal_red": _plain((0.50, 0.02, 0.02), 0.5, (3.0,), 0.1),
    "signal_blue": _plain((0.02, 0.09, 0.38), 0.5, (3.0,), 0.1),
    "signal_yellow": _plain((0.70, 0.45, 0.03), 0.5, (3.0,), 0.1),
    "signal_green": _plain((0.03, 0.35, 0.12), 0.4, (3.0,), 0.1),
    "curtain": _plain((0.42, 0.40, 0.36), 0.9, (3.0, 9.0), 0.35),
}
for _prefix, _build, _colors in (
    ("plaster", _plaster, PLASTERS),
    ("brick", _brick, BRICKS),
    ("tiles", _tiles, TILES),
    ("leaf", _leaf, LEAVES),
):
    _BUILDERS |= {f"{_prefix}_{i}": _build(color) for i, color in enumerate(_colors)}
_BUILDERS |= {f"paint_{i}": _plain(color, 0.6, (0.8, 4.0), 0.22) for i, color in enumerate(PAINTS)}


FLAT = {
    "road",
    "deck",
    "smooth_road",
    "lane",
    "sidewalk",
    "kerb",
    "lawn",
    "marking",
    "tar",
    "iron",
    "water",
    "tint",
    "patch_dark",
    "patch_light",
    "patch_mid",
    "gravel",
}


def get(name: str) -> bpy.types.Material:
    """The world's material of that name."""
    return material(name, _BUILDERS[name], name in FLAT)


def pick(prefix: str, *key: str | int | float) -> str:
    """The name of one of the materials ``prefix_0 ...``, chosen by the key."""
    count = sum(name.startswith(f"{prefix}_") and name.split("_")[-1].isdigit() for name in _BUILDERS)
    return f"{prefix}_{int(rng('material', prefix, *key).integers(count))}"
