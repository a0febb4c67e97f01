#!/usr/bin/env python3
"""Compares the box mask network with MobileSAM as shipped: IoU with truth, error of the lower outline, time.

python evaluate.py --network box_masks.onnx --frames 6 SEQUENCE ...      # rendered sequences with masks/
python evaluate.py --network box_masks.onnx --clips VIDEO ...            # IoU between the two networks
"""

from __future__ import annotations

import argparse
import resource
from pathlib import Path

import cv2
import numpy as np
from collect import detect
from crops import PAD, SIDE, box_of, cut, moved, window
from teacher import MODELS, Teacher, session

SHIPPED_SIDE, SHIPPED_WINDOW = 336, 1.84
LEAST_SIDE, LEAST_SHORT = 12, 8


def cpu_s() -> float:
    """Processor time of this process."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def one_part(mask: np.ndarray) -> np.ndarray:
    """The largest part of a mask, without holes."""
    count, parts, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=4)
    if count < 2:
        return mask
    part = (parts == 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))).astype(np.uint8)
    outlines, _ = cv2.findContours(part, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    return cv2.drawContours(part, outlines, -1, 1, cv2.FILLED) > 0


class Student:
    """The small network, as `src/networks/prompt/box_net.rs` runs it."""

    def __init__(self, path: Path) -> None:
        self.network = session(path)

    def input(self, image: np.ndarray, box: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The crop with its box channel, and its area in the image."""
        area = window(box)
        size = (area[2:] - area[:2]) / SIDE
        crop = (cut(image, area, SIDE, PAD).astype(np.float32) - 128) / 64

        def along(low: float, high: float) -> np.ndarray:
            cells = np.arange(SIDE)
            return np.clip(np.minimum(high, cells + 1) - np.maximum(low, cells), 0, 1)

        low, high = (box[:2] - area[:2]) / size, (box[2:] - area[:2]) / size
        channel = along(low[1], high[1])[:, None] * along(low[0], high[0])[None]
        xs, ys = (area[k] + (np.arange(SIDE) + 0.5) * size[k] for k in (0, 1))
        channel[:, (xs < 0) | (xs >= image.shape[1])] = -1
        channel[(ys < 0) | (ys >= image.shape[0])] = -1
        return np.concatenate([crop.transpose(2, 0, 1), channel[None]])[None].astype(np.float32), area

    def mask(self, image: np.ndarray, box: np.ndarray) -> tuple[np.ndarray, float]:
        """The mask of a box and its quality."""
        tensor, area = self.input(image, box)
        logits, quality = self.network.run(None, {"crop": tensor})
        scale = SIDE / (area[2:] - area[:2])
        xs = ((np.arange(image.shape[1]) + 0.5 - area[0]) * scale[0] - 0.5).astype(np.float32)
        ys = ((np.arange(image.shape[0]) + 0.5 - area[1]) * scale[1] - 0.5).astype(np.float32)
        grid = np.meshgrid(xs, ys)
        plane = cv2.remap(logits[0, 0], *grid, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=-20)
        return one_part(plane > 0), float(quality[0, 0])


class Shipped:
    """MobileSAM at the shipped settings."""

    def __init__(self) -> None:
        self.teacher = Teacher(SHIPPED_SIDE, SHIPPED_WINDOW)

    def mask(self, image: np.ndarray, box: np.ndarray) -> tuple[np.ndarray, float]:
        """The mask of a box and its quality."""
        found = self.teacher.probability(image, box)
        if found is None:
            return np.zeros(image.shape[:2], bool), 0.0
        return one_part(found[0] > 0.5), found[1]


def overlap(a: np.ndarray, b: np.ndarray) -> float:
    """Intersection over union of two masks."""
    return float((a & b).sum() / max(1, (a | b).sum()))


def lower_error(found: np.ndarray, truth: np.ndarray) -> tuple[float, float]:
    """Mean and mean absolute error of the lowest pixel of each column, as a share of the height of the box."""
    columns = truth.any(0) & found.any(0)
    if not columns.any():
        return 1.0, 1.0
    last = lambda mask: mask.shape[0] - np.argmax(mask[::-1], 0)  # noqa: E731
    error = (last(found) - last(truth))[columns] / np.ptp(box_of(truth)[[1, 3]])
    return float(error.mean()), float(np.abs(error).mean())


