"""What is painted on lorry, bus and parcel car; see :mod:`livery` for what the five pictures are."""

from __future__ import annotations

import numpy as np

from . import heavy
from .heavy import HeavySpec
from .livery import (
    AMBER,
    BLACK,
    CHROME,
    GLASS,
    LAMP,
    LAMP_DARK,
    PLATE,
    PLATE_BAND,
    PLATE_INK,
    SEAM,
    SEAT,
    STICKER_RED,
    STICKER_WHITE,
    TAIL,
    Canvas,
    Finish,
)

PANEL = Finish((0.66, 0.66, 0.64), 0.35)
FRAME = Finish((0.34, 0.35, 0.36), 0.35, 0.6)
GREEN = Finish((0.03, 0.20, 0.07), 0.4)
BLUE = Finish((0.02, 0.08, 0.30), 0.4)
ORANGE = Finish((0.60, 0.16, 0.02), 0.4)
DISPLAY = Finish((0.75, 0.36, 0.02), 0.4)


def _plate(spec: HeavySpec, canvas: Canvas, z: float, y: float = 0.0) -> None:
    """A number plate of 52 x 11 cm."""
    canvas.box((y - 0.27, z - 0.067), (y + 0.27, z + 0.067), SEAM)
    canvas.box((y - 0.26, z - 0.055), (y + 0.26, z + 0.055), PLATE)
    end = 0.26 if canvas.mirrored else -0.26
    canvas.box((y + min(end, end * 0.84), z - 0.055), (y + max(end, end * 0.84), z + 0.055), PLATE_BAND)
    canvas.text((y, z), 0.085, spec.plate_text, PLATE_INK)


def _outline(canvas: Canvas, low: tuple[float, float], high: tuple[float, float], width: float, finish: Finish) -> None:
    """The frame of a rectangle."""
    canvas.line([low, (high[0], low[1]), high, (low[0], high[1])], width, finish, closed=True)


def _stripes(canvas: Canvas, u: tuple[float, float], z: float) -> None:
    """Red and white reflecting strips along an edge."""
    for i, at in enumerate(np.arange(u[0] + 0.08, u[1] - 0.25, 0.30)):
        canvas.box((at, z), (at + 0.28, z + 0.055), STICKER_RED if i % 2 else STICKER_WHITE)


def _box_side(canvas: Canvas, box: tuple, seam_every: float) -> None:
    """A box body's side: panels, frame, seams, rivets."""
    x0, x1, z0, z1 = box
    canvas.box((x0 - 0.02, z0 - 0.02), (x1 + 0.02, z1 + 0.05), PANEL)
    for x in np.arange(x0 + seam_every, x1 - 0.3, seam_every):
        canvas.line([(x, z0), (x, z1)], 0.012, SEAM)
        for z in np.arange(z0 + 0.15, z1 - 0.1, 0.25):
            canvas.ellipse((x + 0.035, z), (0.009, 0.009), FRAME)
    _outline(canvas, (x0 + 0.03, z0 + 0.04), (x1 - 0.03, z1 - 0.04), 0.08, FRAME)


def _canvas(spec: HeavySpec, view: str) -> Canvas:
    """An empty picture of the right size."""
    half = spec.width / 2
    u = (spec.tail_x, spec.nose_x) if view in ("left", "right", "top") else (-half, half)
    v = (-half, half) if view == "top" else (0.0, spec.height)
    return Canvas(u, v, mirrored=view in ("left", "rear"))


