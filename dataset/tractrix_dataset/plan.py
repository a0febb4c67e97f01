"""The plan of the town and its landscape: streets, heights, river, one square kilometre.

Everything is an analytic function of (x, y), so that any part of the world
can be built at any resolution, and two builds never disagree.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from .paths import Path
from .seeds import fbm, noise, smoothstep

HALF_EXTENT_M = 500.0
KERB_HEIGHT_M = 0.12
KERB_FACE_M = 0.03
KERB_STONE_M = 0.18
SIDEWALK_M = 2.6
CAMBER_M = 0.05
CORNER_BLEND_M = 8.0
FAR_M = 80.0
RIVER_X_M, RIVER_HALF_M, RIVER_DEPTH_M = 330.0, 15.0, 7.0
BRIDGE_START_M, BRIDGE_END_M, BRIDGE_RISE_M = 288.0, 372.0, 2.6
DECK_HALF_M, UNDER_DECK_M = 7.4, 0.7
HILL_START_M, HILL_END_M, HILL_RISE_M = 120.0, 320.0, 18.5


@dataclass(frozen=True)
class Street:
    """A street: centre line, half width of the carriageway (m), and what it is like."""

    name: str
    path: Path
    half_width: float
    rural: bool = False
    parking: bool = False


@lru_cache(maxsize=1)
def streets() -> tuple[Street, ...]:
    """All streets of the world."""
    linden = [(-165, -48, 15), (-105, -48, 15), (-105, -84, 15), (-165, -84, 15)]
    mill = [(100, 50, 15), (160, 50, 15), (160, 86, 15), (100, 86, 15)]
    lane = [(-480, -262, 0), (-360, -250, 90), (-240, -262, 90), (-120, -248, 90), (0, -250, 0)]
    return (
        Street("main", Path([(-490, 0, 0), (490, 0, 0)]), 5.0, parking=True),
        Street("north", Path([(0, -300, 0), (0, 420, 0)]), 4.6, parking=True),
        Street("linden", Path(linden, closed=True), 3.5),
        Street("linden_link", Path([(-135, -48, 0), (-135, 0, 0)]), 3.4),
        Street("mill", Path(mill, closed=True), 3.5),
        Street("mill_link", Path([(130, 0, 0), (130, 50, 0)]), 3.4),
        Street("lane", Path(lane), 2.7, rural=True),
    )


def street(name: str) -> Street:
    """The street of that name."""
    return next(s for s in streets() if s.name == name)


def _smooth_minimum(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Minimum with a rounded corner: kerbs meet in an arc of about 6 m."""
    h = np.maximum(CORNER_BLEND_M - np.abs(a - b), 0.0)
    return np.minimum(a, b) - h * h / (4 * CORNER_BLEND_M)


@dataclass(frozen=True)
class Survey:
    """What the plan says at points: all arrays have the shape of the points.

    ``kerb``: signed distance to the edge of the nearest carriageway (m,
    negative on the street, at most ``FAR_M``); ``rural``: 1 near country
    lanes, else 0.
    """

    kerb: np.ndarray
    rural: np.ndarray
    half_width: np.ndarray


def _out_of_reach(s: Street, x: np.ndarray, y: np.ndarray) -> bool:
    """Whether a street is so far from all points that it cannot matter."""
    low, high = s.path.bounds
    margin = FAR_M + s.half_width + CORNER_BLEND_M
    return bool(
        x.max() < low[0] - margin
        or x.min() > high[0] + margin
        or y.max() < low[1] - margin
        or y.min() > high[1] + margin
    )


def survey(x: np.ndarray, y: np.ndarray, without: str | None = None) -> Survey:
    """Street distances at points; ``without`` leaves one street out."""
    x, y = np.asarray(x, float), np.asarray(y, float)
    kerb = np.full(x.shape, 1e3)
    nearest = np.full(x.shape, 1e3)
    rural, half_width = np.zeros(x.shape), np.full(x.shape, 4.0)
    for s in streets():
        if s.name == without or _out_of_reach(s, x, y):
            continue
        distance = s.path.locate(x, y)[0] - s.half_width
        closer = distance < nearest
        nearest = np.where(closer, distance, nearest)
        rural = np.where(closer, float(s.rural), rural)
        half_width = np.where(closer, s.half_width, half_width)
        kerb = _smooth_minimum(kerb, distance)
    far = nearest > FAR_M
    return Survey(np.where(far, FAR_M, kerb), np.where(far, 0.0, rural), np.where(far, 4.0, half_width))


