#!/usr/bin/env python3
"""Makes training tiles: an image around a box, the probability of the object per pixel, the box.

Rendered frames have true masks. Real crops and photographs get the masks of MobileSAM: in crops those of the
detector's boxes, in photographs those of any object that a point prompt finds and its own box confirms. A stopped run
resumes: finished parts are kept.

    python tiles.py --renders DIR --real DIR --photos DIR --output DIR --processes 16
"""

from __future__ import annotations

import argparse
import json
import os
import zlib
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
from crops import TILE, TILE_MARGIN, box_of, cut, iou, window
from teacher import Teacher

FIRST_LABEL = 10
LEAST_SIDE, LEAST_SOLID = 16, 0.85
LEAST_QUALITY = 0.84
RENDER, REAL, PHOTO, EMPTY, SYNTHETIC = range(5)


@dataclass
class Tiles:
    """Tiles of one file. Boxes are in pixels of the tile, `scale` is tile pixels per image pixel, x and y."""

    image: list[np.ndarray] = field(default_factory=list)
    mask: list[np.ndarray] = field(default_factory=list)
    box: list[np.ndarray] = field(default_factory=list)
    scale: list[np.ndarray] = field(default_factory=list)
    kind: list[int] = field(default_factory=list)

    def add(self, image: np.ndarray, mask: np.ndarray, box: np.ndarray, kind: int) -> None:
        """Cuts a tile from an RGB image and a mask of 0 to 255, maybe of another size."""
        area = window(box, TILE_MARGIN)
        scale = TILE / (area[2:] - area[:2])
        self.image.append(cut(image, area, TILE))
        self.mask.append(cut(mask[..., None].repeat(3, 2), area, TILE, 0)[..., 0])
        self.box.append(((box.reshape(2, 2) - area[:2]) * scale).ravel())
        self.scale.append(scale)
        self.kind.append(kind)

    def save(self, path: Path) -> None:
        """Writes an archive, whole or not at all."""
        partial = path.with_suffix(".partial.npz")
        content = {
            "image": np.array(self.image, np.uint8).reshape(-1, TILE, TILE, 3),
            "mask": np.array(self.mask, np.uint8).reshape(-1, TILE, TILE),
            "box": np.array(self.box, np.float32).reshape(-1, 4),
            "scale": np.array(self.scale, np.float32).reshape(-1, 2),
            "kind": np.array(self.kind, np.uint8),
        }
        np.savez(partial, **content)
        partial.replace(path)


def degraded(image: np.ndarray, r: np.random.Generator) -> np.ndarray:
    """A copy as a worse camera records it: shrunk and grown again, compressed."""
    height, width = image.shape[:2]
    factor = float(np.exp(r.uniform(np.log(0.3), 0.0)))
    small = cv2.resize(image, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
    if r.random() < 0.3:
        small = cv2.addWeighted(small, 1.8, cv2.GaussianBlur(small, (0, 0), 1.2), -0.8, 0)
    quality = [cv2.IMWRITE_JPEG_QUALITY, int(r.integers(25, 85))]
    small = cv2.imdecode(cv2.imencode(".jpg", small, quality)[1], cv2.IMREAD_COLOR)
    return cv2.resize(small, (width, height), interpolation=cv2.INTER_LINEAR)


def read(path: Path) -> np.ndarray:
    """An RGB image."""
    return cv2.cvtColor(cv2.imread(str(path), cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB)


def instances(labels: np.ndarray) -> list[np.ndarray]:
    """Masks of the vehicles of a rendered frame that are large enough and not behind leaves."""
    found = []
    for label in np.unique(labels[labels >= FIRST_LABEL]):
        mask = cv2.medianBlur((labels == label).astype(np.uint8), 3)
        count, parts, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=4)
        if count < 2:
            continue
        mask = (parts == 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))).astype(np.uint8)
        box = box_of(mask)
        if max(box[2] - box[0], box[3] - box[1]) < LEAST_SIDE or min(box[2] - box[0], box[3] - box[1]) < 9:
            continue
        closed = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, np.ones((7, 7), np.uint8))
        if mask.sum() >= LEAST_SOLID * closed.sum():
            found.append(mask)
    return found


