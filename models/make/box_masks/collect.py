#!/usr/bin/env python3
"""Cuts vehicles out of real images of free licenses: training images of the box mask network, without masks.

Boxes are those of the shipped detector on tiles of several scales. Sources are Git repositories that lie in a folder
(`git clone`, with the commit that SOURCES names); each is listed with its license in models/box_masks.md.

    python collect.py --repositories DIR --output DIR
"""

from __future__ import annotations

import argparse
import json
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from teacher import MODELS, session

VEHICLES = (2, 5, 7)
INPUT = 416
LEAST_SCORE, LEAST_SIDE = 0.35, 14
CONTEXT, LONGEST = 2.6, 260


@dataclass(frozen=True)
class Source:
    """Files of a repository: prefix and endings of paths; scales for the detector, none for backgrounds."""

    repository: str
    commit: str
    license: str
    prefix: str
    endings: tuple[str, ...]
    scales: tuple[float, ...]
    every: int = 1


SOURCES = (
    Source(
        "intel-iot-devkit/sample-videos",
        "57978890822836f2b4743852f04f62fc511757e4",
        "CC BY 4.0",
        "car-detection",
        (".mp4",),
        (0.35, 0.6),
        6,
    ),
    Source(
        "OlafenwaMoses/ImageAI",
        "2156d1a39a196c72057771d1d16226388c1d7baf",
        "MIT",
        "data-videos/traffic-mini",
        (".mp4",),
        (1.0, 0.5),
        6,
    ),
    Source(
        "jekhor/aerial-cars-dataset",
        "d2ed927fe2b06e4794e90d6320152b940808ddd9",
        "CC BY 3.0 (KIT AIS)",
        "MOS",
        (".png",),
        (1.5, 3.0),
    ),
    Source(
        "jekhor/aerial-cars-dataset",
        "d2ed927fe2b06e4794e90d6320152b940808ddd9",
        "CC BY 3.0 (KIT AIS)",
        "MunichStreet",
        (".png",),
        (1.5, 3.0),
    ),
    Source("OpenDroneMap/odm_data_caliterra", "bec3dc7296e90aacb3930eb9df8061849fbfe0d0", "CC0", "", (".jpg",), ()),
    Source("OpenDroneMap/odm_data_lewis", "e3ffe160708611575dcb171a1537ef2b6e8ca68b", "CC0", "", (".jpg",), ()),
    Source("merkato/odm_boruszyn_kap", "f8e9eaba1a195ebcaab902f100df1edc8534b421", "CC BY 3.0", "", (".jpg",), ()),
    Source("obss/sahi", "9a4e5696bc7995ffc3c075460e14e2d96ae1b412", "MIT", "demo/", (".jpeg", ".jpg"), (0.5, 1.0, 2.0)),
    Source(
        "openvinotoolkit/open_model_zoo",
        "7ef5b91f75115a5eec5a67921453d7faaff8f78b",
        "Apache-2.0",
        "models/",
        (".jpg", ".jpeg"),
        (0.5, 1.0),
    ),
    Source(
        "dusty-nv/jetson-inference",
        "45da40a8f3c180191b269f57f736caaa025b8a69",
        "MIT",
        "data/images/",
        (".jpg",),
        (0.5, 1.0),
    ),
)