def _lorry_side(canvas: Canvas, spec: HeavySpec) -> None:
    """Box with lettering, cab with door and window."""
    x0, x1, z0, z1 = heavy.LORRY_BOX
    _box_side(canvas, heavy.LORRY_BOX, 1.06)
    canvas.polygon([(x0 + 0.1, 1.45), (x0 + 2.6, 1.45), (x0 + 4.0, 1.75), (x0 + 0.1, 1.62)], GREEN)
    canvas.polygon([(x0 + 1.4, 1.30), (x1 - 0.1, 1.55), (x1 - 0.1, 1.86), (x0 + 3.6, 1.62)], ORANGE)
    if spec.text:
        canvas.text(((x0 + x1) / 2, 2.62), 0.46, spec.text, GREEN)
        canvas.text((x0 + 1.0, 1.95), 0.12, "TEL 0800 4417", BLUE)
    else:
        canvas.text(((x0 + x1) / 2, 2.6), 0.62, "TRANSIT 24", BLUE)
        canvas.ellipse((x1 - 0.9, 2.6), (0.34, 0.34), ORANGE)
    _stripes(canvas, (x0, x1), z0 + 0.10)
    canvas.polygon([(2.10, 1.62), (3.36, 1.62), (3.30, 2.02), (3.16, 2.52), (2.10, 2.52)], GLASS)
    canvas.line([(2.08, 1.60), (3.38, 1.60), (3.18, 2.55), (2.08, 2.55)], 0.035, BLACK, closed=True)
    canvas.line([(2.04, 2.60), (2.04, 1.05), (2.4, 0.98)], 0.014, SEAM)
    canvas.line([(3.42, 1.05), (3.44, 1.60), (3.20, 2.60), (2.04, 2.60)], 0.014, SEAM)
    canvas.box((2.12, 1.38), (2.34, 1.43), BLACK)
    canvas.text((2.76, 1.30), 0.10, "12.220", CHROME)
    canvas.box((3.46, 1.16), (3.62, 1.24), AMBER)
    canvas.box((1.8, 0.0), (3.75, 0.66), BLACK)


def _lorry_front(canvas: Canvas, spec: HeavySpec) -> None:
    """Windscreen, grille, lamps, bumper; the box's front wall above the cab."""
    canvas.box((-1.3, 2.88), (1.3, 3.6), PANEL)
    pane = [(-1.06, 1.56), (1.06, 1.56), (1.02, 2.46), (-1.02, 2.46)]
    canvas.polygon(pane, GLASS)
    canvas.line(pane, 0.05, BLACK, closed=True)
    for y in (-0.5, 0.45):
        canvas.ellipse((y, 1.80), (0.16, 0.2), SEAT)
        canvas.line([(y - 0.3, 1.58), (y + 0.35, 1.70)], 0.02, SEAM)
    canvas.text((0.0, 2.66), 0.15, "KRAN 12" if not spec.text else "HOLZMANN", STICKER_WHITE)
    canvas.box((-0.86, 0.98), (0.86, 1.40), BLACK)
    for z in np.arange(1.04, 1.38, 0.08):
        canvas.line([(-0.82, z), (0.82, z)], 0.02, CHROME)
    canvas.ellipse((0.0, 1.46), (0.08, 0.06), CHROME)
    canvas.box((-1.3, 0.0), (1.3, 0.60), BLACK)
    for y in (-0.86, 0.86):
        canvas.box((y - 0.22, 0.64), (y + 0.22, 0.84), LAMP)
        canvas.ellipse((y, 0.74), (0.08, 0.08), LAMP_DARK)
        canvas.ellipse((y, 0.74), (0.05, 0.05), CHROME)
        canvas.box((y - 0.05 + np.sign(y) * 0.26, 0.66), (y + 0.05 + np.sign(y) * 0.26, 0.82), AMBER)
        canvas.ellipse((y * 0.9, 2.78), (0.05, 0.025), AMBER)
    _plate(spec, canvas, 0.52)


