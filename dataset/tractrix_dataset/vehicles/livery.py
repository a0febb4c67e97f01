"""What is painted on a body: windows, seams, lights, trim, plates, lettering.

Five orthographic pictures per vehicle (left, right, front, rear, top). The
shader picks one by the surface normal, so nothing depends on the mesh. Each
picture has a colour layer, whose alpha says how much it covers the car's
paint, and a finish layer: red = roughness, green = metallic.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from PIL import Image, ImageDraw, ImageFilter, ImageFont

from ..seeds import rng
from .body import belt_height, top_curve, upper_half_width
from .spec import Pillar, VehicleSpec

PIXELS_PER_M = 320
MARGIN_M = 0.08


@dataclass(frozen=True)
class Finish:
    """Colour (linear RGB), roughness and metallic of a painted thing."""

    color: tuple[float, float, float]
    roughness: float
    metallic: float = 0.0


GLASS = Finish((0.012, 0.015, 0.017), 0.04)
BLACK = Finish((0.022, 0.022, 0.023), 0.55)
SEAM = Finish((0.012, 0.012, 0.012), 0.7)
CHROME = Finish((0.62, 0.63, 0.65), 0.16, 0.9)
LAMP = Finish((0.66, 0.68, 0.70), 0.08, 0.35)
LAMP_DARK = Finish((0.10, 0.105, 0.11), 0.1, 0.3)
TAIL = Finish((0.42, 0.012, 0.012), 0.1)
AMBER = Finish((0.75, 0.23, 0.02), 0.12)
PLATE = Finish((0.72, 0.72, 0.68), 0.45)
PLATE_INK = Finish((0.02, 0.02, 0.03), 0.5)
PLATE_BAND = Finish((0.01, 0.06, 0.35), 0.5)
SEAT = Finish((0.05, 0.05, 0.055), 0.12)
LETTERS = Finish((0.02, 0.05, 0.22), 0.4)
STICKER_RED = Finish((0.55, 0.03, 0.02), 0.45)
STICKER_WHITE = Finish((0.75, 0.75, 0.72), 0.45)


def _srgb(value: float) -> int:
    """A linear value as an 8-bit sRGB code."""
    v = 12.92 * value if value < 0.0031308 else 1.055 * value ** (1 / 2.4) - 0.055
    return round(255 * min(max(v, 0.0), 1.0))


class Canvas:
    """One picture in plane coordinates (u right, v up, metres)."""

    def __init__(self, u: tuple[float, float], v: tuple[float, float], mirrored: bool) -> None:
        self.low = np.array([u[0] - MARGIN_M, v[0] - MARGIN_M])
        self.high = np.array([u[1] + MARGIN_M, v[1] + MARGIN_M])
        self.mirrored = mirrored
        size = tuple(int(s) for s in np.ceil((self.high - self.low) * PIXELS_PER_M))
        self.color = Image.new("RGBA", size, (0, 0, 0, 0))
        self.finish = Image.new("RGB", size, (0, 0, 0))
        self._draw = (ImageDraw.Draw(self.color), ImageDraw.Draw(self.finish))

    def _pixels(self, points: np.ndarray | list) -> list[tuple[float, float]]:
        p = (np.asarray(points, float) - self.low) * PIXELS_PER_M
        return [(float(u), float(self.color.height - v)) for u, v in p]

    @staticmethod
    def _fills(finish: Finish, alpha: float = 1.0) -> tuple[tuple, tuple]:
        rgb = tuple(_srgb(c) for c in finish.color)
        return (*rgb, round(255 * alpha)), (round(255 * finish.roughness), round(255 * finish.metallic), 0)

    def polygon(self, points: np.ndarray | list, finish: Finish) -> None:
        """Fills a polygon of (u, v) points."""
        for draw, fill in zip(self._draw, self._fills(finish)):
            draw.polygon(self._pixels(points), fill=fill)

    def erase(self, points: np.ndarray | list) -> None:
        """Brings the car's paint back inside a polygon."""
        self._draw[0].polygon(self._pixels(points), fill=(0, 0, 0, 0))

    def line(self, points: np.ndarray | list, width_m: float, finish: Finish, closed: bool = False) -> None:
        """Draws a line of the given width in metres."""
        points = [*points, points[0]] if closed else list(points)
        width = max(1, round(width_m * PIXELS_PER_M))
        for draw, fill in zip(self._draw, self._fills(finish)):
            draw.line(self._pixels(points), fill=fill, width=width, joint="curve")

    def box(self, low: tuple[float, float], high: tuple[float, float], finish: Finish) -> None:
        """Fills a rectangle between two corners."""
        self.polygon([low, (high[0], low[1]), high, (low[0], high[1])], finish)

    def ellipse(self, center: tuple[float, float], radii: tuple[float, float], finish: Finish) -> None:
        """Fills an ellipse."""
        a = np.linspace(0, 2 * np.pi, 40)
        self.polygon(np.stack([center[0] + radii[0] * np.cos(a), center[1] + radii[1] * np.sin(a)], 1), finish)

    def text(self, center: tuple[float, float], height_m: float, words: str, finish: Finish) -> None:
        """Writes lines of text, readable for who stands on this side of the car."""
        font = ImageFont.load_default(size=max(8, round(height_m * 1.25 * PIXELS_PER_M)))
        probe = ImageDraw.Draw(Image.new("L", (8, 8)))
        left, upper, right, lower = probe.multiline_textbbox((0, 0), words, font=font, align="center")
        stamp = Image.new("L", (int(right - left) + 4, int(lower - upper) + 4), 0)
        ImageDraw.Draw(stamp).multiline_text((2 - left, 2 - upper), words, fill=255, font=font, align="center")
        if self.mirrored:
            stamp = stamp.transpose(Image.Transpose.FLIP_LEFT_RIGHT)
        (u, v) = self._pixels([center])[0]
        at = (round(u - stamp.width / 2), round(v - stamp.height / 2))
        for image, fill in zip((self.color, self.finish), self._fills(finish)):
            image.paste(fill, (at[0], at[1], at[0] + stamp.width, at[1] + stamp.height), stamp)

    def finished(self) -> tuple[Image.Image, Image.Image]:
        """The two layers; the colour layer slightly softened against aliasing."""
        return self.color.filter(ImageFilter.GaussianBlur(0.6)), self.finish