def decoded(output: np.ndarray) -> np.ndarray:
    """Boxes (x0, y0, x1, y1), score and class of the detector's cells."""
    cells = [
        np.stack(np.meshgrid(np.arange(INPUT // s), np.arange(INPUT // s)), -1).reshape(-1, 2) for s in (8, 16, 32)
    ]
    strides = np.concatenate([np.full((len(c), 1), s) for c, s in zip(cells, (8, 16, 32))])
    cells = np.concatenate(cells)
    centers = (output[:, :2] + cells) * strides
    sizes = np.exp(output[:, 2:4]) * strides
    scores = output[:, 4] * output[:, 5:].max(1)
    return np.column_stack([centers - sizes / 2, centers + sizes / 2, scores, output[:, 5:].argmax(1)])


def suppressed(found: np.ndarray) -> np.ndarray:
    """Non-maximum suppression at an overlap of 0.5."""
    order, kept = np.argsort(-found[:, 4]), []
    while len(order):
        best, order = order[0], order[1:]
        kept.append(best)
        low = np.maximum(found[best, :2], found[order, :2])
        high = np.minimum(found[best, 2:4], found[order, 2:4])
        shared = np.prod(np.maximum(0, high - low), 1)
        area = lambda b: np.prod(b[..., 2:4] - b[..., :2], -1)  # noqa: E731
        order = order[shared / np.minimum(area(found[best]), area(found[order])) < 0.5]
    return found[kept]


def detect(detector: object, image: np.ndarray, scales: tuple[float, ...]) -> np.ndarray:
    """Vehicles (x0, y0, x1, y1, score, class) of a BGR image, from tiles at several scales."""
    found = [np.zeros((0, 6))]
    for scale in scales:
        interpolation = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
        scaled = cv2.resize(image, None, fx=scale, fy=scale, interpolation=interpolation) if scale != 1 else image
        height, width = scaled.shape[:2]
        step = INPUT - 96
        for y in range(0, max(1, height - 96), step):
            for x in range(0, max(1, width - 96), step):
                tile = np.full((INPUT, INPUT, 3), 114, np.uint8)
                part = scaled[y : y + INPUT, x : x + INPUT]
                tile[: part.shape[0], : part.shape[1]] = part
                tensor = tile.transpose(2, 0, 1)[None].astype(np.float32)
                boxes = decoded(detector.run(None, {"images": tensor})[0][0])
                boxes = boxes[(boxes[:, 4] > LEAST_SCORE) & np.isin(boxes[:, 5], VEHICLES)]
                # Boxes that a tile cuts are left to the neighboring tile.
                inner = (boxes[:, 0] > 3) | (x == 0)
                inner &= (boxes[:, 1] > 3) | (y == 0)
                inner &= (boxes[:, 2] < INPUT - 3) & (boxes[:, 3] < INPUT - 3)
                boxes = boxes[inner]
                boxes[:, :4] = (boxes[:, :4] + (x, y, x, y)) / scale
                found.append(boxes)
    return suppressed(np.concatenate(found))


def images_of(source: Source, root: Path) -> list[tuple[str, np.ndarray]]:
    """Images of a source, in the order of their names; frames of a video at intervals."""
    folder = next(
        p for p in (root / source.repository, root / source.repository.replace("/", "+") / "repo") if p.is_dir()
    )
    git = ["git", "-C", str(folder)]
    listing = subprocess.run(
        [*git, "ls-tree", "-r", "--name-only", source.commit], capture_output=True, text=True, check=True
    )
    for name in sorted(listing.stdout.splitlines()):
        if not name.startswith(source.prefix) or not name.lower().endswith(source.endings):
            continue
        content = subprocess.run(
            [*git, "cat-file", "blob", f"{source.commit}:{name}"], capture_output=True, check=False
        )
        if content.returncode:
            continue
        if not name.endswith(".mp4"):
            image = cv2.imdecode(np.frombuffer(content.stdout, np.uint8), cv2.IMREAD_COLOR)
            if image is not None:
                yield name, image
            continue
        with tempfile.NamedTemporaryFile(suffix=".mp4") as file:
            file.write(content.stdout)
            file.flush()
            video = cv2.VideoCapture(file.name)
            number = 0
            while True:
                good, frame = video.read()
                if not good:
                    break
                if number % source.every == 0:
                    yield f"{name}#{number}", frame
                number += 1


def main() -> None:
    """Reads the arguments and cuts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repositories", type=Path, required=True)
    parser.add_argument("--output", type=Path, required=True)
    parser.add_argument("--most", type=int, default=60, help="boxes of one image at most")
    arguments = parser.parse_args()
    arguments.output.mkdir(parents=True, exist_ok=True)
    detector = session(MODELS / "yolox_nano.onnx")
    for s, source in enumerate(SOURCES):
        listing = arguments.output / f"{s:02d}.json"
        if listing.is_file() or not source.scales:
            continue
        entries = []
        for name, image in images_of(source, arguments.repositories):
            boxes = detect(detector, image, source.scales)[: arguments.most]
            for box in boxes:
                side = max(box[2] - box[0], box[3] - box[1])
                if side < LEAST_SIDE:
                    continue
                middle, half = (box[:2] + box[2:4]) / 2, CONTEXT * side / 2
                low = np.maximum(0, np.floor(middle - half)).astype(int)
                high = np.minimum(image.shape[1::-1], np.ceil(middle + half)).astype(int)
                part = image[low[1] : high[1], low[0] : high[0]]
                scale = min(1.0, LONGEST / side)
                if scale < 1:
                    part = cv2.resize(part, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
                file = f"{s:02d}_{len(entries):05d}.webp"
                cv2.imwrite(str(arguments.output / file), part, [cv2.IMWRITE_WEBP_QUALITY, 90])
                inside = ((box[:4] - (*low, *low)) * scale).round(2).tolist()
                entries.append({"file": file, "box": inside, "score": round(float(box[4]), 3), "from": name})
        listing.write_text(json.dumps({"repository": source.repository, "license": source.license, "boxes": entries}))
        print(f"{source.repository} {source.prefix}: {len(entries)} vehicles", flush=True)


if __name__ == "__main__":
    main()