def _lorry_rear(canvas: Canvas, spec: HeavySpec) -> None:
    """Two doors with rods and hinges, reflecting frame, lamps below."""
    _, _, z0, z1 = heavy.LORRY_BOX
    canvas.box((-1.3, z0 - 0.02), (1.3, z1 + 0.05), PANEL)
    _outline(canvas, (-1.20, z0 + 0.05), (1.20, z1 - 0.05), 0.07, FRAME)
    canvas.line([(0, z0 + 0.1), (0, z1 - 0.1)], 0.02, SEAM)
    for y in (-0.75, -0.25, 0.25, 0.75):
        canvas.line([(y, z0 + 0.1), (y, z1 - 0.1)], 0.03, CHROME)
        canvas.box((y - 0.05, 1.60), (y + 0.05, 1.66), SEAM)
        canvas.line([(y - 0.18, 1.63), (y, 1.63)], 0.02, SEAM)
    for y in (-1.14, 1.14):
        for z in np.linspace(z0 + 0.3, z1 - 0.3, 4):
            canvas.box((y - 0.07, z - 0.035), (y + 0.07, z + 0.035), SEAM)
    _stripes(canvas, (-1.2, 1.2), z0 + 0.09)
    canvas.text((0.0, 2.75), 0.17, spec.text or "TRANSIT 24", GREEN if spec.text else BLUE)
    canvas.ellipse((0.62, 2.15), (0.11, 0.11), STICKER_RED)
    canvas.ellipse((0.62, 2.15), (0.085, 0.085), STICKER_WHITE)
    canvas.text((0.62, 2.15), 0.09, "80", PLATE_INK)
    canvas.box((-1.3, 0.0), (1.3, z0 - 0.03), BLACK)
    for y in (-0.92, 0.92):
        canvas.box((y - 0.22, 0.70), (y + 0.22, 0.86), TAIL)
        canvas.box((y - 0.06, 0.70), (y + 0.06, 0.86), AMBER)
    canvas.box((-1.17, 0.56), (-0.60, 0.64), STICKER_RED)
    canvas.box((0.60, 0.56), (1.17, 0.64), STICKER_RED)
    _plate(spec, canvas, 0.80, -0.32)


def _lorry_top(canvas: Canvas, spec: HeavySpec) -> None:
    """Roof sheets of the box, hatch of the cab."""
    x0, x1, _, _ = heavy.LORRY_BOX
    canvas.box((x0 - 0.05, -1.3), (x1 + 0.05, 1.3), PANEL)
    for x in np.arange(x0 + 0.6, x1, 0.6):
        canvas.line([(x, -1.2), (x, 1.2)], 0.025, FRAME)
    _outline(canvas, (x0 + 0.03, -1.21), (x1 - 0.03, 1.21), 0.07, FRAME)
    canvas.box((2.3, -0.4), (2.9, 0.4), BLACK)
    canvas.line([(3.1, -1.0), (3.1, 1.0)], 0.014, SEAM)


def _bus_windows(canvas: Canvas, x: tuple[float, float], step: float) -> None:
    """A band of glass with pillars and sliding vents."""
    z0, z1 = heavy.BUS_GLASS
    canvas.box((x[0], z0), (x[1], z1), GLASS)
    for at in np.arange(x[0] + step, x[1] - 0.2, step):
        canvas.box((at - 0.03, z0), (at + 0.03, z1), BLACK)
        canvas.line([(at - step + 0.05, z1 - 0.35), (at - 0.05, z1 - 0.35)], 0.018, FRAME)
        canvas.box((at - 0.75 * step, z0 + 0.05), (at - 0.45 * step, z0 + 0.42), SEAT)


def _bus_side(canvas: Canvas, spec: HeavySpec) -> None:
    """Window band, doors on the right, seams, an advertisement, vents."""
    _bus_windows(canvas, (-6.1, 5.1), 1.32)
    canvas.polygon([(4.55, 0.95), (5.42, 0.95), (5.38, 2.46), (4.55, 2.46)], GLASS)
    canvas.box((-6.4, 2.46), (5.7, 2.56), BLACK)
    canvas.box((-6.4, 0.0), (5.7, 0.44), BLACK)
    canvas.box((-6.4, 0.44), (5.7, 0.50), STICKER_WHITE)
    for x in (-5.4, -4.2, -1.9, -0.7, 0.5, 1.7, 4.0):
        canvas.line([(x, 0.34), (x, 1.02)], 0.012, SEAM)
    canvas.line([(-6.2, 0.78), (5.6, 0.78)], 0.010, SEAM)
    canvas.box((-1.85, 0.54), (1.65, 0.98), STICKER_WHITE)
    canvas.text((-0.1, 0.76), 0.22, "BLUMEN AM MARKT", GREEN)
    canvas.ellipse((-1.45, 0.76), (0.16, 0.16), STICKER_RED)
    canvas.text((-4.9, 2.72), 0.20, spec.text or "LINIE", BLUE)
    canvas.text((2.6, 2.72), 0.20, "KLIMA AN BORD", BLUE)
    for z in np.arange(0.56, 0.98, 0.07):
        canvas.line([(-6.0, z), (-5.5, z)], 0.025, SEAM)
    if not canvas.mirrored:
        for x in (4.72, 0.10, -5.15):
            _bus_door(canvas, x)
    canvas.box((4.8, 2.50), (5.3, 2.75), BLACK)
    canvas.text((5.05, 2.63), 0.16, "17", DISPLAY)
    canvas.box((3.62, 0.80), (3.74, 0.86), AMBER)