def _side_window(spec: VehicleSpec, gap_top: float = 0.085) -> np.ndarray:
    """Outline of all side glass in (x, z): belt line below, roof edge above, raked ends."""
    foot_rear, head_rear, head_front, foot_front = spec.side_glass
    curve = top_curve(spec)
    lower_x = np.linspace(foot_rear, foot_front, 30)
    lower = np.stack([lower_x, belt_height(spec, lower_x) + 0.035], 1)
    upper_x = np.linspace(head_front, head_rear, 30)
    upper = np.stack([upper_x, np.interp(upper_x, curve[:, 0], curve[:, 1]) - gap_top], 1)
    return np.vstack([lower, upper])


def _pillar_outline(spec: VehicleSpec, pillar: Pillar) -> np.ndarray:
    """A pillar's four corners in (x, z)."""
    low = float(belt_height(spec, pillar.foot_x)) + 0.02
    high = spec.height - 0.06
    half = pillar.width / 2
    return np.array(
        [
            (pillar.foot_x - half, low),
            (pillar.foot_x + half, low),
            (pillar.head_x + half, high),
            (pillar.head_x - half, high),
        ]
    )


def _arch(spec: VehicleSpec, axle: float, radius: float) -> np.ndarray:
    """Points of a circle round a wheel in (x, z)."""
    a = np.linspace(0, 2 * np.pi, 60)
    return np.stack([axle + radius * np.cos(a), spec.wheel_radius + radius * np.sin(a)], 1)


def _door_seams(spec: VehicleSpec, canvas: Canvas) -> None:
    """Door outlines: vertical seams from the sill to the belt line, and the sill seam."""
    sill = spec.clearance + 0.12
    for x in spec.doors:
        belt = float(belt_height(spec, x)) + 0.03
        rear_arch = x < -spec.wheelbase / 2 + spec.arch_radius + 0.25
        foot = (x + 0.22, sill + 0.32) if rear_arch and not spec.text else (x, sill)
        canvas.line([foot, (x + 0.01, sill + 0.42), (x, belt)], 0.014, SEAM)
    canvas.line([(min(spec.doors) + 0.1, sill), (max(spec.doors), sill)], 0.012, SEAM)


