"""Geometry of the network's input, the same in training and in `src/networks/prompt/box_net.rs`.

A box lies in the middle of its crop. The crop has MARGIN times the sides of the box, and neither side counts for less
than half the other, so that long boxes are not distorted by more than a factor of two.
"""

from __future__ import annotations

import cv2
import numpy as np

SIDE = 128
MARGIN = 1.5
MAX_STRETCH = 2.0
# Tiles hold more than a crop, so that training can move and scale the box.
TILE = 256
TILE_MARGIN = 2.1
# Pixels beyond the border of the image.
PAD = 114


def window(box: np.ndarray, margin: float = MARGIN) -> np.ndarray:
    """The crop (x0, y0, x1, y1) of a box, in pixels of the image."""
    width, height = box[2] - box[0], box[3] - box[1]
    half_x = 0.5 * margin * max(width, height / MAX_STRETCH)
    half_y = 0.5 * margin * max(height, width / MAX_STRETCH)
    x, y = 0.5 * (box[0] + box[2]), 0.5 * (box[1] + box[3])
    return np.array([x - half_x, y - half_y, x + half_x, y + half_y])


def cut(image: np.ndarray, area: np.ndarray, side: int, pad: float = PAD) -> np.ndarray:
    """The image in `area`, scaled to side by side pixels: area means where it shrinks, linear where it grows."""
    x0, y0 = np.floor(area[:2]).astype(int)
    x1, y1 = np.ceil(area[2:]).astype(int)
    height, width = image.shape[:2]
    left, top, right, bottom = max(0, -x0), max(0, -y0), max(0, x1 - width), max(0, y1 - height)
    part = image[max(0, y0) : max(0, min(height, y1)), max(0, x0) : max(0, min(width, x1))]
    if left or top or right or bottom:
        value = [pad] * 3
        part = cv2.copyMakeBorder(part, top, bottom, left, right, cv2.BORDER_CONSTANT, value=value)
    scale = np.array([side / (area[2] - area[0]), side / (area[3] - area[1])])
    for axis in (0, 1):
        while scale[axis] < 0.5:
            size = [part.shape[1], part.shape[0]]
            size[axis] = max(1, (size[axis] + 1) // 2)
            shrink = size[axis] / (part.shape[1], part.shape[0])[axis]
            part = cv2.resize(part, size, interpolation=cv2.INTER_AREA)
            scale[axis] /= shrink
    full = np.array([part.shape[1] / (x1 - x0), part.shape[0] / (y1 - y0)])
    offset = (area[:2] - (x0, y0)) * full
    matrix = np.array([[scale[0], 0, -offset[0] * scale[0]], [0, scale[1], -offset[1] * scale[1]]])
    # Pixel centers are at 0.5.
    matrix[:, 2] += 0.5 * scale - 0.5
    border = cv2.BORDER_REPLICATE
    return cv2.warpAffine(part, matrix, (side, side), flags=cv2.INTER_LINEAR, borderMode=border)


def box_of(mask: np.ndarray) -> np.ndarray | None:
    """The box around a mask's pixels; none for an empty one."""
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    if len(rows) == 0:
        return None
    return np.array([columns[0], rows[0], columns[-1] + 1, rows[-1] + 1], float)


def iou(a: np.ndarray, b: np.ndarray) -> float:
    """Intersection over union of two boxes."""
    sides = np.maximum(0, np.minimum(a[2:], b[2:]) - np.maximum(a[:2], b[:2]))
    shared = sides[0] * sides[1]
    area = lambda box: (box[2] - box[0]) * (box[3] - box[1])  # noqa: E731
    return float(shared / max(1e-9, area(a) + area(b) - shared))


def moved(box: np.ndarray, share: float, r: np.random.Generator) -> np.ndarray:
    """The box with every side moved by up to a share of its length."""
    size = np.array([box[2] - box[0], box[3] - box[1]] * 2)
    return box + r.uniform(-share, share, 4) * size
