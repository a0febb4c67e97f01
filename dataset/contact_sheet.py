#!/usr/bin/env python3
"""Contact sheets from rendered sequences, as small JPEG files: per trajectory, per vehicle, of all scenarios."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from tractrix_dataset.scenarios import SCENARIOS

TILE, SMALL_TILE = (320, 180), (256, 144)
CROP = (240, 180)
COLUMNS = 4
MAX_BYTES = 120 * 1024
N_PER_SEQUENCE = 8


def frames_of(folder: Path, indices: list[int]) -> dict[int, np.ndarray]:
    """The chosen frames of a sequence's video, by index."""
    capture = cv2.VideoCapture(str(folder / "video.mp4"))
    found = {}
    index = 0
    while len(found) < len(indices):
        good, image = capture.read()
        if not good:
            break
        if index in indices:
            found[index] = image
        index += 1
    return found


def chosen(n_frames: int, count: int) -> list[int]:
    """Evenly spread frame indices."""
    return sorted({int(i) for i in np.linspace(0, n_frames - 1, count)})


def labelled(image: np.ndarray, words: str) -> np.ndarray:
    """A tile with a caption."""
    image = image.copy()
    for color, width in (((0, 0, 0), 3), ((255, 255, 255), 1)):
        cv2.putText(image, words, (5, 14), cv2.FONT_HERSHEY_SIMPLEX, 0.42, color, width, cv2.LINE_AA)
    return image


def crop_target(image: np.ndarray, mask: np.ndarray) -> np.ndarray | None:
    """The target with some surroundings, in the shape of a crop tile; none where it is hardly seen."""
    ys, xs = np.nonzero(mask == 1)
    if len(xs) < 500:
        return None
    half_h = 0.62 * max(np.ptp(ys), np.ptp(xs) * CROP[1] / CROP[0])
    half_w = half_h * CROP[0] / CROP[1]
    cx, cy = (xs.min() + xs.max()) / 2, (ys.min() + ys.max()) / 2
    patch = cv2.getRectSubPix(image, (int(2 * half_w), int(2 * half_h)), (float(cx), float(cy)))
    return cv2.resize(patch, CROP, interpolation=cv2.INTER_AREA)


def write_sheet(path: Path, tiles: list[np.ndarray]) -> None:
    """Tiles in rows, as a JPEG of at most ``MAX_BYTES``."""
    blank = np.full_like(tiles[0], 255)
    tiles = tiles + [blank] * (-len(tiles) % COLUMNS)
    sheet = np.vstack([np.hstack(tiles[i : i + COLUMNS]) for i in range(0, len(tiles), COLUMNS)])
    for quality in range(88, 20, -6):
        _, data = cv2.imencode(".jpg", sheet, [cv2.IMWRITE_JPEG_QUALITY, quality])
        if len(data) <= MAX_BYTES:
            break
    path.write_bytes(data.tobytes())


def scenario_tiles(folder: Path, scene: dict) -> list[np.ndarray]:
    """Four frames of a scenario, with its name."""
    frames = frames_of(folder, chosen(scene["n_frames"], COLUMNS))
    small = {i: cv2.resize(image, SMALL_TILE, interpolation=cv2.INTER_AREA) for i, image in frames.items()}
    return [labelled(image, f"{scene['trajectory']} {scene['vehicle']} {i}") for i, image in small.items()]


def trajectory_tiles(folder: Path, scene: dict) -> list[np.ndarray]:
    """Four frames of a sequence."""
    frames = frames_of(folder, chosen(scene["n_frames"], COLUMNS))
    small = {i: cv2.resize(image, TILE, interpolation=cv2.INTER_AREA) for i, image in frames.items()}
    return [labelled(image, f"{scene['vehicle']} {i}") for i, image in small.items()]


def vehicle_tiles(folder: Path, scene: dict) -> list[np.ndarray]:
    """Four crops of the vehicle."""
    tiles = []
    for i, image in frames_of(folder, chosen(scene["n_frames"], COLUMNS)).items():
        patch = crop_target(image, cv2.imread(str(folder / scene["frames"][i]["mask"]), cv2.IMREAD_GRAYSCALE))
        if patch is not None:
            tiles.append(labelled(patch, f"{scene['trajectory']} {i}"))
    return tiles


def sheets_of(scene: dict) -> list[tuple[str, Callable[[Path, dict], list[np.ndarray]]]]:
    """The sheets that a sequence is shown on: name, and what makes its tiles."""
    if scene["trajectory"] in SCENARIOS:
        return [("scenarios", scenario_tiles)]
    return [(f"trajectory_{scene['trajectory']}", trajectory_tiles), (f"vehicle_{scene['vehicle']}", vehicle_tiles)]


def main() -> None:
    """Groups the sequences of a folder and writes their sheets."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("sequences", type=Path, help="folder of sequences")
    parser.add_argument("--output", type=Path, required=True, help="folder of the sheets, such as docs/pictures")
    arguments = parser.parse_args()
    arguments.output.mkdir(parents=True, exist_ok=True)
    sheets: dict[str, list[np.ndarray]] = {}
    for path in sorted(arguments.sequences.glob("*/scene.json")):
        scene = json.loads(path.read_text())
        for name, tiles in sheets_of(scene):
            sheets.setdefault(name, []).extend(tiles(path.parent, scene))
    for name, tiles in sheets.items():
        if tiles:
            write_sheet(arguments.output / f"{name}.jpg", tiles[: 8 * COLUMNS])
            print(f"{name}.jpg: {len(tiles)} pictures")


if __name__ == "__main__":
    main()