def _side_details(spec: VehicleSpec, canvas: Canvas, side: str) -> None:
    """Handles, fuel flap, indicator, lamps that wrap round, lettering, stickers."""
    for x in spec.doors[1:]:
        z = float(belt_height(spec, x + 0.2)) - 0.10
        canvas.box((x + 0.09, z - 0.013), (x + 0.29, z + 0.017), CHROME if spec.name == "saloon" else BLACK)
    canvas.box((spec.axles[1] - 0.52, 0.70), (spec.axles[1] - 0.44, 0.735), AMBER)
    if side == "right":
        center = (spec.axles[0] - 0.02, float(belt_height(spec, spec.axles[0])) - 0.14)
        canvas.line(
            [
                (center[0] + dx, center[1] + dz)
                for dx, dz in ((-0.08, -0.08), (0.08, -0.08), (0.08, 0.08), (-0.08, 0.08))
            ],
            0.012,
            SEAM,
            closed=True,
        )
    low, high = min(z for _, z in spec.headlight), max(z for _, z in spec.headlight)
    canvas.polygon(
        [
            (spec.nose_x - 0.38, high),
            (spec.nose_x - 0.26, low + 0.03),
            (spec.nose_x + 0.05, low),
            (spec.nose_x + 0.05, high),
        ],
        LAMP,
    )
    low, high = min(z for _, z in spec.taillight), max(z for _, z in spec.taillight)
    canvas.polygon(
        [
            (spec.tail_x - 0.05, low),
            (spec.tail_x + 0.20, low + 0.02),
            (spec.tail_x + 0.14, high),
            (spec.tail_x - 0.05, high),
        ],
        TAIL,
    )
    for end, inward in ((spec.nose_x, -1), (spec.tail_x, 1)):
        canvas.line([(end + inward * 0.52, spec.clearance + 0.12), (end + inward * 0.42, 0.56)], 0.011, SEAM)
    if spec.text:
        canvas.text((-0.98, 0.80), 0.15, spec.text, LETTERS)
        canvas.line([(-2.2, 0.545), (1.35, 0.545)], 0.035, LETTERS)


def _stickers(spec: VehicleSpec, canvas: Canvas, view: str) -> None:
    """A few small stickers, as owners put them on."""
    r = rng("stickers", spec.name, view)
    if view == "rear":
        canvas.text((-0.42, spec.tail_glass[0] - 0.07), 0.055, spec.badge, CHROME)
        canvas.ellipse((0.50, spec.tail_glass[0] - 0.10), (0.065, 0.045), STICKER_WHITE)
        canvas.text((0.50, spec.tail_glass[0] - 0.10), 0.05, "D", PLATE_INK)
    if view in ("left", "right") and not spec.text:
        x = spec.axles[0] + r.uniform(0.25, 0.45) * (1 if spec.wheelbase > 2 else 0.4)
        z = float(belt_height(spec, x)) - r.uniform(0.12, 0.2)
        canvas.ellipse((x, z), (0.045, 0.045), STICKER_RED if r.random() < 0.5 else STICKER_WHITE)


def _paint_side(spec: VehicleSpec, side: str) -> Canvas:
    """The picture of one side, in (x, z)."""
    canvas = Canvas((spec.tail_x, spec.nose_x), (0.0, spec.height), mirrored=side == "left")
    window = _side_window(spec)
    canvas.line(window, 0.05, CHROME if spec.name in ("saloon", "suv") else BLACK, closed=True)
    canvas.polygon(window, GLASS)
    for pillar in spec.pillars:
        (canvas.erase if pillar.painted else lambda p: canvas.polygon(p, BLACK))(_pillar_outline(spec, pillar))
    if spec.text:
        rear = spec.pillars[-1].foot_x
        canvas.erase([(spec.tail_x, 1.0), (rear, 1.0), (rear, spec.height), (spec.tail_x, spec.height)])
    canvas.box((spec.tail_x - 0.05, 0.0), (spec.nose_x + 0.05, spec.clearance + 0.05), BLACK)
    if spec.trim_height:
        canvas.box((spec.tail_x - 0.05, 0.0), (spec.nose_x + 0.05, spec.trim_height), BLACK)
    for axle in spec.axles:
        if spec.arch_trim:
            canvas.polygon(_arch(spec, axle, spec.arch_radius + 0.07), BLACK)
        canvas.line(_arch(spec, axle, spec.arch_radius), 0.02, SEAM)
    _door_seams(spec, canvas)
    _side_details(spec, canvas, side)
    _stickers(spec, canvas, side)
    return canvas