def over_river(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """True where the bridge's deck takes the place of the ground's street."""
    return (x > BRIDGE_START_M) & (x < BRIDGE_END_M) & (np.abs(y) < 40)


def open_kerb(x: np.ndarray, y: np.ndarray, kerb: np.ndarray) -> np.ndarray:
    """Distance to the kerb of the ground's own streets (m): under the bridge there is only lawn."""
    return np.where(over_river(x, y), np.maximum(kerb, SIDEWALK_M + 0.4), kerb)


def under_deck(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """How far the ground is dug out under the bridge's deck (m), so that it never shows above it."""
    return np.where(over_river(x, y), UNDER_DECK_M * (1 - smoothstep(np.abs(y), DECK_HALF_M, DECK_HALF_M + 1.2)), 0.0)


def river_bed(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """How far the valley is cut into the ground (m, at least 0)."""
    middle = RIVER_X_M + 10 * np.sin(np.asarray(y) / 70.0)
    return RIVER_DEPTH_M * (1 - smoothstep(np.abs(x - middle), RIVER_HALF_M - 4, RIVER_HALF_M + 12))


def base_height(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Height of the streets without camber and bumps (m); smooth everywhere."""
    x, y = np.asarray(x, float), np.asarray(y, float)
    swell = 0.7 * noise(x, y, 140.0, "swell") + 1.5 * noise(x, y, 400.0, "land")
    hill = HILL_RISE_M * smoothstep(y, HILL_START_M, HILL_END_M)
    middle = 0.5 * (BRIDGE_START_M + BRIDGE_END_M)
    arch = np.cos(np.clip((x - middle) / 130.0, -1, 1) * np.pi / 2) ** 2
    return swell + hill + BRIDGE_RISE_M * arch * (1 - smoothstep(np.abs(y), 12, 45))


def bumps(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Unevenness of the country lane (m): long waves, ruts and holes."""
    waves = 0.055 * noise(x, y, 2.6, "waves") + 0.03 * noise(x, y, 1.2, "ruts")
    holes = smoothstep(noise(x, y, 1.7, "holes"), 0.45, 0.8)
    return waves - 0.05 * holes


def road_height(x: np.ndarray, y: np.ndarray, s: Survey) -> np.ndarray:
    """Height of the carriageway (m), camber and unevenness included."""
    across = np.clip(1 + s.kerb / s.half_width, 0, 1)
    camber = CAMBER_M * (1 - across**2)
    paved = 0.006 * fbm(x, y, 5.0, 2, "paved")
    return base_height(x, y) + camber + np.where(s.rural > 0.5, bumps(x, y), paved)


def ground_height(x: np.ndarray, y: np.ndarray, s: Survey | None = None) -> np.ndarray:
    """Height of the ground (m): carriageway, kerb, sidewalk, lawn or field."""
    x, y = np.asarray(x, float), np.asarray(y, float)
    s = survey(x, y) if s is None else s
    free = open_kerb(x, y, s.kerb)
    town = 1 - s.rural
    kerb = town * KERB_HEIGHT_M * np.clip(free / KERB_FACE_M, 0, 1)
    sidewalk = town * 0.02 * np.clip(free - KERB_STONE_M, 0, SIDEWALK_M)
    beyond = np.maximum(free - np.where(town > 0.5, SIDEWALK_M, 0.3), 0)
    rough = 0.06 * fbm(x, y, 3.0, 3, "lawn") * np.clip(beyond / 1.0, 0, 1)
    rough += 1.4 * noise(x, y, 45.0, "field") * smoothstep(beyond, 18, 60)
    return road_height(x, y, s) + kerb + sidewalk + rough - river_bed(x, y) - under_deck(x, y)


def deck_height(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Height of the bridge's carriageway (m); it meets the street at both ends."""
    x, y = np.asarray(x, float), np.asarray(y, float)
    return road_height(x, y, survey(x, y)) + 0.006


def surface_height(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """What one stands on (m): the bridge's deck where there is one, else the ground."""
    x, y = np.asarray(x, float), np.asarray(y, float)
    height = ground_height(x, y)
    on_deck = over_river(x, y) & (np.abs(y) < 7.5)
    return np.where(on_deck, deck_height(x, y), height) if on_deck.any() else height