def cases(sequence: Path, frames: int, shrink: float | None) -> list[tuple[np.ndarray, np.ndarray]]:
    """Images and masks of vehicles; `shrink` is the longer side, in pixels, that the vehicle gets."""
    video, found = cv2.VideoCapture(str(sequence / "video.mp4")), []
    count = int(video.get(cv2.CAP_PROP_FRAME_COUNT))
    for number in range(count):
        good, frame = video.read()
        if not good or number % max(1, count // frames):
            continue
        labels = cv2.imread(str(sequence / f"masks/{number:05d}.png"), cv2.IMREAD_GRAYSCALE)
        image = cv2.cvtColor(frame, cv2.COLOR_BGR2RGB)
        for label in (1, 2):
            mask = labels == label
            if label == 2:
                parts, pieces = cv2.connectedComponents(mask.astype(np.uint8))
                masks = [pieces == k for k in range(1, parts)]
            else:
                masks = [mask]
            for mask in masks:
                box = box_of(mask)
                if box is None or max(box[2:] - box[:2]) < LEAST_SIDE or min(box[2:] - box[:2]) < LEAST_SHORT:
                    continue
                if shrink is None:
                    found.append((image, mask))
                    continue
                scale = shrink / max(box[2] - box[0], box[3] - box[1])
                if scale < 1:
                    small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
                    size = small.shape[1::-1]
                    share = cv2.resize(mask.astype(np.float32), size, interpolation=cv2.INTER_AREA)
                    found.append((small, share > 0.5))
    return found


def compare(networks: dict, items: list, share: float, title: str) -> None:
    """One line per network."""
    for name, network in networks.items():
        r = np.random.default_rng(5)
        rows, start = [], cpu_s()
        for image, truth in items:
            box = moved(box_of(truth), share, r)
            box = np.clip(box, 0, [image.shape[1], image.shape[0]] * 2)
            found, quality = network.mask(image, box)
            rows.append((overlap(found, truth), *lower_error(found, truth), quality))
        rows, time = np.array(rows), (cpu_s() - start) / max(1, len(items))
        print(
            f"{title:24} {name:10} n {len(items):3} IoU {rows[:, 0].mean():.4f} median {np.median(rows[:, 0]):.4f} "
            f"below 0.85 {np.mean(rows[:, 0] < 0.85):.2f} lower mean {100 * rows[:, 1].mean():+.2f} % "
            f"abs {100 * rows[:, 2].mean():.2f} % quality {rows[:, 3].mean():.3f} cpu {1000 * time:.0f} ms",
            flush=True,
        )


def compare_clips(networks: dict, videos: list[Path], frames: int) -> None:
    """IoU between the networks in boxes of the detector."""
    detector = session(MODELS / "yolox_nano.onnx")
    for path in videos:
        names = sorted(path.glob("*.png")) if path.is_dir() else None
        video = None if names else cv2.VideoCapture(str(path))
        count = len(names) if names else int(video.get(cv2.CAP_PROP_FRAME_COUNT))
        rows = []
        for number in range(count):
            if names:
                frame = cv2.imread(str(names[number])) if number % max(1, count // frames) == 0 else None
            else:
                good, frame = video.read()
                if not good:
                    break
            if number % max(1, count // frames):
                continue
            image = cv2.cvtColor(frame, cv2.COLOR_BGR2RGB)
            for box in detect(detector, frame, (0.5, 1.0))[:8]:
                if max(box[2] - box[0], box[3] - box[1]) < LEAST_SIDE:
                    continue
                box = np.clip(box[:4], 0, [image.shape[1], image.shape[0]] * 2)
                (a, qa), (b, qb) = (n.mask(image, box) for n in networks.values())
                rows.append((overlap(a, b), *lower_error(a, b), qa, qb))
        rows = np.array(rows).reshape(-1, 5)
        sure = rows[rows[:, 4] > 0.75]
        for what, part in (("all", rows), ("MobileSAM sure", sure)):
            if len(part):
                print(
                    f"{path.name:34} {what:15} n {len(part):3} IoU {part[:, 0].mean():.4f} median "
                    f"{np.median(part[:, 0]):.4f} lower mean {100 * part[:, 1].mean():+.2f} % abs "
                    f"{100 * part[:, 2].mean():.2f} % quality {part[:, 3].mean():.3f}",
                    flush=True,
                )


def main() -> None:
    """Reads the arguments and compares."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--network", type=Path)
    parser.add_argument("--frames", type=int, default=6)
    parser.add_argument("--clips", action="store_true")
    parser.add_argument("--student-only", action="store_true")
    parser.add_argument("paths", type=Path, nargs="+")
    arguments = parser.parse_args()
    networks = {"small": Student(arguments.network)} if arguments.network else {}
    if not arguments.student_only:
        networks["MobileSAM"] = Shipped()
    if arguments.clips:
        compare_clips(networks, arguments.paths, arguments.frames)
        return
    everything = []
    for path in arguments.paths:
        items = cases(path, arguments.frames, None)
        everything += items
        compare(networks, items, 0.0, path.name)
    compare(networks, everything, 0.0, "all, true box")
    compare(networks, everything, 0.1, "all, moved by 10 %")
    for side in (34, 17):
        small = [item for path in arguments.paths for item in cases(path, arguments.frames, side)]
        compare(networks, small, 0.0, f"all, {side} px")


if __name__ == "__main__":
    main()