def render_tiles(path: Path, variants: int) -> Tiles:
    """Tiles of one rendered frame: as it is, degraded, and boxes without an object."""
    r = np.random.default_rng(zlib.crc32(path.name.encode()))
    image = read(path)
    labels = cv2.imread(str(path.with_suffix(".png")), cv2.IMREAD_GRAYSCALE)
    masks, tiles = instances(labels), Tiles()
    for variant in range(variants):
        seen = image if variant == 0 else degraded(image, r)
        for mask in masks:
            tiles.add(seen, mask * 255, box_of(mask), RENDER)
    for _ in range(2 + len(masks) // 3):
        width, height = np.exp(r.uniform(np.log(14), np.log(200), 2))
        x, y = r.uniform(0, image.shape[1] - width), r.uniform(0, image.shape[0] - height)
        box = np.array([x, y, x + width, y + height])
        inside = labels[int(y) : int(y + height) + 1, int(x) : int(x + width) + 1] >= FIRST_LABEL
        if inside.mean() < 0.04 and max(width, height) < 4 * min(width, height):
            tiles.add(image, np.zeros(image.shape[:2], np.uint8), box, EMPTY)
    return tiles


def taught(image: np.ndarray, box: np.ndarray, teacher: Teacher) -> tuple[np.ndarray, np.ndarray] | None:
    """The teacher's mask of a box (0 to 255) and the mask's own box, where the teacher is sure."""
    found = teacher.probability(image, box)
    if found is None or found[1] < LEAST_QUALITY:
        return None
    inside = (found[0] > 0.5).astype(np.uint8)
    count, parts, stats, _ = cv2.connectedComponentsWithStats(inside, connectivity=4)
    if count < 2:
        return None
    largest = 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))
    own = box_of(parts == largest)
    fill = stats[largest, cv2.CC_STAT_AREA] / ((own[2] - own[0]) * (own[3] - own[1]))
    if fill < 0.35 or stats[largest, cv2.CC_STAT_AREA] < 0.97 * inside.sum():
        return None
    return np.where((parts == largest) | (found[0] < 0.5), np.rint(found[0] * 255), 0).astype(np.uint8), own


def label(folder: Path, entry: dict, teacher: Teacher) -> np.ndarray | None:
    """The teacher's mask of a detected vehicle if its own box confirms the detector's; kept beside the crop."""
    kept = (folder / entry["file"]).with_suffix(".png")
    if not kept.is_file():
        image, box = read(folder / entry["file"]), np.array(entry["box"])
        mask = np.zeros(image.shape[:2], np.uint8)
        first = taught(image, box, teacher)
        if first is not None and iou(first[1], box) > 0.6:
            second = taught(image, first[1], teacher)
            if second is not None and iou(second[1], first[1]) > 0.85:
                mask = second[0]
        cv2.imwrite(str(kept), mask)
    mask = cv2.imread(str(kept), cv2.IMREAD_GRAYSCALE)
    return mask if (mask > 127).any() else None


def real_tiles(folder: Path, entry: dict, teacher: Teacher) -> Tiles:
    """Tiles of one detected vehicle; its box is that of the teacher's mask."""
    tiles = Tiles()
    mask = label(folder, entry, teacher)
    if mask is None:
        return tiles
    image = read(folder / entry["file"])
    r = np.random.default_rng(zlib.crc32(entry["file"].encode()))
    for seen in (image, degraded(image, r)):
        tiles.add(seen, mask, box_of(mask > 127), REAL)
    return tiles