def _mirrored_pair(points: tuple[tuple[float, float], ...]) -> tuple[list, list]:
    """A polygon in (|y|, z) on both sides of the car."""
    return [(y, z) for y, z in points], [(-y, z) for y, z in points]


def _pane(spec: VehicleSpec, x_low: float, z_low: float, x_high: float, z_high: float, inset: float) -> np.ndarray:
    """Outline of the windscreen or rear window in (y, z), following the body's width."""
    t = np.linspace(0, 1, 12)
    x, z = x_low + (x_high - x_low) * t, z_low + (z_high - z_low) * t
    half = np.array([float(upper_half_width(spec, a, max(b, float(belt_height(spec, a))))) for a, b in zip(x, z)])
    half -= inset + 0.05 * np.clip(t - 0.8, 0, 1) + 0.03 * np.clip(0.12 - t, 0, 1)
    return np.vstack([np.stack([half, z], 1), np.stack([-half, z], 1)[::-1]])


def _plate(spec: VehicleSpec, canvas: Canvas, z: float) -> None:
    """A number plate of 52 x 11 cm (shorter on a narrow car)."""
    half = 0.26
    canvas.box((-half - 0.012, z - 0.067), (half + 0.012, z + 0.067), SEAM)
    canvas.box((-half, z - 0.055), (half, z + 0.055), PLATE)
    end = half if canvas.mirrored else -half
    canvas.box((min(end, end * 0.84), z - 0.055), (max(end, end * 0.84), z + 0.055), PLATE_BAND)
    canvas.text((0.0, z), 0.085, spec.plate_text, PLATE_INK)


def _paint_front(spec: VehicleSpec) -> Canvas:
    """The picture of the front, in (y, z)."""
    half = spec.width / 2
    canvas = Canvas((-half, half), (0.0, spec.height), mirrored=False)
    curve = top_curve(spec)
    z_low, z_high = np.interp([spec.cowl_x, spec.header_x], curve[:, 0], curve[:, 1])
    pane = _pane(spec, spec.cowl_x, z_low, spec.header_x, z_high - 0.02, 0.045)
    canvas.line(pane, 0.04, BLACK, closed=True)
    canvas.polygon(pane, GLASS)
    canvas.box((-0.08, z_high - 0.12), (0.08, z_high - 0.05), SEAT)
    canvas.ellipse((0.36, z_low + 0.16), (0.12, 0.14), SEAT)
    canvas.ellipse((-0.36, z_low + 0.16), (0.12, 0.14), SEAT)
    canvas.polygon(spec.grille, BLACK)
    for row in np.linspace(0.15, 0.85, 4):
        (y0, z0), (y1, _), (y2, z2), (y3, _) = spec.grille
        z = z0 + row * (z2 - z0)
        canvas.line([(y0 + (y3 - y0) * row, z), (y1 + (y2 - y1) * row, z)], 0.012, CHROME)
    canvas.ellipse((0.0, spec.grille[2][1] - 0.06), (0.055, 0.055), CHROME)
    for polygon in _mirrored_pair(spec.headlight):
        canvas.polygon(polygon, LAMP)
        canvas.line(polygon, 0.016, SEAM, closed=True)
        y, z = np.mean(polygon, axis=0)
        canvas.ellipse((y * 0.95, z), (0.07, 0.065), LAMP_DARK)
        canvas.ellipse((y * 0.95, z), (0.045, 0.042), CHROME)
        canvas.ellipse((np.sign(y) * (abs(y) + 0.13), z), (0.035, 0.04), AMBER)
    bumper = spec.clearance + 0.06
    canvas.box((-half, 0), (half, bumper), BLACK)
    canvas.box((-half, 0), (half, spec.trim_height), BLACK)
    canvas.polygon(
        [(-0.46, bumper + 0.02), (0.46, bumper + 0.02), (0.40, bumper + 0.14), (-0.40, bumper + 0.14)], BLACK
    )
    for y in (-0.62, 0.62):
        canvas.ellipse((y * half / 0.88, bumper + 0.09), (0.075, 0.05), LAMP_DARK)
        canvas.ellipse((y * half / 0.88, bumper + 0.09), (0.045, 0.035), LAMP)
    canvas.line([(-half, 0.60), (half, 0.60)], 0.010, SEAM)
    _plate(spec, canvas, max(0.45, spec.clearance + 0.24))
    return canvas