def _bus_door(canvas: Canvas, x: float) -> None:
    """A folding door of two wings, 1.25 m wide."""
    canvas.box((x - 0.64, 0.33), (x + 0.64, 2.50), BLACK)
    for side in (-0.31, 0.31):
        canvas.box((x + side - 0.25, 0.45), (x + side + 0.25, 2.42), GLASS)
        canvas.line([(x + side * 0.2, 1.0), (x + side * 0.2, 1.6)], 0.025, AMBER)
    canvas.ellipse((x + 0.3, 1.5), (0.07, 0.07), STICKER_WHITE)


def _bus_front(canvas: Canvas, spec: HeavySpec) -> None:
    """A large windscreen under the destination, lamps, bumper."""
    pane = [(-1.12, 0.98), (1.12, 0.98), (1.14, 2.42), (-1.14, 2.42)]
    canvas.polygon(pane, GLASS)
    canvas.line(pane, 0.05, BLACK, closed=True)
    canvas.box((-1.1, 2.44), (1.1, 2.78), BLACK)
    canvas.text((0.0, 2.61), 0.15, "17 HAUPTBAHNHOF", DISPLAY)
    canvas.ellipse((0.62, 1.35), (0.2, 0.25), SEAT)
    canvas.line([(-0.9, 1.02), (0.0, 1.35)], 0.025, SEAM)
    canvas.line([(0.9, 1.02), (0.1, 1.40)], 0.025, SEAM)
    canvas.box((-1.3, 0.0), (1.3, 0.44), BLACK)
    canvas.ellipse((0.0, 0.86), (0.10, 0.07), CHROME)
    for y in (-0.98, 0.98):
        canvas.ellipse((y, 0.70), (0.17, 0.12), LAMP)
        canvas.ellipse((y, 0.70), (0.08, 0.08), LAMP_DARK)
        canvas.ellipse((y * 0.72, 0.70), (0.08, 0.07), LAMP)
        canvas.box((y - 0.04, 0.84), (y + 0.04, 0.90), AMBER)
    _plate(spec, canvas, 0.56)


def _bus_rear(canvas: Canvas, spec: HeavySpec) -> None:
    """Rear window, engine vents, advertisement, lamps."""
    canvas.box((-0.95, 1.75), (0.95, 2.45), GLASS)
    _outline(canvas, (-0.95, 1.75), (0.95, 2.45), 0.04, BLACK)
    canvas.box((-0.9, 1.12), (0.9, 1.66), STICKER_WHITE)
    canvas.text((0.0, 1.39), 0.24, "KINO ROXY", STICKER_RED)
    for z in np.arange(0.72, 1.06, 0.06):
        canvas.line([(-0.8, z), (0.8, z)], 0.028, SEAM)
    _outline(canvas, (-0.88, 0.62), (0.88, 1.08), 0.014, SEAM)
    canvas.box((-0.35, 2.52), (0.35, 2.76), BLACK)
    canvas.text((0.0, 2.64), 0.17, "17", DISPLAY)
    canvas.box((-1.3, 0.0), (1.3, 0.46), BLACK)
    for y in (-1.10, 1.10):
        for z, lamp in ((0.70, TAIL), (0.88, AMBER), (1.06, TAIL), (2.62, TAIL)):
            canvas.ellipse((y, z), (0.075, 0.075), lamp)
    _plate(spec, canvas, 0.54, 0.0)


def _bus_top(canvas: Canvas, spec: HeavySpec) -> None:
    """Roof seams, hatches, the grilles of the coolers."""
    for x in np.arange(-5.8, 5.2, 1.3):
        canvas.line([(x, -1.1), (x, 1.1)], 0.014, SEAM)
    for x in (-1.2, 3.6):
        canvas.box((x - 0.4, -0.35), (x + 0.4, 0.35), STICKER_WHITE)
        _outline(canvas, (x - 0.4, -0.35), (x + 0.4, 0.35), 0.02, SEAM)
    for x in np.arange(-4.6, -2.3, 0.18):
        canvas.line([(x, -0.7), (x, 0.7)], 0.05, SEAM)
    canvas.text((1.5, 0.0), 0.5, "1450", PLATE_INK)