def photo_tiles(path: Path, teacher: Teacher, prompts: int) -> Tiles:
    """Tiles of objects of any kind: boxes at random places, drawn tight by the teacher, confirmed by it."""
    r = np.random.default_rng(zlib.crc32(path.name.encode()))
    image, tiles, kept = read(path), Tiles(), []
    for _ in range(prompts):
        width, height = np.exp(r.uniform(np.log(24), np.log(220))) * np.exp(r.uniform(-0.4, 0.4, 2))
        x, y = r.uniform(0, image.shape[1] - width), r.uniform(0, image.shape[0] - height)
        box = np.array([x, y, x + width, y + height])
        reach = 1.6 * max(width, height)
        x0, y0 = (int(max(0, v)) for v in (x - reach, y - reach))
        part = image[y0 : int(y + height + reach), x0 : int(x + width + reach)]
        offset = np.array([x0, y0, x0, y0])
        first = teacher.logits(part, box - offset)
        if first is None:
            continue
        logits, area, _ = first
        step = np.array([(area[2] - area[0]) / logits.shape[1], (area[3] - area[1]) / logits.shape[0]])
        own = box_of(logits > 0) * np.array([*step, *step]) + np.array([*area[:2], *area[:2]])
        second = taught(part, own, teacher)
        if second is None or iou(second[1], own) < 0.85 or min(second[1][2:] - second[1][:2]) < 10:
            continue
        if any(iou(second[1] + offset, other) > 0.7 for other in kept):
            continue
        kept.append(second[1] + offset)
        tiles.add(part, second[0], second[1], PHOTO)
    return tiles


def work(job: tuple) -> int:
    """One job of the pool; returns the number of tiles."""
    cv2.setNumThreads(1)
    kind, output, *rest = job
    if output.is_file():
        return len(np.load(output)["kind"])
    if kind == RENDER:
        tiles = render_tiles(*rest)
    else:
        global _teacher
        if "_teacher" not in globals():
            _teacher = Teacher()
        if kind == REAL:
            tiles = Tiles()
            folder, entries = rest
            for entry in entries:
                found = real_tiles(folder, entry, _teacher)
                for name in ("image", "mask", "box", "scale", "kind"):
                    getattr(tiles, name).extend(getattr(found, name))
        else:
            tiles = photo_tiles(rest[0], _teacher, rest[1])
    tiles.save(output)
    return len(tiles.kind)


def main() -> None:
    """Reads the arguments and makes tiles."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--renders", type=Path, required=True)
    parser.add_argument("--real", type=Path, required=True)
    parser.add_argument("--photos", type=Path, required=True)
    parser.add_argument("--output", type=Path, required=True)
    parser.add_argument("--processes", type=int, default=os.cpu_count())
    parser.add_argument("--variants", type=int, default=3, help="tiles of one rendered vehicle")
    parser.add_argument("--prompts", type=int, default=60, help="boxes tried in one photograph")
    parser.add_argument("--only", type=int, default=1000000, help="number of files of each kind, for a try")
    arguments = parser.parse_args()
    arguments.output.mkdir(parents=True, exist_ok=True)
    jobs = []
    renders = sorted(p for p in arguments.renders.glob("*") if p.suffix in (".webp", ".jpg"))
    for path in renders[: arguments.only]:
        if path.with_suffix(".png").is_file():
            jobs.append((RENDER, arguments.output / f"render_{path.stem}.npz", path, arguments.variants))
    for path in sorted(arguments.real.glob("*.json")):
        entries = json.loads(path.read_text())["boxes"][: 8 * arguments.only]
        for k in range(0, len(entries), 8):
            name = f"real_{path.stem}_{k:05d}.npz"
            jobs.append((REAL, arguments.output / name, arguments.real, entries[k : k + 8]))
    photos = sorted(p for p in arguments.photos.glob("*") if p.suffix in (".webp", ".jpg"))
    for path in photos[: arguments.only]:
        jobs.append((PHOTO, arguments.output / f"photo_{path.stem}.npz", path, arguments.prompts))
    counts = {"photo": 0, "real": 0, "render": 0}
    with ProcessPoolExecutor(arguments.processes) as pool:
        for job, count in zip(jobs, pool.map(work, jobs)):
            counts[job[1].name.split("_")[0]] += count
    print("tiles:", counts, flush=True)


if __name__ == "__main__":
    main()