def _paint_rear(spec: VehicleSpec) -> Canvas:
    """The picture of the rear, in (y, z)."""
    half = spec.width / 2
    canvas = Canvas((-half, half), (0.0, spec.height), mirrored=True)
    (z_low, z_high), (x_low, x_high) = spec.tail_glass, spec.tail_glass_x
    pane = _pane(spec, x_low, z_low, x_high, z_high, 0.08)
    canvas.line(pane, 0.035, BLACK, closed=True)
    canvas.polygon(pane, GLASS)
    for z in np.linspace(z_low + 0.05, z_high - 0.06, 7):
        canvas.line([(-half * 0.62, z), (half * 0.62, z)], 0.004, LAMP_DARK)
    canvas.line([(-0.05, z_low + 0.03), (0.34, z_low + 0.10)], 0.02, SEAM)
    for polygon in _mirrored_pair(spec.taillight):
        canvas.polygon(polygon, TAIL)
        canvas.line(polygon, 0.014, SEAM, closed=True)
        y = np.array(polygon)[:, 0]
        z = np.array(polygon)[:, 1]
        canvas.ellipse((y.mean(), z.min() + 0.3 * np.ptp(z)), (0.05, 0.035), AMBER)
        canvas.ellipse((y.mean() * 0.94, z.min() + 0.75 * np.ptp(z)), (0.03, 0.025), STICKER_WHITE)
    lid = 0.62 if spec.height < 1.7 else 0.56
    canvas.line(
        [(-half * 0.72, z_low - 0.06), (-half * 0.74, lid), (half * 0.74, lid), (half * 0.72, z_low - 0.06)],
        0.013,
        SEAM,
    )
    bumper = spec.clearance + 0.08
    canvas.box((-half, 0), (half, max(bumper, spec.trim_height)), BLACK)
    canvas.box((-0.40, z_low - 0.24), (0.40, z_low - 0.05), SEAM) if spec.height < 1.7 else None
    for y in (-0.66, 0.66):
        canvas.box((y - 0.07, bumper + 0.05), (y + 0.07, bumper + 0.085), TAIL)
    _plate(spec, canvas, z_low - 0.145 if spec.height < 1.7 else 0.86)
    _stickers(spec, canvas, "rear")
    return canvas


def _paint_top(spec: VehicleSpec) -> Canvas:
    """The picture from above, in (x, y): bonnet and roof seams, roof hatch, washer jets."""
    half = spec.width / 2
    canvas = Canvas((spec.tail_x, spec.nose_x), (-half, half), mirrored=False)
    hood = 0.80 * half
    canvas.line([(spec.cowl_x + 0.03, -hood), (spec.nose_x - 0.14, -hood * 0.9)], 0.014, SEAM)
    canvas.line([(spec.cowl_x + 0.03, hood), (spec.nose_x - 0.14, hood * 0.9)], 0.014, SEAM)
    canvas.box((spec.cowl_x - 0.02, -hood), (spec.cowl_x + 0.05, hood), BLACK)
    for y in (-0.3, 0.3):
        canvas.ellipse((spec.cowl_x + 0.14, y), (0.02, 0.03), BLACK)
        canvas.line([(spec.cowl_x + 0.25, y * 1.3), (spec.nose_x - 0.25, y)], 0.008, SEAM)
    for y in (-0.66 * half, 0.66 * half):
        canvas.line([(spec.tail_glass_x[1] + 0.05, y), (spec.header_x - 0.05, y)], 0.014, SEAM)
    if spec.name in ("saloon", "smart", "suv"):
        canvas.box((spec.header_x - 0.78, -0.40), (spec.header_x - 0.28, 0.40), GLASS)
    if spec.name == "saloon":
        canvas.line([(-2.22, -0.62), (-1.62, -0.66), (-1.62, 0.66), (-2.22, 0.62)], 0.014, SEAM)
    if spec.name == "van":
        for x in np.linspace(-2.0, 0.2, 6):
            canvas.line([(x, -0.6), (x, 0.6)], 0.02, BLACK)
    return canvas


def paint(spec: VehicleSpec) -> dict[str, Canvas]:
    """All five pictures of a vehicle, by name of the view."""
    return {
        "left": _paint_side(spec, "left"),
        "right": _paint_side(spec, "right"),
        "front": _paint_front(spec),
        "rear": _paint_rear(spec),
        "top": _paint_top(spec),
    }