def _courier_side(canvas: Canvas, spec: HeavySpec) -> None:
    """A small box with lettering behind a cab without doors."""
    x0, x1, z0, z1 = heavy.COURIER_BOX
    _box_side(canvas, heavy.COURIER_BOX, 0.6)
    canvas.box((x0 + 0.1, 0.72), (x1 - 0.1, 1.02), ORANGE)
    canvas.text(((x0 + x1) / 2, 1.72), 0.36, spec.text or "POST", BLUE)
    canvas.text(((x0 + x1) / 2, 1.26), 0.12, "ELEKTRISCH", GREEN)
    canvas.polygon([(0.54, 0.98), (1.12, 0.98), (0.94, 1.86), (0.54, 1.86)], GLASS)
    canvas.line([(0.50, 0.50), (0.50, 1.92), (0.96, 1.92), (1.16, 0.98)], 0.014, SEAM)
    canvas.box((-1.4, 0.0), (1.3, 0.34), BLACK)


def _courier_front(canvas: Canvas, spec: HeavySpec) -> None:
    """Windscreen and lamps, the box's front above."""
    canvas.box((-0.75, 2.08), (0.75, 2.5), PANEL)
    pane = [(-0.55, 1.0), (0.55, 1.0), (0.52, 1.88), (-0.52, 1.88)]
    canvas.polygon(pane, GLASS)
    canvas.line(pane, 0.04, BLACK, closed=True)
    canvas.box((-0.75, 0.0), (0.75, 0.34), BLACK)
    for y in (-0.46, 0.46):
        canvas.ellipse((y, 0.66), (0.09, 0.09), LAMP)
        canvas.ellipse((y, 0.66), (0.05, 0.05), CHROME)
        canvas.ellipse((y, 0.82), (0.03, 0.03), AMBER)
    _plate(spec, canvas, 0.44)


def _courier_rear(canvas: Canvas, spec: HeavySpec) -> None:
    """A roller door with lettering, lamps, plate."""
    _, _, z0, z1 = heavy.COURIER_BOX
    canvas.box((-0.75, z0 - 0.02), (0.75, z1 + 0.05), PANEL)
    _outline(canvas, (-0.62, z0 + 0.12), (0.62, z1 - 0.08), 0.06, FRAME)
    for z in np.arange(z0 + 0.25, z1 - 0.15, 0.16):
        canvas.line([(-0.6, z), (0.6, z)], 0.01, SEAM)
    canvas.text((0.0, 1.75), 0.24, spec.text or "POST", BLUE)
    canvas.box((-0.75, 0.0), (0.75, 0.34), BLACK)
    for y in (-0.56, 0.56):
        canvas.box((y - 0.06, 0.38), (y + 0.06, 0.52), TAIL)
    _plate(spec, canvas, 0.43)


def _courier_top(canvas: Canvas, spec: HeavySpec) -> None:
    """The box's roof with a hatch."""
    x0, x1, _, _ = heavy.COURIER_BOX
    canvas.box((x0 - 0.05, -0.75), (x1 + 0.05, 0.75), PANEL)
    _outline(canvas, (x0 + 0.03, -0.66), (x1 - 0.03, 0.66), 0.06, FRAME)
    canvas.box((-0.7, -0.3), (-0.2, 0.3), BLACK)


PAINTERS = {
    "lorry": (_lorry_side, _lorry_front, _lorry_rear, _lorry_top),
    "bus": (_bus_side, _bus_front, _bus_rear, _bus_top),
    "courier": (_courier_side, _courier_front, _courier_rear, _courier_top),
}


def paint(spec: HeavySpec) -> dict[str, Canvas]:
    """All five pictures of a vehicle, by name of the view."""
    side, front, rear, top = PAINTERS[spec.name]
    painters = {"left": side, "right": side, "front": front, "rear": rear, "top": top}
    pictures = {view: _canvas(spec, view) for view in painters}
    for view, painter in painters.items():
        painter(pictures[view], spec)
    return pictures
