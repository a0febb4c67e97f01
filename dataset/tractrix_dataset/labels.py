"""Label maps: from Blender's object-index pass to masks and semantic maps."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

os.environ.setdefault("OPENCV_IO_ENABLE_OPENEXR", "1")
import cv2  # noqa: E402

SKY, TARGET, OTHER, GROUND, STATIC = range(5)


def read_index_pass(path: Path) -> np.ndarray:
    """The object-index pass (H, W) as small integers."""
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if image is None:
        raise OSError(f"{path}: no index pass there; render the frame again")
    image = image if image.ndim == 2 else image[..., -1]
    return np.rint(image).astype(np.uint8)


def tidy(labels: np.ndarray) -> np.ndarray:
    """Removes the sampling noise at the target's outline (3x3 median)."""
    target = (labels == TARGET).astype(np.uint8)
    smooth = cv2.medianBlur(target, 3)
    around = cv2.dilate(np.where(target == 1, 0, labels).astype(np.uint8), np.ones((3, 3), np.uint8))
    tidied = np.where((target == 1) & (smooth == 0), around, labels)
    return np.where(smooth == 1, TARGET, tidied).astype(np.uint8)


def mask_of(semantic: np.ndarray) -> np.ndarray:
    """The mask of a semantic map: 0 background, 1 target, 2 other moving vehicles."""
    return np.where((semantic == TARGET) | (semantic == OTHER), semantic, 0).astype(np.uint8)


def write_png(path: Path, image: np.ndarray) -> None:
    """Writes an 8-bit PNG, whole or not at all."""
    partial = path.with_suffix(".partial.png")
    if not cv2.imwrite(str(partial), image, [cv2.IMWRITE_PNG_COMPRESSION, 9]):
        raise OSError(f"{path}: cannot be written; is the disk full?")
    partial.replace(path)
